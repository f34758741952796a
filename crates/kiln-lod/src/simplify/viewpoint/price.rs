//! What a collapse changes on the screens, from the pixels of its star alone.
//!
//! The star of `from` is all that a half-edge collapse redraws, and most of the work is the same for all its targets:
//! ```text
//! for each view:
//!     hole    <- where a face of the star is visible: the nearest fragment of another face     (once for all targets)
//!     for each target:
//!         after <- hole, else what is visible; each fragment of a changed face that hides it takes its place
//!         delta <- regions after less regions before, where they differ
//! ```
//! Nothing is allocated in the loops: what is known of a pixel stands in a screen of cells, each of which says for which view and which
//! target it holds.

use super::formula::{CostScratch, Delta, Formula, Histogram};
use super::layers::{Layers, Tiles, tiles_of};
use super::scene::drawn_as;
use super::screen::{DrawnFace, Fragment, Screens};
use crate::simplify::working::{CORNER, Working};
use crate::topology::NONE;

/// A point that may go, with its faces, and where it may go. What is drawn has the mesh's ids; all else those of [`Working`]. Here
/// the two meet, and nowhere else but in [`super::scene`] and the log.
#[derive(Default)]
pub(super) struct Star {
    pub(super) from: u32,
    /// Its faces as they are drawn, `from` first among their points.
    pub(super) faces: Vec<DrawnFace>,
    /// The same: the other two points, in winding order, and the wedge at `from`.
    pub(super) around: Vec<([u32; 2], u32)>,
    /// Its targets.
    pub(super) to: Vec<u32>,
    /// The same as they are drawn.
    to_drawn: Vec<u32>,
    /// `[to.len() * faces.len()]`: the wedge that each face would have at the target, as it is drawn; [`NONE`] where it would vanish.
    wedges: Vec<u32>,
}

impl Star {
    /// Reads the faces at `from`, without targets.
    pub(super) fn read(&mut self, work: &Working<'_>, from: u32) {
        self.from = from;
        self.to.clear();
        self.to_drawn.clear();
        self.wedges.clear();
        self.faces.clear();
        self.around.clear();
        for corner in work.corners(from) {
            let (f, k) = ((*corner / CORNER) as usize, (*corner % CORNER) as usize);
            let (face, around) = (&work.faces[f], [k, (k + 1) % 3, (k + 2) % 3]);
            let (points, wedges) = (around.map(|i| face.points[i]), around.map(|i| face.wedges[i]));
            self.around.push(([points[1], points[2]], wedges[0]));
            self.faces.push(drawn_as(&work.names, f, points, wedges));
        }
    }

    /// Adds the target that was tested last, whose partners are in [`Working::map`].
    pub(super) fn add(&mut self, work: &Working<'_>, to: u32) {
        self.to.push(to);
        self.to_drawn.push(work.names.points[to as usize]);
        self.wedges.extend(self.around.iter().map(|(others, wedge)| {
            if others.contains(&to) {
                return NONE;
            }
            let wedge = work.map.iter().find(|m| m[0] == *wedge).map_or(*wedge, |m| m[1]);
            work.names.wedges[wedge as usize]
        }));
    }

    /// The faces as they would be at target `i`.
    pub(super) fn after(&self, i: usize) -> impl Iterator<Item = DrawnFace> + '_ {
        let wedges = &self.wedges[i * self.faces.len()..(i + 1) * self.faces.len()];
        let stays = self.faces.iter().zip(wedges).filter(|(_, wedge)| **wedge != NONE);
        stays.map(move |(face, wedge)| DrawnFace {
            face: face.face,
            points: [self.to_drawn[i], face.points[1], face.points[2]],
            wedges: [*wedge, face.wedges[1], face.wedges[2]],
        })
    }

    /// The tiles of a screen that the star may cover, before or after, and the least depth of its points.
    #[inline]
    pub(super) fn tiles(&self, screens: &Screens<'_>, view: usize) -> Option<(Tiles, i32)> {
        let [x, y, mut near] = screens.place(self.faces.first()?.points[0], view);
        let (mut low, mut high) = ([x, y], [x, y]);
        for face in &self.faces {
            for point in [face.points[1], face.points[2]] {
                let [x, y, depth] = screens.place(point, view);
                low = [low[0].min(x), low[1].min(y)];
                high = [high[0].max(x), high[1].max(y)];
                near = near.min(depth);
            }
        }
        tiles_of(low, high, screens.size).map(|tiles| (tiles, near))
    }

    /// Whether a fragment that the star's deltas may rest on changed after `time`.
    pub(super) fn changed(&self, screens: &Screens<'_>, layers: &[Layers], time: u32) -> bool {
        let stale = |(view, layers): (usize, &Layers)| {
            self.tiles(screens, view).is_some_and(|(tiles, _)| layers.changed(&tiles, time))
        };
        layers.iter().enumerate().any(stale)
    }
}

