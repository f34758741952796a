//! The plain evaluation: everything is drawn again for every collapse. What the incremental one must equal, and what it is measured
//! against.

use rayon::prelude::*;

use super::formula::{Delta, Formula, Histogram};
use super::screen::{DrawnFace, Fragment, Screens};
use crate::topology::NONE;

/// The item buffer of a view: what every pixel shows, `[size * size]`.
pub(super) fn item_buffer(screens: &Screens<'_>, faces: impl Iterator<Item = DrawnFace>, view: usize) -> Vec<Fragment> {
    let mut buffer = vec![Fragment::BACKGROUND; screens.pixels()];
    for face in faces.filter(|face| face.points[0] != NONE) {
        let Some(shape) = screens.shape(&face, view) else { continue };
        let paint = screens.paint(&shape);
        shape.fragments(screens.size, |pixel, depth, shares| {
            let fragment = Fragment { depth, face: face.face, region: 0 };
            if fragment.hides(&buffer[pixel]) {
                buffer[pixel] = Fragment { region: paint.region(shares), ..fragment };
            }
        });
    }
    buffer
}

/// The pixels of every region in every view, `[region_count * views]`; views are drawn in parallel.
pub(super) fn counts<I: Iterator<Item = DrawnFace>>(screens: &Screens<'_>, faces: impl Fn() -> I + Sync) -> Vec<u32> {
    let draw = |view: usize| {
        let mut counts = vec![0; screens.region_count];
        item_buffer(screens, faces(), view).iter().for_each(|fragment| counts[fragment.region as usize] += 1);
        counts
    };
    let by_view: Vec<Vec<u32>> = (0..screens.views).into_par_iter().map(draw).collect();
    by_region(&by_view, screens.region_count)
}

/// `[views] x [region_count]` counts as `[region_count * views]`.
pub(super) fn by_region(by_view: &[Vec<u32>], region_count: usize) -> Vec<u32> {
    (0..region_count).flat_map(|region| by_view.iter().map(move |counts| counts[region])).collect()
}

/// What views are worth before and after: sum of the differences.
pub(super) fn cost(formula: &Formula, before: &Histogram, after: &Histogram) -> f64 {
    let (before, after) = (formula.values(before), formula.values(after));
    before.iter().zip(&after).map(|(before, after)| (before - after).abs()).sum()
}

/// Where two histograms differ, by view, then region.
pub(super) fn deltas(before: &Histogram, after: &Histogram) -> Vec<Delta> {
    let views = before.views;
    let mut deltas = Vec::new();
    for view in 0..views {
        for region in 0..before.totals.len() {
            let count = after.counts[region * views + view] as i32 - before.counts[region * views + view] as i32;
            if count != 0 {
                deltas.push(Delta { view: view as u32, region: region as u32, count });
            }
        }
    }
    deltas
}
