//! One candidate at a time, the incremental way and the plain way: for benchmarks, and whoever wants to know what a collapse costs.

use kiln_asset::Mesh;

use super::formula::{Delta, Histogram};
use super::price::{Scratch, Star, price};
use super::scene::{Scene, faces};
use super::screen::DrawnFace;
use super::twin;
use super::{ViewCondition, prepared};
use crate::simplify::SimplifyOptions;
use crate::simplify::metric::quadric::Forms;
use crate::simplify::rules::{Moves, moves};
use crate::simplify::working::Working;
use crate::topology::{NONE, Topology};

/// A mesh before any collapse, with its views.
pub struct Study<'a> {
    work: Working<'a>,
    scene: Scene<'a>,
    scratch: Scratch,
    star: Star,
}

impl<'a> Study<'a> {
    /// `condition`: made for `mesh`.
    pub fn new(mesh: &'a Mesh, options: &'a SimplifyOptions, condition: &'a ViewCondition<'a>) -> Study<'a> {
        let topology = Topology::new(mesh);
        let forms = Forms::new(mesh, &topology, &[], options);
        let (work, _) = prepared(mesh, (&topology, &forms), None, options, &[]);
        let scene = Scene::new(&condition.screens, &condition.formula, &work);
        Study { scratch: Scratch::new(&condition.screens, mesh.face_count()), work, scene, star: Star::default() }
    }

    /// All legal collapses, as (from, to), in the study's own ids of points.
    pub fn candidates(&mut self) -> Vec<[u32; 2]> {
        let mut out = Vec::new();
        for from in 0..self.work.points.len() as u32 {
            let point = self.work.points[from as usize];
            let targets: Vec<u32> = match moves(point.kind) {
                Moves::Never => Vec::new(),
                Moves::AlongLine => point.line.iter().copied().filter(|to| *to != NONE).collect(),
                Moves::Anywhere => self.work.corners(from).iter().map(|corner| self.work.others(*corner)[0]).collect(),
            };
            out.extend(targets.into_iter().filter(|to| self.work.test(from, *to, None).is_none()).map(|to| [from, to]));
        }
        out
    }

    /// Reads a candidate for [`Study::price`] and [`Study::draw`]; false if it is not legal.
    pub fn read(&mut self, [from, to]: [u32; 2]) -> bool {
        let legal = self.work.points[from as usize].count > 0 && self.work.test(from, to, None).is_none();
        if legal {
            self.star.read(&self.work, from);
            self.star.add(&self.work, to);
        }
        legal
    }

    /// What the candidate that was read last costs, and its changes of pixel counts, grouped by view; from its star alone.
    pub fn price(&mut self) -> (f64, &[Delta]) {
        let Study { scene, scratch, star, .. } = self;
        price(scene.screens, &scene.layers, star, None, scratch);
        let cost = scene.formula.cost(&scene.histogram, &scratch.deltas[0], &mut scratch.cost);
        (cost, &scratch.deltas[0])
    }

    /// The same by drawing every face in every view: cost, and changes by view, then region.
    pub fn draw(&self) -> (f64, Vec<Delta>) {
        drawn(&self.work, &self.scene, &self.star)
    }
}

/// Cost and changes of the collapse of `star` onto its first target, by drawing everything.
pub(super) fn drawn(work: &Working<'_>, scene: &Scene<'_>, star: &Star) -> (f64, Vec<Delta>) {
    let changed: Vec<DrawnFace> = star.after(0).collect();
    let others = || faces(work).filter(|face| !star.faces.iter().any(|old| old.face == face.face));
    let counts = twin::counts(scene.screens, || others().chain(changed.iter().copied()));
    let after = Histogram::new(counts, scene.screens.views, scene.formula);
    (twin::cost(scene.formula, &scene.histogram, &after), twin::deltas(&scene.histogram, &after))
}
