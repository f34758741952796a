//! What a mesh is like, counted and not changed.

use kiln_asset::{FaceId, Mesh};
use serde::Serialize;

use super::border::Union;
use super::winding;
use crate::topology::is_degenerate;

/// Counts over the points of a mesh; degenerate faces are left out of all of them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Survey {
    /// Edges with exactly one face.
    pub border_edges: u32,
    /// Edges with more than two faces.
    pub crowded_edges: u32,
    /// Edges with two faces that run along it in one direction: one of them is wound the wrong way round.
    pub disagreeing_edges: u32,
    /// Parts that have no point in common.
    pub components: u32,
    /// Patches of faces that hang together over edges with two faces each.
    pub patches: u32,
    /// Of them, how many have neither a border nor a crowded edge.
    pub closed_patches: u32,
    /// Of these, how many are wound inwards throughout.
    pub inside_out_patches: u32,
    /// Patches that cannot be wound consistently, such as a Möbius strip.
    pub unorientable_patches: u32,
    /// Faces that the repair of windings would turn over.
    pub turnable_faces: u32,
}

/// The counts for `mesh`, over the points that it has: best asked of a merged mesh.
pub fn survey(mesh: &Mesh) -> Survey {
    let sound = |f: &FaceId| !is_degenerate(&mesh.face_points(*f).map(|p| p.0));
    let kept: Vec<FaceId> = (0..mesh.face_count() as u32).map(FaceId).filter(sound).collect();
    let found = winding::flood(mesh, &mesh.points, &kept);
    let mut parts = Union::new(mesh.point_count());
    let mut used = vec![false; mesh.point_count()];
    for f in &kept {
        let [a, b, c] = mesh.face_points(*f);
        parts.unite(a, b);
        parts.unite(b, c);
        for p in [a, b, c] {
            used[p.index()] = true;
        }
    }
    let components = (0..mesh.point_count() as u32).filter(|p| used[*p as usize] && parts.find(*p) == *p).count();
    Survey {
        border_edges: found.border_edges,
        crowded_edges: found.crowded_edges,
        disagreeing_edges: found.disagreeing_edges,
        components: components as u32,
        patches: found.patches,
        closed_patches: found.closed_patches,
        inside_out_patches: found.inside_out_patches,
        unorientable_patches: found.unorientable.len() as u32,
        turnable_faces: found.flips.len() as u32,
    }
}
