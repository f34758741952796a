//! What is written: filtered samples, depths, sheets, maps beside the material.

use glam::{Vec2, Vec3, Vec4};
use kiln_asset::{ExtraMap, Material, MaterialId, Mesh, Precision, SubmeshId};

use super::models::*;
use super::*;
use crate::tangents::{UvSource, mikktspace};
use crate::transfer::resolve::TangentFrame;
use crate::transfer::{Baked, Depth};

fn bake_floats(high: &Mesh, low: &LodSet, set: &MaterialSet, options: &BakeOptions) -> Baked {
    let input = BakeInput { high, low, materials: set, images: &no_images, cage: None };
    super::super::bake(&input, options, Backend::Cpu).unwrap()
}

fn floats(picture: &Picture) -> &[[f32; 4]] {
    match picture {
        Picture::Deep(deep) => &deep.texels,
        Picture::Plain(_) => panic!("floats were asked for"),
    }
}

/// A square whose left part, up to `x`, is black and whose right part is white, by vertex colours.
fn step(x: f32) -> Mesh {
    let at = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    let corners =
        [at(0.0, 0.0), at(x, 0.0), at(x, 1.0), at(0.0, 1.0), at(x, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(x, 1.0)];
    let mut raw = mesh(corners.to_vec(), vec![Vec3::Z; 8], vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]);
    let colour = |k: usize| if k < 4 { Vec4::new(0.0, 0.0, 0.0, 1.0) } else { Vec4::ONE };
    raw.colors = Some((0..8).map(colour).collect());
    raw.submeshes[0].attributes.colors = true;
    valid(raw)
}

#[test]
fn a_step_comes_out_as_the_integral_of_the_tent() {
    let edge = 0.5 + 0.3 / 16.0;
    let low = one_level(plane(0.0, upright), 16, 8);
    for samples in [1, 2, 4, 8] {
        let options = BakeOptions {
            maps: vec![MapRole::BaseColor],
            size: 16,
            samples,
            depth: Depth::Float,
            ..within(0.1, &BakeOptions::default())
        };
        let baked = bake_floats(&step(edge), &low, &MaterialSet::default(), &options);
        let row = &floats(&baked.pictures[0])[8 * 16..9 * 16];
        for (x, texel) in row.iter().enumerate() {
            // Light of what lies right of the edge, d texels right of the texel's centre.
            let d = edge * 16.0 - (x as f32 + 0.5);
            let light = match d {
                d if d >= 1.0 => 0.0,
                d if d >= 0.0 => 0.5 * (1.0 - d) * (1.0 - d),
                d if d > -1.0 => 1.0 - 0.5 * (1.0 + d) * (1.0 + d),
                _ => 1.0,
            };
            let exact = if samples == 1 { f32::from(d < 0.0) } else { light };
            assert!(
                (texel[0] - exact).abs() <= 0.6 / samples as f32 * f32::from(samples > 1),
                "{samples}: {texel:?} for {exact} at {x}"
            );
        }
    }
}

#[test]
fn a_bump_on_a_plane_gives_its_slopes_to_the_last_bit_of_8_and_nearly_of_16() {
    let high = valid(hills(500, 0.02, 2.0));
    let low = one_level(plane(0.0, upright), 64, 8);
    for (depth, bound) in [(Depth::Eight, 1.0), (Depth::Sixteen, 40.0)] {
        let options =
            BakeOptions { maps: vec![MapRole::Normal], size: 64, depth, ..within(0.05, &BakeOptions::default()) };
        let baked = bake_floats(&high, &low, &MaterialSet::default(), &options);
        let w = 2.0 * std::f32::consts::TAU;
        for i in 0..64 * 64 {
            let (x, y) = ((i % 64) as f32 + 0.5, 64.0 - (i / 64) as f32 - 0.5);
            let (x, y) = (w * x / 64.0, w * y / 64.0);
            let slope = Vec3::new(-0.02 * w * x.cos() * y.sin(), -0.02 * w * x.sin() * y.cos(), 1.0).normalize();
            let (texel, whole) = match &baked.pictures[0] {
                Picture::Plain(plain) => {
                    (Vec3::from_array([0, 1, 2].map(|c| f32::from(plain.texels[i][c]) / 255.0)), 255.0)
                }
                Picture::Deep(deep) => {
                    assert_eq!(deep.precision, Precision::Unorm16);
                    let [r, g, b, _] = deep.texels[i];
                    (Vec3::new(r, g, b), 65535.0)
                }
            };
            let off = ((texel - (0.5 * slope + 0.5)) * whole).abs().max_element();
            assert!(off <= bound, "{off} steps at texel {i} in {depth:?}");
        }
    }
}

