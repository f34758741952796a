//! What the texels get that the bake left empty.
//!
//! Comes in: a baked picture, which of its texels are covered (hold baked values), and in which chart each texel's centre
//! lies. Goes out: the same picture with every texel set. Covered texels never change.
//!
//! ```text
//! plan, once for a sheet:
//!     holes      a texel inside a chart takes from filled neighbours of the same chart, round after round until none is left
//!     band       N rounds: a texel outside of all charts that has filled neighbours (of 8) belongs to the lowest chart among them
//!                and takes from those of that chart
//!     holes      once more, now that a band may have closed a gap in a chart
//!     orphans    what is left inside a chart that has covered texels takes their mean
//! apply, for each of the sheet's maps:
//!     every texel of a round: the mean of the texels it takes from; rounds in order
//!     the rest: up, each cell of a pyramid is the mean of its 2x2 that have a value; down, a texel without one takes that of
//!     the smallest cell around it that has one
//! ```
//!
//! **Never into another chart.** A filled texel has one chart, and takes from texels of that chart alone: nothing is averaged
//! over two charts, a chart's texels are changed by no other chart, and where two bands meet, the nearer chart wins (Chebyshev
//! distance, the number of rounds), at equal distance the lower one. A band goes around what lies in its way.
//!
//! **Which mips are clean.** With charts at least `2 d` texels apart and a band of `d`, a texel of box-filtered mip `k` that
//! contains a texel of a chart contains none of another chart's colour while `2^k - 1 <= d`: `d = 8` serves down to 1/8. A
//! *bilinear* read at a place inside a chart touches up to `1.5 * 2^k` texels beyond it: `d = 8` serves down to 1/4, `d = 12`
//! (and padding 24) down to 1/8.
//!
//! **Coarser mips.** The pyramid is that of a box filter, so a box-filtered mip of the filled picture has in each texel the
//! mean of what was baked and banded there, and empty space neither darkens nor brightens it.
//!
//! **Spaces.** Means are taken in linear light ([`TexelKind::Srgb`] bytes), of vectors before they are brought to unit length
//! (a mean of length 0 points straight up), and of numbers as they are. Ids are copied, never averaged: from the nearest
//! neighbour of a round, the first texel of an orphan's chart, the first in the pyramid's cell.
//!
//! Departures: the paper's test "length below 1 = empty" fails for 8-bit and averaged normals, hence the coverage mask; it
//! knows no charts; a background of one colour is replaced by the pyramid.
//!
//! Limits: charts that are nearer than two bands share what lies between them; the caller compares padding and dilation. A
//! chart without any covered texel is filled by the pyramid, with its neighbours' colours.
//!
//! Sources: C. González, thesis 2010, section 6.2 (border expansion); the pyramid: S. Gortler et al., The Lumigraph,
//! SIGGRAPH 1996, section 3.4.1 (pull-push), doi:10.1145/237170.237200, here with weights 0 and 1.

mod band;
mod code;
mod pyramid;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use code::Code;
pub use code::{TexelKind, Texels};

/// Rounds with fewer texels are filled by one thread.
const ALONE: usize = 1 << 13;

/// How many texels came from where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DilationReport {
    /// Filled from their own or the nearest chart.
    pub dilated: u64,
    /// Left for the pyramid.
    pub background: u64,
}

/// Where each texel of a sheet takes its value from, for all maps of that sheet.
#[derive(Clone, Debug)]
pub struct Fill {
    width: usize,
    height: usize,
    /// Texels in the order in which they are filled.
    steps: Vec<Step>,
    /// Ends of the rounds in `steps`: no texel takes from one of its own round.
    ends: Vec<usize>,
    orphans: Orphans,
    /// `[height * width]`, 1: has a value before the pyramid.
    filled: Vec<u8>,
    report: DilationReport,
}

/// A texel and the neighbours that it takes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Step {
    texel: u32,
    /// Bit `k`: neighbour `k` in the order of [`band::AROUND`].
    mask: u8,
}