/// What is known of a pixel.
#[derive(Clone, Copy)]
struct Cell {
    /// Where the star is visible, in view `hole_of`: what lies behind it.
    hole_of: u32,
    /// What target `after_of` in a view would show.
    after_of: u32,
    hole: Fragment,
    after: Fragment,
}

/// Pixels won and lost by region.
#[derive(Default)]
struct Tally {
    /// `[region_count]`: pixels, and whether the region is in `touched`.
    counts: Vec<(i32, bool)>,
    touched: Vec<u32>,
    /// A run of pixels that go from one region to another.
    run: (u32, u32, i32),
}

impl Tally {
    #[inline]
    fn pass(&mut self, before: u32, after: u32) {
        if before != after {
            if (self.run.0, self.run.1) != (before, after) {
                self.flush();
                (self.run.0, self.run.1) = (before, after);
            }
            self.run.2 += 1;
        }
    }

    #[inline]
    fn flush(&mut self) {
        let (before, after, count) = std::mem::take(&mut self.run);
        if count != 0 {
            self.add(before, -count);
            self.add(after, count);
        }
    }

    #[inline]
    fn add(&mut self, region: u32, count: i32) {
        let entry = &mut self.counts[region as usize];
        entry.0 += count;
        if !entry.1 {
            entry.1 = true;
            self.touched.push(region);
        }
    }

    /// Empties the tally into `out`, regions in the order in which they were met.
    fn drain(&mut self, mut out: impl FnMut(u32, i32)) {
        self.flush();
        for region in self.touched.drain(..) {
            let entry = &mut self.counts[region as usize];
            if entry.0 != 0 {
                out(region, entry.0);
            }
            *entry = (0, false);
        }
    }
}

/// Memory of one thread.
pub(super) struct Scratch {
    cells: Vec<Cell>,
    hole: u32,
    after: u32,
    /// `[face_count]`: the star that a face was in last.
    marks: Vec<u32>,
    mark: u32,
    tally: Tally,
    /// Regions of the hole less those before.
    opened: Vec<(u32, i32)>,
    /// By target.
    pub(super) deltas: Vec<Vec<Delta>>,
    /// By target: what the views cost so far, and whether that is beyond the limit.
    pub(super) partial: Vec<(f64, bool)>,
    pub(super) cost: CostScratch,
}

impl Scratch {
    pub(super) fn new(screens: &Screens<'_>, face_count: usize) -> Scratch {
        let blank = Fragment::BACKGROUND;
        let cell = Cell { hole_of: 0, after_of: 0, hole: blank, after: blank };
        Scratch {
            cells: vec![cell; screens.pixels()],
            hole: 0,
            after: 0,
            marks: vec![0; face_count],
            mark: 0,
            tally: Tally { counts: vec![(0, false); screens.region_count], ..Tally::default() },
            opened: Vec::new(),
            deltas: Vec::new(),
            partial: Vec::new(),
            cost: CostScratch::default(),
        }
    }

    /// Starts the counters anew before they run out.
    fn renew(&mut self) {
        if self.hole.max(self.after).max(self.mark) > u32::MAX / 2 {
            self.cells.iter_mut().for_each(|cell| (cell.hole_of, cell.after_of) = (0, 0));
            self.marks.fill(0);
            (self.hole, self.after, self.mark) = (0, 0, 0);
        }
    }
}

/// Beyond what cost a target is given up, since it will not come to its turn soon.
pub(super) struct Limit<'a> {
    pub(super) formula: &'a Formula,
    pub(super) histogram: &'a Histogram,
    pub(super) cost: f64,
}

