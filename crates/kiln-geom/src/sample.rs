//! Points spread evenly over a sphere or over a surface, without a random number generator.

use glam::{DVec3, Vec3};

/// Unit directions `[n]` on a Fibonacci lattice: evenly spread, on no symmetry of a regular solid, latitude descending in y.
pub fn fibonacci_sphere(n: usize) -> Vec<Vec3> {
    (0..n)
        .map(|i| {
            let i = i as f64 + 0.5;
            let y = 1.0 - 2.0 * i / n as f64;
            // The offset keeps the first direction off the xy plane; the measuring scripts use the same.
            let angle = std::f64::consts::PI * (1.0 + 5f64.sqrt()) * i + 0.3;
            let r = (1.0 - y * y).sqrt();
            Vec3::new((r * libm::cos(angle)) as f32, y as f32, (r * libm::sin(angle)) as f32)
        })
        .collect()
}

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSample {
    /// Where, object space.
    pub position: Vec3,
    /// On which triangle.
    pub face: u32,
    /// Barycentric coordinates in it.
    pub bary: [f32; 3],
}

/// Area-weighted points of a triangle mesh: the cumulated area is cut into equal strata, each stratum gives one point; inside
/// triangles the points follow a low-discrepancy sequence. The same mesh, count and seed give the same points.
///
/// # Source
/// Inside a triangle: uniform by `sqrt`, as in Osada et al., Shape Distributions, ACM TOG 2002, doi:10.1145/571647.571648,
/// equation 1; the sequence is the additive recurrence with the plastic number (M. Roberts, 2018).
#[derive(Clone, Debug)]
pub struct SurfaceSamples {
    /// `[count]`, ordered by face; empty if the surface has no area.
    pub samples: Vec<SurfaceSample>,
    /// Area of the surface, square object units.
    pub area: f64,
}

impl SurfaceSamples {
    /// `count` points on the triangles `[face_count] x 3` over `positions` (object units).
    ///
    /// # Panics
    /// If a triangle refers to no position.
    pub fn new(positions: &[Vec3], triangles: &[[u32; 3]], count: usize, seed: u64) -> SurfaceSamples {
        let mut area = 0.0;
        let cumulated: Vec<f64> = triangles
            .iter()
            .map(|t| {
                let own = crate::triangle::area(t.map(|v| positions[v as usize]));
                area += if own.is_finite() { own } else { 0.0 };
                area
            })
            .collect();
        if area <= 0.0 || !area.is_finite() {
            return SurfaceSamples { samples: Vec::new(), area: 0.0 };
        }
        let last = last_with_area(&cumulated);
        let mut face = 0;
        let samples = (0..count as u64)
            .map(|i| {
                // Strata ascend, so the face does too.
                let stratum = (i as f64 + unit(hash(i ^ hash(seed)))) / count as f64;
                while face < last && cumulated[face] <= stratum * area {
                    face += 1;
                }
                let [u, v] = plastic(i.wrapping_add(hash(seed) >> 16));
                let s = u.sqrt();
                let bary = [1.0 - s, s * (1.0 - v), s * v];
                let [a, b, c] = triangles[face].map(|v| positions[v as usize].as_dvec3());
                let position: DVec3 = bary[0] * a + bary[1] * b + bary[2] * c;
                SurfaceSample { position: position.as_vec3(), face: face as u32, bary: bary.map(|w| w as f32) }
            })
            .collect();
        SurfaceSamples { samples, area }
    }
}

/// The last face that adds area: rounding may put the last stratum behind it.
fn last_with_area(cumulated: &[f64]) -> usize {
    let total = cumulated[cumulated.len() - 1];
    cumulated.partition_point(|a| *a < total)
}

