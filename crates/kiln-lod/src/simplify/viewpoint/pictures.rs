//! Pictures for people: a texture beside its regions, and what the views see of them.

use glam::{DVec2, Vec2};
use kiln_asset::{Mesh, Raster, SubmeshId};
use kiln_geom::raster::{Rect, rasterise_exact};
use kiln_geom::sample::hash;

use super::cameras::View;
use super::regions::{RegionMap, Regions};
use crate::simplify::texture_border::uv_sets;

/// Least longest side of a segmented picture, pixels: smaller ones are drawn larger.
const SIDE: u32 = 512;
/// Empty pixels between pictures.
const GAP: u32 = 8;
const PAPER: [u8; 4] = [24, 24, 26, 255];
const BACKGROUND: [u8; 4] = [48, 50, 54, 255];
const OUTLINE: [u8; 4] = [0, 0, 0, 255];

/// A colour for an id, the same in every picture; neighbouring ids differ. 0, the background, is grey.
pub fn false_colour(id: u32) -> [u8; 4] {
    if id == 0 {
        return BACKGROUND;
    }
    let bits = hash(u64::from(id));
    // One channel strong, one weak, one between: no id is grey like the background or black like an outline.
    let [strong, weak, between] = [200 + bits % 56, 20 + (bits >> 8) % 90, 60 + (bits >> 16) % 190].map(|c| c as u8);
    match (bits >> 32) % 6 {
        0 => [strong, weak, between, 255],
        1 => [strong, between, weak, 255],
        2 => [weak, strong, between, 255],
        3 => [between, strong, weak, 255],
        4 => [weak, between, strong, 255],
        _ => [between, weak, strong, 255],
    }
}

/// `texture`, and beside it its regions in false colours with black outlines. A submesh of one region gives an empty picture.
pub fn segmentation_picture(texture: &Raster, map: &RegionMap) -> Raster {
    let RegionMap::Picture { width, height, ids, .. } = map else { return Raster::default() };
    let (width, height) = (*width, *height);
    if texture.texels.is_empty() || ids.is_empty() {
        return Raster::default();
    }
    let scale = (SIDE / width.max(height)).max(1);
    let (wide, high) = (width * scale, height * scale);
    let mut out = Raster::filled(2 * wide + GAP, high, PAPER);
    let stride = out.width as usize;
    let id = |x: u32, y: u32| ids[(y / scale) as usize * width as usize + (x / scale) as usize];
    for y in 0..high {
        for x in 0..wide {
            let column = (u64::from(x) * u64::from(texture.width) / u64::from(wide)) as usize;
            let row = (u64::from(y) * u64::from(texture.height) / u64::from(high)) as usize;
            let at = y as usize * stride + x as usize;
            let [r, g, b, _] = texture.texels[row * texture.width as usize + column];
            out.texels[at] = [r, g, b, 255];
            let own = id(x, y);
            let ends = (x + 1 < wide && id(x + 1, y) != own) || (y + 1 < high && id(x, y + 1) != own);
            out.texels[at + (wide + GAP) as usize] = if ends { OUTLINE } else { false_colour(own) };
        }
    }
    out
}

/// What `view` sees: `[size * size]`, top row first, the region of each pixel, 0 where nothing is. Without `regions` a face's is its
/// index plus 1. Both sides of faces are drawn; of two at one depth the lower face is seen. For people: the metric's own item
/// buffers are made in integers throughout.
pub fn item_buffer(mesh: &Mesh, regions: Option<&Regions>, view: &View) -> Vec<u32> {
    let rect = Rect::whole(view.size, view.size);
    let mut ids = vec![0; view.size as usize * view.size as usize];
    let mut depths = vec![f64::INFINITY; ids.len()];
    for (face, (triangle, submesh)) in mesh.triangles.iter().zip(&mesh.face_submesh).enumerate() {
        let seen = triangle.map(|v| view.project(mesh.positions[v as usize].as_dvec3()));
        if view.distance.is_some_and(|distance| seen.iter().any(|p| distance + p[2] <= 0.0)) {
            continue;
        }
        let corners = seen.map(|p| Vec2::new(p[0] as f32, p[1] as f32));
        let uvs = triangle.map(|v| uv_sets(mesh, v).map(|uv| uv.as_dvec2()));
        rasterise_exact(corners, rect, |x, y, weights, area| {
            let shares = weights.map(|w| w as f64 / area as f64);
            let depth = shares[0] * seen[0][2] + shares[1] * seen[1][2] + shares[2] * seen[2][2];
            let at = y as usize * view.size as usize + x as usize;
            if depth < depths[at] {
                depths[at] = depth;
                ids[at] = region(regions, face as u32, *submesh, &uvs, shares);
            }
        });
    }
    ids
}

fn region(regions: Option<&Regions>, face: u32, submesh: SubmeshId, uvs: &[[DVec2; 2]; 3], shares: [f64; 3]) -> u32 {
    let uv = |set: usize| shares[0] * uvs[0][set] + shares[1] * uvs[1][set] + shares[2] * uvs[2][set];
    regions.map_or(face + 1, |regions| regions.at(submesh, [uv(0), uv(1)]))
}

