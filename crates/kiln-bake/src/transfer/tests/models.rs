//! Models with known answers.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};
use kiln_asset::{AttributeSet, Level, LodSet, MaterialId, Mesh, RawMesh, Submesh, SubmeshId, UvLayout};
use kiln_geom::math::{cos, sin};

use crate::tangents::{UvSource, mikktspace};

/// One submesh named `part` with these triangles.
pub(super) fn mesh(positions: Vec<Vec3>, normals: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> RawMesh {
    RawMesh {
        face_submesh: vec![SubmeshId(0); triangles.len()],
        submeshes: vec![Submesh {
            name: "part".into(),
            attributes: AttributeSet { normals: true, ..AttributeSet::default() },
            ..Submesh::default()
        }],
        normals: Some(normals),
        positions,
        triangles,
        ..RawMesh::default()
    }
}

pub(super) fn valid(raw: RawMesh) -> Mesh {
    Mesh::new(raw).expect("a valid mesh")
}

/// A grid of `columns` x `rows` quads over `[0, 1]^2`, closed where `place` closes it. `place` gives position and normal.
pub(super) fn grid(columns: u32, rows: u32, place: impl Fn(f32, f32) -> (Vec3, Vec3)) -> RawMesh {
    let (mut positions, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for j in 0..=rows {
        for i in 0..=columns {
            let (p, n) = place(i as f32 / columns as f32, j as f32 / rows as f32);
            positions.push(p);
            normals.push(n);
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let a = j * (columns + 1) + i;
            let (b, c, d) = (a + 1, a + columns + 1, a + columns + 2);
            triangles.push([a, b, d]);
            triangles.push([a, d, c]);
        }
    }
    mesh(positions, normals, triangles)
}

/// A unit sphere of about `2 * columns * rows` triangles with exact normals; the poles' degenerate triangles are left out.
pub(super) fn sphere(columns: u32, rows: u32) -> RawMesh {
    let mut raw = grid(columns, rows, |u, v| {
        let (a, b) = (u * TAU, v * TAU / 2.0);
        let n = Vec3::new(sin(b) * cos(a), -cos(b), -sin(b) * sin(a));
        (n, n)
    });
    let positions = raw.positions.clone();
    raw.triangles.retain(|t| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        (b - a).cross(c - a).length() > 1e-6
    });
    raw.face_submesh = vec![SubmeshId(0); raw.triangles.len()];
    raw
}

/// A torus of radii 1 and 0.4 whose tube is `bump` thicker and thinner in waves; normals by differences.
pub(super) fn torus(columns: u32, rows: u32, bump: f32) -> RawMesh {
    let place = |u: f32, v: f32| {
        let (a, b) = (u * TAU, v * TAU);
        let r = 0.4 + bump * sin(8.0 * a) * sin(5.0 * b);
        Vec3::new((1.0 + r * cos(b)) * cos(a), r * sin(b), -(1.0 + r * cos(b)) * sin(a))
    };
    grid(columns, rows, |u, v| {
        let e = 1e-3;
        let du = place(u + e, v) - place(u - e, v);
        let dv = place(u, v + e) - place(u, v - e);
        (place(u, v), du.cross(dv).normalize())
    })
}

/// An axis-aligned cube with flat normals.
pub(super) fn cube(centre: Vec3, half: f32) -> RawMesh {
    let (mut positions, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let n = Vec3::from_array(std::array::from_fn(|k| if k == axis { sign } else { 0.0 }));
            let s = Vec3::from_array(std::array::from_fn(|k| if k == (axis + 1) % 3 { 1.0 } else { 0.0 }));
            let t = n.cross(s);
            let first = positions.len() as u32;
            for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                positions.push(centre + half * (n + x * s + y * t));
                normals.push(n);
            }
            triangles.push([first, first + 1, first + 2]);
            triangles.push([first, first + 2, first + 3]);
        }
    }
    mesh(positions, normals, triangles)
}

