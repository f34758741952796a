//! Large meshes: regions are collapsed each by itself, then what is left as one.
//!
//! **Problem.** One queue over a large mesh jumps all over it: every collapse waits for memory, and one thread has all the work.
//!
//! **Method.** In rounds, while many faces are left:
//! ```text
//! regions  <- stretches of equally many faces along a Z-curve (rest); points with faces in several regions are held: they neither
//!             go nor take others in
//! each     <- collapsed by itself until a share of its faces is left (collapse)
//! limit    <- the median of what the last collapses cost
//! each     <- goes on to that cost, so that all regions come to the same; then the rest takes it back
//! ```
//! The last part is all that is left, in exact order, to the floor. The logs are joined by cost ([`log`](super::log)), so a level
//! between is hardly other than that of one queue: what was held is made up for later, by the last part or by a round whose regions lie
//! elsewhere, and stands in the log where its cost, or what it rests on, puts it.
//!
//! A point that is not held has its whole star in its region, and no collapse there reads or writes a face of another: regions can
//! be collapsed in any order, or at once. They depend on the mesh alone, so the log is the same on any number of threads.
//!
//! **What it brings**, processor time at a tenth, the same code with and without regions: 1,002,252 triangles 2.55 s and 0.89 s on one
//! thread, since a region lies in the core's own cache; on two threads the loop and not only the preparation is shared.
//!
//! **Limits.** Just before a round ends its levels have some points too many where regions meet. What keeps values of its own along a
//! sequence, namely borders of an atlas and of textures, is collapsed as one part, and so is what goes by views: any place may show
//! in the same pixel as any other.

use kiln_asset::{Mesh, UvLayout};
use rayon::prelude::*;

use super::CollapseSequence;
use super::collapse::Collapser;
use super::log::Log;
use super::metric::Metric;
use super::rest::{MetricRest, Rest, Scratch};
use super::working::Working;

/// When and how finely a mesh is divided.
#[derive(Clone, Copy)]
pub(super) struct Grain {
    /// Faces below which what is left is one part.
    pub(super) whole: usize,
    /// Most faces of a region; half of that or more, and a power of two of them, so that threads have equally much to do.
    pub(super) region: usize,
}

/// A region of 31,000 faces takes about four megabytes. Half of that was no faster on either number of threads, and holds more points.
pub(super) const GRAIN: Grain = Grain { whole: 60_000, region: 32_768 };
/// Share of the faces that a round leaves. Less leaves less to the last part, but just before a round ends its levels have too many
/// points where regions meet, by what was held over what is left. Mean error of half-edge levels against one queue on bunny, armadillo
/// and FlightHelmet: a fifth, cut to a quarter, 3 to 14 % more; a third, cut to 35 %, 3 to 4 % more (bunny, FlightHelmet), and at
/// most 1 % more at a half, a quarter and a tenth.
const SHARE: f64 = 1.0 / 3.0;
/// How far above the floor a round stops.
const ABOVE_FLOOR: f64 = 1.1;

/// The part that has all faces that are left.
pub(super) fn whole<'a>(rest: &Rest<'a>, layout: Option<&UvLayout>) -> Working<'a> {
    let mut work = rest.part(&rest.order(0.0), &mut Scratch::new(rest.mesh));
    if let Some(layout) = layout {
        work.hold_borders(layout);
    }
    work
}

/// The sequence of a mesh that is one part.
pub(super) fn collapse_whole<M: Metric + Sync>(
    mesh: &Mesh,
    work: Working<'_>,
    metric: M,
    floor: f64,
) -> CollapseSequence {
    let faces = mesh.face_count() as u32;
    finish(mesh, Log::default(), Collapser::new(work, metric, faces), faces_of(mesh, floor))
}

/// The sequence of a mesh, large ones by regions.
pub(super) fn collapse<M: MetricRest>(mut rest: Rest<'_>, mut metric: M, floor: f64, grain: Grain) -> CollapseSequence {
    let floor = faces_of(rest.mesh, floor);
    let mut log = Log::default();
    let mut left = rest.mesh.face_count() as u32;
    let mut order = rest.order(0.0);
    for round in 1.. {
        let share = SHARE.max(ABOVE_FLOOR * f64::from(floor) / order.len().max(1) as f64);
        if order.len() < grain.whole || share > 0.8 {
            break;
        }
        let before = order.len();
        let count = before.div_ceil(grain.region).next_power_of_two();
        let regions: Vec<&[u32]> = order.chunks(before.div_ceil(count)).collect();
        left -= collapse_round(&mut rest, &mut metric, &regions, share, &mut log);
        order.retain(|f| rest.has_face(*f));
        if order.len() < grain.whole || 10 * order.len() > 9 * before {
            break;
        }
        // By the golden ratio, so that they lie evenly however many rounds there are.
        order = rest.order((f64::from(round) * 0.618_034).fract());
    }
    let mesh = rest.mesh;
    let work = rest.part(&order, &mut Scratch::new(mesh));
    let metric = metric.part(&work);
    drop(rest);
    finish(mesh, log, Collapser::new(work, metric, left), floor)
}

fn faces_of(mesh: &Mesh, share: f64) -> u32 {
    (share * mesh.face_count() as f64) as u32
}

/// Collapses each region down to about that share of its faces; how many vanish.
fn collapse_round<M: MetricRest>(
    rest: &mut Rest<'_>,
    metric: &mut M,
    regions: &[&[u32]],
    share: f64,
    log: &mut Log,
) -> u32 {
    let first = |scratch: &mut Scratch, faces: &&[u32]| {
        let work = rest.part(faces, scratch);
        let metric = metric.part(&work);
        let mut part = Collapser::new(work, metric, faces.len() as u32);
        part.run((share * faces.len() as f64) as u32, u32::MAX);
        part
    };
    let mut parts: Vec<Collapser<'_, M::Part>> =
        regions.par_iter().map_init(|| Scratch::new(rest.mesh), first).collect();
    let mut costs: Vec<u32> = parts.iter().map(|part| part.dearest).collect();
    costs.sort_unstable();
    let limit = costs[costs.len() / 2];
    parts.par_iter_mut().for_each(|part| part.run(0, limit));
    let mut vanished = 0;
    for part in parts {
        rest.take_back(&part.work);
        metric.take_back(&part.metric, &part.work.names);
        vanished += part.log.faces.len() as u32;
        log.append(&part.log, &part.work.names);
    }
    vanished
}

/// Collapses the last part down to the floor, and makes one sequence of all.
fn finish<M: Metric + Sync>(mesh: &Mesh, mut log: Log, mut last: Collapser<'_, M>, floor: u32) -> CollapseSequence {
    last.run(floor, u32::MAX);
    let joint = !log.collapses.is_empty();
    log.append(&last.log, &last.work.names);
    let report = last.report(log.collapses.len(), floor);
    let mut out = log.finish(mesh.face_count() as u32, mesh.vertex_count() as u32, joint);
    out.report = report;
    out
}
