//! Merge: the submeshes of an asset as one mesh whose parts share points where they touch.
//!
//! **Problem.** In: a mesh whose submeshes each have points of their own. Out: the same faces, order, names, materials and
//! attribute values, but along every *boundary* (where two submeshes touch) both sides refer to the same points, so that
//! whatever moves a point later moves it for both and no crack can open. Positions are not touched: every wedge keeps its
//! own, so parts that no later stage changes come back bit for bit.
//!
//! **Method.**
//! ```text
//! drop degenerate and duplicate faces
//! border half-edges <- edges with exactly one face within their own submesh
//! sort their midpoints into a grid of cells twice the weld distance wide
//! for every pair of border edges of different submeshes with midpoints in reach:
//!     if their ends lie pairwise within the weld distance: unite the points, end by end
//! number the united points anew, lowest first
//! drop what the union made degenerate or duplicate, and vertices that no face uses
//! ```
//! Closed parts that merely touch have no border edges and are never welded. Within one submesh nothing is joined by
//! distance: import has already joined equal positions there, and two borders of one part that lie close are more often a
//! slit that the author wanted than a mistake. (Two points of one submesh can still meet through a third part that lies
//! within the weld distance of both.)
//!
//! **Departures** from González: none in the rule; he gives no way to find the pairs.
//!
//! **Limits.** Only edges that match end by end are joined: where one part has a vertex in the middle of its neighbour's edge
//! (a T-junction) the two stay apart. Where three or more parts share an edge it is joined, and simplification keeps it as it is.
//!
//! **Sources.** C. González, *Simplification of 3D models for interactive applications*, PhD thesis, Universitat Jaume I
//! 2010, section 3.3 (virtual mesh, boundary edges).

mod border;
mod clean;

use kiln_asset::{Mesh, PointId};
use serde::{Deserialize, Serialize};

/// What `merge` may do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MergeOptions {
    /// Farthest that the ends of two border edges may lie apart to be joined, object units. The default 0 joins only equal
    /// positions; files that store parts in local coordinates want about 1e-5 of the diagonal. Values above a hundredth of
    /// the diagonal are taken as that.
    pub weld: f32,
}

impl Default for MergeOptions {
    fn default() -> Self {
        MergeOptions { weld: 0.0 }
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
    /// Faces dropped because two of their corners lay at one point.
    pub degenerate_faces: u32,
    /// Faces dropped because their submesh had the same three points in the same winding already.
    pub duplicate_faces: u32,
    /// Vertices dropped because no face used them.
    pub unused_vertices: u32,
}

/// `mesh` with shared points along the boundaries of its submeshes, without degenerate and duplicate faces, and what was
/// done to it. Faces keep their order, vertices theirs, and all their attributes, positions included, are bitwise equal.
pub fn merge(mesh: &Mesh, options: &MergeOptions) -> (Mesh, MergeReport) {
    let mut report = MergeReport::default();
    let kept = clean::sound_faces(mesh, &mesh.points, &mut report);

    let edges = border::border_edges(mesh, &kept);
    report.border_edges = edges.len() as u32;
    let weld = if options.weld > 0.0 { options.weld.min(0.01 * mesh.diagonal()) } else { 0.0 };
    let (points, joined) = border::join(mesh, &edges, weld);
    report.joined_edges = joined;
    report.joined_points = (mesh.point_count() - count(&points)) as u32;

    let kept = clean::sound_faces_of(mesh, &points, kept, &mut report);
    let merged = clean::gather(mesh, points, &kept, &mut report);
    (merged, report)
}

/// Number of points in a dense numbering.
fn count(points: &[PointId]) -> usize {
    points.iter().map(|p| p.index() + 1).max().unwrap_or(0)
}

#[cfg(test)]
mod tests;
