//! Cluster DAG: which clusters to draw, and their triangles.
//!
//! A group is **above** what is allowed where its error shows too much; a cluster is drawn if its group is above and the group that
//! made it is not:
//! ```text
//! Detail::Error   above <- error > allowed
//! Detail::View    above <- scale error > near and |centre - eye|^2 < (scale error + radius)^2
//! roots           above, always: nothing replaces them
//! ```
//! That is the error against what a pixel covers at the nearest point of the group's sphere, or at `near`, without quotient and root.
//! Spheres and errors hold those below by more than single precision rounds, so with a sound container every corner of the surface is drawn once.
//! `shaders/select_clusters.wgsl` decides by the same products.
//!
//! Nothing here panics or allocates beyond what it returns, whatever the records say: a cluster that names no group or leaves its
//! arrays is not drawn.
//!
//! **Limits.** Every cluster is asked, some nanoseconds each; there is no hierarchy. Lengths above 1e18 overflow.

use alloc::vec::Vec;
pub use kiln_format::layout::{ClusterRecord, ClusterView, GroupRecord};

use kiln_format::layout::{MAX_CLUSTER_TRIANGLES, MAX_CLUSTER_VERTICES};
use kiln_format::record::NONE;

/// How much detail is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Detail {
    /// The same error all over, object units.
    Error(f32),
    /// As seen from a place.
    View {
        /// The eye, object space.
        eye: [f32; 3],
        /// From what distance on an error of one object unit is allowed, object units: pixels that a unit covers at distance 1 by
        /// the pixels that an error may cover.
        scale: f32,
        /// What is drawn is at least this far from the eye: distance of the near plane, object units.
        near: f32,
    },
}

impl Detail {
    /// What a perspective camera at `eye` (object space) needs so that no error covers more than `max_error_px` pixels.
    ///
    /// Values that make no view, and an error of 0 pixels, give the finest detail.
    pub fn of_view(eye: [f32; 3], vertical_fov_radians: f32, viewport_height_px: f32, max_error_px: f32) -> Detail {
        let scale = viewport_height_px / (2.0 * libm::tanf(vertical_fov_radians * 0.5) * max_error_px);
        Detail::View { eye, scale: if scale.is_finite() && scale >= 0.0 { scale } else { f32::INFINITY }, near: 0.0 }
    }

    /// Whether a group's error shows too much.
    fn is_above(&self, group: &GroupRecord) -> bool {
        if group.error == f32::MAX {
            return true;
        }
        match self {
            Detail::Error(allowed) => group.error > *allowed,
            Detail::View { eye, scale, near } => {
                let [x, y, z, radius] = group.sphere;
                let (x, y, z) = (x - eye[0], y - eye[1], z - eye[2]);
                let shows = scale * group.error;
                let reach = shows + radius;
                shows > *near && x * x + y * y + z * z < reach * reach
            }
        }
    }
}

/// Whether `cluster` is drawn.
fn is_drawn(view: &ClusterView<'_>, cluster: &ClusterRecord, detail: &Detail) -> bool {
    let is_above = |group: u32| view.groups.get(group as usize).map(|group| detail.is_above(group));
    is_above(cluster.group) == Some(true) && (cluster.made_by == NONE || is_above(cluster.made_by) == Some(false))
}

/// The numbers of the clusters to draw, ascending.
pub fn selected<'a>(view: &'a ClusterView<'_>, detail: Detail) -> impl Iterator<Item = u32> + 'a {
    let drawn = move |(_, cluster): &(u32, &ClusterRecord)| is_drawn(view, cluster, &detail);
    (0..).zip(view.clusters).filter(drawn).map(|(number, _)| number)
}

/// Replaces `out` by the numbers of the clusters to draw, ascending.
pub fn select(view: &ClusterView<'_>, detail: Detail, out: &mut Vec<u32>) {
    out.clear();
    out.extend(selected(view, detail));
}

