//! Transcendental functions with the same bits on every machine: `libm` instead of the system's library.
//!
//! `sqrt` needs no wrapper: IEEE 754 rounds it exactly everywhere.

/// Sine of `x`, radians.
pub fn sin(x: f32) -> f32 {
    libm::sinf(x)
}

/// Cosine of `x`, radians.
pub fn cos(x: f32) -> f32 {
    libm::cosf(x)
}

/// Tangent of `x`, radians.
pub fn tan(x: f32) -> f32 {
    libm::tanf(x)
}

/// Arc cosine in radians; `x` outside `[-1, 1]` counts as the nearer end, so that rounded dot products give no NaN.
pub fn acos(x: f32) -> f32 {
    libm::acosf(x.clamp(-1.0, 1.0))
}

/// Arc sine in radians; `x` outside `[-1, 1]` counts as the nearer end.
pub fn asin(x: f32) -> f32 {
    libm::asinf(x.clamp(-1.0, 1.0))
}

/// Angle of `(x, y)` against the x axis, radians in `[-pi, pi]`.
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}

/// e to the power of `x`.
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// Natural logarithm.
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// Logarithm to base 2.
pub fn log2(x: f32) -> f32 {
    libm::log2f(x)
}

/// `x` to the power of `y`.
pub fn pow(x: f32, y: f32) -> f32 {
    libm::powf(x, y)
}

/// Cube root.
pub fn cbrt(x: f32) -> f32 {
    libm::cbrtf(x)
}

/// Sine of `x`, radians, double precision.
pub fn sin64(x: f64) -> f64 {
    libm::sin(x)
}

/// Cosine of `x`, radians, double precision.
pub fn cos64(x: f64) -> f64 {
    libm::cos(x)
}

/// Tangent of `x`, radians, double precision.
pub fn tan64(x: f64) -> f64 {
    libm::tan(x)
}

/// Arc cosine in radians, double precision; `x` outside `[-1, 1]` counts as the nearer end.
pub fn acos64(x: f64) -> f64 {
    libm::acos(x.clamp(-1.0, 1.0))
}

/// Arc sine in radians, double precision; `x` outside `[-1, 1]` counts as the nearer end.
pub fn asin64(x: f64) -> f64 {
    libm::asin(x.clamp(-1.0, 1.0))
}

/// Angle of `(x, y)` against the x axis, radians in `[-pi, pi]`, double precision.
pub fn atan264(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// e to the power of `x`, double precision.
pub fn exp64(x: f64) -> f64 {
    libm::exp(x)
}

/// Natural logarithm, double precision.
pub fn ln64(x: f64) -> f64 {
    libm::log(x)
}

/// Logarithm to base 2, double precision.
pub fn log264(x: f64) -> f64 {
    libm::log2(x)
}

/// `x` to the power of `y`, double precision.
pub fn pow64(x: f64, y: f64) -> f64 {
    libm::pow(x, y)
}

/// Cube root, double precision.
pub fn cbrt64(x: f64) -> f64 {
    libm::cbrt(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bits that every machine must give; they change only with a change of `libm`'s algorithms, which changes outputs and
    /// so must be noticed.
    #[test]
    fn the_bits_are_the_recorded_ones() {
        let bits =
            [sin(1.0), cos(1.0), tan(1.0), acos(0.25), asin(0.25), atan2(1.0, 2.0), exp(1.0), ln(3.0), pow(2.5, 1.5)]
                .map(f32::to_bits);
        let near =
            [0.841471f32, 0.540302, 1.557408, 1.318116, 0.252680, 0.463648, std::f32::consts::E, 1.098612, 3.952847];
        for (got, near) in bits.iter().zip(near) {
            assert!((f32::from_bits(*got) - near).abs() < 1e-6, "{} is not near {near}", f32::from_bits(*got));
        }
        assert_eq!(bits, RECORDED);
    }

    const RECORDED: [u32; 9] =
        [1062693540, 1057640768, 1070029091, 1068021767, 1048665934, 1055744824, 1076754516, 1066180436, 1081932658];

    #[test]
    fn a_dot_product_a_little_above_one_has_an_angle() {
        assert_eq!(acos(1.000_000_1), 0.0);
        assert_eq!(acos64(-1.000_000_1), std::f64::consts::PI);
        assert_eq!(asin(-1.5), -std::f32::consts::FRAC_PI_2);
    }
}
