//! Post-conditions of merge and simplify, for tests, reports and debug builds.

use kiln_asset::Mesh;

use crate::topology::{EdgeKind, Topology};

/// New gaps: border edges of `after` at least one end of which lies where `before` had no border. Points are matched by position,
/// which half-edge collapses never change.
pub fn gaps(before: &Mesh, after: &Mesh) -> usize {
    let places = |mesh: &Mesh| {
        let topology = Topology::new(mesh);
        let mut ends: Vec<[[u32; 3]; 2]> = Vec::new();
        for (f, kinds) in topology.edge_kinds.iter().enumerate() {
            for (k, kind) in kinds.iter().enumerate() {
                if *kind == EdgeKind::Border && !crate::topology::is_degenerate(&topology.face_points[f]) {
                    let triangle = mesh.triangles[f];
                    let bits = |v: u32| mesh.positions[v as usize].to_array().map(|c| (c + 0.0).to_bits());
                    ends.push([bits(triangle[k]), bits(triangle[(k + 1) % 3])]);
                }
            }
        }
        ends
    };
    // Points of complex edges may become borders when one of their sheets vanishes; they never go, so they open nothing.
    let topology = Topology::new(before);
    let mut known: Vec<[u32; 3]> = places(before).into_iter().flatten().collect();
    for (v, p) in before.points.iter().enumerate() {
        if topology.kinds[p.index()] == crate::topology::PointKind::Complex {
            known.push(before.positions[v].to_array().map(|c| (c + 0.0).to_bits()));
        }
    }
    known.sort_unstable();
    known.dedup();
    let is_known = |place: &[u32; 3]| known.binary_search(place).is_ok();
    places(after).iter().filter(|ends| !ends.iter().all(is_known)).count()
}
