//! Levels out of a log: budgets, the cut of each, its distance to the source, and what is reported.
//!
//! ```text
//! without rules: the shortest prefix that meets the budget
//! with rules:    wishes by submesh (parts); the cut that meets them and the total, continued where needed (continuation)
//! then:          small loose components go, if asked for and the budget is not met (components)
//!                points and attributes to where they are nearest to the source, with free placement (fit)
//!                the distance to the source, measured (error)
//! ```

use kiln_asset::{Level, LodSet, Mesh, QuadricCoefficients};
use serde::{Deserialize, Serialize};

use super::continuation::{self, Goal, Log, Standing, submesh_faces};
use super::cut::{Stop, Want, cut_by_parts};
use super::fit::{Samples, fit};
use super::metric::quadric::Forms;
use super::parts::{Counts, PartLevel, PartReport, PartRule, governing, wants};
use super::rules::Rule;
use super::sequence::Replayed;
use super::{CollapseSequence, Dependencies, SimplifyOptions, collapse_prepared, components, error};
use crate::check::Borders;
use crate::topology::Topology;

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

impl Budget {
    /// Triangles of all submeshes together, if that is what bounds it.
    fn total(self, source_triangles: u32) -> Option<u32> {
        match self {
            Budget::Keep(share) => Some((share * f64::from(source_triangles)).floor() as u32),
            Budget::Triangles(faces) => Some(faces),
            Budget::Error(_) => None,
        }
    }

    fn said(self) -> String {
        match self {
            Budget::Keep(share) => format!("keep {share}"),
            Budget::Triangles(faces) => format!("{faces} triangles"),
            Budget::Error(error) => format!("error {error:e}"),
        }
    }
}

/// Where the kept points of a level stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Placement {
    /// Where they stood in the source, so that levels can share one vertex buffer.
    #[default]
    HalfEdge,
    /// Where the level lies nearest to its source; seams of an atlas stay, so that levels can share its maps.
    Free,
}

/// How to cut and measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelsOptions {
    /// Where kept points stand.
    pub placement: Placement,
    /// Most sample points a side when the error is measured; vertices first, then points spread over the faces by area. 0 measures
    /// nothing and takes the metric's own estimate.
    pub samples: u32,
    /// Loose components whose bounding box has at most this diagonal, object units, may go where a budget is not met; 0 keeps all.
    pub prune: f32,
}

/// Sample points a side by which errors are measured unless a caller says otherwise.
pub const SAMPLES: u32 = 200_000;

impl Default for LevelsOptions {
    fn default() -> Self {
        LevelsOptions { placement: Placement::HalfEdge, samples: SAMPLES, prune: 0.0 }
    }
}

/// What holds for single submeshes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Parts<'a> {
    /// Budgets of their own; a later one wins.
    pub rules: &'a [PartRule],
    /// Of the sequence; made where rules need it and it is not given.
    pub dependencies: Option<&'a Dependencies>,
    /// Empty, or `[submesh_count]`: submeshes that the sequence left alone.
    pub locked: &'a [bool],
    /// What continuations collapse by.
    pub options: SimplifyOptions,
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
    /// What each rule by part asked and got; empty without rules.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartReport>,
    /// Collapses beyond the log, where closure kept a budget out of its reach.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub continued: u32,
    /// Small loose components that went for the budget.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pruned: u32,
    /// Why the budget was missed, if it was.
    pub short: Option<String>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// All levels of a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SimplifyReport {
    /// Finest first.
    pub levels: Vec<LevelReport>,
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
    levels_by_parts(mesh, carried, sequence, source, budgets, options, &Parts::default())
}

