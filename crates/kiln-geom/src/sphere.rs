//! The sphere around a set of positions: what cameras frame.

use glam::{DVec3, Vec3};

/// A sphere in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Its centre, object space.
    pub centre: DVec3,
    /// Its radius, object units.
    pub radius: f64,
}

/// A sphere around all `positions` (object space), not much larger than the least one; radius 0 for one place or none.
///
/// # Source
/// J. Ritter, An Efficient Bounding Sphere, Graphics Gems, 1990; then grown until it holds every position.
pub fn bounding_sphere(positions: &[Vec3]) -> Sphere {
    let Some(start) = positions.first().map(|p| p.as_dvec3()) else {
        return Sphere { centre: DVec3::ZERO, radius: 0.0 };
    };
    let furthest = |from: DVec3| {
        let mut best = (from, 0.0);
        for p in positions {
            let d = (p.as_dvec3() - from).length_squared();
            if d > best.1 {
                best = (p.as_dvec3(), d);
            }
        }
        (best.0, best.1.sqrt())
    };
    let (p, _) = furthest(start);
    let (q, d) = furthest(p);
    let (mut centre, mut radius) = (0.5 * (p + q), 0.5 * d);
    for _ in 0..50 {
        let (out, d) = furthest(centre);
        if d <= radius * (1.0 + 1e-9) {
            break;
        }
        let grown = 0.5 * (radius + d);
        centre += (out - centre) * (1.0 - grown / d);
        radius = grown;
    }
    Sphere { centre, radius: radius.max(furthest(centre).1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sphere_of_a_cube_goes_through_its_corners() {
        let corners: Vec<Vec3> =
            (0..8).map(|k| Vec3::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2) as f32) * 2.0).collect();
        let sphere = bounding_sphere(&corners);
        assert!((sphere.centre - DVec3::ONE).length() < 1e-6);
        assert!((sphere.radius - 3f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn every_position_lies_in_the_sphere() {
        let positions: Vec<Vec3> =
            crate::sample::fibonacci_sphere(300).into_iter().map(|p| p * Vec3::new(5.0, 1.0, 2.0) + p.y).collect();
        let sphere = bounding_sphere(&positions);
        assert!(positions.iter().all(|p| (p.as_dvec3() - sphere.centre).length() <= sphere.radius * (1.0 + 1e-12)));
        assert!(sphere.radius < 5.6, "{}", sphere.radius);
        assert_eq!(bounding_sphere(&[Vec3::ONE]).radius, 0.0);
    }
}
