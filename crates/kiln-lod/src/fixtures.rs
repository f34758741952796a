//! Small meshes for this crate's tests.

use glam::{Vec2, Vec3};
use kiln_asset::{Mesh, RawMesh, Submesh, SubmeshId};

use crate::merge::{MergeOptions, merge};

fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
    let submesh = Submesh { name: "part".into(), source_triangles: triangles.len() as u32, ..Default::default() };
    Mesh::new(RawMesh {
        positions,
        face_submesh: vec![SubmeshId(0); triangles.len()],
        triangles,
        submeshes: vec![submesh],
        ..Default::default()
    })
    .expect("a sound fixture")
}

/// Triangles over as many separate places as they name.
pub(crate) fn soup(triangles: &[[u32; 3]]) -> Mesh {
    let count = triangles.iter().flatten().max().map_or(0, |m| m + 1);
    let place = |i: u32| Vec3::new(i as f32, (i * i % 7) as f32, (i * 5 % 3) as f32);
    mesh((0..count).map(place).collect(), triangles.to_vec())
}

fn grid_triangles(columns: u32, rows: u32, first: u32) -> Vec<[u32; 3]> {
    let mut triangles = Vec::new();
    for y in 0..rows {
        for x in 0..columns {
            let a = first + y * (columns + 1) + x;
            let b = a + columns + 1;
            triangles.extend([[a, a + 1, b], [a + 1, b + 1, b]]);
        }
    }
    triangles
}

fn grid_points(columns: u32, rows: u32, x0: f32) -> Vec<Vec3> {
    (0..=rows).flat_map(|y| (0..=columns).map(move |x| Vec3::new(x0 + x as f32, y as f32, 0.0))).collect()
}

/// A flat grid of quads, open all around.
pub(crate) fn grid(columns: u32, rows: u32) -> Mesh {
    mesh(grid_points(columns, rows, 0.0), grid_triangles(columns, rows, 0))
}

/// The height field `z(x, y)` over a grid.
pub(crate) fn field(columns: u32, rows: u32, z: impl Fn(f32, f32) -> f32) -> Mesh {
    let mut points = grid_points(columns, rows, 0.0);
    for p in &mut points {
        p.z = z(p.x, p.y);
    }
    mesh(points, grid_triangles(columns, rows, 0))
}

/// A closed sphere of `columns` meridians and `rows` bands, radius 1.
pub(crate) fn sphere(columns: u32, rows: u32) -> Mesh {
    let mut points = vec![Vec3::Y];
    for r in 1..rows {
        let polar = std::f32::consts::PI * r as f32 / rows as f32;
        for c in 0..columns {
            let turn = std::f32::consts::TAU * c as f32 / columns as f32;
            points.push(Vec3::new(polar.sin() * turn.cos(), polar.cos(), polar.sin() * turn.sin()));
        }
    }
    points.push(-Vec3::Y);
    let last = points.len() as u32 - 1;
    let at = |r: u32, c: u32| 1 + (r - 1) * columns + c % columns;
    let mut triangles = Vec::new();
    for c in 0..columns {
        triangles.push([0, at(1, c + 1), at(1, c)]);
        for r in 1..rows - 1 {
            triangles.push([at(r, c), at(r, c + 1), at(r + 1, c)]);
            triangles.push([at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)]);
        }
        triangles.push([last, at(rows - 1, c), at(rows - 1, c + 1)]);
    }
    mesh(points, triangles)
}

