//! One candidate at a time, the incremental way and the plain way: for benchmarks, and whoever wants to know what a collapse costs.

use kiln_asset::Mesh;
use kiln_gpu::{Gpu, GpuError};
use rayon::prelude::*;

use super::formula::{Delta, Histogram};
use super::gpu::Device;
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

/// Candidates by the points that go.
pub struct Stars(pub(super) Vec<Star>);

/// A mesh before any collapse, with its views.
pub struct Study<'a> {
    work: Working<'a>,
    pub(super) scene: Scene<'a>,
    scratch: Scratch,
    star: Star,
    face_count: usize,
}

impl<'a> Study<'a> {
    /// `condition`: made for `mesh`.
    pub fn new(mesh: &'a Mesh, options: &'a SimplifyOptions, condition: &'a ViewCondition<'a>) -> Study<'a> {
        let topology = Topology::new(mesh);
        let forms = Forms::new(mesh, &topology, &[], options);
        let (work, _) = prepared(mesh, (&topology, &forms), None, options, &[]);
        let scene = Scene::new(&condition.screens, &condition.formula, &work);
        let face_count = mesh.face_count();
        Study { scratch: Scratch::new(&condition.screens, face_count), work, scene, star: Star::default(), face_count }
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

    /// Reads candidates for a batch; those of the same point, where they lie together, share a star. What is not legal is left out.
    pub fn stars(&mut self, candidates: &[[u32; 2]]) -> Stars {
        let mut stars: Vec<Star> = Vec::new();
        for [from, to] in candidates {
            if self.work.points[*from as usize].count == 0 || self.work.test(*from, *to, None).is_some() {
                continue;
            }
            if stars.last().is_none_or(|star| star.from != *from) {
                let mut star = Star::default();
                star.read(&self.work, *from);
                stars.push(star);
            }
            if let Some(star) = stars.last_mut() {
                star.add(&self.work, *to);
            }
        }
        Stars(stars)
    }

    /// Cost and changes of all candidates of a batch, stars in parallel.
    pub fn price_batch(&self, stars: &Stars) -> Vec<(f64, Vec<Delta>)> {
        let scene = &self.scene;
        let share = stars.0.len().div_ceil(4 * rayon::current_num_threads()).max(1);
        let some = |stars: &[Star]| {
            let mut scratch = Scratch::new(scene.screens, self.face_count);
            let mut out = Vec::new();
            for star in stars {
                price(scene.screens, &scene.layers, star, None, &mut scratch);
                for deltas in &scratch.deltas[..star.to.len()] {
                    let cost = scene.formula.cost(&scene.histogram, deltas, &mut scratch.cost);
                    out.push((cost, deltas.clone()));
                }
            }
            out
        };
        stars.0.par_chunks(share).map(some).collect::<Vec<_>>().concat()
    }

    /// What a device needs for pricing batches.
    ///
    /// # Errors
    /// The device has no room for it, or refuses the shaders.
    pub fn on<'g>(&self, gpu: &'g Gpu) -> Result<Device<'g>, GpuError> {
        Device::new(gpu, &self.scene)
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
