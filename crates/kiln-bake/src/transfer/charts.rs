//! Charts of a layout: faces that hang together in it.

use glam::Vec2;
use kiln_asset::Mesh;

/// `[face_count]` chart of each face, numbered by first face: faces belong together where they share a point at one place of the
/// layout.
pub(crate) fn charts(mesh: &Mesh, uv: &[Vec2]) -> Vec<u32> {
    let key = |v: u32| (mesh.points[v as usize].0, uv[v as usize].x.to_bits(), uv[v as usize].y.to_bits());
    let mut order: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    order.sort_unstable_by_key(|v| (key(*v), *v));
    // One number for all vertices at one place.
    let mut place = vec![0u32; mesh.vertex_count()];
    let mut count = 0;
    for (k, v) in order.iter().enumerate() {
        if k > 0 && key(order[k - 1]) != key(*v) {
            count += 1;
        }
        place[*v as usize] = count;
    }
    let mut parent: Vec<u32> = (0..=count).collect();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| root(&mut parent, place[v as usize]));
        let least = a.min(b).min(c);
        for r in [a, b, c] {
            parent[r as usize] = least;
        }
    }
    let mut number = vec![u32::MAX; count as usize + 1];
    let mut next = 0;
    let chart_of = |triangle: &[u32; 3]| {
        let r = root(&mut parent, place[triangle[0] as usize]) as usize;
        if number[r] == u32::MAX {
            number[r] = next;
            next += 1;
        }
        number[r]
    };
    mesh.triangles.iter().map(chart_of).collect()
}

fn root(parent: &mut [u32], mut at: u32) -> u32 {
    while parent[at as usize] != at {
        parent[at as usize] = parent[parent[at as usize] as usize];
        at = parent[at as usize];
    }
    at
}