/// A cube of `n x n` quads a side, each side with wedges, normals and UVs of its own.
pub(crate) fn hard_cube(n: u32) -> Mesh {
    let mut raw =
        RawMesh { submeshes: vec![Submesh { name: "cube".into(), ..Default::default() }], ..Default::default() };
    let (mut normals, mut uvs) = (Vec::new(), Vec::new());
    let axes = [Vec3::X, Vec3::Y, Vec3::Z];
    for side in 0..6_usize {
        let (k, sign) = (side / 2, if side % 2 == 0 { 1.0 } else { -1.0 });
        let (out, u, v) = (axes[k] * sign, axes[(k + 1) % 3], axes[(k + 2) % 3]);
        let first = raw.positions.len() as u32;
        for y in 0..=n {
            for x in 0..=n {
                let place = [x, y].map(|i| 2.0 * i as f32 / n as f32 - 1.0);
                raw.positions.push(out + u * place[0] + v * place[1]);
                normals.push(out);
                uvs.push(Vec2::new(side as f32 + x as f32 / n as f32 * 0.9, y as f32 / n as f32));
            }
        }
        for t in grid_triangles(n, n, first) {
            raw.triangles.push(if sign > 0.0 { t } else { [t[0], t[2], t[1]] });
        }
    }
    raw.face_submesh = vec![SubmeshId(0); raw.triangles.len()];
    raw.submeshes[0].source_triangles = raw.triangles.len() as u32;
    raw.submeshes[0].attributes.normals = true;
    raw.submeshes[0].attributes.uv0 = true;
    raw.normals = Some(normals);
    raw.uv0 = Some(uvs);
    Mesh::new(raw).expect("a sound fixture")
}

/// Two grids side by side as two submeshes, merged.
pub(crate) fn merged_pair(columns: u32, rows: u32) -> Mesh {
    merge(&pair(columns, rows), &MergeOptions::default()).0
}

/// Two wavy grids side by side as two submeshes, not merged.
pub(crate) fn pair(columns: u32, rows: u32) -> Mesh {
    let mut positions = grid_points(columns, rows, 0.0);
    positions.extend(grid_points(columns, rows, columns as f32));
    for p in &mut positions {
        p.z = (p.x * 0.7).sin() * 0.3 + (p.y * 0.9).cos() * 0.2;
    }
    let half = (positions.len() / 2) as u32;
    let mut triangles = grid_triangles(columns, rows, 0);
    let count = triangles.len();
    triangles.extend(grid_triangles(columns, rows, half));
    let submesh = |name: &str| Submesh { name: name.into(), source_triangles: count as u32, ..Default::default() };
    Mesh::new(RawMesh {
        positions,
        face_submesh: (0..2 * count).map(|f| SubmeshId((f >= count) as u32)).collect(),
        triangles,
        submeshes: vec![submesh("left"), submesh("right")],
        ..Default::default()
    })
    .expect("a sound fixture")
}

/// `columns x rows` submeshes "part X Y" of `n x n` quads each, on the height field `z(x, y)`, merged.
pub(crate) fn quilt(columns: u32, rows: u32, n: u32, z: impl Fn(f32, f32) -> f32) -> Mesh {
    let mut raw = RawMesh::default();
    for part in 0..columns * rows {
        let (x0, y0) = ((part % columns * n) as f32, (part / columns * n) as f32);
        let first = raw.positions.len() as u32;
        raw.positions.extend(grid_points(n, n, x0).into_iter().map(|p| Vec3::new(p.x, p.y + y0, z(p.x, p.y + y0))));
        let triangles = grid_triangles(n, n, first);
        raw.face_submesh.extend(triangles.iter().map(|_| SubmeshId(part)));
        let name = format!("part {} {}", part % columns, part / columns);
        raw.submeshes.push(Submesh { name, source_triangles: triangles.len() as u32, ..Default::default() });
        raw.triangles.extend(triangles);
    }
    raw.uv0 = Some(raw.positions.iter().map(|p| p.truncate() * 0.01).collect());
    merge(&Mesh::new(raw).expect("a sound fixture"), &MergeOptions::default()).0
}

/// A 4 x 4 grid with a UV slit along the line x = 2 from the border up to y = 2.
pub(crate) fn slit_grid() -> Mesh {
    let mut raw = grid(4, 4).into_raw();
    let mut uv: Vec<Vec2> = raw.positions.iter().map(|p| p.truncate()).collect();
    for y in 0..2_u32 {
        let old = y * 5 + 2;
        let new = raw.positions.len() as u32;
        raw.positions.push(raw.positions[old as usize]);
        uv.push(uv[old as usize] + Vec2::new(10.0, 0.0));
        for t in &mut raw.triangles {
            let right = t.iter().any(|v| *v < 25 && v % 5 > 2);
            for v in t.iter_mut().filter(|v| **v == old && right) {
                *v = new;
            }
        }
    }
    raw.points.clear();
    raw.uv0 = Some(uv);
    Mesh::new(raw).expect("a sound fixture")
}