/// The same under rules for single submeshes.
///
/// # Panics
/// If `sequence` or the dependencies in `parts` are of another mesh.
pub fn levels_by_parts(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    sequence: &CollapseSequence,
    source: &Mesh,
    budgets: &[Budget],
    options: &LevelsOptions,
    parts: &Parts<'_>,
) -> (LodSet, SimplifyReport) {
    let source_triangles: u32 = mesh.submeshes.iter().map(|s| s.source_triangles).sum();
    let surface = (options.samples > 0).then(|| error::Surface::new(source, options.samples));
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, carried, &parts.options);
    let made;
    let dependencies = match parts.dependencies {
        Some(given) => given,
        None if parts.rules.is_empty() => &Dependencies::default(),
        None => {
            made = Dependencies::for_cuts(mesh, sequence).expect("invariant: the sequence is the mesh's own");
            &made
        }
    };
    let governed = governing(parts.rules, &mesh.submeshes);
    let log = Log { mesh, sequence, dependencies };
    let mut cutter = Cutter {
        log,
        forms,
        options,
        parts,
        surface,
        borders: Borders::of(mesh, &topology),
        samples: Samples::new(mesh, &topology),
        faces: submesh_faces(mesh),
        source: mesh.submeshes.iter().map(|s| s.source_triangles).collect(),
        source_triangles,
        // Rules that hold for no submesh leave the plain cut.
        by_parts: governed.iter().any(Option::is_some),
        governed,
        plain: vec![None; budgets.len()],
        finest: 0,
    };
    for rule in parts.rules {
        if let PartLevel::AsLevel(n) = rule.level
            && n < budgets.len()
            && cutter.plain[n].is_none()
        {
            cutter.plain[n] = Some(cutter.plain_level(budgets[n]));
        }
    }
    let mut set = LodSet { levels: Vec::new(), layout: None, source_triangles };
    let mut report = SimplifyReport::default();
    let mut least = 0.0_f32;
    for budget in budgets {
        let made = if cutter.by_parts { cutter.by_parts(*budget) } else { cutter.by_prefix(*budget) };
        least = least.max(made.measured);
        report.levels.push(cutter.report(*budget, &made, least));
        set.levels.push(Level { mesh: made.mesh, error: least, quadrics: made.quadrics });
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
    let mut forms = Forms::new(mesh, &topology, carried, &SimplifyOptions::default());
    let samples = Samples::new(mesh, &topology);
    let cut = replay(mesh, sequence, &mut forms, sequence.reach(faces));
    placed(mesh, &samples, cut, &forms, placement, &[])
}

/// One level of `mesh` with at most `faces` triangles, if that is in reach, and unmeasured, where no other level is wanted: the
/// sequence goes no farther than that.
pub fn simplify(mesh: &Mesh, faces: u32, placement: Placement, options: &SimplifyOptions) -> Mesh {
    let topology = Topology::new(mesh);
    let mut forms = Forms::new(mesh, &topology, &[], options);
    let floor = f64::from(faces) / mesh.face_count().max(1) as f64;
    let options = SimplifyOptions { floor, ..*options };
    let sequence = collapse_prepared(mesh, &topology, &forms, None, &options, &[], None);
    let cut = replay(mesh, &sequence, &mut forms, sequence.reach(faces));
    match placement {
        Placement::HalfEdge => cut.level,
        Placement::Free => placed(mesh, &Samples::new(mesh, &topology), cut, &forms, placement, &[]),
    }
}

/// What the first `count` collapses leave; the forms stand there then.
fn replay(mesh: &Mesh, sequence: &CollapseSequence, forms: &mut Forms, count: usize) -> Replayed {
    forms.go_to(sequence, count);
    sequence.replay_with_heirs(mesh, count).expect("invariant: a replay of the mesh's own sequence keeps its promises")
}

/// The level with its points where they shall stand; the forms must stand at its cut. `held`: empty, or `[submesh_count]`.
fn placed(
    mesh: &Mesh,
    samples: &Samples<'_>,
    cut: Replayed,
    forms: &Forms,
    placement: Placement,
    held: &[bool],
) -> Mesh {
    if placement == Placement::HalfEdge {
        return cut.level;
    }
    let mut forms: Vec<_> = cut.origin.iter().map(|p| forms.grown(*p)).collect();
    if held.contains(&true) {
        let held = super::points_of(&cut.level, held);
        forms.iter_mut().zip(held).filter(|f| f.1).for_each(|f| *f.0 = None);
    }
    fit(mesh, samples, cut, &forms, SimplifyOptions::default().turn_cosine)
}

/// A level before it is reported.
struct Made {
    mesh: Mesh,
    quadrics: Vec<QuadricCoefficients>,
    measured: f32,
    metric_error: f32,
    gaps: u32,
    wants: Vec<Want>,
    continued: u32,
    pruned: u32,
}

