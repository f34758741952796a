//! What a view is worth, from the pixels that its regions have.
//!
//! With `p(r|v) = pixels of r in v / pixels of v`, `p(r)` the mean of `p(r|v)` over views, all in nats:
//! ```text
//! entropy              H^a   = (1 - sum_r p(r|v)^a) / (a - 1)                                        -> -sum p ln p
//! mutual information   I^a   = 1 / (a - 1) sum_r p(r|v) ((p(r|v) / p(r))^(a - 1) - 1)                -> sum p ln (p / p(r))
//! ```
//! Both are sums over regions of `p` times a logarithm of order a, `ln_a(x) = (x^(a - 1) - 1) / (a - 1)`, which is `ln x` at a = 1: by `expm1`
//! it is computed without a jump there:
//! ```text
//! H^a = -sum p e,         e = ln_a(p)
//! I^a =  sum p (e + f + (a - 1) e f),                     f = ln_a(1 / p(r))
//! ```
//! `e` and `p e` depend on a pixel count alone, so they are tables; `f` depends on a region's pixels in all views together.

/// Which of the two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Measure {
    /// How evenly a view's pixels are spread over regions (Havrda-Charvát-Tsallis; Shannon at alpha = 1).
    #[default]
    Entropy,
    /// How far a view's regions are from those of all views.
    MutualInformation,
}

/// A change of a pixel count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Delta {
    /// The view.
    pub view: u32,
    /// The region.
    pub region: u32,
    /// Pixels that it wins.
    pub count: i32,
}

/// A measure with its tables.
pub(super) struct Formula {
    pub(super) measure: Measure,
    /// Alpha minus 1.
    pub(super) order: f64,
    /// 1 / pixels of a view.
    share: f64,
    /// 1 / pixels of all views.
    whole: f64,
    /// `[pixels + 1]`: `e`.
    logs: Vec<f64>,
    /// `[pixels + 1]`: `p e`.
    terms: Vec<f64>,
}

/// The pixels of every region in every view.
pub(super) struct Histogram {
    pub(super) views: usize,
    /// `[region_count * views]`; the views of a region lie together.
    pub(super) counts: Vec<u32>,
    /// `[region_count]`: pixels in all views.
    pub(super) totals: Vec<u32>,
    /// `[region_count]`: `f`.
    rarity: Vec<f64>,
}

/// Memory of [`Formula::cost`].
#[derive(Default)]
pub(super) struct CostScratch {
    /// `[region_count]`: 1 + where the region stands in `regions`, or 0.
    slot: Vec<u32>,
    regions: Vec<u32>,
    /// `[regions.len() * views]`.
    changes: Vec<i32>,
    /// `[views]`.
    by_view: Vec<f64>,
}

/// `ln_a(x)` by the natural logarithm of x.
fn log_of_order(log: f64, order: f64) -> f64 {
    if order == 0.0 { log } else { libm::expm1(order * log) / order }
}

impl Formula {
    /// `alpha` above 0; `pixels` of one view.
    pub(super) fn new(measure: Measure, alpha: f64, pixels: usize, views: usize) -> Formula {
        let order = alpha - 1.0;
        let share = 1.0 / pixels as f64;
        // A region without pixels has no term.
        let log = |count: usize| if count == 0 { 0.0 } else { log_of_order(libm::log(count as f64 * share), order) };
        let logs: Vec<f64> = (0..=pixels).map(log).collect();
        let terms = logs.iter().enumerate().map(|(count, log)| count as f64 * share * log).collect();
        Formula { measure, order, share, whole: share / views as f64, logs, terms }
    }

    /// `f` of a region with so many pixels in all views.
    fn rarity(&self, total: u32) -> f64 {
        if total == 0 || self.measure == Measure::Entropy {
            return 0.0;
        }
        log_of_order(-libm::log(f64::from(total) * self.whole), self.order)
    }

    /// A region's term in a view's mutual information.
    #[inline]
    fn information(&self, count: u32, rarity: f64) -> f64 {
        let log = self.logs[count as usize];
        f64::from(count) * self.share * (log + rarity + self.order * log * rarity)
    }

