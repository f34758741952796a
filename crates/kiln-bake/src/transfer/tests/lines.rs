//! Where lines go and which of their hits count: against brute force and planted surfaces.

use glam::{DVec3, Vec2, Vec3};
use kiln_asset::{FaceId, Mesh};
use kiln_geom::math;

use super::models::*;
use super::*;
use crate::transfer::{Matching, Method};

/// Unit directions of a face's corners by the page's words.
fn corner_directions(low: &Mesh, face: u32, directions: Directions) -> [DVec3; 3] {
    let normals = low.normals.as_ref().unwrap();
    let [a, b, c] = low.face_positions(FaceId(face)).map(|p| p.as_dvec3());
    let own = (b - a).cross(c - a).normalize();
    let corners = match directions {
        Directions::Face => [own; 3],
        Directions::Mixed => low.triangles[face as usize].map(|v| normals[v as usize].as_dvec3().normalize()),
        Directions::Smooth => low.face_points(FaceId(face)).map(|point| {
            let mut sum = DVec3::ZERO;
            for (f, triangle) in low.triangles.iter().enumerate() {
                for k in 0..3 {
                    if low.points[triangle[k] as usize] != point {
                        continue;
                    }
                    let p = low.face_positions(FaceId(f as u32)).map(|p| p.as_dvec3());
                    let angle = (p[(k + 1) % 3] - p[k]).angle_between(p[(k + 2) % 3] - p[k]);
                    sum += angle * normals[triangle[k] as usize].as_dvec3().normalize();
                }
            }
            sum.normalize()
        }),
    };
    if corners.iter().all(|d| d.dot(own) > 0.05) { corners } else { [own; 3] }
}

/// Signed distances of all hits of a texel's line, with their faces.
fn all_hits(high: &Mesh, origin: DVec3, direction: DVec3) -> Vec<(f64, DVec3)> {
    let mut found = Vec::new();
    for f in 0..high.face_count() as u32 {
        let [a, b, c] = high.face_positions(FaceId(f)).map(|p| p.as_dvec3());
        let n = (b - a).cross(c - a);
        let along = n.dot(direction);
        if along <= 0.0 {
            continue;
        }
        let k = n.dot(a - origin) / along;
        let p = origin + direction * k;
        if [(a, b), (b, c), (c, a)].iter().all(|(s, e)| n.dot((*e - *s).cross(p - *s)) >= 0.0) {
            found.push((k, p));
        }
    }
    found
}