/// What levels are cut from.
struct Cutter<'a> {
    log: Log<'a>,
    forms: Forms,
    options: &'a LevelsOptions,
    parts: &'a Parts<'a>,
    /// `None`: nothing is measured.
    surface: Option<error::Surface<'a>>,
    borders: Borders,
    samples: Samples<'a>,
    /// `[submesh_count]`: triangles of the mesh and of the source.
    faces: Vec<u32>,
    source: Vec<u32>,
    source_triangles: u32,
    by_parts: bool,
    governed: Vec<Option<usize>>,
    /// For each level that a rule names, triangles of each submesh there without rules.
    plain: Vec<Option<Vec<u32>>>,
    /// How far into the log the finer levels went.
    finest: usize,
}

impl Cutter<'_> {
    fn by_prefix(&mut self, budget: Budget) -> Made {
        let Log { mesh, sequence, .. } = self.log;
        let count = match budget.total(self.source_triangles) {
            Some(faces) => sequence.reach(faces).max(self.finest),
            None => self.within(budget, self.finest),
        };
        self.finest = count;
        let cut = replay(mesh, sequence, &mut self.forms, count);
        let gaps = self.borders.gaps(&cut.level) as u32;
        let quadrics = self.forms.object_space(&cut.origin);
        let level = placed(mesh, &self.samples, cut, &self.forms, self.options.placement, self.parts.locked);
        let metric_error = count.checked_sub(1).map_or(0.0, |last| sequence.collapses[last].error);
        let wants = vec![Want::Free; self.faces.len()];
        self.finished(level, quadrics, budget, Made { metric_error, gaps, wants, ..Made::empty() })
    }

    /// The coarsest prefix whose measured distance holds.
    fn within(&mut self, budget: Budget, finest: usize) -> usize {
        let Budget::Error(error) = budget else { return finest };
        let Log { mesh, sequence, .. } = self.log;
        let (forms, options, locked, surface) = (&mut self.forms, self.options, self.parts.locked, &self.surface);
        let samples = &self.samples;
        let Some(surface) = surface else { return sequence.within(error).max(finest) };
        farthest_within(sequence, error, finest, |count| {
            let cut = replay(mesh, sequence, forms, count);
            surface.distance(&placed(mesh, samples, cut, forms, options.placement, locked))
        })
    }

    fn by_parts(&mut self, budget: Budget) -> Made {
        let mut granted = self.granted(None);
        let mut standing = self.stand(budget, &granted);
        // Relative rules look at what the other part came to, not at what it was granted.
        let again = self.granted(Some(&standing.faces));
        let differs = |(a, b): (&Want, &Want)| matches!((a, b), (Want::Faces(a), Want::Faces(b)) if a.abs_diff(*b) > 1);
        if granted.iter().zip(&again).any(differs) {
            granted = again;
            standing = self.stand(budget, &granted);
        }
        self.finest = standing.free_until.max(self.finest);

        let gaps = self.borders.gaps(&standing.mesh) as u32;
        let Standing { quadrics, error, continued, .. } = &standing;
        let made = Made { metric_error: *error, continued: *continued, gaps, wants: granted, ..Made::empty() };
        let quadrics = quadrics.clone();
        let level = match self.options.placement {
            Placement::HalfEdge => standing.mesh,
            Placement::Free => place_standing(self.log.mesh, &self.samples, &standing, Placement::Free, &self.faces),
        };
        self.finished(level, quadrics, budget, made)
    }

    /// What each submesh shall have.
    fn granted(&self, reached: Option<&[u32]>) -> Vec<Want> {
        let counts = Counts { incoming: &self.faces, source: &self.source };
        let at_level = |n: usize| self.plain.get(n).and_then(Clone::clone).unwrap_or_else(|| self.faces.clone());
        let mut wants = wants(self.parts.rules, &self.governed, &counts, &at_level, reached);
        for (s, _) in self.parts.locked.iter().enumerate().filter(|(_, locked)| **locked) {
            wants[s] = Want::Faces(self.faces[s]);
        }
        wants
    }

    /// Triangles of each submesh in a level if there were no rules.
    fn plain_level(&mut self, budget: Budget) -> Vec<u32> {
        let count = match budget.total(self.source_triangles) {
            Some(faces) => self.log.sequence.reach(faces),
            None => self.within(budget, 0),
        };
        let mut faces = self.faces.clone();
        let end =
            self.log.sequence.collapses.get(count).map_or(self.log.sequence.faces.len(), |c| c.first_face as usize);
        for f in &self.log.sequence.faces[..end] {
            let left = &mut faces[self.log.mesh.face_submesh[*f as usize].index()];
            *left = left.saturating_sub(1);
        }
        faces
    }

    fn stand(&mut self, budget: Budget, granted: &[Want]) -> Standing {
        let options = &self.parts.options;
        let mut goal = Goal { wants: granted, total: budget.total(self.source_triangles), earliest: self.finest };
        let Budget::Error(error) = budget else {
            return continuation::meet(&self.log, &mut self.forms, &goal, options);
        };
        // Every free threshold with the parts where they shall be; what closure keeps from a part is continued at the end.
        let at = |forms: &mut Forms, count: usize| {
            let stop = Stop { faces: u32::MAX, earliest: count, latest: count };
            let cut = cut_by_parts(self.log.dependencies, &self.faces, granted, stop, true);
            continuation::stand(&self.log, forms, None, &cut)
        };
        let (placement, held) = (self.options.placement, &self.faces);
        let forms = &mut self.forms;
        let Some(surface) = &self.surface else {
            let standing = at(forms, self.log.sequence.within(error).max(self.finest));
            return continuation::go_on(standing, &goal, options);
        };
        let (mesh, samples) = (self.log.mesh, &self.samples);
        let measure = |standing: &Standing| surface.distance(&place_standing(mesh, samples, standing, placement, held));
        let count = farthest_within(self.log.sequence, error, self.finest, |count| measure(&at(forms, count)));
        let standing = at(forms, count);
        goal.total = None;
        let measured = measure(&standing);
        let onward = continuation::go_on(at(forms, count), &goal, options);
        // A part brought lower may leave the distance; the level's bound holds before the part's.
        if onward.continued > 0 && measure(&onward) > error.max(measured) { standing } else { onward }
    }

    /// Prunes and measures.
    fn finished(&self, level: Mesh, quadrics: Vec<QuadricCoefficients>, budget: Budget, made: Made) -> Made {
        let total = budget.total(self.source_triangles).filter(|_| self.options.prune > 0.0);
        let (mut level, mut quadrics, mut pruned) = (level, quadrics, 0);
        if let Some(total) = total.filter(|total| level.face_count() > *total as usize) {
            let kept: Vec<bool> = made.wants.iter().map(|want| *want != Want::Free).collect();
            let (rest, origin, count) = components::prune(&level, self.options.prune, total, &kept);
            quadrics = origin.iter().map(|p| quadrics[*p as usize]).collect();
            (level, pruned) = (rest, count);
        }
        let measured = self.surface.as_ref().map_or(made.metric_error, |surface| surface.distance(&level));
        Made { measured, mesh: level, quadrics, pruned, ..made }
    }

    fn report(&self, budget: Budget, made: &Made, error: f32) -> LevelReport {
        let submeshes = submesh_faces(&made.mesh);
        let faces = made.mesh.face_count() as u32;
        let granted = |s: usize| match made.wants[s] {
            Want::Free => submeshes[s],
            Want::Faces(most) => most,
        };
        let mut parts = Vec::new();
        for (r, rule) in self.parts.rules.iter().enumerate() {
            let own: Vec<usize> = (0..submeshes.len()).filter(|s| self.governed[*s] == Some(r)).collect();
            if !own.is_empty() {
                parts.push(PartReport {
                    rule: rule.name.clone(),
                    submeshes: own.len() as u32,
                    asked: own.iter().map(|s| granted(*s)).sum(),
                    triangles: own.iter().map(|s| submeshes[*s]).sum(),
                });
            }
        }
        let asked = budget.said();
        let missed = match budget {
            Budget::Error(most) => error > most,
            _ => budget.total(self.source_triangles).is_some_and(|most| faces > most),
        };
        let over = |s: &usize| submeshes[*s] > granted(*s);
        let parts_over: Vec<usize> = (0..submeshes.len()).filter(over).collect();
        let mut short = Vec::new();
        if missed {
            let fixed: u32 = (0..submeshes.len()).filter(|s| made.wants[*s] != Want::Free).map(|s| submeshes[s]).sum();
            let most = budget.total(self.source_triangles).unwrap_or(u32::MAX);
            short.push(if fixed >= most {
                format!(
                    "asked {asked}, reached {faces} triangles, {} more: parts with rules of their own hold {fixed}",
                    faces - most
                )
            } else {
                why_short(&asked, faces, self.log.sequence)
            });
        }
        if let Some(first) = parts_over.first() {
            let more: u32 = parts_over.iter().map(|s| submeshes[*s] - granted(*s)).sum();
            short.push(format!(
                "{} of the submeshes with rules of their own have {more} triangles more than these grant, first \"{}\" with {} for {}: \
                 no further collapse of theirs is legal",
                parts_over.len(),
                self.log.mesh.submeshes[*first].name,
                submeshes[*first],
                granted(*first),
            ));
        }
        LevelReport {
            budget: asked,
            triangles: faces,
            error,
            metric_error: made.metric_error,
            submeshes,
            gaps: made.gaps,
            parts,
            continued: made.continued,
            pruned: made.pruned,
            short: (!short.is_empty()).then(|| short.join("; ")),
        }
    }
}

