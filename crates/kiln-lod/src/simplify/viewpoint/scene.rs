//! The state of all views while a mesh is collapsed: fragments, histograms, the measure.

use rayon::prelude::*;

use super::formula::{Formula, Histogram};
use super::layers::Layers;
use super::price::Star;
use super::screen::{DrawnFace, Fragment, Screens};
use super::twin;
use crate::simplify::working::{Names, Working};
use crate::topology::NONE;

pub(super) struct Scene<'a> {
    pub(super) screens: &'a Screens<'a>,
    /// `[views]`.
    pub(super) layers: Vec<Layers>,
    pub(super) histogram: Histogram,
    pub(super) formula: &'a Formula,
    /// Collapses so far.
    pub(super) now: u32,
}

/// The faces that are left.
pub(super) fn faces<'w>(work: &'w Working<'_>) -> impl Iterator<Item = DrawnFace> + 'w {
    let live = work.faces.iter().enumerate().filter(|(_, face)| face.points[0] != NONE);
    live.map(|(f, face)| {
        let ([points @ .., _], [wedges @ .., _]) = (face.points, face.wedges);
        drawn_as(&work.names, f, points, wedges)
    })
}

/// Face `f` of a working set in the mesh's ids, from whichever of its corners.
#[inline]
pub(super) fn drawn_as(names: &Names, f: usize, points: [u32; 3], wedges: [u32; 3]) -> DrawnFace {
    DrawnFace {
        face: names.faces[f],
        points: points.map(|p| names.points[p as usize]),
        wedges: wedges.map(|w| names.wedges[w as usize]),
    }
}

impl<'a> Scene<'a> {
    /// Draws the faces of `work`.
    pub(super) fn new(screens: &'a Screens<'a>, formula: &'a Formula, work: &Working<'_>) -> Scene<'a> {
        let draw = |view: usize| {
            let mut layers = Layers::new(screens.size);
            faces(work).for_each(|face| draw_face(screens, &mut layers, &face, view, 0));
            layers.moves.clear();
            layers.settle(&layers.all(), 0);
            let mut counts = vec![0; screens.region_count];
            layers.front.iter().for_each(|fragment| counts[fragment.region as usize] += 1);
            (layers, counts)
        };
        let drawn: Vec<(Layers, Vec<u32>)> = (0..screens.views).into_par_iter().map(draw).collect();
        let (layers, by_view): (Vec<Layers>, Vec<Vec<u32>>) = drawn.into_iter().unzip();
        let histogram = Histogram::new(twin::by_region(&by_view, screens.region_count), screens.views, formula);
        Scene { screens, layers, histogram, formula, now: 0 }
    }

    /// The collapse of `star` onto its only target.
    pub(super) fn collapse(&mut self, star: &Star) {
        self.now += 1;
        let (screens, now) = (self.screens, self.now);
        self.layers.par_iter_mut().enumerate().for_each(|(view, layers)| {
            let Some((tiles, _)) = star.tiles(screens, view) else { return };
            for face in &star.faces {
                let Some(shape) = screens.shape(face, view) else { continue };
                shape.runs(screens.size, |from, to| {
                    layers.stamp(from, to, now);
                    (from..to).for_each(|pixel| layers.remove(pixel, face.face));
                });
            }
            for face in star.after(0) {
                draw_face(screens, layers, &face, view, now);
            }
            layers.settle(&tiles, now);
        });
        for (view, layers) in self.layers.iter_mut().enumerate() {
            self.histogram.pass(view, &layers.moves, self.formula);
            layers.moves.clear();
        }
    }
}

/// Adds the fragments of a face at time `now`.
fn draw_face(screens: &Screens<'_>, layers: &mut Layers, face: &DrawnFace, view: usize, now: u32) {
    let Some(shape) = screens.shape(face, view) else { return };
    let paint = screens.paint(&shape);
    shape.fragments(screens.size, |pixel, depth, shares| {
        let region = paint.region(shares);
        layers.stamp(pixel, pixel + 1, now);
        layers.insert(pixel, Fragment { depth, face: face.face, region });
    });
}