/// Two models in one submesh.
pub(super) fn both(mut a: RawMesh, b: RawMesh) -> RawMesh {
    let shift = a.positions.len() as u32;
    a.positions.extend(b.positions);
    a.triangles.extend(b.triangles.iter().map(|t| t.map(|v| v + shift)));
    a.face_submesh.extend(b.face_submesh);
    let (Some(an), Some(bn)) = (&mut a.normals, b.normals) else { panic!("models have normals") };
    an.extend(bn);
    a.points.clear();
    a
}

/// Every face becomes a chart of its own in a square of a grid, so no vertex is shared; tangents along that atlas.
pub(super) fn charted(raw: &RawMesh) -> Mesh {
    let squares = (1..).find(|n| n * n * 2 >= raw.triangles.len()).expect("some grid");
    let keep: Vec<u32> = raw.triangles.iter().flatten().copied().collect();
    let triangles: Vec<[u32; 3]> = (0..raw.triangles.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let welded = valid(raw.clone()).into_raw();
    let mut out = welded.gather(&keep, triangles, raw.face_submesh.clone());
    let margin = 0.04;
    let uv = (0..raw.triangles.len()).flat_map(|f| {
        let cell = Vec2::new((f / 2 % squares) as f32, (f / 2 / squares) as f32);
        // Two triangles a square, apart by the margin.
        let corners = if f % 2 == 0 {
            [Vec2::new(margin, margin), Vec2::new(1.0 - 3.0 * margin, margin), Vec2::new(margin, 1.0 - 3.0 * margin)]
        } else {
            [
                Vec2::new(1.0 - margin, 1.0 - margin),
                Vec2::new(3.0 * margin, 1.0 - margin),
                Vec2::new(1.0 - margin, 3.0 * margin),
            ]
        };
        corners.map(|c| (cell + c) / squares as f32)
    });
    out.atlas_uv = Some(uv.collect());
    mikktspace(&valid(out), UvSource::AtlasUv).expect("tangents")
}

/// The square `[0, 1]^2` at height `z`, facing +Z, with `uv0` and `atlas_uv` as `layout` maps (x, y) and tangents along
/// the atlas.
pub(super) fn plane(z: f32, layout: impl Fn(f32, f32) -> Vec2) -> Mesh {
    let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    let mut raw =
        mesh(corners.iter().map(|(x, y)| Vec3::new(*x, *y, z)).collect(), vec![Vec3::Z; 4], vec![[0, 1, 2], [0, 2, 3]]);
    let uv: Vec<Vec2> = corners.iter().map(|(x, y)| layout(*x, *y)).collect();
    raw.uv0 = Some(uv.clone());
    raw.atlas_uv = Some(uv);
    raw.submeshes[0].attributes.uv0 = true;
    raw.submeshes[0].material = Some(MaterialId(0));
    mikktspace(&valid(raw), UvSource::AtlasUv).expect("tangents")
}

/// A height field over `[0, 1]^2` with exact normals.
pub(super) fn hills(steps: u32, height: f32, waves: f32) -> RawMesh {
    grid(steps, steps, |x, y| {
        let w = waves * TAU;
        let z = height * sin(w * x) * sin(w * y);
        let slope = Vec3::new(-height * w * cos(w * x) * sin(w * y), -height * w * sin(w * x) * cos(w * y), 1.0);
        (Vec3::new(x, y, z), slope.normalize())
    })
}

/// One level as a set.
pub(super) fn one_level(mesh: Mesh, size: u32, padding: u32) -> LodSet {
    LodSet {
        source_triangles: mesh.face_count() as u32,
        layout: Some(UvLayout { size, padding, chart_count: 1, sheets: 1 }),
        levels: vec![Level { mesh, error: 0.0, quadrics: Vec::new() }],
    }
}

/// V downwards, as glTF has it.
pub(super) fn upright(x: f32, y: f32) -> Vec2 {
    Vec2::new(x, 1.0 - y)
}
