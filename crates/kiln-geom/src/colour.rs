//! sRGB bytes to linear light and back, exactly rounded.
//!
//! Encoding is a search among 255 thresholds: the byte is the one whose code is nearest to the sRGB curve at that light, so
//! it is monotone, the same on every machine, and every byte survives a round trip.
//!
//! Source: IEC 61966-2-1:1999 (sRGB), the piecewise curve.

use std::sync::LazyLock;

static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|k| decode(k as f64 / 255.0) as f32));

/// `THRESHOLDS[k]`: least light that encodes to `k + 1`; nothing encodes to more than 255.
static THRESHOLDS: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|k| if k < 255 { decode((k as f64 + 0.5) / 255.0) as f32 } else { f32::INFINITY })
});

/// Bits of the least light that [`START`] knows, below the first threshold, and by how much to shift them: 256 steps an octave,
/// so narrow that none holds two thresholds.
const START_BITS: u32 = 0x3900_0000;
const START_SHIFT: u32 = 15;

/// `START[k]`: the byte of the least light in step `k`, from 2^-13 to 1.
static START: LazyLock<[u8; 13 * 256]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let light = f32::from_bits(START_BITS + ((k as u32) << START_SHIFT));
        THRESHOLDS.partition_point(|threshold| *threshold <= light) as u8
    })
});

fn decode(code: f64) -> f64 {
    if code <= 0.04045 { code / 12.92 } else { libm::pow((code + 0.055) / 1.055, 2.4) }
}

/// Linear light in `[0, 1]` of an sRGB byte.
#[inline]
pub fn srgb_to_linear(code: u8) -> f32 {
    LINEAR[code as usize]
}

/// sRGB byte of linear light, nearest on the curve; below 0 (and NaN) gives 0, above 1 gives 255.
#[inline]
pub fn linear_to_srgb(light: f32) -> u8 {
    if light.is_nan() || light < f32::from_bits(START_BITS) {
        return 0;
    }
    let step = ((light.to_bits() - START_BITS) >> START_SHIFT) as usize;
    let Some(byte) = START.get(step) else { return 255 };
    byte + u8::from(THRESHOLDS[*byte as usize] <= light)
}

/// Linear light of an sRGB code in `[0, 1]`, unitless.
pub fn srgb_to_linear_f32(code: f32) -> f32 {
    decode(code as f64) as f32
}

/// sRGB code in `[0, 1]` of linear light, unitless.
pub fn linear_to_srgb_f32(light: f32) -> f32 {
    let light = light as f64;
    let code = if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055 };
    code as f32
}

/// Nearest byte of a value in `[0, 1]` that is stored without a curve; clamped, NaN gives 0.
#[inline]
pub fn unorm8(value: f32) -> u8 {
    (value * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_survives_the_round_trip() {
        for code in 0..=255 {
            assert_eq!(linear_to_srgb(srgb_to_linear(code)), code);
            assert_eq!(unorm8(code as f32 / 255.0), code);
        }
    }

    #[test]
    fn the_byte_is_the_nearest_one_on_the_curve() {
        for k in 0..=100_000 {
            let light = k as f32 / 100_000.0;
            let exact = linear_to_srgb_f32(light) as f64 * 255.0;
            let byte = linear_to_srgb(light) as f64;
            assert!((byte - exact).abs() <= 0.5 + 1e-4, "light {light}: byte {byte}, curve {exact}");
        }
    }

    #[test]
    fn the_table_of_starts_changes_no_byte() {
        let search = |light: f32| THRESHOLDS.partition_point(|threshold| *threshold <= light) as u8;
        let near = THRESHOLDS[..255]
            .iter()
            .flat_map(|t| [-1, 0, 1].map(|ulp| f32::from_bits(t.to_bits().wrapping_add_signed(ulp))));
        let steps = (0..=13 * 256 + 1).map(|k| f32::from_bits(START_BITS - (1 << START_SHIFT) + (k << START_SHIFT)));
        let even = (0..100_000).map(|k| k as f32 / 90_000.0);
        for light in near.chain(steps).chain(even) {
            assert_eq!(linear_to_srgb(light), search(light), "light {light}");
        }
        assert_eq!(linear_to_srgb(f32::NEG_INFINITY), 0);
    }

    #[test]
    fn known_lights() {
        assert_eq!(srgb_to_linear(0), 0.0);
        assert_eq!(srgb_to_linear(255), 1.0);
        assert!((srgb_to_linear(188) - 0.5029).abs() < 1e-4);
        assert_eq!(linear_to_srgb(0.5), 188);
    }

    #[test]
    fn light_outside_the_range_is_clamped() {
        assert_eq!(linear_to_srgb(-1.0), 0);
        assert_eq!(linear_to_srgb(f32::NAN), 0);
        assert_eq!(linear_to_srgb(f32::INFINITY), 255);
        assert_eq!(unorm8(f32::NAN), 0);
        assert_eq!(unorm8(7.0), 255);
    }
}
