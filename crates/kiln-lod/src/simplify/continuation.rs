//! A cut by parts, and what goes on from it where closure keeps a budget out of reach.
//!
//! **Problem.** What a finished part no longer does, its neighbours may rest on: around a part at 100 % the log gives out early.
//!
//! **Method.** The log is cut; while a part or the total has too many triangles, collapses go on *from the cut*, the points of all
//! finished submeshes locked, and that log is cut by the same rules:
//! ```text
//! cut the log by parts, the free submeshes no farther than twice the error at which they would stop without closure
//! up to ROUNDS times, while a wish or the total is not met:
//!     lock the points of submeshes that have what they shall have
//!     collapse the cut to exhaustion, or until the total is met; cut that log by parts
//!     no collapse: stop
//! ```
//! The bound on the error keeps free submeshes far from a fixed one from paying for those near it: the continuation's queue
//! chooses among all of them anew, by cost.
//!
//! **Limits.** The continuation is made for one level's wishes and is not kept beyond that level: it costs a collapse of the cut.

use kiln_asset::{Mesh, QuadricCoefficients};

use super::cut::{PartCut, Stop, Want, cut_by_parts};
use super::metric::quadric::{Forms, Quadric};
use super::sequence::Replayed;
use super::{CollapseSequence, Dependencies, SimplifyOptions, collapse_prepared, points_of};
use crate::topology::{NONE, PointKind, Topology};

/// Most continuations of a level. The second one gives back to free submeshes what a part could not do; a third has not been seen to
/// change a triangle on any model tried.
const ROUNDS: usize = 3;
/// How many times the error at which free submeshes would stop without closure they may come to before the continuation takes
/// over. Below 2 most levels of jointed parts are continued for a handful of triangles; above 4 far parts visibly pay.
const STARVED: f32 = 2.0;

/// A cut on its own.
pub(super) struct Standing {
    pub(super) mesh: Mesh,
    /// For each vertex of the first log's mesh that of this mesh that it went to, or [`NONE`].
    pub(super) heirs: Vec<u32>,
    /// For each point where the log placed it; empty if it placed none, or was continued.
    pub(super) places: Vec<Option<glam::Vec3>>,
    /// `[point_count]`: the mesh's form of each point, about its place.
    pub(super) forms: Vec<Quadric>,
    /// `[point_count]`, object space.
    pub(super) quadrics: Vec<QuadricCoefficients>,
    /// `[point_count]`: whether it has taken in another.
    pub(super) grown: Vec<bool>,
    /// `[submesh_count]`.
    pub(super) faces: Vec<u32>,
    /// The metric's error, object units.
    pub(super) error: f32,
    /// Collapses beyond the log.
    pub(super) continued: u32,
    /// The threshold of the free submeshes in the log.
    pub(super) free_until: usize,
}

/// A mesh and its log.
pub(super) struct Log<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) sequence: &'a CollapseSequence,
    pub(super) dependencies: &'a Dependencies,
}

/// What a level by parts is bound to.
pub(super) struct Goal<'a> {
    /// `[submesh_count]`.
    pub(super) wants: &'a [Want],
    /// Triangles of all submeshes together.
    pub(super) total: Option<u32>,
    /// Threshold of the free submeshes in a finer level.
    pub(super) earliest: usize,
}

impl Goal<'_> {
    /// What the free submeshes may have together; `faces` tells what others hold that cannot be brought lower.
    fn free_share(&self, stuck: Option<&[u32]>) -> u32 {
        let held = self.wants.iter().enumerate().map(|(s, want)| match (want, stuck) {
            (Want::Free, _) => 0,
            (Want::Faces(most), None) => *most,
            (Want::Faces(most), Some(faces)) => faces[s].max(*most),
        });
        let held: u64 = held.map(u64::from).sum();
        self.total.map_or(u32::MAX, |total| u64::from(total).saturating_sub(held) as u32)
    }

    fn free_faces(&self, faces: &[u32]) -> u64 {
        faces.iter().zip(self.wants).filter(|(_, w)| **w == Want::Free).map(|(f, _)| u64::from(*f)).sum()
    }

    /// Whether a submesh has what it shall have; free ones have it together.
    fn finished(&self, faces: &[u32], share: u32) -> Vec<bool> {
        let free = self.free_faces(faces) <= u64::from(share);
        let one = |(faces, want): (&u32, &Want)| match want {
            Want::Free => free,
            Want::Faces(most) => faces <= most,
        };
        faces.iter().zip(self.wants).map(one).collect()
    }
}

/// Triangles of each submesh `[submesh_count]`.
pub(super) fn submesh_faces(mesh: &Mesh) -> Vec<u32> {
    (0..mesh.submeshes.len() as u32).map(|s| mesh.submesh_faces(kiln_asset::SubmeshId(s)).len() as u32).collect()
}