#[test]
fn hits_are_those_of_every_texels_own_line() {
    let high = valid(both(torus(50, 24, 0.05), cube(Vec3::new(1.0, 0.1, 0.0), 0.45)));
    let low = charted(&both(torus(10, 6, 0.0), cube(Vec3::new(1.0, 0.1, 0.0), 0.47)));
    let (size, reach) = (80, 0.2);
    for directions in [Directions::Smooth, Directions::Mixed, Directions::Face] {
        for hit in [HitRule::Outermost, HitRule::Nearest] {
            let options = BakeOptions { directions, hit, ..within(reach, &normals_only(size, NormalSpace::Object)) };
            let found = find(&high, &low, &options, Backend::Cpu).unwrap();
            let (mut compared, mut differ) = (0, 0);
            for (texel, owner) in found.low_faces.iter().enumerate().filter(|(_, o)| **o != 0) {
                let face = owner - 1;
                let d = corner_directions(&low, face, directions);
                let p = low.face_positions(FaceId(face)).map(|p| p.as_dvec3());
                let uv = low.triangles[face as usize].map(|v| low.atlas_uv.as_ref().unwrap()[v as usize].as_dvec2());
                let at = glam::DVec2::new((texel % 80) as f64 + 0.5, (texel / 80) as f64 + 0.5) / f64::from(size);
                let area = (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
                let b1 = (at - uv[0]).perp_dot(uv[2] - uv[0]) / area;
                let b2 = (uv[1] - uv[0]).perp_dot(at - uv[0]) / area;
                let mix = |v: [DVec3; 3]| v[0] * (1.0 - b1 - b2) + v[1] * b1 + v[2] * b2;
                let (origin, direction) = (mix(p), mix(d).normalize());
                let reachable =
                    all_hits(&high, origin, direction).into_iter().filter(|h| h.0.abs() <= f64::from(reach));
                let key = |k: f64| if hit == HitRule::Outermost { -k } else { k.abs() };
                let best = reachable.min_by(|a, b| key(a.0).total_cmp(&key(b.0)));
                compared += 1;
                match (best, found.positions[texel]) {
                    (Some((_, exact)), Some(position)) if (exact - position.as_dvec3()).length() < 1e-4 => {}
                    (None, None) => {}
                    _ => differ += 1,
                }
            }
            // Lines that are cut where they cross may miss what the brute force finds; two or three graze an edge.
            let allowed = if found.report.crossing_faces == 0 { compared / 1000 } else { compared / 20 };
            assert!(compared > 2000 && differ <= allowed, "{directions:?} {hit:?}: {differ} of {compared} differ");
        }
    }
}

/// An icosahedron's 20 faces with normals of the sphere.
fn icosahedron() -> kiln_asset::RawMesh {
    let g = 0.5 * (1.0 + 5f32.sqrt());
    let corners: Vec<Vec3> = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .iter()
    .map(|c| Vec3::from_array(*c).normalize())
    .collect();
    let faces = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    mesh(corners.clone(), corners, faces)
}

#[test]
fn a_sphere_on_twenty_faces_shows_the_normals_where_each_texels_line_meets_it() {
    let (high, low) = (valid(sphere(256, 128)), one_level(charted(&icosahedron()), 512, 4));
    let set = MaterialSet::default();
    let input = BakeInput { high: &high, low: &low, materials: &set, images: &no_images, cage: None };
    let options = BakeOptions {
        maps: Vec::new(),
        extras: vec![kiln_asset::ExtraMap::ObjectNormal, kiln_asset::ExtraMap::Position],
        size: 512,
        samples: 4,
        dilation: 0,
        ..within(0.25, &BakeOptions::default())
    };
    let options = BakeOptions { depth: crate::transfer::Depth::Float, ..options };
    let baked = super::super::bake(&input, &options, Backend::Cpu).unwrap();
    assert_eq!((baked.report.missed, baked.report.crossing_faces), (0, 0));
    let deep = |k: usize| match &baked.pictures[k] {
        Picture::Deep(deep) => deep,
        Picture::Plain(_) => panic!("floats"),
    };
    // The mean over all texels that one sample a texel calls covered: where their own lines meet the sphere.
    let single = BakeOptions { samples: 1, ..options.clone() };
    let hits = super::super::find_hits(&input, &single, Backend::Cpu).unwrap();
    let (mut sum, mut count) = (0.0, 0);
    for (texel, position) in hits.positions().iter().enumerate() {
        let Some(position) = position else { continue };
        let [x, y, z, _] = deep(1).texels[texel];
        sum += f64::from(degrees(Vec3::new(x, y, z), *position));
        count += 1;
    }
    let mean = sum / f64::from(count);
    assert!(count > 50_000 && mean < 0.3, "{mean} degrees over {count} texels");
    assert_eq!(baked.materials.extras.len(), 2);
}

/// A square of side 1 at height `z` facing up (or down), no UVs.
fn sheet(z: f32, up: bool, from: f32, to: f32) -> kiln_asset::RawMesh {
    let at = |x: f32, y: f32| Vec3::new(from + (to - from) * x, from + (to - from) * y, z);
    let corners = vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)];
    let triangles = if up { vec![[0, 1, 2], [0, 2, 3]] } else { vec![[0, 2, 1], [0, 3, 2]] };
    mesh(corners, vec![if up { Vec3::Z } else { Vec3::NEG_Z }; 4], triangles)
}

