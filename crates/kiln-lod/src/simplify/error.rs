//! Measured error: how far a level's surface lies from the source's, by sample points on both.

use glam::Vec3;
use kiln_asset::Mesh;
use kiln_geom::Bvh;
use kiln_geom::sample::SurfaceSamples;
use rayon::prelude::*;

/// The source, ready to be measured against.
pub(crate) struct Surface<'a> {
    mesh: &'a Mesh,
    bvh: Bvh,
    samples: Vec<Vec3>,
    limit: u32,
}

impl<'a> Surface<'a> {
    /// `limit`: most sample points a side.
    pub(crate) fn new(mesh: &'a Mesh, limit: u32) -> Surface<'a> {
        Surface { mesh, bvh: Bvh::new(&mesh.positions, &mesh.triangles), samples: sample_points(mesh, limit), limit }
    }

    /// The larger of the two one-sided greatest distances, object units.
    pub(crate) fn distance(&self, level: &Mesh) -> f32 {
        if level.triangles == self.mesh.triangles && level.positions == self.mesh.positions {
            return 0.0;
        }
        if level.face_count() == 0 || self.samples.is_empty() {
            return if level.face_count() == 0 && self.samples.is_empty() { 0.0 } else { f32::INFINITY };
        }
        let other = Bvh::new(&level.positions, &level.triangles);
        farthest(&self.samples, &other).max(farthest(&sample_points(level, self.limit), &self.bvh))
    }
}

/// The larger of the two one-sided greatest distances between two surfaces by at most `limit` sample points a side.
pub fn surface_error(source: &Mesh, level: &Mesh, limit: u32) -> f32 {
    Surface::new(source, limit).distance(level)
}

/// The mesh's used vertices (every n-th, if they are too many for half the limit) and as many points by area as the limit leaves,
/// but no more than four a face.
fn sample_points(mesh: &Mesh, limit: u32) -> Vec<Vec3> {
    let limit = limit.max(2) as usize;
    let mut used = vec![false; mesh.vertex_count()];
    for v in mesh.triangles.iter().flatten() {
        used[*v as usize] = true;
    }
    let corners: Vec<Vec3> = mesh.positions.iter().zip(&used).filter(|(_, used)| **used).map(|(p, _)| *p).collect();
    let step = corners.len().div_ceil(limit / 2).max(1);
    let mut points: Vec<Vec3> = corners.iter().step_by(step).copied().collect();
    let spread = (limit - points.len().min(limit)).min(4 * mesh.face_count());
    let samples = SurfaceSamples::new(&mesh.positions, &mesh.triangles, spread, 1);
    points.extend(samples.samples.iter().map(|s| s.position));
    points
}

/// The greatest distance of a point to the surface.
fn farthest(points: &[Vec3], surface: &Bvh) -> f32 {
    // A maximum is the same in any order.
    points.par_iter().map(|p| surface.nearest_point(*p).map_or(0.0, |near| near.distance)).reduce(|| 0.0, f32::max)
}
