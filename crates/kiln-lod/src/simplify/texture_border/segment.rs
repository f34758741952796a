//! Whether a segment in UV space crosses a border of a picture.
//!
//! **Rule.** A segment crosses a texel if it meets the texel's closed square: sides and corners count on both sides, so the answer
//! does not depend on which end comes first nor on which way the picture lies, and no segment slips between two texels of a
//! border that touch by their corners. Ends are rounded to 1/256 texel; from there on all is integers and exact.
//!
//! ```text
//! for each row of texels that the segment meets:
//!     columns <- those that it meets between the row's upper and lower side
//!     wrap row and columns as the sampler does; look for a set bit among them, 64 at a time
//! ```
//! **Bounds.** A segment that is longer than [`REACH`] pictures, or lies farther than that from a picture that does not repeat,
//! or is no number, counts as crossing wherever the picture has a border: it takes no time.

use glam::{DVec2, Vec2};
use kiln_asset::Wrap;

use super::canny::BorderImage;

/// Units in a texel.
const UNITS: i64 = 256;

/// Most pictures that a segment is followed through.
const REACH: f64 = 4.0;

/// Whether the segment between two UVs (v down) meets a texel of a border.
pub(super) fn crosses(image: &BorderImage, wrap: [Wrap; 2], a: Vec2, b: Vec2) -> bool {
    if image.count() == 0 {
        return false;
    }
    let Some([a, b]) = in_units(image, wrap, a, b) else { return true };
    // From the upper end to the lower.
    let ([px, py], [qx, qy]) = if a[1] <= b[1] { (a, b) } else { (b, a) };
    let (dx, dy) = (qx - px, qy - py);
    let clamps = wrap[1] == Wrap::ClampToEdge;
    let last_row = i64::from(image.height) - 1;
    let (mut first, mut last) = (div_ceil(py, UNITS) - 1, py.max(qy).div_euclid(UNITS));
    if clamps {
        (first, last) = (first.clamp(0, last_row), last.clamp(0, last_row));
    }
    (first..=last).any(|row| {
        // Rows at the edge of a picture that does not repeat go on for ever.
        let upper = if clamps && row == 0 { py } else { py.max(row * UNITS) };
        let lower = if clamps && row == last_row { qy } else { qy.min((row + 1) * UNITS) };
        let columns = if dy == 0 {
            [div_ceil(px.min(qx), UNITS) - 1, px.max(qx).div_euclid(UNITS)]
        } else {
            // Numerators over dy of x where the segment enters and leaves the row.
            let [one, other] = [upper, lower].map(|y| px * dy + (y - py) * dx);
            [div_ceil(one.min(other), UNITS * dy) - 1, one.max(other).div_euclid(UNITS * dy)]
        };
        let row = wrap[1].texel(row, image.height as usize) as u32;
        any_in_row(image, wrap[0], row, columns)
    })
}

/// The ends in 1/256 texel, moved by whole periods near the picture; `None` beyond all bounds.
fn in_units(image: &BorderImage, wrap: [Wrap; 2], a: Vec2, b: Vec2) -> Option<[[i64; 2]; 2]> {
    let (mut a, mut b) = (a.as_dvec2(), b.as_dvec2());
    // The same rounding whichever end is named first.
    if (b.x, b.y) < (a.x, a.y) {
        (a, b) = (b, a);
    }
    for k in 0..2 {
        // No number is beyond all bounds, too.
        let period = match wrap[k] {
            Wrap::Repeat => 1.0,
            Wrap::MirroredRepeat => 2.0,
            Wrap::ClampToEdge if a[k].abs() <= REACH && b[k].abs() <= REACH => continue,
            Wrap::ClampToEdge => return None,
        };
        let whole = (a[k] / period).floor() * period;
        (a[k], b[k]) = (a[k] - whole, b[k] - whole);
        if !(b[k] - a[k]).is_finite() || (b[k] - a[k]).abs() > REACH {
            return None;
        }
    }
    let units = DVec2::new(f64::from(image.width), f64::from(image.height)) * UNITS as f64;
    Some([a, b].map(|end| (end * units + 0.5).floor().to_array().map(|c| c as i64)))
}