/// The changes of the pixel counts for each target of `star`: [`Scratch::deltas`], grouped by view. With a limit, a target whose
/// views so far cost more is left as it is: [`Scratch::partial`] then holds a lower bound of its cost.
pub(super) fn price(
    screens: &Screens<'_>,
    layers: &[Layers],
    star: &Star,
    limit: Option<&Limit<'_>>,
    scratch: &mut Scratch,
) {
    scratch.renew();
    scratch.deltas.iter_mut().for_each(Vec::clear);
    if scratch.deltas.len() < star.to.len() {
        scratch.deltas.resize_with(star.to.len(), Vec::new);
    }
    scratch.partial.clear();
    scratch.partial.resize(star.to.len(), (0.0, false));
    let mut left = star.to.len();
    scratch.mark += 1;
    for face in &star.faces {
        scratch.marks[face.face as usize] = scratch.mark;
    }
    // Far views first, so that one that sees the star comes early.
    let stride = stride(layers.len());
    let mut view = 0;
    for _ in 0..layers.len() {
        view = (view + stride) % layers.len();
        let layers = &layers[view];
        let Some((tiles, near)) = star.tiles(screens, view) else { continue };
        if layers.hide(&tiles, near) {
            continue;
        }
        open(screens, layers, star, view, scratch);
        for target in 0..star.to.len() {
            if scratch.partial[target].1 {
                continue;
            }
            let first = scratch.deltas[target].len();
            fill(screens, layers, star, [view, target], scratch);
            if let Some(limit) = limit {
                let partial = &mut scratch.partial[target];
                partial.0 += limit.formula.change(limit.histogram, &scratch.deltas[target][first..]).abs();
                partial.1 = partial.0 > limit.cost;
                left -= usize::from(partial.1);
            }
        }
        if left == 0 {
            return;
        }
    }
}

/// A step through so many views that meets them all and seldom goes to a neighbour.
pub(super) fn stride(views: usize) -> usize {
    let shares_none = |step: &usize| {
        let (mut a, mut b) = (*step, views);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    (views * 3 / 8..views).chain([1]).find(shares_none).unwrap_or(1)
}

/// Finds the hole that the star leaves in a view.
fn open(screens: &Screens<'_>, layers: &Layers, star: &Star, view: usize, scratch: &mut Scratch) {
    let Scratch { cells, hole, marks, mark, tally, opened, .. } = scratch;
    *hole += 1;
    for face in &star.faces {
        let Some(shape) = screens.shape(face, view) else { continue };
        shape.runs(screens.size, |from, to| {
            let fronts = &layers.front[from..to];
            for (i, (cell, front)) in cells[from..to].iter_mut().zip(fronts).enumerate() {
                if front.face != face.face {
                    continue;
                }
                let mut behind = layers.behind(from + i).filter(|fragment| marks[fragment.face as usize] != *mark);
                let next = behind.next().copied().unwrap_or(Fragment::BACKGROUND);
                (cell.hole_of, cell.hole) = (*hole, next);
                tally.pass(front.region, next.region);
            }
        });
    }
    opened.clear();
    tally.drain(|region, count| opened.push((region, count)));
}

/// Draws the faces as they would be at a target over the hole and what is visible.
fn fill(screens: &Screens<'_>, layers: &Layers, star: &Star, [view, target]: [usize; 2], scratch: &mut Scratch) {
    let Scratch { cells, hole, after, tally, opened, deltas, .. } = scratch;
    *after += 1;
    for (region, count) in opened {
        tally.add(*region, *count);
    }
    for face in star.after(target) {
        let Some(shape) = screens.shape(&face, view) else { continue };
        let paint = screens.paint(&shape);
        shape.fragments(screens.size, |pixel, depth, shares| {
            let cell = &mut cells[pixel];
            let shown = if cell.after_of == *after {
                cell.after
            } else if cell.hole_of == *hole {
                cell.hole
            } else {
                layers.front[pixel]
            };
            let fragment = Fragment { depth, face: face.face, region: 0 };
            if fragment.hides(&shown) {
                let region = paint.region(shares);
                tally.pass(shown.region, region);
                (cell.after_of, cell.after) = (*after, Fragment { region, ..fragment });
            }
        });
    }
    let deltas = &mut deltas[target];
    tally.drain(|region, count| deltas.push(Delta { view: view as u32, region, count }));
}