/// The item buffers of all `views` in false colours, side by side in rows, in the views' order.
pub fn view_sheet(mesh: &Mesh, regions: Option<&Regions>, views: &[View]) -> Raster {
    let Some(size) = views.iter().map(|view| view.size).max() else { return Raster::default() };
    let columns = (1..).find(|c: &u32| c * c >= views.len() as u32).unwrap_or(1);
    let rows = (views.len() as u32).div_ceil(columns);
    let step = size + GAP;
    let mut out = Raster::filled(columns * step + GAP, rows * step + GAP, PAPER);
    for (k, view) in views.iter().enumerate() {
        let (x, y) = (GAP + k as u32 % columns * step, GAP + k as u32 / columns * step);
        let ids = item_buffer(mesh, regions, view);
        for (row, line) in ids.chunks(view.size as usize).enumerate() {
            let at = (y as usize + row) * out.width as usize + x as usize;
            for (texel, id) in out.texels[at..at + line.len()].iter_mut().zip(line) {
                *texel = false_colour(*id);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::fixtures;
    use crate::simplify::viewpoint::{Cameras, views};

    #[test]
    fn a_sphere_is_a_disc_from_everywhere() {
        let mesh = fixtures::sphere(48, 24);
        let regions = Regions { count: 2, maps: vec![RegionMap::Whole(1)] };
        for view in views(Cameras::Dodecahedron, 100, &mesh) {
            let ids = item_buffer(&mesh, Some(&regions), &view);
            let seen = ids.iter().filter(|id| **id == 1).count();
            let disc = std::f64::consts::PI * (50.0f64 / 1.02).powi(2);
            assert!((seen as f64 / disc - 1.0).abs() < 0.02, "{seen} of {disc}");
            assert_eq!([ids[0], ids[99], ids[9900], ids[5050]], [0, 0, 0, 1]);
            let faces: BTreeSet<u32> = item_buffer(&mesh, None, &view).into_iter().collect();
            // About half of them, each by its own id.
            assert!(faces.len() > mesh.face_count() / 3 && faces.len() < 2 * mesh.face_count() / 3, "{}", faces.len());
            assert_eq!(faces.first(), Some(&0));
        }
    }

    #[test]
    fn regions_follow_the_uvs_and_the_nearer_face_is_seen() {
        // Two squares, one behind the other; u runs with x.
        let mut raw = fixtures::grid(1, 1).into_raw();
        let back: Vec<glam::Vec3> = raw.positions.iter().map(|p| *p - 0.5 * glam::Vec3::Z).collect();
        raw.uv0 = Some(raw.positions.iter().chain(&back).map(|p| Vec2::new(p.x, p.y)).collect());
        raw.positions.extend(back);
        raw.triangles.extend([[4, 5, 6], [5, 7, 6]]);
        raw.face_submesh = [0, 0, 1, 1].map(SubmeshId).to_vec();
        raw.submeshes.push(kiln_asset::Submesh { name: "behind".into(), ..raw.submeshes[0].clone() });
        raw.points.clear();
        let mesh = Mesh::new(raw).expect("a sound mesh");
        let wrap = [kiln_asset::Wrap::ClampToEdge; 2];
        let front = RegionMap::Picture { width: 2, height: 1, wrap, ids: vec![1, 2].into(), set: 0 };
        let regions = Regions { count: 4, maps: vec![front, RegionMap::Whole(3)] };
        let base = views(Cameras::Dodecahedron, 64, &mesh)[0];
        let from = |back: glam::DVec3| View { right: glam::DVec3::Y.cross(back), up: glam::DVec3::Y, back, ..base };
        let ids = item_buffer(&mesh, Some(&regions), &from(glam::DVec3::Z));
        assert_eq!([ids[32 * 64 + 20], ids[32 * 64 + 44]], [1, 2]);
        assert!(!ids.contains(&3));
        let ids = item_buffer(&mesh, Some(&regions), &from(-glam::DVec3::Z));
        assert_eq!([ids[32 * 64 + 20], ids[32 * 64 + 44]], [3, 3]);
    }

    #[test]
    fn pictures_show_every_region_and_their_outlines() {
        let texture = Raster::filled(8, 4, [9, 8, 7, 255]);
        let ids: Vec<u32> = (0..8).map(|i| if i % 4 < 2 { 5 } else { 6 }).collect();
        let wrap = [kiln_asset::Wrap::Repeat; 2];
        let map = RegionMap::Picture { width: 4, height: 2, wrap, ids: ids.into(), set: 0 };
        let picture = segmentation_picture(&texture, &map);
        assert_eq!((picture.width, picture.height), (2 * 512 + 8, 256));
        let at = |x: u32, y: u32| picture.texels[(y * picture.width + x) as usize];
        assert_eq!(at(10, 10), [9, 8, 7, 255]);
        assert_eq!([at(520, 0), at(520 + 255, 9), at(520 + 256, 9)], [false_colour(5), OUTLINE, false_colour(6)]);
        assert_eq!(segmentation_picture(&texture, &RegionMap::Whole(1)), Raster::default());
        let colours: BTreeSet<[u8; 4]> = (0..200).map(false_colour).collect();
        assert!(colours.len() > 195 && !colours.contains(&OUTLINE));
    }

    #[test]
    fn the_sheet_has_a_place_for_every_view() {
        let mesh = fixtures::sphere(12, 6);
        let sheet = view_sheet(&mesh, None, &views(Cameras::Icosahedron, 32, &mesh));
        assert_eq!((sheet.width, sheet.height), (4 * 40 + 8, 3 * 40 + 8));
        let middle = |k: u32| sheet.texels[((8 + k / 4 * 40 + 16) * sheet.width + 8 + k % 4 * 40 + 16) as usize];
        assert!((0..12).all(|k| ![PAPER, BACKGROUND].contains(&middle(k))));
        assert_eq!(view_sheet(&mesh, None, &[]), Raster::default());
    }
}
