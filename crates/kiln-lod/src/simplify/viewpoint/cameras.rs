//! Cameras: where the views of a model look from.
//!
//! **Method.** The views stand at the vertices of a regular solid around the model's bounding sphere, or on a Fibonacci lattice, and
//! look at the sphere's centre. Every view frames the whole sphere, so that no collapse can move a point out of a picture.
//!
//! Coordinates are made of 0, 1 and the golden ratio by sums, products and square roots, which IEEE 754 rounds alike everywhere.
//! The solids stand upright: a vertex of the icosahedron lies in a plane of two axes, so symmetric models meet symmetric views.
//!
//! **Departures.** The thesis does not say how its cameras project. Here rays are parallel: every pixel sees an equal area, near
//! parts count no more than far ones, and a face's projection is affine, which makes exact integer rasterisation possible. The thesis
//! exchanges the names of its two solids in section 5.3 (a dodecahedron has 20 vertices, an icosahedron 12).
//!
//! **Sources.** C. González, PhD thesis, Universitat Jaume I 2010, section 5.2.3, step 1; P. Lindstrom, G. Turk, Image-driven
//! simplification, ACM TOG 19(3), 2000, doi:10.1145/353981.353995 (20 views).

use glam::DVec3;
use kiln_asset::Mesh;
use kiln_geom::sample::fibonacci_sphere;
use kiln_geom::sphere::bounding_sphere;

/// Empty border around the framed sphere, as a factor.
const MARGIN: f64 = 1.02;

/// Where views look from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cameras {
    /// The 12 vertices of an icosahedron.
    Icosahedron,
    /// The 20 vertices of a dodecahedron.
    #[default]
    Dodecahedron,
    /// So many places on a Fibonacci lattice.
    Fibonacci(u32),
}

/// A view. A place `p` (object space) falls on pixel coordinates
/// `x = size / 2 + s (p - centre) . right`, `y = size / 2 - s (p - centre) . up`, y down, pixel `(i, j)` covering
/// `[i, i + 1] x [j, j + 1]`; `s = pixels_per_unit` for parallel rays. Nearer is greater `(p - centre) . back`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Unit vector to the right of the picture, object space.
    pub right: DVec3,
    /// Unit vector upwards in the picture, object space.
    pub up: DVec3,
    /// Unit vector from the centre to the eye, object space.
    pub back: DVec3,
    /// The place in the middle of the picture, object space.
    pub centre: DVec3,
    /// Pixels in an object unit, in the plane through the centre.
    pub pixels_per_unit: f64,
    /// Width and height of the picture, pixels.
    pub size: u32,
    /// From the centre to the eye, object units, where rays meet in it; then a place is `distance / (distance - depth)` times as
    /// large. `None`: parallel rays.
    pub distance: Option<f64>,
}

impl Cameras {
    /// Number of views.
    pub fn count(self) -> u32 {
        match self {
            Cameras::Icosahedron => 12,
            Cameras::Dodecahedron => 20,
            Cameras::Fibonacci(count) => count,
        }
    }

    /// `[count]` unit vectors towards the eyes, object space.
    pub fn directions(self) -> Vec<DVec3> {
        let golden = 0.5 * (1.0 + 5f64.sqrt());
        let signs = [-1.0, 1.0];
        let places: Vec<DVec3> = match self {
            Cameras::Icosahedron => rectangles(1.0, golden).collect(),
            Cameras::Dodecahedron => {
                let cube = signs.iter().flat_map(|x| signs.iter().flat_map(move |y| signs.map(|z| (*x, *y, z))));
                cube.map(DVec3::from).chain(rectangles(1.0 / golden, golden)).collect()
            }
            Cameras::Fibonacci(count) => fibonacci_sphere(count as usize).into_iter().map(|d| d.as_dvec3()).collect(),
        };
        places.into_iter().map(DVec3::normalize).collect()
    }
}

/// The corners of three rectangles of half sides `a` and `b`, one across each axis, each turned into the next.
fn rectangles(a: f64, b: f64) -> impl Iterator<Item = DVec3> {
    (0..3).flat_map(move |axis: usize| {
        let corners = [(-a, -b), (-a, b), (a, -b), (a, b)];
        corners.map(move |(a, b)| {
            let mut place = [0.0; 3];
            place[(axis + 1) % 3] = a;
            place[(axis + 2) % 3] = b;
            DVec3::from_array(place)
        })
    })
}

/// The views of `mesh` from `cameras`, each `size` pixels wide and high and just wider than the mesh's bounding sphere. A mesh at
/// one place, or without any, is framed by a sphere of radius 1.
pub fn views(cameras: Cameras, size: u32, mesh: &Mesh) -> Vec<View> {
    let sphere = bounding_sphere(&mesh.positions);
    let radius = if sphere.radius > 0.0 { sphere.radius } else { 1.0 };
    let view = |back: DVec3| {
        let upwards = if back.y.abs() < 0.95 { DVec3::Y } else { DVec3::Z };
        let right = upwards.cross(back).normalize();
        let up = back.cross(right);
        let pixels_per_unit = 0.5 * f64::from(size) / (MARGIN * radius);
        View { right, up, back, centre: sphere.centre, pixels_per_unit, size, distance: None }
    };
    cameras.directions().into_iter().map(view).collect()
}

