//! Surfaces against surfaces: how far the points of each lie from the other.
//!
//! ```text
//! spread n points over each surface, by area (kiln-geom's SurfaceSamples)
//! for each, the nearest point of the other surface and the angle between the two true normals
//! mean = mean of both means; rms = root of the mean of both mean squares; p99, hausdorff = the larger of both
//! ```
//! The Hausdorff distance is over samples: a lower bound of the true one, approached as the density grows.
//!
//! Source: P. Cignoni, C. Rocchini, R. Scopigno, Metro: Measuring Error on Simplified Surfaces, CGF 17(2), 1998,
//! doi:10.1111/1467-8659.00236.

use glam::{DVec3, Vec3};
use kiln_asset::Mesh;
use kiln_geom::Bvh;
use kiln_geom::sample::{SurfaceSample, SurfaceSamples};
use rayon::prelude::*;
use serde::Serialize;

/// How far two surfaces are apart, both ways.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distances {
    /// Mean distance, object units.
    pub mean: f64,
    /// Root of the mean square distance, object units.
    pub rms: f64,
    /// 99th percentile, the larger of both ways, object units.
    pub p99: f64,
    /// Greatest distance of a sample, object units.
    pub hausdorff: f64,
    /// Mean angle between the true normals at nearest points, degrees.
    pub normal_degrees: f64,
    /// Diagonal of the reference's bounding box, object units.
    pub diagonal: f64,
    /// Points spread over each surface.
    pub samples: usize,
}

impl Distances {
    /// The same with lengths in diagonals of the reference, `diagonal` 1.
    pub fn in_diagonals(&self) -> Distances {
        let unit = if self.diagonal > 0.0 { self.diagonal } else { 1.0 };
        Distances {
            mean: self.mean / unit,
            rms: self.rms / unit,
            p99: self.p99 / unit,
            hausdorff: self.hausdorff / unit,
            diagonal: self.diagonal / unit,
            ..*self
        }
    }
}

/// A surface to compare others with: its tree and its samples are made once.
pub struct SurfaceReference<'a> {
    surface: Surface<'a>,
    diagonal: f64,
    count: usize,
}

struct Surface<'a> {
    positions: &'a [Vec3],
    /// Those with area: the others add no surface, and their normal is noise.
    triangles: Vec<[u32; 3]>,
    bvh: Bvh,
    samples: Vec<SurfaceSample>,
}

