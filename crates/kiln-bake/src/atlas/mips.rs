//! What a padding is worth: down to which mip level a chart's texels hold nothing but the chart.
//!
//! A sheet's mip level `k` has texels of `s x s` texels of the sheet, `s = 2^k`, each their mean. Dilation fills a band of
//! `h = padding / 2` texels (rounded down) around each chart, measured as the padding is, in steps to any of eight
//! neighbours. Two charts are `padding >= 2 h` empty texels apart, so a band holds the colour of its own chart only. Whatever
//! is read within `h` texels of a texel that the chart touches is therefore clean, and all that has to be known is how far a
//! read reaches.
//!
//! - **A whole texel of level `k`** that touches the chart: its other texels are at most `s - 1` away, along each axis. Clean
//!   while `s - 1 <= h`.
//! - **A bilinear fetch** at a place of the chart, `p` along one axis: the two texels of level `k` whose middles lie around it
//!   begin at `x = s floor(p / s - 1/2)` and end before `x + 2 s`, so `s / 2 <= p - x < 3 s / 2`. The texel of the sheet in which
//!   `p` lies is `t = floor(p)`. Downwards the fetch reaches `t - x`, upwards `x + 2 s - 1 - t`; for even `s` both are at most
//!   `3 s / 2 - 1`, for `s = 1` at most 1. The axes do not ask each other, so the same holds for both. Clean while that is at
//!   most `h`.
//!
//! | level | whole texel reaches | padding for it | bilinear fetch reaches | padding for it |
//! | --- | --- | --- | --- | --- |
//! | 0, whole size | 0 | 0 | 1 | 2 |
//! | 1, 1/2 | 1 | 2 | 2 | 4 |
//! | 2, 1/4 | 3 | 6 | 5 | 10 |
//! | 3, 1/8 | 7 | 14 | 11 | 22 |
//! | 4, 1/16 | 15 | 30 | 23 | 46 |
//! | 5, 1/32 | 31 | 62 | 47 | 94 |
//!
//! So 16 texels keep every texel of 1/8 clean, and bilinear fetches down to 1/4. A bilinear fetch at 1/8 on the very edge of a
//! chart reaches 3 texels beyond the chart's band of 8, into the neighbour's: across a straight edge it takes at most 1/16 of its
//! value from there ([`foreign_share`]). Fetches that shall be clean at 1/8 too need 22 texels.
//!
//! **Conditions.** The sheet's size is a multiple of `2^k`, and each level is made by averaging blocks of four, as every engine
//! does by default (a wider filter reaches further). Dilation is at least `h` (the pipeline's default of 8 for a padding of 16).
//! Trilinear fetches are clean where the coarser of their two levels is. An anisotropic fetch reads along its pixel's footprint,
//! which may leave the chart: nothing here speaks of that. Towards the sheet's edge `h` empty texels are kept, so the same holds
//! for samplers that repeat, and for those that clamp anyway.

/// How texels of a mip level are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fetch {
    /// One texel as a whole: it must hold nothing of another chart.
    Texel,
    /// The four texels whose middles lie around a place inside the chart.
    Bilinear,
}

/// Levels of which the module speaks: one more than halvings of the largest sheet.
const LEVELS: u32 = 15;

impl Fetch {
    /// How far a read at mip level `level` (at most 30) reaches from the texel of the sheet that it is about, texels of the sheet
    /// along each axis.
    pub fn reach(self, level: u32) -> u32 {
        match (self, level) {
            (Fetch::Texel, _) => (1 << level) - 1,
            (Fetch::Bilinear, 0) => 1,
            (Fetch::Bilinear, _) => 3 * (1 << (level - 1)) - 1,
        }
    }

    /// Least padding, texels of the sheet, at which reads at mip level `level` are clean.
    pub fn padding_for(self, level: u32) -> u32 {
        2 * self.reach(level)
    }

    /// The coarsest mip level at which reads are clean with that padding; `None` if not even the sheet's own texels are.
    pub fn coarsest_clean(self, padding: u32) -> Option<u32> {
        (0..LEVELS).take_while(|level| self.padding_for(*level) <= padding).last()
    }
}

/// The largest share of its value, `[0, 1]`, that a bilinear fetch at mip level `level` takes from beyond the band of its own
/// chart across a straight edge, with all texels beyond the band foreign. 0 where [`Fetch::coarsest_clean`] says so.
pub fn foreign_share(padding: u32, level: u32) -> f64 {
    let (side, band) = (f64::from(1u32 << level), f64::from(padding / 2));
    let mut most = 0.0f64;
    // `p - x` runs over [s / 2, 3 s / 2); texels of the sheet below `t - h` are foreign. The lower texel weighs 3/2 - (p - x) / s.
    // For a whole number `floor(p - x)` the weight is largest at its beginning.
    let mut first = (side / 2.0).floor();
    while first < 1.5 * side {
        let from = first.max(side / 2.0);
        let weight = 1.5 - from / side;
        let foreign = (first - band).clamp(0.0, side) / side;
        // Beyond the lower texel's own foreign part lies the upper one's.
        let foreign_above = (first - band - side).clamp(0.0, side) / side;
        most = most.max(weight * foreign + (1.0 - weight) * foreign_above);
        first += 1.0;
    }
    most
}
