//! One channel of BC5: two endpoints of 8 bits and for each of 16 texels 3 bits between them.
//!
//! **Method.** With endpoints `high > low` a block has the eight values `((7 - k) high + k low) / 7`. From the greatest and least
//! texel, each endpoint walks by one step as long as the sum of squared errors falls: shrinking the range often places the
//! inner values better than it costs the outermost texels. Errors are whole numbers (sevenths), so nothing is rounded. The
//! other mode, six values with 0 and 255, is not tried: maps of normals have no use for it.

/// Most walks of both endpoints: where a walk still gains after so many, the next gains are below what is seen.
const STEPS: usize = 24;

/// The 8 bytes of a channel's block; texels row by row.
pub(super) fn encode_channel(texels: &[u8; 16]) -> [u8; 8] {
    let least = texels.iter().copied().min().unwrap_or(0);
    let greatest = texels.iter().copied().max().unwrap_or(0);
    if least == greatest {
        // Equal endpoints select the mode of six values, whose first is the endpoint.
        return [greatest, least, 0, 0, 0, 0, 0, 0];
    }
    let (mut high, mut low) = (i32::from(greatest), i32::from(least));
    let mut best = error(texels, high, low);
    for _ in 0..STEPS {
        let before = best;
        for (dh, dl) in [(-1, 0), (0, 1), (-1, 1), (1, 0), (0, -1), (-1, -1), (1, 1)] {
            let (h, l) = (high + dh, low + dl);
            if h <= l || h > 255 || l < 0 {
                continue;
            }
            let found = error(texels, h, l);
            if found < best {
                (best, high, low) = (found, h, l);
            }
        }
        if best == before {
            break;
        }
    }
    let mut bits = 0u64;
    for (i, texel) in texels.iter().enumerate() {
        // Codes: 0 high, 1 low, 2 to 7 from high to low.
        let code = match step(i32::from(*texel), high, low) {
            0 => 0,
            7 => 1,
            k => k as u64 + 1,
        };
        bits |= code << (3 * i);
    }
    let b = bits.to_le_bytes();
    [high as u8, low as u8, b[0], b[1], b[2], b[3], b[4], b[5]]
}

/// The nearest of the eight values, counted from `high`.
fn step(texel: i32, high: i32, low: i32) -> i32 {
    let range = high - low;
    ((14 * (high - texel) + range) / (2 * range)).clamp(0, 7)
}

/// Sum of squared errors, in squares of a seventh.
fn error(texels: &[u8; 16], high: i32, low: i32) -> i32 {
    let of = |texel: &u8| {
        let k = step(i32::from(*texel), high, low);
        let off = 7 * i32::from(*texel) - (7 - k) * high - k * low;
        off * off
    };
    texels.iter().map(of).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(block: [u8; 8]) -> [u8; 16] {
        let mut out = [0u8; 16];
        bcdec_rs::bc4(&block, &mut out, 4, false);
        out
    }

    /// The naive twin: every pair of endpoints.
    fn least_error(texels: &[u8; 16]) -> i32 {
        let pairs = (0..255).flat_map(|low| (low + 1..256).map(move |high| (high, low)));
        pairs.map(|(high, low)| error(texels, high, low)).min().expect("pairs")
    }

    #[test]
    fn the_eight_values_come_back_as_they_are() {
        let texels: [u8; 16] = std::array::from_fn(|i| 40 + 20 * (i as u8 % 8));
        assert_eq!(decoded(encode_channel(&texels)), texels);
    }

    #[test]
    fn the_walk_comes_near_to_trying_every_pair() {
        let mut seed = 7u32;
        let (mut walked, mut naive) = (0i64, 0i64);
        for _ in 0..40 {
            let texels: [u8; 16] = std::array::from_fn(|_| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                100 + (seed >> 25) as u8
            });
            let found = decoded(encode_channel(&texels));
            let own: i64 = texels.iter().zip(found).map(|(a, b)| i64::from(a.abs_diff(b)).pow(2)).sum();
            walked += own;
            naive += i64::from(least_error(&texels));
        }
        // Sums in squares of one and of a seventh.
        let ratio = 49.0 * walked as f64 / naive as f64;
        assert!(ratio < 1.25, "{ratio:.3} times the least error");
    }
}
