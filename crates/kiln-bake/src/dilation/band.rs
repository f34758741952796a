//! Which texel takes from which: rounds in charts and around them.
//!
//! All arrays have a rim of one texel that is never filled, so that every texel has 8 neighbours. A round around the charts
//! looks only at rows in whose reach something changed: whole rows of bytes say where a texel has any filled neighbour, and
//! only those texels look at their neighbours' charts.

use rayon::prelude::*;

use super::code::Code;
use super::{DilationReport, Fill, Orphans, Step};

/// A texel's neighbours `(right, down)`: along the axes first, so that the first that is filled is the nearest.
pub(super) const AROUND: [(isize, isize); 8] = [(0, -1), (-1, 0), (1, 0), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)];

/// Rows in one task.
const ROWS: usize = 32;

/// Chart of covered texels that neither lie in a chart nor beside one.
const NO_CHART: u32 = u32::MAX;

/// The value of a step's texel. `steps_to`: how far each neighbour of [`AROUND`] lies in `texels`.
#[inline]
pub(super) fn value<C: Code>(texels: &[C::Texel], steps_to: &[isize; 8], step: Step) -> C::Texel {
    let at = |k: u32| texels[(step.texel as usize).wrapping_add_signed(steps_to[k as usize & 7])];
    let mut mask = step.mask;
    let mut sum = C::decode(at(mask.trailing_zeros()));
    mask &= mask.wrapping_sub(1);
    if C::COPIES || mask == 0 {
        return C::encode(sum);
    }
    while mask != 0 {
        sum += C::decode(at(mask.trailing_zeros()));
        mask &= mask - 1;
    }
    C::encode(sum * SHARE[step.mask.count_ones() as usize & 15])
}

/// One over the number of neighbours.
const SHARE: [f32; 16] =
    [1.0, 1.0, 0.5, 1.0 / 3.0, 0.25, 0.2, 1.0 / 6.0, 1.0 / 7.0, 0.125, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// A texel about to be filled.
#[derive(Clone, Copy)]
struct Found {
    step: Step,
    /// Where it lies in the arrays with a rim.
    at: u32,
    /// The chart that it belongs to from now on.
    chart: u32,
}

/// A plan in the making.
pub(super) struct Band<'a> {
    width: usize,
    height: usize,
    covered: &'a [bool],
    charts: &'a [u32],
    /// `[height + 2] x (width + 2)`: chart that a filled texel belongs to, 0: not filled.
    owners: Vec<u32>,
    /// The same shape, 1: filled.
    filled: Vec<u8>,
    /// Texels inside charts that are not filled, ascending.
    holes: Vec<u32>,
    steps: Vec<Step>,
    ends: Vec<usize>,
    covered_count: u64,
}

