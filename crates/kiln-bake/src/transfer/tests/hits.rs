//! Where hits fall: against analytic surfaces and against brute force.

use glam::{DVec3, Vec2, Vec3};
use kiln_asset::{FaceId, Mesh};

use super::models::*;
use super::*;
use crate::transfer::{Backend, BakeError};

fn corner_texels(low: &Mesh, uv: &[Vec2], face: usize, size: u32) -> [Vec2; 3] {
    low.triangles[face].map(|v| uv[v as usize] * size as f32)
}

#[test]
fn a_spheres_normals_are_the_analytic_ones_within_half_a_degree() {
    let high = valid(sphere(128, 64));
    let low = charted(&sphere(12, 8));
    let hits = find(&high, &low, &within(0.2, &normals_only(512, NormalSpace::Object)), Backend::Cpu).unwrap();
    assert!(hits.report.covered > 100_000, "{:?}", hits.report);
    assert_eq!(hits.report.missed, 0);
    assert_eq!(hits.report.overlapping, 0);
    for (normal, position) in hits.normals.iter().zip(hits.positions) {
        let Some(position) = position else { continue };
        let angle = degrees(*normal, position);
        assert!(angle < 0.5, "{angle} degrees at {position}");
    }
}

/// The hit point nearest to the owner's plane by intersecting the line with every high triangle, in double precision.
fn brute_force(high: &Mesh, low: &Mesh, face: u32, centre: Vec2, size: u32, cage: f64) -> Option<DVec3> {
    let [p0, p1, p2] = low.face_positions(FaceId(face)).map(|p| p.as_dvec3());
    let [t0, t1, t2] = corner_texels(low, low.atlas_uv.as_ref().unwrap(), face as usize, size).map(|t| t.as_dvec2());
    let area = (t1 - t0).perp_dot(t2 - t0);
    let d = centre.as_dvec2() - t0;
    let (b1, b2) = (d.perp_dot(t2 - t0) / area, (t1 - t0).perp_dot(d) / area);
    let origin = p0 + (p1 - p0) * b1 + (p2 - p0) * b2;
    let normal = (p1 - p0).cross(p2 - p0).normalize();
    let mut best: Option<(f64, DVec3)> = None;
    for f in 0..high.face_count() as u32 {
        let [a, b, c] = high.face_positions(FaceId(f)).map(|p| p.as_dvec3());
        let n = (b - a).cross(c - a);
        let facing = n.dot(normal);
        if facing <= 0.0 {
            continue;
        }
        let k = n.dot(a - origin) / facing;
        let p = origin + normal * k;
        let inside = [(a, b), (b, c), (c, a)].iter().all(|(s, e)| n.dot((*e - *s).cross(p - *s)) >= 0.0);
        if inside && k.abs() <= cage && best.is_none_or(|(distance, _)| k.abs() < distance) {
            best = Some((k.abs(), p));
        }
    }
    best.map(|b| b.1)
}

#[test]
fn hits_are_the_points_nearest_to_the_low_plane() {
    // A folded composite: a bumpy torus with a cube through it, so that many lines meet several sheets.
    let high = valid(both(torus(60, 30, 0.05), cube(Vec3::new(1.0, 0.1, 0.0), 0.45)));
    let low = charted(&both(torus(10, 6, 0.0), cube(Vec3::new(1.0, 0.1, 0.0), 0.47)));
    let cage = 0.3;
    let hits = find(&high, &low, &within(cage, &normals_only(96, NormalSpace::Object)), Backend::Cpu).unwrap();
    let (mut compared, mut differ) = (0, 0);
    for (texel, (found, owner)) in hits.positions.iter().zip(&hits.low_faces).enumerate() {
        if *owner == 0 {
            assert!(found.is_none());
            continue;
        }
        let centre = Vec2::new((texel % 96) as f32 + 0.5, (texel / 96) as f32 + 0.5);
        let exact = brute_force(&high, &low, owner - 1, centre, 96, cage as f64);
        compared += 1;
        match (exact, found) {
            (Some(exact), Some(found)) if (exact - found.as_dvec3()).length() < 2e-3 => {}
            (None, None) => {}
            _ => differ += 1,
        }
    }
    // What may differ: lines that graze an edge within 1/512 texel and end on another sheet.
    assert!(compared > 3000 && differ * 500 < compared, "{differ} of {compared} texels differ");
}

