//! Simplify: edge collapses on points and wedges, logged once to exhaustion, from which all levels are cut.
//!
//! **Problem.** In: a mesh with points shared along boundaries and seams. Out: levels with fewer triangles, finest first, each
//! with its measured distance to the source. Must not change: submeshes (names, order, materials), charts (attributes never
//! cross a seam), joined borders (no crack), and in a level that keeps all triangles, any bit.
//!
//! **Method.** Half-edge collapse: `from` goes, `to` stays where it is.
//! ```text
//! quadrics  <- area-weighted planes of the faces; planes along border, seam and boundary edges
//! heap      <- for each point its cheapest target that the table of kinds allows
//! while the heap has a point, and more faces than the floor are left:
//!     test the cheapest: link, partners, turn, sliver, UV          (rules)
//!     forbidden: the point's next dearer target; else
//!     collapse: faces at both ends vanish, wedges go to their partners, quadrics add; log it
//!     price `to` and its neighbours again
//! level     <- the shortest prefix of the log that meets the budget, replayed; free placement moves its points to where their
//!              level lies nearest to its source (fit); then its distance to the source is measured
//! ```
//! No crack can open: submeshes share points, and a point of a seam or boundary goes with all its wedges at once, each to the
//! wedge that its own faces have at the other end.
//!
//! **Departures.** Garland and Heckbert place the kept point where the quadric is least at every collapse; here it is an end (so
//! that levels are subsets of one vertex buffer), or moves once, after the cut; and they weigh border planes by 1000, here by a factor found on open scans. Lines use the
//! same plane weights in a scale-free unit (square edge length).
//!
//! **Limits.** Points where lines meet and points without a fan never go, so models of many small charts or parts stop early; the
//! report counts what each rule forbade. Attributes do not price collapses yet, they only forbid those across seams; creases
//! (wedges that differ in normal only) hold nothing: a wedge takes the nearest normal at the kept point.
//!
//! **Sources.** M. Garland, P. Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997,
//! doi:10.1145/258734.258849. C. Gonzalez, PhD thesis, Universitat Jaume I 2010, chapter 3 (boundaries). Link condition: T. Dey
//! et al., "Topology preserving edge contraction", Publ. Inst. Math. 1999.

mod collapse;
pub mod error;
mod fit;
mod heap;
mod metric;
pub mod rules;
pub mod sequence;
mod uv_border;
mod working;

use kiln_asset::{Level, LodSet, Mesh, QuadricCoefficients, UvLayout};
use serde::{Deserialize, Serialize};

pub use error::surface_error;
pub use sequence::{Collapse, CollapseSequence, SequenceReport};

use crate::check;
use crate::topology::Topology;
use metric::quadric::{Forms, QuadricMetric};
use rules::Rule;
use working::Working;

/// How to collapse. All are unitless.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimplifyOptions {
    /// Stop when this share of the faces is left; 0 goes on to exhaustion. A twentieth of a percent is below any level that
    /// people ask for and spares nothing worth sparing, so the default is 0.
    pub floor: f64,
    /// How strongly open borders hold their shape, on the square length of their edges.
    pub border_weight: f64,
    /// How strongly seams and boundaries hold theirs.
    pub line_weight: f64,
    /// Share of the square edge length in the cost: orders places without error (flat, straight) by length, and is far below
    /// any error that shows.
    pub length_weight: f64,
    /// Whether texture coordinates, normals and colours have a price.
    pub attributes: bool,
    /// Cosine of the most that a face may turn.
    pub turn_cosine: f64,
    /// Least `2 area / longest edge squared` of a face that is made thinner.
    pub sliver: f64,
}

impl Default for SimplifyOptions {
    fn default() -> Self {
        SimplifyOptions {
            floor: 0.0,
            border_weight: 10.0,
            line_weight: 1.0,
            length_weight: 1e-6,
            attributes: true,
            turn_cosine: 0.25,
            sliver: 0.02,
        }
    }
}

/// What a level may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// Share of the source asset's triangles.
    Keep(f64),
    /// Triangles.
    Triangles(u32),
    /// Measured distance to the source, object units.
    Error(f32),
}

/// Where the kept points of a level stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Placement {
    /// Where they stood in the source, so that levels can share one vertex buffer.
    #[default]
    HalfEdge,
    /// Where their forms are least, inside patches and on open borders.
    Free,
}

