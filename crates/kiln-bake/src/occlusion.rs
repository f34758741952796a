//! Ambient occlusion and bent normals of points on a surface, by rays.
//!
//! Comes in: a mesh with its tree, and points on it with normals. Goes out, for each point: how much of the hemisphere above it
//! is open, weighted by the cosine, and the mean direction of what is open.
//!
//! ```text
//! once:   a disc of `rays` points on a Vogel spiral, lifted to the hemisphere: directions of density cos / pi
//! a point: turn the spiral by an angle hashed from the point's seed; frame around the normal
//!     origin = point, lifted off its face
//!     each direction above the face's plane: open unless anything is met within `reach`, from either side
//! openness = open / asked; bent = sum of the open directions, at unit length
//! ```
//!
//! **Off its own surface.** The origin is lifted along the face's normal by 2^-18 (3.8 millionths) of the largest coordinate of
//! the face's corners: 32 roundings of an interpolated point in `f32`, so a point meets neither its own face nor one that goes
//! on in its plane, and what is smaller than that casts no shade. A face too thin to have a normal is lifted along the point's.
//!
//! **Smooth normals.** Where a normal is bent away from its face, part of its hemisphere lies below the face. Rays there would
//! meet the mesh's own facets, so they are not asked, and count for neither side: a sphere of few facets is open everywhere.
//! A normal on the back of its face lifts to the back.
//!
//! Departures: Landis takes uniform rays and no reach; the cosine is what light on a matt surface has, and saves weights.
//!
//! Limits: what lies further than `reach` is open sky. With `n` rays openness has steps of `1 / n`, and an error of a few of
//! them at edges of shade (measured in the tests). Transparency is not looked at.
//!
//! Sources: H. Landis, Production-Ready Global Illumination, SIGGRAPH 2002 course 16 (occlusion and bent normal by rays);
//! M. Pharr, W. Jakob, G. Humphreys, Physically Based Rendering, 3rd edition, section 13.6.3 (Malley's method: a disc lifted to
//! a cosine-weighted hemisphere); H. Vogel, A better way to construct the sunflower head, Mathematical Biosciences 44, 1979,
//! doi:10.1016/0025-5564(79)90080-4 (the spiral).

use glam::{Vec2, Vec3};
use kiln_geom::bvh::Bvh;
use kiln_geom::math;
use kiln_geom::sample::{hash, unit};

/// How far origins are lifted, in units of the largest coordinate of their face: 2^-18.
const LIFT: f32 = 1.0 / (1 << 18) as f32;

/// Least height of a face whose normal is more than rounding, in units of its longest edge.
const THIN: f64 = 1e-4;

/// A surface that shades itself.
#[derive(Clone, Debug)]
pub struct Occluder<'a> {
    bvh: &'a Bvh,
    positions: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    /// `[rays]`, a disc of radius 1.
    disc: Vec<Vec2>,
    reach: f32,
}

/// What a point sees of the sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Openness {
    /// Share of the hemisphere that is open, weighted by the cosine, `[0, 1]`.
    pub share: f32,
    /// Mean direction of the open share, object space, unit length; the normal where nothing is open.
    pub bent: Vec3,
}