/// Writes the numbers of the clusters to draw, ascending, as far as there is room, and returns how many there are.
pub fn select_into(view: &ClusterView<'_>, detail: Detail, out: &mut [u32]) -> usize {
    let mut count = 0;
    for number in selected(view, detail) {
        if let Some(slot) = out.get_mut(count) {
            *slot = number;
        }
        count += 1;
    }
    count
}

/// A cluster's triangles as vertices of level 0; none if its record leaves the arrays.
pub fn triangles<'a>(view: &ClusterView<'a>, cluster: u32) -> impl Iterator<Item = [u32; 3]> + 'a {
    let (references, corners) = slices(view, cluster).unwrap_or_default();
    let vertex = |place: u8| references.get(usize::from(place)).copied();
    corners.chunks_exact(3).filter_map(move |t| Some([vertex(t[0])?, vertex(t[1])?, vertex(t[2])?]))
}

/// A cluster's references and corners.
fn slices<'a>(view: &ClusterView<'a>, cluster: u32) -> Option<(&'a [u32], &'a [u8])> {
    let cluster = view.clusters.get(cluster as usize)?;
    if cluster.triangle_count > MAX_CLUSTER_TRIANGLES || cluster.vertex_count > MAX_CLUSTER_VERTICES {
        return None;
    }
    let references = view.references.get(cluster.first_reference as usize..)?;
    let corners = view.corners.get((cluster.first_triangle as usize).checked_mul(3)?..)?;
    Some((references.get(..cluster.vertex_count as usize)?, corners.get(..3 * cluster.triangle_count as usize)?))
}

/// Replaces `out` by the index buffer of these clusters, in their order: vertices of level 0, three a triangle.
pub fn indices(view: &ClusterView<'_>, clusters: &[u32], out: &mut Vec<u32>) {
    out.clear();
    for cluster in clusters {
        out.extend(triangles(view, *cluster).flatten());
    }
}

/// Triangles that are drawn; does not rise as less detail is wanted.
pub fn triangle_count(view: &ClusterView<'_>, detail: Detail) -> u64 {
    let drawn = view.clusters.iter().filter(|cluster| is_drawn(view, cluster, &detail));
    drawn.map(|cluster| u64::from(cluster.triangle_count)).sum()
}

/// The most detail of the kind of `detail` that draws at most `budget` triangles, and not more than `detail` itself; the least that
/// there is if all of it draws more. Asks all clusters 32 times.
pub fn within_budget(view: &ClusterView<'_>, detail: Detail, budget: u64) -> Detail {
    // Numbers that are not negative are ordered as their bits are.
    let (greatest, f32_of) = (f32::MAX.to_bits() - 1, f32::from_bits);
    let fits = |detail: &Detail| triangle_count(view, *detail) <= budget;
    if fits(&detail) {
        return detail;
    }
    match detail {
        Detail::Error(least) => {
            let (mut low, mut high) = (least.max(0.0).to_bits().min(greatest), greatest);
            while low < high {
                let middle = low + (high - low) / 2;
                if fits(&Detail::Error(f32_of(middle))) { high = middle } else { low = middle + 1 }
            }
            Detail::Error(f32_of(low))
        }
        Detail::View { eye, scale, near } => {
            let (mut low, mut high) = (0, scale.max(0.0).to_bits().min(greatest));
            while low < high {
                let middle = high - (high - low) / 2;
                if fits(&Detail::View { eye, scale: f32_of(middle), near }) { low = middle } else { high = middle - 1 }
            }
            Detail::View { eye, scale: f32_of(low), near }
        }
    }
}

/// Whether all triangles of a cluster face away from `eye` (object space); they may be left out where their material is single-sided.
pub fn faces_away(cluster: &ClusterRecord, eye: [f32; 3]) -> bool {
    let ([cx, cy, cz, radius], [ax, ay, az, cutoff]) = (cluster.sphere, cluster.cone);
    let (x, y, z) = (cx - eye[0], cy - eye[1], cz - eye[2]);
    cutoff < 1.0 && x * ax + y * ay + z * az >= cutoff * libm::sqrtf(x * x + y * y + z * z) + radius
}

#[cfg(test)]
pub(crate) mod tests;