/// How to cut and measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelsOptions {
    /// Where kept points stand.
    pub placement: Placement,
    /// Most sample points a side when the error is measured; vertices first, then points spread over the faces by area.
    pub samples: u32,
}

impl Default for LevelsOptions {
    fn default() -> Self {
        LevelsOptions { placement: Placement::HalfEdge, samples: 200_000 }
    }
}

/// One level.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelReport {
    /// What was asked, in words.
    pub budget: String,
    /// Triangles reached.
    pub triangles: u32,
    /// Measured error, object units.
    pub error: f32,
    /// The metric's own estimate, object units.
    pub metric_error: f32,
    /// Triangles of each submesh, in order.
    pub submeshes: Vec<u32>,
    /// Border edges along boundaries that were joined before: always 0.
    pub gaps: u32,
    /// Why the budget was missed, if it was.
    pub short: Option<String>,
}

/// All levels of a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SimplifyReport {
    /// Finest first.
    pub levels: Vec<LevelReport>,
}

/// The collapse sequence of `mesh` to exhaustion. `carried`: empty, or `[point_count]` forms of an earlier stage, object space.
/// `layout`: the atlas whose chart borders must stay in place.
pub fn collapse(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    layout: Option<&UvLayout>,
    options: &SimplifyOptions,
) -> CollapseSequence {
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, carried, options);
    collapse_prepared(mesh, &topology, &forms, layout, options)
}

fn collapse_prepared(
    mesh: &Mesh,
    topology: &Topology,
    forms: &Forms,
    layout: Option<&UvLayout>,
    options: &SimplifyOptions,
) -> CollapseSequence {
    let mut work = Working::new(mesh, topology, forms.positions(), layout, options);
    let metric = QuadricMetric::new(mesh, forms.initial().to_vec(), &mut work, options);
    collapse::Collapser::new(mesh, work, metric, options).run()
}

/// One level of `mesh` with at most `faces` triangles, if that is in reach, and unmeasured, where no other level is wanted: the
/// sequence goes no farther than that.
pub fn simplify(mesh: &Mesh, faces: u32, placement: Placement, options: &SimplifyOptions) -> Mesh {
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, &[], options);
    let floor = f64::from(faces) / mesh.face_count().max(1) as f64;
    let sequence = collapse_prepared(mesh, &topology, &forms, None, &SimplifyOptions { floor, ..*options });
    let samples = fit::Samples::new(mesh, &topology);
    Cutter { mesh, sequence: &sequence, forms, samples, placement }.cut(sequence.reach(faces))
}

/// The levels of `budgets` (finest first) out of `sequence`, measured against `source`. `mesh` and `carried` are those that the
/// sequence was made from; each level carries its forms on.
///
/// # Panics
/// If `sequence` is of another mesh.
pub fn levels(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    sequence: &CollapseSequence,
    source: &Mesh,
    budgets: &[Budget],
    options: &LevelsOptions,
) -> (LodSet, SimplifyReport) {
    let source_triangles: u32 = mesh.submeshes.iter().map(|s| s.source_triangles).sum();
    let surface = error::Surface::new(source, options.samples);
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, carried, &SimplifyOptions::default());
    let samples = fit::Samples::new(mesh, &topology);
    let mut cutter = Cutter { mesh, sequence, forms, samples, placement: options.placement };
    let mut set = LodSet { levels: Vec::new(), layout: None, source_triangles };
    let mut report = SimplifyReport::default();
    let mut least = 0.0_f32;
    let mut finest = 0;
    for budget in budgets {
        let (count, measured) = match *budget {
            Budget::Keep(share) => {
                cutter.by_faces(&surface, (share * f64::from(source_triangles)).floor() as u32, finest)
            }
            Budget::Triangles(faces) => cutter.by_faces(&surface, faces, finest),
            Budget::Error(error) => cutter.by_error(&surface, error, finest),
        };
        let replayed = cutter.replay(count);
        let gaps = check::gaps(mesh, &replayed.level) as u32;
        let quadrics = cutter.forms.object_space(&replayed.origin);
        let level = cutter.placed(replayed);
        finest = count;
        least = least.max(measured);
        let asked = match *budget {
            Budget::Keep(share) => format!("keep {share}"),
            Budget::Triangles(faces) => format!("{faces} triangles"),
            Budget::Error(error) => format!("error {error:e}"),
        };
        let faces = level.face_count() as u32;
        let short = match *budget {
            Budget::Keep(share) if faces > (share * f64::from(source_triangles)).floor() as u32 => Some(()),
            Budget::Triangles(most) if faces > most => Some(()),
            Budget::Error(error) if least > error => Some(()),
            _ => None,
        };
        report.levels.push(LevelReport {
            budget: asked.clone(),
            triangles: faces,
            error: least,
            metric_error: count.checked_sub(1).map_or(0.0, |last| sequence.collapses[last].error),
            submeshes: (0..level.submeshes.len() as u32)
                .map(|s| level.submesh_faces(kiln_asset::SubmeshId(s)).len() as u32)
                .collect(),
            gaps,
            short: short.map(|()| why_short(&asked, faces, sequence)),
        });
        set.levels.push(Level { mesh: level, error: least, quadrics });
    }
    (set, report)
}