impl<'a> Occluder<'a> {
    /// The mesh of `triangles` (`[face_count] x 3`) over `positions` (object space) with its own tree, asked with `rays` rays a
    /// point (at least 1) that end after `reach` object units (infinity: never).
    pub fn new(bvh: &'a Bvh, positions: &'a [Vec3], triangles: &'a [[u32; 3]], rays: u32, reach: f32) -> Occluder<'a> {
        let rays = rays.max(1);
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let disc = (0..rays)
            .map(|k| {
                let (radius, angle) = (((k as f64 + 0.5) / rays as f64).sqrt(), golden * k as f64);
                Vec2::new((radius * math::cos64(angle)) as f32, (radius * math::sin64(angle)) as f32)
            })
            .collect();
        Occluder { bvh, positions, triangles, disc, reach }
    }

    /// What `point` on `face` sees over the hemisphere around `normal` (object space, unit length). `seed` turns the rays: the
    /// texel's number, so that neighbours err differently and a bake gives the same bytes again.
    ///
    /// A face or point that is none (no such number, not finite) is open, with its normal.
    pub fn at(&self, point: Vec3, normal: Vec3, face: u32, seed: u32) -> Openness {
        self.part_at(point, normal, face, seed, [0, 1])
    }

    /// As [`Occluder::at`], with the rays `first`, `first + step`, ... only: points that are averaged, and together take all rays of one
    /// seed, look everywhere once. Where none of them lies above the face, one is mirrored.
    pub fn part_at(&self, point: Vec3, normal: Vec3, face: u32, seed: u32, [first, step]: [u32; 2]) -> Openness {
        let nothing = Openness { share: 1.0, bent: normal };
        let Some(triangle) = self.triangles.get(face as usize) else { return nothing };
        let corners = triangle.map(|v| self.positions[v as usize]);
        let up = face_normal(corners).map_or(normal, |up| if up.dot(normal) < 0.0 { -up } else { up });
        let largest = corners.iter().fold(point.abs(), |most, corner| most.max(corner.abs())).max_element();
        let origin = point + LIFT * largest * up;

        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let turn = std::f64::consts::TAU * unit(hash(seed as u64));
        let (sin, cos) = (math::sin64(turn) as f32, math::cos64(turn) as f32);
        let (across, along) = (cos * tangent + sin * bitangent, cos * bitangent - sin * tangent);
        let (mut asked, mut open, mut sum) = (0u32, 0u32, Vec3::ZERO);
        let mut ask = |direction: Vec3| {
            asked += 1;
            if !self.bvh.occluded(origin, direction, 0.0, self.reach) {
                open += 1;
                sum += direction;
            }
        };
        let rays = self.disc.iter().skip(first as usize).step_by(step.max(1) as usize);
        let direction =
            |Vec2 { x, y }: &Vec2| *x * across + *y * along + (1.0 - x * x - y * y).max(0.0).sqrt() * normal;
        let mut below = None;
        for direction in rays.map(direction) {
            if direction.dot(up) > 0.0 {
                below = Some(None);
                ask(direction);
            } else {
                below = below.or(Some(Some(direction)));
            }
        }
        if let Some(Some(direction)) = below {
            ask(direction - 2.0 * direction.dot(up) * up);
        }
        if asked == 0 {
            return nothing;
        }
        Openness { share: open as f32 / asked as f32, bent: sum.try_normalize().unwrap_or(normal) }
    }
}

/// `None` for a face that is too thin, or none.
fn face_normal(corners: [Vec3; 3]) -> Option<Vec3> {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let cross = (b - a).cross(c - a);
    let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    (cross.length() > THIN * longest).then(|| cross.normalize().as_vec3())
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;

    /// Planted: one or more rectangles, each of two triangles; `corner`, and two sides.
    fn sheets(rectangles: &[[Vec3; 3]]) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for [corner, u, v] in rectangles {
            let first = positions.len() as u32;
            positions.extend([*corner, *corner + *u, *corner + *u + *v, *corner + *v]);
            triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        (positions, triangles)
    }

    fn mean(positions: &[Vec3], triangles: &[[u32; 3]], rays: u32, reach: f32, at: (Vec3, Vec3, u32)) -> Openness {
        let bvh = Bvh::new(positions, triangles);
        let occluder = Occluder::new(&bvh, positions, triangles, rays, reach);
        let each = |seed| occluder.at(at.0, at.1, at.2, seed);
        let all: Vec<Openness> = (0..16).map(each).collect();
        let share = all.iter().map(|o| o.share).sum::<f32>() / 16.0;
        for one in &all {
            assert!((one.share - share).abs() < 3.0 / (rays as f32).sqrt(), "{one:?} of {share}");
        }
        Openness { share, bent: all.iter().map(|o| o.bent).sum::<Vec3>().normalize() }
    }

    /// The floor from -50 to 50, seen from above.
    const FLOOR: [Vec3; 3] = [Vec3::new(-50.0, 0.0, 50.0), Vec3::new(100.0, 0.0, 0.0), Vec3::new(0.0, 0.0, -100.0)];

    #[test]
    fn a_plane_is_open_wherever_it_lies() {
        for offset in [Vec3::ZERO, Vec3::new(1e4, -3e3, 77.7), Vec3::splat(1e-4)] {
            for turn in [0.0f32, 0.3, 1.1] {
                let lean = |p: Vec3| glam::Quat::from_axis_angle(Vec3::new(1.0, 2.0, 3.0).normalize(), turn) * p;
                let (mut positions, triangles) = sheets(&[FLOOR]);
                positions.iter_mut().for_each(|p| *p = lean(*p) + offset);
                let bvh = Bvh::new(&positions, &triangles);
                let occluder = Occluder::new(&bvh, &positions, &triangles, 64, f32::INFINITY);
                for k in 0..200u32 {
                    let (u, v) = (unit(hash(k as u64)) as f32, unit(hash(1000 + k as u64)) as f32);
                    let [a, b, c] = triangles[0].map(|v| positions[v as usize]);
                    let point = a + u.min(v) * (c - b) + u.max(v) * (b - a);
                    let got = occluder.at(point, lean(Vec3::Y), 0, k);
                    assert_eq!(got.share, 1.0, "point {k} at {offset}");
                    assert!(got.bent.dot(lean(Vec3::Y)) > 0.99, "{got:?}");
                }
            }
        }
    }

    #[test]
    fn a_wall_hides_what_its_height_says_and_bends_away_from_it() {
        // Half the sky for a wall without end; a wall of height h at distance d: (1 - cos(atan(h / d))) / 2.
        for height in [0.5f32, 1.0, 3.0, 1e4] {
            let wall = [Vec3::new(-1.0, 0.0, -1e4), Vec3::new(0.0, 0.0, 2e4), Vec3::new(0.0, height, 0.0)];
            let (positions, triangles) = sheets(&[FLOOR, wall]);
            let hidden = 0.5 * (1.0 - 1.0 / (1.0 + height * height).sqrt());
            let got = mean(&positions, &triangles, 512, f32::INFINITY, (Vec3::ZERO, Vec3::Y, 0));
            assert!((got.share - (1.0 - hidden)).abs() < 2e-3, "{got:?} for {hidden} hidden");
            if height > 1e3 {
                // Half the hemisphere, weighted by the cosine: (2/3, pi/3) away from the wall and up.
                let expected = Vec3::new(2.0 / 3.0, PI / 3.0, 0.0).normalize();
                assert!(math::acos(got.bent.dot(expected)).to_degrees() < 0.5, "{got:?} for {expected}");
                // A single texel of few rays is near, too.
                let bvh = Bvh::new(&positions, &triangles);
                let few = Occluder::new(&bvh, &positions, &triangles, 64, f32::INFINITY);
                for seed in 0..100 {
                    let one = few.at(Vec3::ZERO, Vec3::Y, 0, seed);
                    assert!((one.share - 0.5).abs() < 0.05 && one.bent.dot(expected) > 0.99, "{one:?}");
                }
            }
        }
    }

    #[test]
    fn a_corner_of_three_planes_bends_along_its_diagonal() {
        let x = [Vec3::new(0.0, 0.0, 0.0), Vec3::new(0.0, 1e4, 0.0), Vec3::new(0.0, 0.0, 1e4)];
        let z = [Vec3::new(0.0, 0.0, 0.0), Vec3::new(1e4, 0.0, 0.0), Vec3::new(0.0, 1e4, 0.0)];
        let (positions, triangles) = sheets(&[FLOOR, x, z]);
        // On the floor near the corner a quarter of the sky is left, its mean at (2/3 sin 45, ...) = (1/3, pi/6, 1/3).
        let got = mean(&positions, &triangles, 1024, f32::INFINITY, (Vec3::new(0.01, 0.0, 0.01), Vec3::Y, 1));
        assert!((got.share - 0.25).abs() < 3e-3, "{got:?}");
        let expected = Vec3::new(1.0 / 3.0, PI / 6.0, 1.0 / 3.0).normalize();
        assert!(math::acos(got.bent.dot(expected)).to_degrees() < 0.5, "{got:?} for {expected}");
    }

    #[test]
    fn the_floor_of_a_closed_box_sees_nothing_and_what_is_out_of_reach_is_sky() {
        let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        let (u, v, w) = (at(2.0, 0.0, 0.0), at(0.0, 2.0, 0.0), at(0.0, 0.0, 2.0));
        let corner = at(-1.0, 0.0, -1.0);
        let (positions, triangles) = sheets(&[
            [corner, w, u],
            [corner + v, u, w],
            [corner, u, v],
            [corner + w, v, u],
            [corner, v, w],
            [corner + u, w, v],
        ]);
        let bvh = Bvh::new(&positions, &triangles);
        for (k, point) in
            [at(0.0, 0.0, 0.0), at(0.9, 0.0, -0.9), at(-0.999, 0.0, 0.3), at(0.3, 0.0, 0.3)].iter().enumerate()
        {
            let face = u32::from(point.x < point.z);
            let got =
                Occluder::new(&bvh, &positions, &triangles, 256, f32::INFINITY).at(*point, Vec3::Y, face, k as u32);
            assert_eq!((got.share, got.bent), (0.0, Vec3::Y), "{point}");
        }
        // Nothing lies within 0.9 of the floor's middle, and outside everything is open.
        let short = Occluder::new(&bvh, &positions, &triangles, 256, 0.9);
        assert_eq!(short.at(Vec3::ZERO, Vec3::Y, 0, 5).share, 1.0);
        let outside = Occluder::new(&bvh, &positions, &triangles, 256, f32::INFINITY);
        assert_eq!(outside.at(at(0.2, 0.0, 0.1), -Vec3::Y, 0, 5).share, 1.0);
    }

    #[test]
    fn a_dome_with_a_hole_lets_in_the_square_of_its_sine() {
        for (degrees, expected) in [(30.0f64, 0.25f32), (60.0, 0.75)] {
            let (rings, segments) = (40, 80);
            let (mut positions, mut triangles) = sheets(&[FLOOR]);
            let first = positions.len() as u32;
            for ring in 0..=rings {
                let polar = (degrees + (90.0 - degrees) * ring as f64 / rings as f64).to_radians();
                for segment in 0..segments {
                    let around = std::f64::consts::TAU * segment as f64 / segments as f64;
                    let (s, c) = (math::sin64(polar), math::cos64(polar));
                    let at = [s * math::cos64(around), c, s * math::sin64(around)];
                    positions.push(Vec3::from(at.map(|c| c as f32)));
                }
            }
            let at = |r: u32, s: u32| first + r * segments + s % segments;
            for r in 0..rings {
                for s in 0..segments {
                    triangles.extend([
                        [at(r, s), at(r, s + 1), at(r + 1, s)],
                        [at(r, s + 1), at(r + 1, s + 1), at(r + 1, s)],
                    ]);
                }
            }
            let got = mean(&positions, &triangles, 1024, f32::INFINITY, (Vec3::ZERO, Vec3::Y, 0));
            assert!((got.share - expected).abs() < 3e-3, "{got:?} for {expected}");
            assert!(got.bent.dot(Vec3::Y) > 0.9999, "{got:?}");
        }
    }

    #[test]
    fn a_coarse_sphere_with_smooth_normals_is_open() {
        let (rings, segments) = (6u32, 8u32);
        let mut positions = Vec::new();
        for r in 0..=rings {
            for s in 0..segments {
                let (polar, around) = (PI * r as f32 / rings as f32, 2.0 * PI * s as f32 / segments as f32);
                positions.push(Vec3::new(
                    math::sin(polar) * math::cos(around),
                    math::cos(polar),
                    math::sin(polar) * math::sin(around),
                ));
            }
        }
        let at = |r: u32, s: u32| r * segments + s % segments;
        let triangles: Vec<[u32; 3]> = (0..rings)
            .flat_map(|r| {
                (0..segments).flat_map(move |s| {
                    [[at(r, s), at(r, s + 1), at(r + 1, s)], [at(r, s + 1), at(r + 1, s + 1), at(r + 1, s)]]
                })
            })
            .collect();
        let bvh = Bvh::new(&positions, &triangles);
        let occluder = Occluder::new(&bvh, &positions, &triangles, 128, f32::INFINITY);
        let has_area = |t: &[u32; 3]| face_normal(t.map(|v| positions[v as usize])).is_some();
        assert_eq!(triangles.iter().filter(|t| has_area(t)).count(), 80);
        for (face, triangle) in triangles.iter().enumerate().filter(|(_, t)| has_area(t)) {
            for (k, bary) in [[0.9f32, 0.05, 0.05], [0.05, 0.9, 0.05], [0.3, 0.3, 0.4]].iter().enumerate() {
                let corners = triangle.map(|v| positions[v as usize]);
                let point: Vec3 = corners.iter().zip(bary).map(|(c, w)| *c * *w).sum();
                assert_eq!(occluder.at(point, point.normalize(), face as u32, k as u32).share, 1.0, "face {face}, {k}");
            }
        }
    }

    #[test]
    fn what_is_no_face_is_open() {
        let (positions, mut triangles) = sheets(&[FLOOR]);
        triangles.push([0, 0, 1]);
        let bvh = Bvh::new(&positions, &triangles);
        let occluder = Occluder::new(&bvh, &positions, &triangles, 0, 1.0);
        for face in [3, u32::MAX] {
            assert_eq!(occluder.at(Vec3::ZERO, Vec3::X, face, 0), Openness { share: 1.0, bent: Vec3::X });
        }
        assert_eq!(occluder.at(Vec3::NAN, Vec3::Y, 0, 0).share, 1.0);
        // A face without area lends its point's normal.
        assert_eq!(occluder.at(positions[0], Vec3::Y, 2, 0).share, 1.0);
    }
}