/// Heights of the hits on the low square at 0, from the centre and from near a corner.
fn heights(high: kiln_asset::RawMesh, hit: HitRule, reach: [f32; 2]) -> [Option<f32>; 2] {
    let options = BakeOptions {
        hit,
        directions: Directions::Smooth,
        front: Some(reach[0]),
        back: Some(reach[1]),
        ..normals_only(16, NormalSpace::Object)
    };
    let found = find(&valid(high), &plane(0.0, upright), &options, Backend::Cpu).unwrap();
    [8 * 16 + 8, 2 * 16 + 2].map(|texel| found.positions[texel].map(|p| (p.z * 1000.0).round() / 1000.0))
}

#[test]
fn both_rules_on_a_thin_wall_a_bolt_a_fold_and_two_sheets() {
    use HitRule::{Nearest, Outermost};
    // A closed wall of thickness 1 whose outer side the low surface lies 0.8 under: the back side is nearer, and faces away.
    let wall = || both(sheet(0.8, true, 0.0, 1.0), sheet(-0.2, false, 0.0, 1.0));
    for hit in [Nearest, Outermost] {
        assert_eq!(heights(wall(), hit, [1.0, 1.0]), [Some(0.8), Some(0.8)], "{hit:?}");
    }
    // A bolt that floats over the middle.
    let bolt = || both(sheet(0.0, true, 0.0, 1.0), sheet(0.1, true, 0.3, 0.7));
    assert_eq!(heights(bolt(), Outermost, [0.2, 0.2]), [Some(0.1), Some(0.0)]);
    assert_eq!(heights(bolt(), Nearest, [0.2, 0.2]), [Some(0.0), Some(0.0)]);
    // A fold: an overhang far in front; out of reach it does no harm, within reach only the nearest is safe.
    let ear = || both(sheet(0.02, true, 0.0, 1.0), both(sheet(0.6, true, 0.2, 0.8), sheet(0.5, false, 0.2, 0.8)));
    assert_eq!(heights(ear(), Outermost, [0.1, 0.1]), [Some(0.02), Some(0.02)]);
    assert_eq!(heights(ear(), Nearest, [1.0, 1.0]), [Some(0.02), Some(0.02)]);
    assert_eq!(heights(ear(), Outermost, [1.0, 1.0]), [Some(0.6), Some(0.02)]);
    // Two sheets that face the same way, before and behind.
    let two = || both(sheet(0.05, true, 0.0, 1.0), sheet(-0.02, true, 0.0, 1.0));
    assert_eq!(heights(two(), Outermost, [0.1, 0.1]), [Some(0.05), Some(0.05)]);
    assert_eq!(heights(two(), Nearest, [0.1, 0.1]), [Some(-0.02), Some(-0.02)]);
    // Front and back are two lengths.
    assert_eq!(heights(two(), Outermost, [0.01, 0.1]), [Some(-0.02), Some(-0.02)]);
    assert_eq!(heights(two(), Nearest, [0.1, 0.01]), [Some(0.05), Some(0.05)]);
}

#[test]
fn smooth_directions_leave_no_gap_at_a_hard_edge_where_the_faces_own_do() {
    // A rounded cube around a cube with hard edges: along the faces' normals its corners are seen by nobody.
    let rounded = {
        let mut raw = sphere(96, 48);
        for p in &mut raw.positions {
            *p = (*p * 1.35).clamp(Vec3::splat(-1.0), Vec3::splat(1.0)) * 1.1;
        }
        valid(raw)
    };
    let low = charted(&cube(Vec3::ZERO, 1.0));
    let seen = |directions| {
        let options = BakeOptions { directions, ..within(0.6, &normals_only(128, NormalSpace::Object)) };
        let found = find(&rounded, &low, &options, Backend::Cpu).unwrap();
        // How near to an edge of the rounded cube it is seen: the second largest coordinate.
        let near = found.positions.iter().flatten().map(|p| {
            let mut c = p.abs().to_array();
            c.sort_by(f32::total_cmp);
            c[1]
        });
        (near.fold(0.0, f32::max), found.report.missed)
    };
    let ((smooth, missed), (face, _)) = (seen(Directions::Smooth), seen(Directions::Face));
    assert_eq!(missed, 0);
    assert!(smooth > 1.04 && face < 1.0, "{smooth} and {face} of 1.1");
}