#[test]
fn front_and_behind_count_alike_and_equal_distances_go_to_the_lower_face() {
    let low = plane(0.0, upright);
    let sheet_at = |z: f32| {
        let mut raw = plane(z, upright).into_raw();
        (raw.uv0, raw.atlas_uv, raw.tangents) = (None, None, None);
        raw
    };
    for (heights, nearest) in
        [([0.1, -0.05], 1), ([0.05, -0.1], 0), ([0.1, -0.1], 0), ([-0.1, 0.1], 0), ([0.1, 0.1], 0)]
    {
        let high = valid(both(sheet_at(heights[0]), sheet_at(heights[1])));
        let hits = find(&high, &low, &within(0.5, &normals_only(16, NormalSpace::Object)), Backend::Cpu).unwrap();
        for high_face in &hits.high_faces {
            assert_eq!((high_face - 1) / 2, nearest, "heights {heights:?}");
        }
    }
}

#[test]
fn the_cage_and_the_facing_rule_leave_texels_without_a_hit() {
    let low = plane(0.0, upright);
    let high = valid(hills(8, 0.0, 1.0));
    let lifted = |z: f32| {
        let mut raw = high.clone().into_raw();
        raw.positions.iter_mut().for_each(|p| p.z += z);
        valid(raw)
    };
    let options = normals_only(16, NormalSpace::Object);
    let covered = |high: &Mesh, options: &BakeOptions| {
        let hits = find(high, &low, &within(0.1, options), Backend::Cpu).unwrap();
        assert_eq!(hits.report.covered + hits.report.missed, 256);
        hits.report.covered
    };
    assert_eq!(covered(&lifted(0.09), &options), 256);
    assert_eq!(covered(&lifted(0.11), &options), 0);
    assert_eq!(covered(&lifted(-0.11), &options), 0);
    let mut turned = lifted(0.0).into_raw();
    turned.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let turned = valid(turned);
    assert_eq!(covered(&turned, &options), 0);
    assert_eq!(covered(&turned, &BakeOptions { back_faces: true, ..options.clone() }), 256);
    // Half of the high mesh is not there: exactly the texels over it are missed.
    let mut half = lifted(0.0).into_raw();
    half.positions.iter_mut().for_each(|p| p.x *= 0.5);
    assert_eq!(covered(&valid(half), &options), 128);
}

#[test]
fn a_texel_has_one_owner_and_overlapping_layouts_are_counted() {
    let low = plane(0.0, upright);
    let options = normals_only(33, NormalSpace::Object);
    let hits = find(&low, &low, &within(0.1, &options), Backend::Cpu).unwrap();
    assert_eq!((hits.report.owned, hits.report.overlapping), (33 * 33, 0));
    let mut raw = low.clone().into_raw();
    // The second triangle's corners fall on the first one's texels.
    let uv = raw.atlas_uv.as_mut().unwrap();
    let double = uv[1];
    uv[3] = double;
    let folded = valid(raw);
    let hits = find(&low, &folded, &within(0.1, &options), Backend::Cpu).unwrap();
    assert!(hits.report.owned > 500);
    assert_eq!(hits.report.overlapping, hits.report.owned);
    assert!(hits.low_faces.iter().all(|f| *f <= 1), "the lower face owns");
}

#[test]
fn one_and_four_threads_give_the_same_hits() {
    let high = valid(torus(60, 30, 0.05));
    let low = charted(&torus(12, 8, 0.0));
    let options = normals_only(128, NormalSpace::Object);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let hits = find(&high, &low, &within(0.3, &options), Backend::Cpu).unwrap();
            let bits: Vec<[u32; 3]> = hits.normals.iter().map(|n| n.to_array().map(f32::to_bits)).collect();
            (hits.low_faces, hits.high_faces, bits)
        })
    };
    assert!(with(1) == with(4));
}

#[test]
fn options_out_of_range_are_named() {
    let low = plane(0.0, upright);
    let options = |size| normals_only(size, NormalSpace::Object);
    let samples = BakeOptions { samples: 3, ..options(8) };
    for (options, name) in [
        (within(0.1, &options(0)), "size"),
        (within(0.1, &options(16385)), "size"),
        (within(0.0, &options(8)), "front"),
        (within(f32::NAN, &options(8)), "front"),
        (within(-1.0, &options(8)), "front"),
        (within(0.1, &samples), "samples"),
        (BakeOptions { rays: 0, ..within(0.1, &options(8)) }, "rays"),
    ] {
        match find(&low, &low, &options, Backend::Cpu) {
            Err(BakeError::Option { name: found, .. }) => assert_eq!(found, name),
            _ => panic!("{options:?} went through"),
        }
    }
}
