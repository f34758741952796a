//! Splits vertices where charts split: one wedge for each (vertex, UV) that some corner wants.

use glam::{DVec2, Vec2};
use kiln_asset::{FaceId, Mesh, RawMesh};

use super::UnwrapOutput;
use super::surface::Surface;

/// `mesh` with `atlas_uv`. `sheets`: what lies on each, in order; `sheet_of`: `[submesh_count]`. Triangles keep their order,
/// points their ids. A face without a chart gets a single UV for all three corners: that of the first of its points that has one
/// on its sheet, else that of the sheet's first charted face; it covers nothing.
pub(super) fn split(mesh: &Mesh, sheets: &[(&Surface, &UnwrapOutput)], sheet_of: &[u32], size: u32) -> Mesh {
    let (mut raw, atlas_uv) = split_wedges(mesh, &corner_uvs(mesh, sheets, sheet_of, size), Vec2::ZERO);
    raw.atlas_uv = Some(atlas_uv);
    Mesh::new(raw).expect("invariant: wedges copied from a valid mesh, UVs finite by `orient`, every point kept")
}

/// `[face_count] x 3` UVs for all faces of the mesh, sheet `s` in `[s, s + 1] x [0, 1]`.
fn corner_uvs(mesh: &Mesh, sheets: &[(&Surface, &UnwrapOutput)], sheet_of: &[u32], size: u32) -> Vec<[Vec2; 3]> {
    let mut corner_uvs = vec![None; mesh.face_count()];
    // A point may have charts on several sheets: (sheet, UV) of the last that was laid.
    let mut point_uv = vec![None; mesh.point_count()];
    for (sheet, (surface, charts)) in sheets.iter().enumerate() {
        let mut anywhere = None;
        for (face, corners) in surface.faces.iter().zip(&charts.corners) {
            let uvs = corners.map(|texel| on_sheet(texel, size, sheet));
            for (point, uv) in mesh.face_points(*face).iter().zip(uvs) {
                match &mut point_uv[point.index()] {
                    Some((known, _)) if *known == sheet => {}
                    entry => *entry = Some((sheet, uv)),
                }
            }
            corner_uvs[face.index()] = Some(uvs);
            anywhere.get_or_insert(uvs[0]);
        }
        let here = |f: &usize| sheet_of[mesh.face_submesh[*f].index()] as usize == sheet;
        for f in (0..mesh.face_count()).filter(here) {
            if corner_uvs[f].is_none() {
                let points = mesh.face_points(FaceId(f as u32));
                let known = points.iter().find_map(|p| point_uv[p.index()].filter(|(known, _)| *known == sheet));
                corner_uvs[f] = Some([known.map(|(_, uv)| uv).or(anywhere).unwrap_or(Vec2::ZERO); 3]);
            }
        }
    }
    corner_uvs.into_iter().map(|uvs| uvs.unwrap_or([Vec2::ZERO; 3])).collect()
}

/// The UV of a place on a sheet, texels.
fn on_sheet(texel: Vec2, size: u32, sheet: usize) -> Vec2 {
    if sheet == 0 {
        return texel / size as f32;
    }
    let uv = texel.as_dvec2() / f64::from(size);
    DVec2::new(uv.x + sheet as f64, uv.y).as_vec2()
}

/// `mesh` with one wedge for each (vertex, value) among `corners` (`[face_count] x 3`), and the value of each new vertex.
/// The wedges of a vertex follow one another in the order in which faces ask for them; all attributes are copied; points
/// keep their ids; a vertex that no face uses stays, with the value `unused`, for its point may have no other.
pub(crate) fn split_wedges<T: Copy + PartialEq>(mesh: &Mesh, corners: &[[T; 3]], unused: T) -> (RawMesh, Vec<T>) {
    const END: u32 = u32::MAX;
    // The wedges of each vertex: a chain of (value, next).
    let mut first = vec![END; mesh.vertex_count()];
    let mut wedges: Vec<(T, u32)> = Vec::with_capacity(mesh.vertex_count());
    let mut corner_wedge = Vec::with_capacity(3 * mesh.face_count());
    for (triangle, values) in mesh.triangles.iter().zip(corners) {
        for (v, value) in triangle.iter().zip(values) {
            let (mut link, mut last) = (first[*v as usize], END);
            while link != END && wedges[link as usize].0 != *value {
                (last, link) = (link, wedges[link as usize].1);
            }
            if link == END {
                link = wedges.len() as u32;
                wedges.push((*value, END));
                match last {
                    END => first[*v as usize] = link,
                    last => wedges[last as usize].1 = link,
                }
            }
            corner_wedge.push(link);
        }
    }
    let mut number = vec![END; wedges.len()];
    let mut keep = Vec::with_capacity(wedges.len());
    let mut values = Vec::with_capacity(wedges.len());
    for (v, first) in first.iter().enumerate() {
        let mut link = *first;
        if link == END {
            keep.push(v as u32);
            values.push(unused);
        }
        while link != END {
            let (value, next) = wedges[link as usize];
            number[link as usize] = keep.len() as u32;
            keep.push(v as u32);
            values.push(value);
            link = next;
        }
    }
    let triangles = corner_wedge.chunks_exact(3).map(|c| [c[0], c[1], c[2]].map(|w| number[w as usize])).collect();
    let mut raw = mesh.gather(&keep, triangles, mesh.face_submesh.clone());
    raw.points = keep.iter().map(|v| mesh.points[*v as usize]).collect();
    (raw, values)
}