    /// What each view is worth: `[views]`.
    pub(super) fn values(&self, histogram: &Histogram) -> Vec<f64> {
        let mut values = vec![0.0; histogram.views];
        for (region, counts) in histogram.counts.chunks_exact(histogram.views).enumerate() {
            for (value, count) in values.iter_mut().zip(counts) {
                *value += match self.measure {
                    Measure::Entropy => -self.terms[*count as usize],
                    Measure::MutualInformation => self.information(*count, self.rarity(histogram.totals[region])),
                };
            }
        }
        values
    }

    /// Sum over views of how much the changes `deltas`, grouped by view, no region twice in one, would change what a view is worth.
    pub(super) fn cost(&self, histogram: &Histogram, deltas: &[Delta], scratch: &mut CostScratch) -> f64 {
        match self.measure {
            Measure::Entropy => {
                let by_view = deltas.chunk_by(|a, b| a.view == b.view);
                by_view.map(|deltas| self.change(histogram, deltas).abs()).sum()
            }
            Measure::MutualInformation => self.information_cost(histogram, deltas, scratch),
        }
    }

    /// How much less entropy a view would have after the changes `deltas`, all in it.
    #[inline]
    pub(super) fn change(&self, histogram: &Histogram, deltas: &[Delta]) -> f64 {
        let term = |delta: &Delta| {
            let count = histogram.counts[delta.region as usize * histogram.views + delta.view as usize];
            self.terms[count.wrapping_add_signed(delta.count) as usize] - self.terms[count as usize]
        };
        deltas.iter().map(term).sum()
    }

    /// Whether what views cost adds up, so that some of them give a lower bound.
    pub(super) fn adds_up(&self) -> bool {
        self.measure == Measure::Entropy
    }

    /// `p(r)` couples the views: every changed region's term is done again in all of them.
    fn information_cost(&self, histogram: &Histogram, deltas: &[Delta], scratch: &mut CostScratch) -> f64 {
        let CostScratch { slot, regions, changes, by_view } = scratch;
        let views = histogram.views;
        slot.resize(histogram.totals.len(), 0);
        regions.clear();
        changes.clear();
        for delta in deltas {
            let slot = &mut slot[delta.region as usize];
            if *slot == 0 {
                regions.push(delta.region);
                changes.resize(regions.len() * views, 0);
                *slot = regions.len() as u32;
            }
            changes[(*slot as usize - 1) * views + delta.view as usize] += delta.count;
        }
        by_view.clear();
        by_view.resize(views, 0.0);
        for (region, changes) in regions.iter().map(|r| *r as usize).zip(changes.chunks_exact(views)) {
            slot[region] = 0;
            let before = histogram.rarity[region];
            let total = histogram.totals[region].wrapping_add_signed(changes.iter().sum());
            let after = self.rarity(total);
            let counts = &histogram.counts[region * views..(region + 1) * views];
            for ((value, count), change) in by_view.iter_mut().zip(counts).zip(changes) {
                *value +=
                    self.information(count.wrapping_add_signed(*change), after) - self.information(*count, before);
            }
        }
        by_view.iter().map(|value| value.abs()).sum()
    }
}

impl Histogram {
    /// `counts`: `[region_count * views]`.
    pub(super) fn new(counts: Vec<u32>, views: usize, formula: &Formula) -> Histogram {
        let totals: Vec<u32> = counts.chunks_exact(views).map(|counts| counts.iter().sum()).collect();
        let rarity = totals.iter().map(|total| formula.rarity(*total)).collect();
        Histogram { views, counts, totals, rarity }
    }

    /// Applies pixels that went from one region to another in `view`: before, after, how many.
    pub(super) fn pass(&mut self, view: usize, moves: &[(u32, u32, u32)], formula: &Formula) {
        for (before, after, count) in moves {
            for (region, change) in [(*before, -(*count as i32)), (*after, *count as i32)] {
                let region = region as usize;
                let count = &mut self.counts[region * self.views + view];
                *count = count.wrapping_add_signed(change);
                self.totals[region] = self.totals[region].wrapping_add_signed(change);
            }
        }
        for (before, after, _) in moves {
            for region in [*before as usize, *after as usize] {
                self.rarity[region] = formula.rarity(self.totals[region]);
            }
        }
    }
}