impl<'a> Band<'a> {
    pub(super) fn new(width: usize, height: usize, covered: &'a [bool], charts: &'a [u32]) -> Band<'a> {
        let stride = width + 2;
        let mut owners = vec![0u32; stride * (height + 2)];
        let mut filled = vec![0u8; stride * (height + 2)];
        let rows = owners.par_chunks_mut(stride).zip(filled.par_chunks_mut(stride)).skip(1).take(height);
        let found: Vec<(Vec<u32>, u64)> = rows
            .enumerate()
            .map(|(y, (owners, filled))| {
                let row = y * width..(y + 1) * width;
                let (own, chart) = (&covered[row.clone()], &charts[row]);
                // Without branches: rows where everything covered lies in charts, and the reverse, are most.
                let (mut count, mut odd) = (0u32, 0u32);
                for ((owner, filled), (covered, chart)) in
                    owners[1..].iter_mut().zip(&mut filled[1..]).zip(own.iter().zip(chart))
                {
                    let covered = u32::from(*covered);
                    *filled = covered as u8;
                    *owner = chart & covered.wrapping_neg();
                    count += covered;
                    odd |= covered ^ u32::from(*chart != 0);
                }
                let mut holes = Vec::new();
                for x in (0..width).filter(|x| odd != 0 && own[*x] != (chart[*x] != 0)) {
                    let texel = y * width + x;
                    match own[x] {
                        true => owners[x + 1] = chart_beside(width, height, covered, charts, texel),
                        false => holes.push(texel as u32),
                    }
                }
                (holes, u64::from(count))
            })
            .collect();
        let covered_count = found.iter().map(|(_, count)| count).sum();
        let holes = found.into_iter().flat_map(|(holes, _)| holes).collect();
        let (steps, ends) = (Vec::new(), Vec::new());
        Band { width, height, covered, charts, owners, filled, holes, steps, ends, covered_count }
    }

    /// Fills holes in charts from their own chart until none can be.
    pub(super) fn fill_holes(&mut self) {
        let mut front = std::mem::take(&mut self.holes);
        let all = front.clone();
        while !front.is_empty() {
            let found: Vec<Found> = front
                .iter()
                .filter_map(|texel| {
                    let (at, chart) = (self.padded(*texel), self.charts[*texel as usize]);
                    let mask = mask_of(&self.around(at), chart);
                    (mask != 0).then_some(Found { step: Step { texel: *texel, mask }, at: at as u32, chart })
                })
                .collect();
            if !found.is_empty() {
                self.put(&found);
                self.ends.push(self.steps.len());
            }
            front.clear();
            for Found { step, at, chart } in &found {
                for (right, down) in AROUND {
                    let at = (*at as usize).wrapping_add_signed(down * self.stride() as isize + right);
                    let next = (step.texel as usize).wrapping_add_signed(down * self.width as isize + right);
                    if self.filled[at] == 0 && !self.is_rim(at) && self.charts[next] == *chart {
                        front.push(next as u32);
                    }
                }
            }
            front.sort_unstable();
            front.dedup();
        }
        self.holes = all.into_iter().filter(|texel| self.filled[self.padded(*texel)] == 0).collect();
    }

    /// `rounds` rounds outside of charts.
    pub(super) fn grow(&mut self, rounds: u32) {
        let mut rows: Vec<usize> = (0..self.height).collect();
        for _ in 0..rounds {
            let found: Vec<(Vec<Found>, Vec<usize>)> =
                rows.par_chunks(ROWS).map(|rows| self.candidates(rows)).collect();
            let mut near = vec![false; self.height];
            for (found, changed) in &found {
                self.put(found);
                changed.iter().for_each(|y| near[y.saturating_sub(1)..(y + 2).min(self.height)].fill(true));
            }
            rows = (0..self.height).filter(|y| near[*y]).collect();
            if rows.is_empty() {
                break;
            }
            self.ends.push(self.steps.len());
        }
    }

    /// Texels of these rows, outside of charts and not filled, that have filled neighbours; and the rows that have some.
    fn candidates(&self, rows: &[usize]) -> (Vec<Found>, Vec<usize>) {
        let (width, stride) = (self.width, self.stride());
        let (mut column, mut open) = (vec![0u8; stride], vec![0u8; stride.next_multiple_of(8)]);
        let (mut found, mut changed) = (Vec::new(), Vec::new());
        for y in rows {
            let row = |k: usize| &self.filled[(y + k) * stride..(y + k + 1) * stride];
            let (above, own, below) = (row(0), row(1), row(2));
            for (((any, a), b), c) in column.iter_mut().zip(above).zip(own).zip(below) {
                *any = a | b | c;
            }
            let (left, middle, right) = (&column[..width], &column[1..=width], &column[2..]);
            for ((((open, l), m), r), own) in open[1..].iter_mut().zip(left).zip(middle).zip(right).zip(&own[1..]) {
                *open = (l | m | r) & (own ^ 1);
            }
            let before = found.len();
            for (word, eight) in open.as_chunks::<8>().0.iter().enumerate() {
                let mut eight = u64::from_le_bytes(*eight);
                while eight != 0 {
                    let x = 8 * word + eight.trailing_zeros() as usize / 8;
                    eight &= eight - 1;
                    let (texel, at) = (y * width + x - 1, (y + 1) * stride + x);
                    if self.charts[texel] == 0 {
                        let (mask, chart) = self.lowest(at);
                        found.push(Found { step: Step { texel: texel as u32, mask }, at: at as u32, chart });
                    }
                }
            }
            if found.len() > before {
                changed.push(*y);
            }
        }
        (found, changed)
    }

    /// The lowest chart among a texel's filled neighbours, and which of them it owns.
    #[inline]
    fn lowest(&self, at: usize) -> (u8, u32) {
        let owners = self.around(at);
        // No chart is 0: one less, it is above all others.
        let chart = owners.iter().fold(u32::MAX, |least, owner| least.min(owner.wrapping_sub(1))).wrapping_add(1);
        (mask_of(&owners, chart), chart)
    }

    /// Owners of the 8 neighbours in the order of [`AROUND`].
    #[inline]
    fn around(&self, at: usize) -> [u32; 8] {
        let row = |start: usize| &self.owners[start..start + 3];
        let stride = self.stride();
        let (above, own, below) = (row(at - stride - 1), row(at - 1), row(at + stride - 1));
        [above[1], own[0], own[2], below[1], above[0], above[2], below[0], below[2]]
    }

    fn put(&mut self, found: &[Found]) {
        for Found { at, chart, .. } in found {
            self.owners[*at as usize] = *chart;
            self.filled[*at as usize] = 1;
        }
        self.steps.extend(found.iter().map(|found| found.step));
    }

    #[inline]
    fn stride(&self) -> usize {
        self.width + 2
    }

    /// Where a texel lies in the arrays with a rim.
    #[inline]
    fn padded(&self, texel: u32) -> usize {
        let (x, y) = (texel as usize % self.width, texel as usize / self.width);
        (y + 1) * self.stride() + x + 1
    }

    fn is_rim(&self, at: usize) -> bool {
        let (x, y) = (at % self.stride(), at / self.stride());
        x == 0 || x == self.width + 1 || y == 0 || y == self.height + 1
    }

    pub(super) fn finish(mut self) -> Fill {
        let orphans = self.orphans();
        for (texel, _) in &orphans.texels {
            let at = self.padded(*texel);
            self.filled[at] = 1;
        }
        let dilated = (self.steps.len() + orphans.texels.len()) as u64;
        let background = self.charts.len() as u64 - self.covered_count - dilated;
        Fill {
            width: self.width,
            height: self.height,
            steps: self.steps,
            ends: self.ends,
            orphans,
            filled: self.filled,
            report: DilationReport { dilated, background },
        }
    }

    /// The holes that are left, of charts that have covered texels.
    fn orphans(&self) -> Orphans {
        let mut charts: Vec<u32> = self.holes.iter().map(|texel| self.charts[*texel as usize]).collect();
        charts.sort_unstable();
        charts.dedup();
        if charts.is_empty() {
            return Orphans::default();
        }
        let mut covered: Vec<(u32, u32)> = (0u32..)
            .zip(self.covered.iter().zip(self.charts))
            .filter(|(_, (covered, _))| **covered)
            .filter_map(|(texel, (_, chart))| Some((charts.binary_search(chart).ok()? as u32, texel)))
            .collect();
        covered.sort_unstable();
        let start = |chart: usize| covered.partition_point(|(own, _)| (*own as usize) < chart);
        let starts: Vec<usize> = (0..=charts.len()).map(start).collect();
        let chart_of = |texel: &u32| charts.binary_search(&self.charts[*texel as usize]).ok();
        let texels = self
            .holes
            .iter()
            .filter_map(|texel| Some((*texel, chart_of(texel)?)))
            .filter(|(_, chart)| starts[*chart] < starts[chart + 1])
            .map(|(texel, chart)| (texel, chart as u32))
            .collect();
        Orphans { texels, starts, covered: covered.into_iter().map(|(_, texel)| texel).collect() }
    }
}

#[inline]
fn mask_of(owners: &[u32; 8], chart: u32) -> u8 {
    owners.iter().enumerate().fold(0, |mask, (k, owner)| mask | u8::from(*owner == chart) << k)
}

/// The lowest chart among the covered neighbours of a texel that lies in none; without one, among all neighbours.
fn chart_beside(width: usize, height: usize, covered: &[bool], charts: &[u32], texel: usize) -> u32 {
    let (x, y) = ((texel % width) as isize, (texel / width) as isize);
    let inside = |(right, down): &(isize, isize)| {
        (0..width as isize).contains(&(x + right)) && (0..height as isize).contains(&(y + down))
    };
    let neighbours = AROUND.iter().filter(|step| inside(step)).map(|(right, down)| {
        let at = (y + down) as usize * width + (x + right) as usize;
        (!covered[at], charts[at])
    });
    neighbours.filter(|(_, chart)| *chart != 0).min().map_or(NO_CHART, |(_, chart)| chart)
}