#[test]
fn a_mirrored_strip_lights_the_same_on_both_halves() {
    // z = a hill of |x|; the right half's texels serve the left half, mirrored.
    let high = {
        let mut raw = hills(120, 0.03, 1.0);
        let place = raw.positions.clone();
        for (p, (n, q)) in raw.positions.iter_mut().zip(raw.normals.as_mut().unwrap().iter_mut().zip(place)) {
            // The grid covers [0, 1]; let it cover [-1, 1] in x, symmetric about 0.
            let x = 2.0 * q.x - 1.0;
            let z = 0.03 * (6.0 * x * x).sin() * (5.0 * q.y).sin();
            let slope =
                [0.36 * x * (6.0 * x * x).cos() * (5.0 * q.y).sin(), 0.15 * (6.0 * x * x).sin() * (5.0 * q.y).cos()];
            *p = Vec3::new(x, q.y, z);
            *n = Vec3::new(-slope[0], -slope[1], 1.0).normalize();
        }
        valid(raw)
    };
    let corners = [(-1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (-1.0, 1.0), (0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    let mut raw = mesh(
        corners.iter().map(|(x, y)| Vec3::new(*x, *y, 0.0)).collect(),
        vec![Vec3::Z; 8],
        vec![[4, 5, 6], [4, 6, 7], [0, 1, 2], [0, 2, 3]],
    );
    raw.atlas_uv = Some(corners.iter().map(|(x, y)| Vec2::new(x.abs(), 1.0 - y)).collect());
    let low = mikktspace(&valid(raw), UvSource::AtlasUv).unwrap();
    let options = BakeOptions { maps: vec![MapRole::Normal], size: 64, ..within(0.1, &BakeOptions::default()) };
    let set = one_level(low.clone(), 64, 0);
    let baked = bake_floats(&high, &set, &MaterialSet::default(), &options);
    assert_eq!(baked.report.overlapping, 64 * 64, "the lower faces own, the others share");
    for samples in [2, 4] {
        // The sheet is several bins wide, whose filters reach into each other: nothing is counted twice.
        let options = BakeOptions { size: 192, samples, ..options.clone() };
        let report = bake_floats(&high, &set, &MaterialSet::default(), &options).report;
        assert_eq!(report.overlapping, 192 * 192, "{samples} x {samples} samples");
    }
    let Picture::Plain(map) = &baked.pictures[0] else { panic!("8 bits") };
    let (normals, tangents) = (low.normals.as_ref().unwrap(), low.tangents.as_ref().unwrap());
    let read = |face: usize, bary: [f32; 3], texel: usize| {
        let corners = low.triangles[face].map(|v| v as usize);
        let frame = TangentFrame::new(corners.map(|v| normals[v]), corners.map(|v| tangents[v]), bary);
        frame.decode(decoded(map.texels[texel]))
    };
    for texel in 0..64 * 64 {
        let (u, v) = (((texel % 64) as f32 + 0.5) / 64.0, ((texel / 64) as f32 + 0.5) / 64.0);
        // Either triangle of each half will do: all lie in one plane.
        let right = read(0, [1.0 / 3.0; 3], texel);
        let left = read(2, [1.0 / 3.0; 3], texel);
        assert!((right - left * Vec3::new(-1.0, 1.0, 1.0)).length() < 1e-5, "{right} and {left}");
        let (x, y) = (u, 1.0 - v);
        let slope = [0.36 * x * (6.0 * x * x).cos() * (5.0 * y).sin(), 0.15 * (6.0 * x * x).sin() * (5.0 * y).cos()];
        assert!(degrees(right, Vec3::new(-slope[0], -slope[1], 1.0)) < 1.2);
    }
}

#[test]
fn extras_hold_what_their_names_say() {
    let mut raw = both(hills(8, 0.0, 1.0), hills(8, 0.0, 1.0));
    // The second part: to the right, higher, half transparent, of another material.
    let half = raw.positions.len() / 2;
    raw.positions[half..].iter_mut().for_each(|p| *p = *p * Vec3::new(0.5, 1.0, 1.0) + Vec3::new(0.5, 0.0, 0.03));
    raw.positions[..half].iter_mut().for_each(|p| p.x *= 0.5);
    raw.submeshes.push(kiln_asset::Submesh { name: "second".into(), ..raw.submeshes[0].clone() });
    raw.submeshes[1].material = Some(MaterialId(1));
    let faces = raw.triangles.len() / 2;
    raw.face_submesh[faces..].fill(SubmeshId(1));
    let high = valid(raw);
    let set = MaterialSet {
        materials: vec![
            Material::default(),
            Material { base_color_factor: [1.0, 1.0, 1.0, 0.5], ..Material::default() },
        ],
        ..MaterialSet::default()
    };
    let options = BakeOptions {
        maps: Vec::new(),
        extras: ExtraMap::ALL.to_vec(),
        size: 16,
        matching: crate::transfer::Matching::Any,
        ..within(0.05, &BakeOptions::default())
    };
    let baked = bake_floats(&high, &one_level(plane(0.0, upright), 16, 8), &set, &options);
    let kinds: Vec<ExtraMap> = baked.materials.extras.iter().map(|e| e.kind).collect();
    assert_eq!(kinds, ExtraMap::ALL);
    let at = |kind: ExtraMap, x: usize| {
        let image = baked.materials.extras.iter().find(|e| e.kind == kind).unwrap().image;
        floats(&baked.pictures[image.index()])[8 * 16 + x]
    };
    let near = |found: [f32; 4], expected: [f32; 3]| {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?} for {expected:?}");
    };
    near(at(ExtraMap::Height, 3), [0.0; 3]);
    near(at(ExtraMap::Height, 12), [0.03; 3]);
    near(at(ExtraMap::Position, 12), [12.5 / 16.0, 7.5 / 16.0, 0.03]);
    // 16 bits: half of the unit vector and a half.
    near(at(ExtraMap::ObjectNormal, 3), [0.5, 0.5, 1.0]);
    near(at(ExtraMap::ObjectId, 3), [0.0; 3]);
    near(at(ExtraMap::ObjectId, 12), [1.0; 3]);
    near(at(ExtraMap::MaterialId, 3), [-1.0; 3]);
    near(at(ExtraMap::MaterialId, 12), [1.0; 3]);
    near(at(ExtraMap::Opacity, 3), [1.0; 3]);
    near(at(ExtraMap::Opacity, 12), [0.5; 3]);
    near(at(ExtraMap::Coverage, 12), [1.0; 3]);
    near(at(ExtraMap::Curvature, 3), [0.0; 3]);
    near(at(ExtraMap::AmbientOcclusion, 12), [1.0; 3]);
    // 64 rays know the mean direction to a degree.
    let [x, y, z, _] = at(ExtraMap::BentNormal, 12);
    assert!(degrees(2.0 * Vec3::new(x, y, z) - 1.0, Vec3::Z) < 1.5);
}

#[test]
fn each_sheet_has_maps_and_materials_of_its_own() {
    let mut raw = both(hills(4, 0.0, 1.0), hills(4, 0.0, 1.0));
    let half = raw.positions.len() / 2;
    raw.positions[half..].iter_mut().for_each(|p| p.x += 2.0);
    raw.submeshes.push(kiln_asset::Submesh { name: "second".into(), ..raw.submeshes[0].clone() });
    raw.submeshes[0].material = Some(MaterialId(0));
    raw.submeshes[1].material = Some(MaterialId(1));
    let faces = raw.triangles.len() / 2;
    raw.face_submesh[faces..].fill(SubmeshId(1));
    // The second part's sheet lies right of the first one's, [1, 2] x [0, 1].
    let uv = |p: &Vec3| if p.x < 1.5 { Vec2::new(p.x, 1.0 - p.y) } else { Vec2::new(p.x - 1.0, 1.0 - p.y) };
    raw.atlas_uv = Some(raw.positions.iter().map(uv).map(|uv| uv * Vec2::new(1.0, 0.9)).collect());
    let shrink = |uv: &mut Vec2| uv.x = uv.x.floor().min(1.0) + 0.05 + 0.9 * (uv.x - uv.x.floor().min(1.0));
    let atlas = raw.atlas_uv.as_mut().unwrap();
    for (k, uv) in atlas.iter_mut().enumerate() {
        if k < half {
            uv.x = 0.05 + 0.9 * uv.x;
        } else {
            shrink(uv);
        }
    }
    let mesh = valid(raw);
    let paint = |r, g| Material { base_color_factor: [r, g, 0.0, 1.0], ..Material::default() };
    let set = MaterialSet { materials: vec![paint(1.0, 0.0), paint(0.0, 1.0)], ..MaterialSet::default() };
    let mut low = one_level(mikktspace(&mesh, UvSource::AtlasUv).unwrap(), 32, 2);
    low.layout.as_mut().unwrap().sheets = 2;
    let options = BakeOptions {
        maps: vec![MapRole::BaseColor, MapRole::Normal],
        size: 32,
        dilation: 2,
        ..within(0.05, &BakeOptions::default())
    };
    let baked = bake_floats(&mesh, &low, &set, &options);
    assert_eq!((baked.report.sheets, baked.pictures.len(), baked.materials.images.len()), (2, 4, 4));
    let names: Vec<&str> = baked.materials.images.iter().map(|i| i.name.as_str()).collect();
    assert_eq!(names, ["base-color 1001", "normal 1001", "base-color 1002", "normal 1002"]);
    let colour = |k: usize| match &baked.pictures[k] {
        Picture::Plain(plain) => plain.texels[16 * 32 + 16],
        Picture::Deep(_) => panic!("8 bits"),
    };
    assert_eq!((colour(0), colour(2)), ([255, 0, 0, 255], [0, 255, 0, 255]));
    let finest = &baked.levels.levels[0].mesh;
    assert_eq!(finest.submeshes.iter().map(|s| s.material.unwrap().0).collect::<Vec<_>>(), [0, 1]);
    assert!(finest.uv0.as_ref().unwrap().iter().all(|uv| (0.0..=1.0).contains(&uv.x)));
    assert_eq!(baked.materials.materials[1].base_color.unwrap().texture.0, 2);
    crate::transfer::check::check(&low, &baked.levels, &baked.materials, baked.pictures.len()).unwrap();
}

#[test]
fn occlusion_comes_from_the_source_from_rays_or_from_both() {
    // A floor with a wall along x = 1: at its foot half of the cosine-weighted sky is gone.
    let mut raw = both(hills(4, 0.0, 1.0), hills(4, 0.0, 1.0));
    let half = raw.positions.len() / 2;
    for (p, n) in raw.positions[half..].iter_mut().zip(&mut raw.normals.as_mut().unwrap()[half..]) {
        (*p, *n) = (Vec3::new(1.0, 40.0 * (p.y - 0.5), 40.0 * p.x), Vec3::NEG_X);
    }
    raw.triangles.truncate(raw.triangles.len());
    let flip = raw.triangles.len() / 2;
    raw.triangles[flip..].iter_mut().for_each(|t| t.swap(1, 2));
    let high = valid(raw);
    let low = one_level(plane(0.0, upright), 32, 8);
    let go = |occlusion| {
        let options = BakeOptions {
            maps: vec![MapRole::Occlusion],
            occlusion,
            size: 32,
            rays: 512,
            ray_length: Some(1000.0),
            ..within(0.01, &BakeOptions::default())
        };
        bake_floats(&high, &low, &MaterialSet::default(), &options)
    };
    use crate::transfer::OcclusionSource::{Both, Rays, Source};
    assert_eq!(go(Source).report.neutral_maps, [MapRole::Occlusion]);
    for source in [Rays, Both] {
        let baked = go(source);
        let Picture::Plain(map) = &baked.pictures[0] else { panic!("8 bits") };
        let (foot, away) = (map.texels[16 * 32 + 31][0], map.texels[16 * 32][0]);
        // An endless wall from the foot up takes (1 - cos a) / 2, a the angle from its top to the floor's normal: here 1/2.
        assert!(foot.abs_diff(128) <= 6 && away > foot, "{foot} and {away}");
        assert!(baked.materials.materials[0].occlusion.is_some());
    }
}