#[test]
fn lines_that_cross_are_cut_and_counted_and_odd_faces_are_reported() {
    // The inner side of a small tube: lines that look inwards meet at its axis.
    let tube = |radius: f32| {
        let raw = grid_tube(24, radius);
        let mut raw = raw;
        raw.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        raw.normals.as_mut().unwrap().iter_mut().for_each(|n| *n = -*n);
        raw
    };
    let (high, low) = (valid(tube(0.95)), charted(&tube(1.0)));
    let options = BakeOptions { directions: Directions::Smooth, ..within(3.0, &normals_only(64, NormalSpace::Object)) };
    let found = find(&high, &low, &options, Backend::Cpu).unwrap();
    assert_eq!(found.report.crossing_faces, low.face_count() as u64);
    // Without the cut the outermost hit would be the far side; it faces the other way there, so nothing is missed here.
    assert_eq!(found.report.missed, 0);
    for position in found.positions.iter().flatten() {
        let radius = Vec2::new(position.x, position.z).length();
        assert!((0.9..=0.96).contains(&radius), "{radius}");
    }
    // A face without area on the sheet, and one that has no normal.
    let mut raw = plane(0.0, upright).into_raw();
    let uv = raw.atlas_uv.as_mut().unwrap();
    uv[3] = uv[0];
    let found = find(&valid(sheet(0.0, true, 0.0, 1.0)), &valid(raw), &within(0.1, &options), Backend::Cpu).unwrap();
    assert_eq!((found.report.flat_faces, found.report.sliver_faces), (1, 0));
    let mut raw = plane(0.0, upright).into_raw();
    raw.positions[3] = raw.positions[0];
    raw.points.clear();
    let found = find(&valid(sheet(0.0, true, 0.0, 1.0)), &valid(raw), &within(0.1, &options), Backend::Cpu).unwrap();
    assert_eq!((found.report.flat_faces, found.report.sliver_faces), (0, 1));
}

