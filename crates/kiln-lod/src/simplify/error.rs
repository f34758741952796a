//! Measured error: how far a level's surface lies from the source's, by sample points on both.
//!
//! The error is the greatest distance of a sample to the other surface. Nearly all samples lie much closer than that, so they
//! need no nearest point, only the proof that something is near enough:
//! ```text
//! sort the samples of each side by that side's tree: neighbours in the row are neighbours in space
//! most <- 0
//! every 61st sample, then all of them, in chunks on all threads:
//!     the chunk's box is small beside `most`, and a triangle lies within `most` less its radius of its centre: done with it
//!     the chunk is larger than 16: its two halves
//!     nearby <- the subtrees of the other side that hold all within `most` of the chunk's box
//!     for each sample: if the last answer or a triangle of `nearby` is at most `most` away: done with it
//!                      else: most <- the sample's distance, by the whole tree, if it is greater
//! ```
//! A sample is dropped only below a distance that another sample has, so the maximum is that of all distances, the same bits
//! in any order and on any thread count.

use std::sync::atomic::{AtomicU32, Ordering};

use glam::Vec3;
use kiln_asset::Mesh;
use kiln_geom::sample::SurfaceSamples;
use kiln_geom::{Bvh, Hint, Nearby};
use rayon::prelude::*;

/// The first round's step: enough samples to find a bound that few others exceed.
const STEP: usize = 61;
/// Samples that one triangle may prove near enough at once.
const CHUNK: usize = 64;
/// Samples that share a list of subtrees.
const FEW: usize = 32;

/// The source, ready to be measured against.
pub struct Surface<'a> {
    mesh: &'a Mesh,
    bvh: Bvh,
    samples: Vec<Vec3>,
    limit: u32,
}

impl<'a> Surface<'a> {
    /// `limit`: most sample points a side.
    pub fn new(mesh: &'a Mesh, limit: u32) -> Surface<'a> {
        let bvh = Bvh::new(&mesh.positions, &mesh.triangles);
        Surface { mesh, samples: sorted(mesh, &bvh, limit), bvh, limit }
    }

    /// The larger of the two one-sided greatest distances, object units.
    pub fn distance(&self, level: &Mesh) -> f32 {
        if level.triangles == self.mesh.triangles && level.positions == self.mesh.positions {
            return 0.0;
        }
        if level.face_count() == 0 || self.samples.is_empty() {
            return if level.face_count() == 0 && self.samples.is_empty() { 0.0 } else { f32::INFINITY };
        }
        let other = Bvh::new(&level.positions, &level.triangles);
        let samples = sorted(level, &other, self.limit);
        // What one side has reached, the other need not look into.
        let most = AtomicU32::new(0);
        raise(&most, &samples, &self.bvh);
        raise(&most, &self.samples, &other);
        f32::from_bits(most.into_inner())
    }
}

/// The larger of the two one-sided greatest distances between two surfaces by at most `limit` sample points a side.
pub fn surface_error(source: &Mesh, level: &Mesh, limit: u32) -> f32 {
    Surface::new(source, limit).distance(level)
}

/// The mesh's used vertices (every n-th, if they are too many for half the limit) and as many points by area as the limit leaves,
/// but no more than four a face.
pub fn sample_points(mesh: &Mesh, limit: u32) -> Vec<Vec3> {
    samples(mesh, limit).into_iter().map(|(_, point)| point).collect()
}

/// [`sample_points`], each with a face that it lies on.
fn samples(mesh: &Mesh, limit: u32) -> Vec<(u32, Vec3)> {
    let limit = limit.max(2) as usize;
    let mut face_of = vec![u32::MAX; mesh.vertex_count()];
    for (f, triangle) in mesh.triangles.iter().enumerate() {
        triangle.iter().for_each(|v| face_of[*v as usize] = f as u32);
    }
    let used = face_of.iter().filter(|f| **f != u32::MAX).count();
    let step = used.div_ceil(limit / 2).max(1);
    let corners = face_of.iter().zip(&mesh.positions).filter(|(f, _)| **f != u32::MAX).step_by(step);
    let mut points: Vec<(u32, Vec3)> = corners.map(|(f, p)| (*f, *p)).collect();
    let spread = (limit - points.len().min(limit)).min(4 * mesh.face_count());
    let spread = SurfaceSamples::new(&mesh.positions, &mesh.triangles, spread, 1);
    points.extend(spread.samples.iter().map(|s| (s.face, s.position)));
    points
}

/// [`sample_points`] in the order of the mesh's own tree.
fn sorted(mesh: &Mesh, own: &Bvh, limit: u32) -> Vec<Vec3> {
    // By counting: where each face's samples start.
    let mut rank = vec![0; mesh.face_count()];
    own.order().iter().enumerate().for_each(|(i, f)| rank[*f as usize] = i);
    let samples = samples(mesh, limit);
    let mut start = vec![0u32; mesh.face_count() + 1];
    samples.iter().for_each(|(f, _)| start[rank[*f as usize] + 1] += 1);
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    let mut points = vec![Vec3::ZERO; samples.len()];
    for (f, point) in samples {
        let slot = &mut start[rank[f as usize]];
        points[*slot as usize] = point;
        *slot += 1;
    }
    points
}

/// Raises `most` (the bits of a distance, object units) to the greatest distance of a point to the surface, if that is greater.
fn raise(most: &AtomicU32, points: &[Vec3], surface: &Bvh) {
    let thinned: Vec<Vec3> = points.iter().step_by(STEP).copied().collect();
    for round in [&thinned[..], points] {
        round.par_chunks(16 * CHUNK).for_each(|chunks| {
            let mut search = Search { most, surface, hint: Hint::default(), nearby: Nearby::default() };
            chunks.chunks(CHUNK).for_each(|chunk| search.settle(chunk));
        });
    }
}

/// One thread's part of [`raise`].
struct Search<'a> {
    most: &'a AtomicU32,
    surface: &'a Bvh,
    hint: Hint,
    nearby: Nearby,
}