/// One level of `sequence` with at most `faces` triangles, if that is in reach, and unmeasured; `mesh` and `carried` as for
/// [`levels`].
///
/// # Panics
/// If `sequence` is of another mesh.
pub fn cut(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    sequence: &CollapseSequence,
    faces: u32,
    placement: Placement,
) -> Mesh {
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, carried, &SimplifyOptions::default());
    let samples = fit::Samples::new(mesh, &topology);
    Cutter { mesh, sequence, forms, samples, placement }.cut(sequence.reach(faces))
}

/// What levels are cut from.
struct Cutter<'a> {
    mesh: &'a Mesh,
    sequence: &'a CollapseSequence,
    forms: Forms,
    samples: fit::Samples,
    placement: Placement,
}

impl Cutter<'_> {
    /// What the first `count` collapses leave; the forms stand there then.
    fn replay(&mut self, count: usize) -> sequence::Replayed {
        self.forms.go_to(self.sequence, count);
        (self.sequence.replay_with_heirs(self.mesh, count))
            .expect("invariant: a replay of the mesh's own sequence keeps its promises")
    }

    /// The level with its points where they shall stand; the forms must stand at its cut.
    fn placed(&self, cut: sequence::Replayed) -> Mesh {
        if self.placement == Placement::HalfEdge {
            return cut.level;
        }
        let forms: Vec<_> = cut.origin.iter().map(|p| self.forms.grown(*p)).collect();
        fit::fit(self.mesh, &self.samples, cut, &forms, SimplifyOptions::default().turn_cosine)
    }

    fn cut(&mut self, count: usize) -> Mesh {
        let replayed = self.replay(count);
        self.placed(replayed)
    }

    fn measure(&mut self, surface: &error::Surface<'_>, count: usize) -> f32 {
        surface.distance(&self.cut(count))
    }

    fn by_faces(&mut self, surface: &error::Surface<'_>, faces: u32, finest: usize) -> (usize, f32) {
        let count = self.sequence.reach(faces).max(finest);
        (count, self.measure(surface, count))
    }

    /// The coarsest cut whose measured distance is at most `error`: starts where the metric says so, then halves the range.
    fn by_error(&mut self, surface: &error::Surface<'_>, error: f32, finest: usize) -> (usize, f32) {
        let mut best = (finest, self.measure(surface, finest));
        let (mut low, mut high) = (finest, self.sequence.collapses.len());
        let mut probe = self.sequence.within(error).clamp(low, high);
        // Measured distances are not quite monotone in the cut; ten halvings find a cut that holds, not always the last one.
        for _ in 0..10 {
            if low >= high {
                break;
            }
            let measured = self.measure(surface, probe);
            if measured <= error {
                best = (probe, measured);
                low = probe + 1;
            } else {
                high = probe;
            }
            probe = low + (high - low) / 2;
        }
        best
    }
}

fn why_short(asked: &str, faces: u32, sequence: &CollapseSequence) -> String {
    let report = sequence.report();
    let mut worst: Vec<(u32, Rule)> =
        Rule::ALL.iter().map(|r| (report.blocked[*r as usize], *r)).filter(|w| w.0 > 0).collect();
    worst.sort_by_key(|w| (std::cmp::Reverse(w.0), w.1));
    let reasons: Vec<String> = worst.iter().take(3).map(|(n, rule)| format!("{n} times {}", rule.reason())).collect();
    format!("asked {asked}, reached {faces} triangles: no further collapse is legal ({})", reasons.join("; "))
}

#[cfg(test)]
mod tests;