/// The cut of `log`. `forms` are those of its mesh, which is that of `from`, if there is one.
pub(super) fn stand(log: &Log<'_>, forms: &mut Forms, from: Option<&Standing>, cut: &PartCut) -> Standing {
    let Replayed { level: mesh, origin, heirs, places } = (log.sequence.replay_set(log.mesh, &cut.applied))
        .expect("invariant: a closed set of the mesh's own sequence keeps its promises");
    forms.apply(log.sequence, &cut.applied);
    let last = cut.applied.iter().rposition(|a| *a);
    let before = |p: u32| from.is_some_and(|from| from.grown[p as usize]);
    let heirs = match from {
        None => heirs,
        Some(from) => from.heirs.iter().map(|v| heirs.get(*v as usize).copied().unwrap_or(NONE)).collect(),
    };
    Standing {
        heirs,
        places: if from.is_some() { Vec::new() } else { places },
        forms: origin.iter().map(|p| forms.form(*p)).collect(),
        quadrics: forms.object_space(&origin),
        grown: origin.iter().map(|p| before(*p) || forms.grown(*p).is_some()).collect(),
        faces: submesh_faces(&mesh),
        mesh,
        error: last.map_or(0.0, |last| log.sequence.collapses[last].error),
        continued: 0,
        free_until: cut.free_until,
    }
}

/// The last collapse that free submeshes may do in the log, plus one.
fn latest(log: &Log<'_>, faces: &[u32], goal: &Goal<'_>, share: u32) -> usize {
    let count = log.dependencies.len();
    let stop = Stop { faces: share, earliest: goal.earliest, latest: count };
    let unbound = cut_by_parts(log.dependencies, faces, goal.wants, stop, false).free_until;
    let error = unbound.checked_sub(1).map_or(0.0, |last| log.sequence.collapses[last].error);
    log.sequence.within(STARVED * error).max(unbound).max(goal.earliest)
}

/// The cut of `log` that meets `goal`, continued where the log does not reach it.
pub(super) fn meet(log: &Log<'_>, forms: &mut Forms, goal: &Goal<'_>, options: &SimplifyOptions) -> Standing {
    let faces = submesh_faces(log.mesh);
    let share = goal.free_share(None);
    let stop = Stop { faces: share, earliest: goal.earliest, latest: latest(log, &faces, goal, share) };
    let cut = cut_by_parts(log.dependencies, &faces, goal.wants, stop, true);
    let standing = stand(log, forms, None, &cut);
    go_on(standing, goal, options)
}

/// Goes on from a cut that does not meet `goal`.
pub(super) fn go_on(mut standing: Standing, goal: &Goal<'_>, options: &SimplifyOptions) -> Standing {
    for round in 0..ROUNDS {
        let stuck = (round > 0).then_some(standing.faces.as_slice());
        let share = goal.free_share(stuck);
        let finished = goal.finished(&standing.faces, share);
        if finished.iter().all(|f| *f) {
            break;
        }
        let Some(next) = continued(&standing, goal, &finished, share, options) else { continue };
        standing = next;
    }
    standing
}

/// One continuation; `None` if nothing can be done.
fn continued(
    standing: &Standing,
    goal: &Goal<'_>,
    finished: &[bool],
    share: u32,
    options: &SimplifyOptions,
) -> Option<Standing> {
    let mesh = &standing.mesh;
    let topology = Topology::new(mesh);
    let mut locked = points_of(mesh, finished);
    if mesh.atlas_uv.is_some() {
        // How far chart borders have left their places is known to the log only.
        locked.iter_mut().zip(&topology.kinds).for_each(|(locked, kind)| *locked |= *kind != PointKind::Manifold);
    }
    // Where only the free submeshes are left, what they shall have together ends the loop.
    let only_free = finished.iter().zip(goal.wants).all(|(f, want)| *f || *want == Want::Free);
    let (all, free) = (mesh.face_count() as u64, goal.free_faces(&standing.faces));
    let floor = if only_free { (all - free + u64::from(share)) as f64 / all as f64 } else { 0.0 };
    let options = SimplifyOptions { floor, ..*options };
    let mut forms = Forms::new(mesh, &topology, &standing.quadrics, &options);
    let sequence = collapse_prepared(mesh, &topology, &forms, None, &options, &locked, None);
    let dependencies =
        Dependencies::for_cuts(mesh, &sequence).expect("invariant: the sequence was made from this very mesh");
    let stop = Stop { faces: share, earliest: 0, latest: sequence.collapses.len() };
    let cut = cut_by_parts(&dependencies, &standing.faces, goal.wants, stop, true);
    let count = cut.applied.iter().filter(|a| **a).count() as u32;
    if count == 0 {
        return None;
    }
    let log = Log { mesh, sequence: &sequence, dependencies: &dependencies };
    let next = stand(&log, &mut forms, Some(standing), &cut);
    Some(Standing {
        continued: standing.continued + count,
        free_until: standing.free_until,
        error: next.error.max(standing.error),
        ..next
    })
}