/// Texels inside charts that no round reaches.
#[derive(Clone, Debug, Default)]
struct Orphans {
    /// `(texel, row of starts)`, ascending texels.
    texels: Vec<(u32, u32)>,
    /// `[chart_count + 1]` of the charts that have orphans: where in `covered` their texels start.
    starts: Vec<usize>,
    /// Covered texels of those charts, chart after chart, each ascending.
    covered: Vec<u32>,
}

impl Fill {
    /// The plan for a sheet of `width` by `height` texels.
    ///
    /// `covered`: `[height * width]`, texels that hold baked values. `charts`: `[height * width]`, number + 1 of the chart that a
    /// texel's centre lies in, 0 for none; a covered texel in none counts to the lowest chart among its covered neighbours'.
    /// `rounds`: width of the band around charts, texels.
    ///
    /// # Panics
    /// If a mask has another length, or there are `2^32` texels or more.
    pub fn plan(width: u32, height: u32, covered: &[bool], charts: &[u32], rounds: u32) -> Fill {
        let (width, height) = (width as usize, height as usize);
        let count = width * height;
        assert!(covered.len() == count && charts.len() == count, "masks of another size");
        assert!(u32::try_from(count).is_ok(), "a sheet of 2^32 texels");
        let mut band = band::Band::new(width, height, covered, charts);
        band.fill_holes();
        band.grow(rounds);
        if rounds > 0 {
            band.fill_holes();
        }
        band.finish()
    }

    /// How many texels are filled from where; the same for every map.
    pub fn report(&self) -> DilationReport {
        self.report
    }

    /// Sets every texel of `picture` that is not covered.
    ///
    /// # Panics
    /// If the picture has another size than the plan.
    pub fn apply<P: Texels>(&self, picture: &mut P, kind: TexelKind) {
        let (width, texels) = picture.grid();
        assert!(width == self.width && texels.len() == self.width * self.height, "a picture of another size");
        match kind {
            TexelKind::Srgb => self.run::<P::Srgb>(texels),
            TexelKind::Linear => self.run::<P::Linear>(texels),
            TexelKind::Normal => self.run::<P::Normal>(texels),
            TexelKind::Vector => self.run::<P::Vector>(texels),
            TexelKind::Nearest => self.run::<P::Nearest>(texels),
        }
    }

    fn run<C: Code>(&self, texels: &mut [C::Texel]) {
        let steps_to = band::AROUND.map(|(right, down)| down * self.width as isize + right);
        let alone = rayon::current_num_threads() == 1;
        let mut values: Vec<C::Texel> = Vec::new();
        let mut start = 0;
        for end in &self.ends {
            let steps = &self.steps[start..*end];
            start = *end;
            // No texel takes from another of its round, so one thread needs no copy.
            if alone || steps.len() < ALONE {
                for step in steps {
                    texels[step.texel as usize] = band::value::<C>(texels, &steps_to, *step);
                }
                continue;
            }
            steps.par_iter().map(|step| band::value::<C>(texels, &steps_to, *step)).collect_into_vec(&mut values);
            for (step, value) in steps.iter().zip(&values) {
                texels[step.texel as usize] = *value;
            }
        }
        self.orphans.fill::<C>(texels);
        if self.report.background > 0 {
            pyramid::fill::<C>(texels, &self.filled, self.width, self.height);
        }
    }
}

impl Orphans {
    fn fill<C: Code>(&self, texels: &mut [C::Texel]) {
        let means: Vec<C::Texel> = self
            .starts
            .windows(2)
            .map(|range| {
                let own = &self.covered[range[0]..range[1]];
                C::encode(code::mean::<C>(own.iter().map(|texel| C::decode(texels[*texel as usize]))))
            })
            .collect();
        for (texel, chart) in &self.texels {
            texels[*texel as usize] = means[*chart as usize];
        }
    }
}