/// Whether one of the columns from `columns[0]` to `columns[1]`, wrapped, is set in a row.
fn any_in_row(image: &BorderImage, wrap: Wrap, row: u32, columns: [i64; 2]) -> bool {
    let width = i64::from(image.width);
    let [first, last] = columns;
    if wrap == Wrap::ClampToEdge {
        return image.any(row, first.clamp(0, width - 1) as u32, last.clamp(0, width - 1) as u32);
    }
    (first.div_euclid(width)..=last.div_euclid(width)).any(|piece| {
        let [mut low, mut high] =
            [first.max(piece * width), last.min((piece + 1) * width - 1)].map(|c| c - piece * width);
        if wrap == Wrap::MirroredRepeat && piece.rem_euclid(2) == 1 {
            [low, high] = [width - 1 - high, width - 1 - low];
        }
        image.any(row, low as u32, high as u32)
    })
}

/// `a / b` rounded up; `b` is above 0.
fn div_ceil(a: i64, b: i64) -> i64 {
    -(-a).div_euclid(b)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge];

    fn image(width: u32, height: u32, texels: &[(u32, u32)]) -> BorderImage {
        let mut image = BorderImage::new(width, height);
        for (x, y) in texels {
            image.set(*x, *y);
        }
        image
    }

    /// Every texel of a wide neighbourhood, one at a time: its closed square against the closed segment, by separating axes.
    fn naive(image: &BorderImage, wrap: [Wrap; 2], [a, b]: [[i64; 2]; 2]) -> bool {
        let meets = |x: i64, y: i64| {
            let (low, high) = ([x * UNITS, y * UNITS], [(x + 1) * UNITS, (y + 1) * UNITS]);
            if (0..2).any(|k| a[k].max(b[k]) < low[k] || a[k].min(b[k]) > high[k]) {
                return false;
            }
            let side = |cx: i64, cy: i64| {
                (i128::from(b[0] - a[0]) * i128::from(cy - a[1]) - i128::from(b[1] - a[1]) * i128::from(cx - a[0]))
                    .signum()
            };
            let sides = [side(low[0], low[1]), side(high[0], low[1]), side(low[0], high[1]), side(high[0], high[1])];
            !(sides.iter().all(|s| *s > 0) || sides.iter().all(|s| *s < 0))
        };
        let span = |k: usize| a[k].min(b[k]).div_euclid(UNITS) - 1..=a[k].max(b[k]).div_euclid(UNITS) + 1;
        span(1).any(|y| {
            span(0).any(|x| {
                let texel = (wrap[0].texel(x, image.width as usize), wrap[1].texel(y, image.height as usize));
                image.get(texel.0 as u32, texel.1 as u32) && meets(x, y)
            })
        })
    }

    fn uv(x: f32, y: f32, size: f32) -> Vec2 {
        Vec2::new(x, y) / size
    }

    #[test]
    fn a_segment_crosses_the_texels_that_it_meets() {
        let one = image(8, 8, &[(3, 4)]);
        let wrap = [Wrap::ClampToEdge; 2];
        let meets = |ax, ay, bx, by| crosses(&one, wrap, uv(ax, ay, 8.0), uv(bx, by, 8.0));
        assert!(meets(0.5, 4.5, 7.5, 4.5) && meets(3.5, 0.5, 3.5, 7.5), "through the middle");
        assert!(meets(3.2, 4.2, 3.8, 4.3), "inside");
        assert!(meets(3.5, 4.5, 3.5, 4.5), "a point");
        assert!(!meets(0.5, 3.5, 7.5, 3.5) && !meets(0.5, 0.5, 3.5, 3.5) && !meets(4.5, 4.5, 7.5, 7.5), "beside");
        assert!(meets(1.0, 3.0, 5.0, 3.0) == meets(5.0, 3.0, 1.0, 3.0));
        assert!(meets(0.0, 4.0, 8.0, 4.0) && meets(0.0, 5.0, 8.0, 5.0), "along a side");
        assert!(meets(2.0, 5.0, 4.0, 3.0) && meets(2.0, 3.0, 3.0, 4.0), "by a corner");
    }

    #[test]
    fn no_segment_slips_through_a_diagonal_chain() {
        let chain = image(8, 8, &[0, 1, 2, 3, 4, 5, 6, 7].map(|i| (i, i)));
        let wrap = [Wrap::ClampToEdge; 2];
        for i in 1..8 {
            let at = i as f32;
            assert!(
                crosses(&chain, wrap, uv(at + 0.5, at - 0.5, 8.0), uv(at - 0.5, at + 0.5, 8.0)),
                "through corner {i}"
            );
        }
    }

    #[test]
    fn wrap_modes_lead_to_different_texels() {
        let left = image(8, 1, &[(0, 0)]);
        let meets =
            |wrap, from: f32, to: f32| crosses(&left, [wrap, Wrap::Repeat], uv(from, 0.5, 8.0), uv(to, 0.5, 8.0));
        // Just right of the picture: the first texel again, the last again, the last for ever.
        assert!(meets(Wrap::Repeat, 8.2, 8.4));
        assert!(!meets(Wrap::MirroredRepeat, 8.2, 8.4) && meets(Wrap::MirroredRepeat, 15.2, 15.4));
        assert!(!meets(Wrap::ClampToEdge, 8.2, 30.0) && meets(Wrap::ClampToEdge, -30.0, -2.0));
        assert!(meets(Wrap::MirroredRepeat, -0.4, -0.2) && !meets(Wrap::Repeat, -0.4, -0.2));
        // Far off by whole periods.
        assert!(meets(Wrap::Repeat, 8000.2, 8000.4) && !meets(Wrap::Repeat, 8002.2, 8002.4));
    }

    #[test]
    fn a_segment_beyond_all_bounds_crosses_if_there_is_a_border() {
        let one = image(4, 4, &[(1, 1)]);
        let bounds = [Vec2::NAN, Vec2::new(f32::INFINITY, 0.0), Vec2::splat(-3e38), Vec2::new(0.0, 1e20)];
        for wrap in WRAPS {
            for far in bounds {
                assert!(crosses(&one, [wrap; 2], Vec2::ZERO, far) && crosses(&one, [wrap; 2], far, Vec2::ONE));
                assert!(!crosses(&image(4, 4, &[]), [wrap; 2], Vec2::ZERO, far));
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn rows_of_bits_and_single_texels_agree(
            size in (1_u32..130, 1_u32..9),
            set in prop::collection::vec((0_u32..130, 0_u32..9), 1..12),
            ends in [(-40_i32..40, -40_i32..40), (-40_i32..40, -40_i32..40)],
            finer in prop::bool::ANY,
            wraps in (0_usize..3, 0_usize..3),
        ) {
            let (width, height) = size;
            let texels: Vec<_> = set.iter().map(|(x, y)| (x % width, y % height)).collect();
            let image = image(width, height, &texels);
            let wrap = [WRAPS[wraps.0], WRAPS[wraps.1]];
            // Quarters of a texel meet sides and corners often; sevenths never.
            let part = if finer { 7.0 } else { 4.0 };
            let [a, b] = ends.map(|(x, y)| Vec2::new(x as f32 / part / width as f32, y as f32 / part / height as f32));
            if let Some(units) = in_units(&image, wrap, a, b) {
                prop_assert_eq!(crosses(&image, wrap, a, b), naive(&image, wrap, units));
            }
            prop_assert_eq!(crosses(&image, wrap, a, b), crosses(&image, wrap, b, a));
        }
    }
}