impl View {
    /// Pixel coordinates (y down) of a place in object space, and how far it is behind the centre, object units.
    pub fn project(&self, place: DVec3) -> [f64; 3] {
        let p = place - self.centre;
        let depth = -p.dot(self.back);
        let scale = self.pixels_per_unit * self.distance.map_or(1.0, |distance| distance / (distance + depth));
        let middle = 0.5 * f64::from(self.size);
        [middle + scale * p.dot(self.right), middle - scale * p.dot(self.up), depth]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn the_solids_are_regular() {
        for (cameras, count, degree, cosine) in
            [(Cameras::Icosahedron, 12, 5, 1.0 / 5f64.sqrt()), (Cameras::Dodecahedron, 20, 3, 5f64.sqrt() / 3.0)]
        {
            let directions = cameras.directions();
            assert_eq!((directions.len(), cameras.count() as usize), (count, count));
            for d in &directions {
                assert!((d.length() - 1.0).abs() < 1e-15);
                let near: Vec<f64> = directions.iter().map(|e| d.dot(*e)).filter(|c| *c < 0.999).collect();
                let next = near.iter().copied().fold(-1.0, f64::max);
                assert!((next - cosine).abs() < 1e-12, "{cameras:?}: {next}");
                assert_eq!(near.iter().filter(|c| **c > next - 1e-9).count(), degree, "edges at a vertex");
                assert!(directions.iter().any(|e| (*d + *e).length() < 1e-12), "each vertex has its opposite");
            }
        }
    }

    #[test]
    fn a_lattice_has_as_many_views_as_asked_and_they_lie_apart() {
        for count in [1, 7, 24, 100] {
            let directions = Cameras::Fibonacci(count).directions();
            assert_eq!(directions.len(), count as usize);
            let mut sum = DVec3::ZERO;
            for (i, d) in directions.iter().enumerate() {
                sum += *d;
                let apart = directions[..i].iter().map(|e| (*d - *e).length()).fold(f64::INFINITY, f64::min);
                assert!(apart > 2.0 / f64::from(count).sqrt(), "{count}: {apart}");
            }
            assert!(count == 1 || sum.length() / f64::from(count) < 0.1, "{sum}");
        }
    }

    #[test]
    fn every_view_frames_the_whole_model_right_side_up() {
        let mesh = fixtures::sphere(24, 12);
        for cameras in [Cameras::Icosahedron, Cameras::Dodecahedron, Cameras::Fibonacci(33)] {
            for view in views(cameras, 200, &mesh) {
                let axes = [view.right, view.up, view.back];
                assert!(axes.iter().all(|a| (a.length() - 1.0).abs() < 1e-12));
                assert!((view.right.cross(view.up) - view.back).length() < 1e-12, "right-handed");
                assert!(view.up.y > 0.0 || view.back.y.abs() >= 0.95, "up is up, but for views from above and below");
                let [x, y, depth] = view.project(view.centre);
                assert_eq!([x, y, depth], [100.0, 100.0, 0.0]);
                let mut widest = 0f64;
                for p in &mesh.positions {
                    let [x, y, depth] = view.project(p.as_dvec3());
                    assert!((0.0..200.0).contains(&x) && (0.0..200.0).contains(&y));
                    assert!(depth.abs() <= 1.0 + 1e-6);
                    widest = widest.max((x - 100.0).hypot(y - 100.0));
                }
                assert!(widest > 96.0, "fills the picture: {widest}");
            }
        }
    }

    #[test]
    fn right_of_the_centre_is_right_and_rays_that_meet_make_near_things_large() {
        let mesh = fixtures::sphere(8, 4);
        let parallel = views(Cameras::Dodecahedron, 64, &mesh)[3];
        let meeting = View { distance: Some(3.0), ..parallel };
        for view in [parallel, meeting] {
            let [x, y, _] = view.project(view.centre + 0.5 * view.right + 0.25 * view.up);
            assert!(x > 32.0 && y < 32.0);
        }
        let width =
            |view: &View, towards: f64| view.project(view.centre + 0.5 * view.right + towards * view.back)[0] - 32.0;
        assert_eq!(width(&parallel, 0.5), width(&parallel, -0.5));
        assert!((width(&meeting, 0.0) - width(&parallel, 0.0)).abs() < 1e-12);
        assert!((width(&meeting, 1.0) / width(&meeting, 0.0) - 1.5).abs() < 1e-12);
    }

    #[test]
    fn a_mesh_without_extent_has_finite_views() {
        for mesh in [Mesh::default(), fixtures::soup(&[[0, 0, 0]])] {
            for view in views(Cameras::Icosahedron, 16, &mesh) {
                assert!(view.pixels_per_unit.is_finite() && view.right.is_finite() && view.centre.is_finite());
            }
        }
    }
}