impl Search<'_> {
    fn settle(&mut self, points: &[Vec3]) {
        let most = f32::from_bits(self.most.load(Ordering::Relaxed));
        let [first, rest @ ..] = points else { return };
        let (lo, hi) = rest.iter().fold((*first, *first), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let centre = 0.5 * (lo + hi);
        // From the centre as it was rounded to the box's farthest corner; a millionth more for the roundings to come.
        let radius = (1.0 + 1e-6) * (hi - centre).max(centre - lo).length();
        if 2.0 * radius <= most && self.surface.is_within(centre, most - radius, &mut self.hint) {
            return;
        }
        if points.len() > FEW {
            let (front, back) = points.split_at(points.len() / 2);
            self.settle(front);
            self.settle(back);
            return;
        }
        self.surface.gather(lo, hi, most, &mut self.nearby);
        points.iter().for_each(|point| self.measure(*point));
    }

    fn measure(&mut self, point: Vec3) {
        let most = f32::from_bits(self.most.load(Ordering::Relaxed));
        if let Some(distance) = self.surface.distance_beyond(point, most, &mut self.nearby, &mut self.hint) {
            // Bits of positive floats order as the floats do.
            self.most.fetch_max(distance.to_bits(), Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_asset::{RawMesh, SubmeshId};
    use proptest::prelude::*;

    /// As the page's first sentence says it.
    fn plain(source: &Mesh, level: &Mesh, limit: u32) -> f32 {
        let one_way = |from: &Mesh, to: &Mesh| {
            let bvh = Bvh::new(&to.positions, &to.triangles);
            let distances =
                sample_points(from, limit).into_iter().map(|p| bvh.nearest_point(p).map_or(0.0, |n| n.distance));
            distances.fold(0.0, f32::max)
        };
        one_way(source, level).max(one_way(level, source))
    }

    fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
        let face_submesh = vec![SubmeshId(0); triangles.len()];
        let raw =
            RawMesh { positions, triangles, face_submesh, submeshes: vec![Default::default()], ..Default::default() };
        Mesh::new(raw).expect("valid")
    }

    fn soup() -> impl Strategy<Value = Mesh> {
        let place = prop_oneof![
            (-2i32..3, -2i32..3, -2i32..3).prop_map(|(x, y, z)| Vec3::new(x as f32, y as f32, z as f32)),
            (-2.0f32..2.0, -2.0f32..2.0, -2.0f32..2.0).prop_map(|(x, y, z)| Vec3::new(x, y, z)),
        ];
        (1usize..20).prop_flat_map(move |count| {
            let index = 0..count as u32;
            let face = [index.clone(), index.clone(), index];
            (prop::collection::vec(place.clone(), count), prop::collection::vec(face, 1..30))
                .prop_map(|(positions, triangles)| mesh(positions, triangles))
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn the_greatest_distance_is_that_of_all_samples(a in soup(), b in soup(), limit in 2u32..2000) {
            if a.positions != b.positions || a.triangles != b.triangles {
                prop_assert_eq!(surface_error(&a, &b, limit), plain(&a, &b, limit));
            }
        }
    }

    /// A bumpy sheet of `2 n^2` faces.
    fn sheet(n: u32, bump: f32) -> Mesh {
        let at = |i: u32, j: u32| {
            let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
            Vec3::new(x, y, bump * kiln_geom::math::sin(9.0 * x) * kiln_geom::math::cos(7.0 * y))
        };
        let positions = (0..=n).flat_map(|j| (0..=n).map(move |i| at(i, j))).collect();
        let corner = |i: u32, j: u32| j * (n + 1) + i;
        let quads = (0..n).flat_map(|j| (0..n).map(move |i| (i, j)));
        let triangles = quads
            .flat_map(|(i, j)| {
                let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        mesh(positions, triangles)
    }

    #[test]
    fn the_error_is_the_same_on_any_thread_count_and_that_of_the_plain_maximum() {
        let (fine, coarse) = (sheet(60, 0.1), sheet(9, 0.1));
        let expected = plain(&fine, &coarse, 20_000);
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            assert_eq!(pool.install(|| surface_error(&fine, &coarse, 20_000)), expected);
        }
        assert!(expected > 1e-3 && expected < 0.1, "{expected}");
    }

    #[test]
    fn a_bump_between_the_samples_of_the_first_round_is_found() {
        let flat = sheet(40, 0.0);
        let mut raw = flat.clone().into_raw();
        raw.positions[777].z = 0.25;
        let bumped = Mesh::new(raw).expect("valid");
        assert_eq!(surface_error(&flat, &bumped, 10_000), 0.25);
        assert_eq!(surface_error(&bumped, &flat, 10_000), 0.25);
    }

    #[test]
    fn an_empty_level_is_infinitely_far_and_the_same_mesh_is_nowhere_away() {
        let (some, none) = (sheet(3, 0.1), mesh(Vec::new(), Vec::new()));
        assert_eq!(surface_error(&some, &some, 100), 0.0);
        assert_eq!(surface_error(&some, &none, 100), f32::INFINITY);
        assert_eq!(surface_error(&none, &some, 100), f32::INFINITY);
        assert_eq!(surface_error(&none, &none, 100), 0.0);
    }
}
