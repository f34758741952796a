//! Cameras that frame a sphere.

use glam::{DVec3, Vec3};
pub use kiln_geom::sphere::{Sphere, bounding_sphere};

/// Empty border around the framed sphere, as a factor.
const MARGIN: f64 = 1.02;

/// A view: where from, how wide, and whether rays are parallel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The point in the middle of the picture, object space.
    pub centre: DVec3,
    /// Unit vector to the right of the picture, object space.
    pub right: DVec3,
    /// Unit vector upwards in the picture, object space.
    pub up: DVec3,
    /// Unit vector from the centre to the eye, object space.
    pub back: DVec3,
    /// Half the picture's smaller side in the plane through the centre, object units.
    pub half_extent: f64,
    /// From the centre to the eye, object units; `None`: orthographic.
    pub distance: Option<f64>,
}

/// A vertex in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Projected {
    /// Picture coordinates, pixels, y down.
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Linear over the picture, greater is further.
    pub(crate) depth: f64,
    /// One over the distance from the eye (1 for parallel rays): weights of perspective-correct interpolation.
    pub(crate) inverse_w: f64,
}

impl Camera {
    /// Parallel rays from `direction` (object space, any length), framing `sphere`.
    pub fn orthographic(direction: Vec3, sphere: Sphere) -> Camera {
        let back = direction.as_dvec3().try_normalize().unwrap_or(DVec3::Z);
        let up = if back.y.abs() < 0.95 { DVec3::Y } else { DVec3::Z };
        let right = up.cross(back).normalize();
        let half_extent = MARGIN * sphere.radius.max(f64::MIN_POSITIVE);
        Camera { centre: sphere.centre, right, up: back.cross(right), back, half_extent, distance: None }
    }

    /// An eye towards `direction` (object space, any length), so far away that `sphere` fills an angle of view of `degrees`.
    pub fn perspective(direction: Vec3, sphere: Sphere, degrees: f64) -> Camera {
        let parallel = Camera::orthographic(direction, sphere);
        let half = (degrees.clamp(1.0, 150.0) * 0.5).to_radians();
        let distance = parallel.half_extent / kiln_geom::math::sin64(half);
        Camera { half_extent: kiln_geom::math::tan64(half) * distance, distance: Some(distance), ..parallel }
    }

    /// The cameras of a measurement: `count` orthographic views on a Fibonacci lattice.
    pub fn views(count: usize, sphere: Sphere) -> Vec<Camera> {
        let directions = kiln_geom::sample::fibonacci_sphere(count);
        directions.into_iter().map(|direction| Camera::orthographic(direction, sphere)).collect()
    }

    /// Unit vector from a place towards the eye, object space.
    pub fn towards_eye(&self, place: DVec3) -> DVec3 {
        match self.distance {
            None => self.back,
            Some(distance) => (self.centre + distance * self.back - place).try_normalize().unwrap_or(self.back),
        }
    }

    /// Where a point falls in a picture of `width` by `height` pixels; `None` behind the eye or too close to it.
    pub(crate) fn project(&self, point: DVec3, width: f64, height: f64) -> Option<Projected> {
        let p = point - self.centre;
        let (x, y, z) = (p.dot(self.right), p.dot(self.up), p.dot(self.back));
        let half = 0.5 * width.min(height) / self.half_extent;
        let (scale, depth, inverse_w) = match self.distance {
            None => (half, -z, 1.0),
            Some(distance) => {
                let w = distance - z;
                if w <= 1e-3 * distance {
                    return None;
                }
                (half * distance / w, -1.0 / w, 1.0 / w)
            }
        };
        Some(Projected { x: 0.5 * width + x * scale, y: 0.5 * height - y * scale, depth, inverse_w })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_is_the_middle_and_the_axes_run_right_and_up() {
        let sphere = Sphere { centre: DVec3::new(1.0, 2.0, 3.0), radius: 2.0 };
        for camera in [Camera::orthographic(Vec3::Z, sphere), Camera::perspective(Vec3::Z, sphere, 45.0)] {
            let at = |p: DVec3| camera.project(sphere.centre + p, 100.0, 100.0).expect("before the eye");
            assert_eq!((at(DVec3::ZERO).x, at(DVec3::ZERO).y), (50.0, 50.0));
            assert!(at(DVec3::X).x > 50.0 && at(DVec3::Y).y < 50.0);
            assert!(at(DVec3::Z).depth < at(-DVec3::Z).depth);
            assert!(at(DVec3::X * 2.0).x < 100.0);
        }
    }

    #[test]
    fn a_sphere_touches_the_margin_of_a_perspective_picture() {
        // The tangent cone of the margin's sphere has exactly the angle of view.
        let sphere = Sphere { centre: DVec3::ZERO, radius: 1.0 };
        let camera = Camera::perspective(Vec3::Z, sphere, 60.0);
        let (sin, cos) = (0.5f64, 0.75f64.sqrt());
        let tangent = camera.project(DVec3::new(MARGIN * cos, 0.0, MARGIN * sin), 64.0, 64.0).expect("before the eye");
        assert!((tangent.x - 64.0).abs() < 1e-9, "{}", tangent.x);
    }

    #[test]
    fn what_lies_behind_the_eye_has_no_place() {
        let camera = Camera::perspective(Vec3::Z, Sphere { centre: DVec3::ZERO, radius: 1.0 }, 45.0);
        assert_eq!(camera.project(DVec3::Z * 10.0, 64.0, 64.0), None);
    }
}