impl<'a> Surface<'a> {
    /// `None`: no area.
    fn new(mesh: &'a Mesh, count: usize, seed: u64) -> Option<Surface<'a>> {
        let solid = |t: &&[u32; 3]| kiln_geom::triangle::area(t.map(|v| mesh.positions[v as usize])) > 0.0;
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().filter(solid).copied().collect();
        let samples = SurfaceSamples::new(&mesh.positions, &triangles, count, seed).samples;
        if samples.is_empty() {
            return None;
        }
        let bvh = Bvh::new(&mesh.positions, &triangles);
        Some(Surface { positions: &mesh.positions, triangles, bvh, samples })
    }

    /// Unit normal of a face.
    fn normal(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.triangles[face as usize].map(|v| self.positions[v as usize].as_dvec3());
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// For each of its samples the distance to `other`, object units, and the angle between the normals, degrees.
    fn measure(&self, other: &Surface<'_>) -> OneWay {
        let found: Vec<(f64, f64)> = self
            .samples
            .par_iter()
            .filter_map(|sample| {
                let nearest = other.bvh.nearest_point(sample.position)?;
                let cosine = self.normal(sample.face).dot(other.normal(nearest.face));
                Some((nearest.distance as f64, kiln_geom::math::acos64(cosine).to_degrees()))
            })
            .collect();
        let count = found.len().max(1) as f64;
        let mut distances: Vec<f64> = found.iter().map(|(d, _)| *d).collect();
        // Summed in the samples' order, then sorted for the percentile.
        let (sum, squares) = distances.iter().fold((0.0, 0.0), |(s, q), d| (s + d, q + d * d));
        let angles: f64 = found.iter().map(|(_, angle)| *angle).sum();
        distances.sort_unstable_by(f64::total_cmp);
        OneWay {
            mean: sum / count,
            mean_square: squares / count,
            p99: percentile(&distances, 0.99),
            max: distances.last().copied().unwrap_or(0.0),
            angle: angles / count,
        }
    }
}

struct OneWay {
    mean: f64,
    mean_square: f64,
    p99: f64,
    max: f64,
    angle: f64,
}

/// Of sorted values, linear between neighbours.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let at = share * sorted.len().saturating_sub(1) as f64;
    let (low, part) = (at as usize, at.fract());
    match (sorted.get(low), sorted.get(low + 1)) {
        (Some(a), Some(b)) => a + part * (b - a),
        (Some(a), None) => *a,
        (None, _) => 0.0,
    }
}

impl<'a> SurfaceReference<'a> {
    /// A reference with `samples` points on it; `None` if its surface has no area.
    pub fn new(mesh: &'a Mesh, samples: usize) -> Option<SurfaceReference<'a>> {
        let surface = Surface::new(mesh, samples, 1)?;
        Some(SurfaceReference { surface, diagonal: mesh.diagonal() as f64, count: samples })
    }

    /// How far `mesh`, with as many points on it, is from the reference; `None` if its surface has no area.
    pub fn compare(&self, mesh: &Mesh) -> Option<Distances> {
        let other = Surface::new(mesh, self.count, 2)?;
        let (there, back) = (self.surface.measure(&other), other.measure(&self.surface));
        Some(Distances {
            mean: 0.5 * (there.mean + back.mean),
            rms: (0.5 * (there.mean_square + back.mean_square)).sqrt(),
            p99: there.p99.max(back.p99),
            hausdorff: there.max.max(back.max),
            normal_degrees: 0.5 * (there.angle + back.angle),
            diagonal: self.diagonal,
            samples: self.count,
        })
    }
}

/// How far `other` is from `reference`, with `samples` points on each; `None` if either surface has no area.
pub fn surface_distance(reference: &Mesh, other: &Mesh, samples: usize) -> Option<Distances> {
    SurfaceReference::new(reference, samples)?.compare(other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_asset::{RawMesh, SubmeshId};
    use proptest::prelude::*;

    /// An `n` by `n` grid of quads over the unit square at height `z(x, y)`.
    fn sheet(n: u32, z: impl Fn(f32, f32) -> f32) -> Mesh {
        let at = |i: u32, j: u32| {
            let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
            Vec3::new(x, y, z(x, y))
        };
        let mut raw = RawMesh { submeshes: vec![Default::default()], ..Default::default() };
        for j in 0..n {
            for i in 0..n {
                let v = raw.positions.len() as u32;
                raw.positions.extend([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                raw.triangles.extend([[v, v + 1, v + 2], [v, v + 2, v + 3]]);
                raw.face_submesh.extend([SubmeshId(0); 2]);
            }
        }
        Mesh::new(raw).expect("valid")
    }

    #[test]
    fn parallel_planes_are_their_offset_apart() {
        let (a, b) = (sheet(3, |_, _| 0.0), sheet(7, |_, _| 0.25));
        let d = surface_distance(&a, &b, 5000).expect("area");
        for length in [d.mean, d.rms, d.p99, d.hausdorff] {
            assert!((length - 0.25).abs() < 1e-6, "{d:?}");
        }
        assert!(d.normal_degrees < 1e-4);
        assert!((d.diagonal - 2f64.sqrt()).abs() < 1e-6);
        assert!((d.in_diagonals().mean - 0.25 / 2f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn a_surface_is_nowhere_away_from_itself() {
        let mesh = sheet(5, |x, y| 0.1 * x * y);
        let d = surface_distance(&mesh, &mesh, 5000).expect("area");
        assert!(d.hausdorff < 1e-7 && d.mean < 1e-8, "{d:?}");
    }

    #[test]
    fn a_wedge_has_the_mean_and_the_greatest_distance_of_its_slope() {
        // Height x against the plane, both ways: from the plane the foot lies on the slope or past its rim.
        let d = surface_distance(&sheet(1, |_, _| 0.0), &sheet(1, |x, _| 0.1 * x), 20_000).expect("area");
        assert!((d.hausdorff - 0.1).abs() < 2e-3, "{d:?}");
        assert!((d.mean - 0.05).abs() < 5e-4, "{d:?}");
        assert!((d.normal_degrees - 0.1f64.atan().to_degrees()).abs() < 1e-3, "{d:?}");
    }

    #[test]
    fn a_part_that_is_missing_shows_both_ways() {
        let whole = sheet(2, |_, _| 0.0);
        let mut raw = whole.clone().into_raw();
        raw.triangles.truncate(6);
        raw.face_submesh.truncate(6);
        let part = Mesh::new(raw).expect("valid");
        for d in [surface_distance(&whole, &part, 20_000), surface_distance(&part, &whole, 20_000)] {
            // The corner that lost its quad lies half the side from either neighbour quad.
            assert!((d.expect("area").hausdorff - 0.5).abs() < 0.02, "{d:?}");
        }
    }

    #[test]
    fn a_surface_without_area_has_no_distance() {
        let flat = sheet(1, |_, _| 0.0);
        let none = Mesh::new(RawMesh::default()).expect("valid");
        assert_eq!(surface_distance(&flat, &none, 100), None);
        assert_eq!(surface_distance(&none, &flat, 100), None);
    }

    #[test]
    fn the_figures_are_the_same_on_any_thread_count() {
        let (a, b) = (sheet(9, |x, y| x * y), sheet(4, |x, y| x * y));
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            pool.install(|| surface_distance(&a, &b, 3000))
        };
        assert_eq!(on(1), on(4));
    }

    proptest! {
        #[test]
        fn a_percentile_lies_between_its_neighbours(mut values in prop::collection::vec(0.0f64..9.0, 1..50)) {
            values.sort_unstable_by(f64::total_cmp);
            let p = percentile(&values, 0.99);
            prop_assert!(p <= values[values.len() - 1] && p >= values[0]);
            prop_assert_eq!(percentile(&values, 1.0), values[values.len() - 1]);
        }
    }
}