/// A tube around the Y axis from -1 to 1.
fn grid_tube(columns: u32, radius: f32) -> kiln_asset::RawMesh {
    let (mut positions, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for j in 0..2 {
        for i in 0..=columns {
            let a = std::f32::consts::TAU * i as f32 / columns as f32;
            let n = Vec3::new(math::cos(a), 0.0, -math::sin(a));
            positions.push(radius * n + (2.0 * j as f32 - 1.0) * Vec3::Y);
            normals.push(n);
        }
    }
    for i in 0..columns {
        let (a, b) = (i, i + 1);
        let (c, d) = (a + columns + 1, b + columns + 1);
        triangles.push([a, b, d]);
        triangles.push([a, d, c]);
    }
    mesh(positions, normals, triangles)
}

#[test]
fn a_cage_says_how_far_each_part_looks() {
    // Two sheets in front; the cage passes between them over one half and over both in the other.
    let high = valid(both(sheet(0.0, true, 0.0, 1.0), sheet(0.1, true, 0.0, 1.0)));
    let low = one_level(plane(0.0, upright), 16, 8);
    let mut raw = sheet(0.05, true, -1.0, 2.0);
    // Slanted: 0.05 at x = 0, 0.15 at x = 1.
    raw.positions.iter_mut().for_each(|p| p.z = 0.05 + 0.1 * p.x);
    let cage = valid(raw);
    let set = MaterialSet::default();
    let options = BakeOptions { hit: HitRule::Outermost, ..within(0.02, &normals_only(16, NormalSpace::Object)) };
    let input = BakeInput { high: &high, low: &low, materials: &set, images: &no_images, cage: Some(&cage) };
    let found = find_hits(&input, &options, Backend::Cpu).unwrap();
    let positions = found.positions();
    let z = |x: usize| (positions[8 * 16 + x].unwrap().z * 1000.0).round() / 1000.0;
    assert_eq!([z(1), z(6), z(9), z(14)], [0.0, 0.0, 0.1, 0.1]);
    assert_eq!(found.report.front, 0.02);
}

#[test]
fn a_submesh_shows_its_own_name_or_nothing_if_that_is_asked() {
    let mut raw = both(sheet(0.0, true, 0.0, 1.0), sheet(0.05, true, 0.0, 0.5));
    raw.submeshes.push(kiln_asset::Submesh { name: "other".into(), ..raw.submeshes[0].clone() });
    let half = raw.triangles.len() / 2;
    raw.face_submesh[half..].fill(kiln_asset::SubmeshId(1));
    // The low part's namesake covers a quarter only.
    raw.submeshes.swap(0, 1);
    let high = valid(raw);
    let covered = |matching| {
        let options = BakeOptions { matching, ..within(0.1, &normals_only(16, NormalSpace::Object)) };
        let found = find(&high, &plane(0.0, upright), &options, Backend::Cpu).unwrap();
        let floats = found.positions.iter().flatten().filter(|p| p.z > 0.01).count();
        (found.report.covered, floats)
    };
    assert_eq!(covered(Matching::Name), (64, 64));
    assert_eq!(covered(Matching::Prefer), (256, 64));
    assert_eq!(covered(Matching::Any), (256, 0));
}

#[test]
fn a_shared_layout_needs_no_lines() {
    // The high plane bulges far away, but its layout is the low one's.
    let mut raw = plane(0.0, upright).into_raw();
    raw.positions.iter_mut().for_each(|p| p.z = 5.0);
    raw.atlas_uv = None;
    let high = valid(raw.clone());
    let low = one_level(plane(0.0, upright), 32, 8);
    let set = MaterialSet::default();
    let options = BakeOptions {
        maps: Vec::new(),
        extras: vec![kiln_asset::ExtraMap::Height, kiln_asset::ExtraMap::Position],
        method: Method::Correspondence,
        size: 32,
        ..BakeOptions::default()
    };
    let go = |high: &Mesh| {
        let input = BakeInput { high, low: &low, materials: &set, images: &no_images, cage: None };
        super::super::bake(&input, &options, Backend::Cpu)
    };
    let baked = go(&high).unwrap();
    let Picture::Deep(heights) = &baked.pictures[0] else { panic!("floats") };
    assert!(heights.texels.iter().all(|t| (t[0] - 5.0).abs() < 1e-5));
    let Picture::Deep(places) = &baked.pictures[1] else { panic!("floats") };
    let [x, y, ..] = places.texels[3 * 32 + 20];
    assert!((x - 20.5 / 32.0).abs() < 1e-5 && (y - 1.0 + 3.5 / 32.0).abs() < 1e-5);
    // Overlaps and layouts that do not meet are refused by name.
    let mut doubled = raw.clone();
    doubled.triangles.extend([[0, 1, 2]]);
    doubled.face_submesh.push(doubled.face_submesh[0]);
    assert!(matches!(go(&valid(doubled)), Err(BakeError::Layouts(_))));
    let mut away = raw.clone();
    away.uv0.as_mut().unwrap().iter_mut().for_each(|uv| uv.x += 3.0);
    assert!(matches!(go(&valid(away)), Err(BakeError::Layouts(_))));
    // Nor does a layout that repeats beyond its square.
    let mut repeated = low.clone();
    repeated.layout = None;
    let mut mesh = repeated.levels[0].mesh.clone().into_raw();
    mesh.atlas_uv.as_mut().unwrap().iter_mut().for_each(|uv| uv.x *= 2.0);
    repeated.levels[0].mesh = valid(mesh);
    let input = BakeInput { high: &high, low: &repeated, materials: &set, images: &no_images, cage: None };
    assert!(matches!(super::super::bake(&input, &options, Backend::Cpu), Err(BakeError::Layouts(_))));
    let mut without = raw;
    without.uv0 = None;
    assert!(matches!(go(&valid(without)), Err(BakeError::Layouts(_))));
}
