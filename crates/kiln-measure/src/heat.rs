//! Differences as colours, and the bar that says what the colours mean.

use kiln_asset::Raster;

use crate::render::Picture;
use crate::{font, sheet};

/// From nothing to the scale's end: ever lighter, so that it reads in grey too.
const RAMP: [[u8; 3]; 6] = [[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]];

/// Width of the bar without its numbers, pixels.
const BAR: u32 = 20;

/// Characters of a number beside the bar.
const DIGITS: u32 = 6;

/// The colour of `value` on a scale from 0 to `greatest`; beyond it, its end.
pub fn colour(value: f64, greatest: f64) -> [u8; 3] {
    let share = if greatest > 0.0 { (value / greatest).clamp(0.0, 1.0) } else { 0.0 };
    let place = share * (RAMP.len() - 1) as f64;
    let below = (place as usize).min(RAMP.len() - 2);
    let part = place - below as f64;
    [0, 1, 2].map(|c| {
        let (a, b) = (f64::from(RAMP[below][c]), f64::from(RAMP[below + 1][c]));
        (a + part * (b - a) + 0.5) as u8
    })
}

/// The least of 1, 2, 5, 10, ... times a power of ten that is not below `value`; 1 for 0: the end of a scale for people.
pub fn scale_end(value: f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return 1.0;
    }
    let mut power = 1e-6;
    loop {
        for digit in [1.0, 2.0, 5.0] {
            if digit * power >= value * (1.0 - 1e-9) || power >= 1e12 {
                return digit * power;
            }
        }
        power *= 10.0;
    }
}

/// `[height * width]`: root of the mean square over the channels, codes, of two pictures of one size.
pub fn differences(reference: &Picture, other: &Picture) -> Vec<f32> {
    let pairs = reference.codes.iter().zip(&other.codes);
    pairs.map(|(a, b)| ((*a - *b).length_squared() / 3.0).sqrt()).collect()
}

/// Values `[height * width]` as colours on a scale from 0 to `greatest`.
pub fn heat_map(width: u32, height: u32, values: &[f32], greatest: f64) -> Raster {
    let opaque = |[r, g, b]: [u8; 3]| [r, g, b, 255];
    Raster { width, height, texels: values.iter().map(|v| opaque(colour(f64::from(*v), greatest))).collect() }
}

/// The scale from 0 (bottom) to `greatest` (top), `height` pixels high, with a number at every quarter.
pub fn colour_bar(height: u32, greatest: f64) -> Raster {
    let text_width = DIGITS * (font::WIDTH + 1) * sheet::SCALE;
    let text_height = font::HEIGHT * sheet::SCALE;
    let height = height.max(text_height);
    let mut bar = Raster::filled(BAR + 4 + text_width, height, sheet::PAPER);
    for y in 0..height {
        let share = f64::from(height - 1 - y) / f64::from((height - 1).max(1));
        let [r, g, b] = colour(share, 1.0);
        let start = y as usize * bar.width as usize;
        bar.texels[start..start + BAR as usize].fill([r, g, b, 255]);
    }
    for quarter in 0..=4 {
        let value = greatest * f64::from(quarter) / 4.0;
        let y = (height - text_height) * (4 - quarter) / 4;
        sheet::write(&mut bar, &number(value), BAR + 4, y, text_width);
    }
    bar
}

/// Three significant digits in at most [`DIGITS`] characters, for what scales here hold (codes and shares).
fn number(value: f64) -> String {
    let decimals = if value == 0.0 || value >= 100.0 {
        0
    } else if value >= 10.0 {
        1
    } else if value >= 1.0 {
        2
    } else {
        4
    };
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn the_ramp_grows_lighter_from_end_to_end() {
        let light = |share: f64| {
            let [r, g, b] = colour(share, 1.0).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let lights: Vec<f64> = (0..=100).map(|k| light(f64::from(k) / 100.0)).collect();
        assert!(lights.windows(2).all(|w| w[1] >= w[0] - 0.5), "{lights:?}");
        assert!(lights[0] < 5.0 && lights[100] > 230.0);
        assert_eq!((colour(0.0, 3.0), colour(3.0, 3.0), colour(9.0, 3.0)), (RAMP[0], RAMP[5], RAMP[5]));
        assert_eq!(colour(1.0, 0.0), RAMP[0]);
    }

    #[test]
    fn scales_end_at_round_numbers_not_below_the_value() {
        for (value, end) in [(0.0, 1.0), (0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (2.5, 5.0), (37.0, 50.0), (0.013, 0.02)] {
            assert!((scale_end(value) - end).abs() < 1e-9 * end, "{value}: {}", scale_end(value));
        }
        assert_eq!((scale_end(f64::NAN), scale_end(f64::INFINITY)), (1.0, 1.0));
    }

    #[test]
    fn the_map_has_the_colours_that_the_bar_has_at_their_values() {
        let map = heat_map(3, 1, &[0.0, 25.0, 50.0], 50.0);
        let bar = colour_bar(101, 50.0);
        let on_bar = |y: u32| bar.texels[(y * bar.width) as usize];
        assert_eq!(map.texels, [on_bar(100), on_bar(50), on_bar(0)]);
    }

    #[test]
    fn numbers_stand_beside_the_bar() {
        let bar = colour_bar(120, 20.0);
        let ink = |rows: std::ops::Range<u32>| {
            let texels =
                rows.flat_map(|y| bar.texels[(y * bar.width + BAR) as usize..][..(bar.width - BAR) as usize].iter());
            texels.filter(|t| **t == sheet::INK).count()
        };
        assert!(ink(0..14) > 50 && ink(106..120) > 20 && ink(53..67) > 50);
        assert_eq!(ink(14..26), 0);
        for (value, text) in
            [(0.0, "0"), (50.0, "50"), (12.5, "12.5"), (0.05, "0.05"), (0.0125, "0.0125"), (255.0, "255")]
        {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn a_difference_is_the_root_mean_square_of_the_channels() {
        let one = |code: Vec3| Picture { width: 1, height: 1, codes: vec![code], coverage: vec![1.0] };
        let d = differences(&one(Vec3::new(10.0, 20.0, 30.0)), &one(Vec3::new(13.0, 20.0, 30.0)));
        assert!((d[0] - 3f32.sqrt()).abs() < 1e-6);
    }
}
