//! Post-conditions of merge and simplify, for tests, reports and debug builds.

use kiln_asset::{FaceId, Mesh};

use crate::topology::{EdgeKind, PointKind, Topology};

/// New gaps: border edges of `after` at least one end of which lies where `before` had no border. Points are matched by the
/// positions of their wedges, which half-edge collapses never change; free placement, which moves all wedges of a point together,
/// comes after this check.
///
/// Points of complex edges count as known: such an edge may become a border when one of its sheets vanishes, but its points
/// never go, so nothing opens there.
pub fn gaps(before: &Mesh, after: &Mesh) -> usize {
    Borders::of(before, &Topology::new(before)).gaps(after)
}

/// Where a mesh has borders; many others can be compared with it.
pub(crate) struct Borders {
    /// Places of all wedges of border and complex points, as bits, ascending.
    known: Vec<[u32; 3]>,
}

impl Borders {
    /// Of `before`, whose topology it is.
    pub(crate) fn of(before: &Mesh, topology: &Topology) -> Borders {
        let mut known_point: Vec<bool> = topology.kinds.iter().map(|kind| *kind == PointKind::Complex).collect();
        for corner in border_half_edges(topology) {
            for p in half_edge_points(topology, corner) {
                known_point[p as usize] = true;
            }
        }
        // All wedges of a point: which of them a border edge names may change with its faces.
        let mut known: Vec<[u32; 3]> = (0..before.vertex_count())
            .filter(|v| known_point[before.points[*v].index()])
            .map(|v| place(before, v))
            .collect();
        known.sort_unstable();
        known.dedup();
        Borders { known }
    }

    /// As [`gaps`].
    pub(crate) fn gaps(&self, after: &Mesh) -> usize {
        let topology = Topology::new(after);
        border_half_edges(&topology)
            .filter(|corner| {
                [*corner, crate::topology::next(*corner)].iter().any(|c| {
                    let v = after.triangles[*c as usize / 3][*c as usize % 3] as usize;
                    self.known.binary_search(&place(after, v)).is_err()
                })
            })
            .count()
    }
}

fn place(mesh: &Mesh, v: usize) -> [u32; 3] {
    mesh.positions[v].to_array().map(|c| (c + 0.0).to_bits())
}

/// The corners whose half-edges have no second face.
fn border_half_edges(topology: &Topology) -> impl Iterator<Item = u32> {
    let kinds = topology.edge_kinds.iter().flatten().zip(0..);
    kinds.filter(|(kind, _)| **kind == EdgeKind::Border).map(|(_, corner)| corner)
}

fn half_edge_points(topology: &Topology, corner: u32) -> [u32; 2] {
    [corner, crate::topology::next(corner)].map(|c| topology.face_points[c as usize / 3][c as usize % 3])
}

/// Faces with two corners at one point: none is left by `merge`, and none is made by a collapse.
pub fn degenerate_faces(mesh: &Mesh) -> usize {
    (0..mesh.face_count() as u32)
        .filter(|f| crate::topology::is_degenerate(&mesh.face_points(FaceId(*f)).map(|p| p.0)))
        .count()
}