impl Made {
    fn empty() -> Made {
        Made {
            mesh: Mesh::default(),
            quadrics: Vec::new(),
            measured: 0.0,
            metric_error: 0.0,
            gaps: 0,
            wants: Vec::new(),
            continued: 0,
            pruned: 0,
        }
    }
}

/// The cut of `mesh` with its points where they shall stand; those of submeshes that have all their faces stay.
fn place_standing(
    mesh: &Mesh,
    samples: &Samples<'_>,
    standing: &Standing,
    placement: Placement,
    before: &[u32],
) -> Mesh {
    if placement == Placement::HalfEdge {
        return standing.mesh.clone();
    }
    let whole: Vec<bool> = standing.faces.iter().zip(before).map(|(now, before)| now == before).collect();
    let held = super::points_of(&standing.mesh, &whole);
    let forms: Vec<_> =
        (standing.forms.iter().enumerate()).map(|(p, form)| (standing.grown[p] && !held[p]).then_some(*form)).collect();
    let cut = Replayed {
        level: standing.mesh.clone(),
        origin: Vec::new(),
        heirs: standing.heirs.clone(),
        places: standing.places.clone(),
    };
    fit(mesh, samples, cut, &forms, SimplifyOptions::default().turn_cosine)
}

/// The coarsest cut whose measured distance is at most `error`: starts where the metric says so, then halves the range.
fn farthest_within(
    sequence: &CollapseSequence,
    error: f32,
    finest: usize,
    mut measure: impl FnMut(usize) -> f32,
) -> usize {
    let mut best = finest;
    let (mut low, mut high) = (finest, sequence.collapses.len());
    let mut probe = sequence.within(error).clamp(low, high);
    // Measured distances are not quite monotone in the cut; ten halvings find a cut that holds, not always the last one.
    for _ in 0..10 {
        if low >= high {
            break;
        }
        if measure(probe) <= error {
            best = probe;
            low = probe + 1;
        } else {
            high = probe;
        }
        probe = low + (high - low) / 2;
    }
    best
}

fn why_short(asked: &str, faces: u32, sequence: &CollapseSequence) -> String {
    let report = sequence.report();
    let mut worst: Vec<(u32, Rule)> =
        Rule::ALL.iter().map(|r| (report.blocked[*r as usize], *r)).filter(|w| w.0 > 0).collect();
    worst.sort_by_key(|w| (std::cmp::Reverse(w.0), w.1));
    let reasons: Vec<String> = worst.iter().take(3).map(|(n, rule)| format!("{n} times {}", rule.reason())).collect();
    format!("asked {asked}, reached {faces} triangles: no further collapse is legal ({})", reasons.join("; "))
}