/// A well-mixed 64-bit value of an index: for jitter that must not depend on any generator's state.
///
/// # Source
/// Steele, Lea, Flood, Fast splittable pseudorandom number generators, OOPSLA 2014, doi:10.1145/2660193.2660195 (SplitMix64).
pub fn hash(index: u64) -> u64 {
    let mut z = index.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A value in `[0, 1)` from the upper 53 bits.
pub fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Term `i` of the two-dimensional additive recurrence with the plastic number, in `[0, 1)^2`, in exact 64-bit arithmetic.
fn plastic(i: u64) -> [f64; 2] {
    // 2^64 / p and 2^64 / p^2 with p^3 = p + 1.
    const STEP: [u64; 2] = [13_925_035_116_211_876_495, 10_511_698_010_929_265_436];
    STEP.map(|step| unit(i.wrapping_mul(step).wrapping_add(1 << 63)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_unit_and_balanced() {
        let directions = fibonacci_sphere(1000);
        assert!(directions.iter().all(|d| (d.length() - 1.0).abs() < 1e-6));
        let mean: Vec3 = directions.iter().copied().sum::<Vec3>() / 1000.0;
        assert!(mean.length() < 2e-3, "{mean}");
        // No two closer than half the spacing of a perfect lattice.
        let spacing = (4.0 * std::f32::consts::PI / 1000.0).sqrt();
        for (i, a) in directions.iter().enumerate() {
            for b in &directions[..i] {
                assert!((*a - *b).length() > 0.5 * spacing);
            }
        }
    }

    #[test]
    fn samples_follow_the_area() {
        // Two right triangles: areas 0.5 and 1.5, and a degenerate one between them.
        let positions = [
            Vec3::ZERO,
            Vec3::X,
            Vec3::Y,
            Vec3::new(0.0, 0.0, 5.0),
            Vec3::new(3.0, 0.0, 5.0),
            Vec3::new(0.0, 1.0, 5.0),
        ];
        let samples = SurfaceSamples::new(&positions, &[[0, 1, 2], [0, 1, 1], [3, 4, 5]], 4000, 1);
        assert_eq!(samples.area, 2.0);
        let counts = [0, 1, 2].map(|f| samples.samples.iter().filter(|s| s.face == f).count());
        assert_eq!(counts[1], 0);
        assert!(counts[0].abs_diff(1000) <= 1, "{counts:?}");
        assert_eq!(counts.iter().sum::<usize>(), 4000);
        // Each triangle's mean is its centroid.
        for (face, centroid) in [(0, Vec3::new(1.0, 1.0, 0.0) / 3.0), (2, Vec3::new(1.0, 1.0 / 3.0, 5.0))] {
            let own: Vec<_> = samples.samples.iter().filter(|s| s.face == face).map(|s| s.position).collect();
            let mean = own.iter().copied().sum::<Vec3>() / own.len() as f32;
            assert!((mean - centroid).length() < 5e-3, "{mean} for {centroid}");
        }
    }

    #[test]
    fn every_sample_lies_on_the_face_of_its_stratum() {
        // Faces of area from a millionth to a million, and none: the twin looks each stratum up by itself.
        let scale = |f: u32| if f % 7 == 3 { 0.0 } else { 10f32.powi((f * 5 % 7) as i32 - 3) };
        let positions: Vec<Vec3> =
            (0..60u32).flat_map(|f| [Vec3::ZERO, Vec3::X * scale(f), Vec3::Y * scale(f)]).collect();
        let triangles: Vec<[u32; 3]> = (0..60).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        let mut sum = 0.0;
        let mut cumulated = Vec::new();
        for t in &triangles {
            sum += crate::triangle::area(t.map(|v| positions[v as usize]));
            cumulated.push(sum);
        }
        for count in [1usize, 10, 5000] {
            for (i, sample) in SurfaceSamples::new(&positions, &triangles, count, 5).samples.iter().enumerate() {
                let stratum = (i as f64 + unit(hash(i as u64 ^ hash(5)))) / count as f64;
                let face = cumulated.partition_point(|a| *a <= stratum * sum).min(last_with_area(&cumulated));
                assert_eq!(sample.face, face as u32);
            }
        }
    }

    #[test]
    fn samples_lie_where_their_barycentric_coordinates_say() {
        let positions = [Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, -1.0, 0.0), Vec3::new(0.0, 0.0, 1.0)];
        for s in SurfaceSamples::new(&positions, &[[0, 1, 2]], 100, 7).samples {
            let on = s.bary[0] * positions[0] + s.bary[1] * positions[1] + s.bary[2] * positions[2];
            assert!((on - s.position).length() < 1e-5);
            assert!(s.bary.iter().all(|w| *w >= 0.0));
        }
    }

    #[test]
    fn a_surface_without_area_has_no_samples() {
        assert!(SurfaceSamples::new(&[], &[], 10, 1).samples.is_empty());
        assert!(SurfaceSamples::new(&[Vec3::ONE], &[[0, 0, 0]], 10, 1).samples.is_empty());
    }

    #[test]
    fn the_recurrence_is_that_of_the_plastic_number() {
        let p: f64 = 1.324_717_957_244_746;
        let [u, v] = plastic(1);
        assert!((u - (0.5 + 1.0 / p).fract()).abs() < 1e-12);
        assert!((v - (0.5 + 1.0 / (p * p)).fract()).abs() < 1e-12);
    }
}
