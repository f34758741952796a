//! Merge: the submeshes of an asset as one mesh whose parts share points where they touch.
//!
//! **Problem.** In: a mesh whose submeshes each have points of their own. Out: the same faces, order, names, materials and
//! attribute values, but along every *boundary* (where two submeshes touch) both sides refer to the same points, so that
//! whatever moves a point later moves it for both and no crack can open. Positions are not touched: every wedge keeps its
//! own, so parts that no later stage changes come back bit for bit. On the way the mesh is repaired, and every repair counted
//! ([`RepairKind`]); a sound mesh keeps all its faces and values.
//!
//! **Method.**
//! ```text
//! drop degenerate and duplicate faces
//! border half-edges <- edges with exactly one face within their own submesh
//! sort their midpoints into a grid of cells twice the weld distance wide
//! for every pair of border edges of different submeshes with midpoints in reach:
//!     if their ends lie pairwise within the weld distance: unite the points, end by end
//! number the united points anew, lowest first
//! drop what the union made degenerate or duplicate
//! if asked for: turn over faces that are wound against their patch or inwards     (winding)
//! give normals without direction the mean of their faces' normals                 (normals)
//! drop vertices that no face uses
//! ```
//! Closed parts that merely touch have no border edges and are never welded. Within one submesh nothing is joined by
//! distance: import has already joined equal positions there, and two borders of one part that lie close are more often a
//! slit that the author wanted than a mistake. (Two points of one submesh can still meet through a third part that lies
//! within the weld distance of both.)
//!
//! Degenerate faces and unused vertices always go: no later stage can do anything with them. Windings stay unless asked for,
//! since a scene may well mean them (a room seen from inside, leaves drawn from one side). Where they are repaired, a normal
//! that afterwards looks away from the faces of its wedge is turned round; right normals on wrongly wound faces stay.
//!
//! **Departures** from González: none in the rule; he gives no way to find the pairs.
//!
//! **Limits.** Only edges that match end by end are joined: where one part has a vertex in the middle of its neighbour's edge
//! (a T-junction) the two stay apart. The repair of windings turns the wall of a closed cavity outward like any other closed
//! part, and leaves a patch without orientation (a Möbius strip) as it is; the report names it. Where three or more parts share an edge it is joined, and simplification keeps it as it is.
//!
//! **Sources.** C. González, *Simplification of 3D models for interactive applications*, PhD thesis, Universitat Jaume I
//! 2010, section 3.3 (virtual mesh, boundary edges).

mod border;
mod clean;
mod normals;
mod repair;
mod survey;
mod winding;

use kiln_asset::{FaceId, Mesh, PointId};
use serde::{Deserialize, Serialize};

pub use repair::{Repair, RepairKind};
pub use survey::{Survey, survey};

use repair::{Repairs, place};

/// What `merge` may do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MergeOptions {
    /// Farthest that the ends of two border edges may lie apart to be joined, object units. The default 0 joins only equal
    /// positions; files that store parts in local coordinates want about 1e-5 of the diagonal. Values above a hundredth of
    /// the diagonal are taken as that.
    pub weld: f32,
    /// Drop faces that their submesh has already. Default: yes.
    pub duplicate_faces: bool,
    /// Rebuild normals without direction. Default: yes.
    pub zero_normals: bool,
    /// Turn over faces that are wound the wrong way round. Default: no.
    pub winding: bool,
}

impl Default for MergeOptions {
    fn default() -> Self {
        MergeOptions { weld: 0.0, duplicate_faces: true, zero_normals: true, winding: false }
    }
}

/// What `merge` did.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MergeReport {
    /// Edges with exactly one face within their own submesh, before joining.
    pub border_edges: u32,
    /// Of them, how many now lie on a boundary.
    pub joined_edges: u32,
    /// How many points fewer than before for the joining.
    pub joined_points: u32,
    /// What was repaired, by kind.
    pub repairs: Vec<Repair>,
    /// One face of each patch without orientation, such as a Möbius strip: its windings were left. Empty unless asked for.
    pub unorientable: Vec<String>,
}

impl MergeReport {
    /// How often a kind of repair was made.
    pub fn count(&self, kind: RepairKind) -> u32 {
        self.repairs.iter().find(|repair| repair.kind == kind).map_or(0, |repair| repair.count)
    }
}

/// `mesh` with shared points along the boundaries of its submeshes, repaired as `options` say, and what was done to it. Faces keep
/// their order, vertices theirs, and all attributes that no repair names, positions among them, are bitwise equal.
pub fn merge(mesh: &Mesh, options: &MergeOptions) -> (Mesh, MergeReport) {
    let mut report = MergeReport::default();
    let mut repairs = Repairs::default();
    let all = (0..mesh.face_count() as u32).map(FaceId).collect();
    let kept = clean::sound_faces(mesh, &mesh.points, all, options, &mut repairs);

    let edges = border::border_edges(mesh, &kept);
    report.border_edges = edges.len() as u32;
    let weld = if options.weld > 0.0 { options.weld.min(0.01 * mesh.diagonal()) } else { 0.0 };
    let (points, joined) = border::join(mesh, &edges, weld);
    report.joined_edges = joined;
    report.joined_points = (mesh.point_count() - count(&points)) as u32;
    let mut kept = clean::sound_faces(mesh, &points, kept, options, &mut repairs);

    let mut changed = None;
    if options.winding {
        loop {
            let mesh = changed.as_ref().unwrap_or(mesh);
            let found = winding::flood(mesh, &points, &kept);
            report.unorientable = found.unorientable.iter().map(|f| place(mesh, *f)).collect();
            let Some(first) = found.flips.first() else { break };
            repairs.add(RepairKind::Winding, found.flips.len(), || place(mesh, *first));
            let turned = winding::turn(mesh, &kept, &found.flips);
            // Two sheets that ended at one crowded edge may have become one: each further round has fewer faces.
            kept = clean::sound_faces(&turned, &points, kept, options, &mut repairs);
            changed = Some(turned);
        }
    }
    if options.zero_normals
        && let Some(filled) = normals::rebuild_zero(changed.as_ref().unwrap_or(mesh), &points, &kept, &mut repairs)
    {
        changed = Some(filled);
    }
    let merged = clean::gather(changed.as_ref().unwrap_or(mesh), points, &kept, &mut repairs);
    report.repairs = repairs.finish();
    (merged, report)
}

/// Number of points in a dense numbering.
fn count(points: &[PointId]) -> usize {
    points.iter().map(|p| p.index() + 1).max().unwrap_or(0)
}

#[cfg(test)]
mod tests;
