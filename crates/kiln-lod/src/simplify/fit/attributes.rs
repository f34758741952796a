//! The fit of attributes: least squares of what the faces interpolate at the samples.

use std::ops::{Add, Mul, Sub};

use glam::{DVec3, Vec2, Vec4};
use kiln_asset::RawMesh;
use rayon::prelude::*;

use super::Fit;
use super::stars::{Place, Stars, frames};
use crate::simplify::metric::quadric::Quadric;
use crate::topology::NONE;

/// Sweeps for attributes.
const ATTRIBUTE_SWEEPS: usize = 8;

impl Fit<'_> {
    /// Fits all attributes at the points that moved, or could have.
    pub(super) fn attributes(&self, raw: &mut RawMesh, forms: &[Option<Quadric>]) {
        let uvs = raw.uv0.is_some() || raw.uv1.is_some() || raw.atlas_uv.is_some();
        if !uvs && raw.normals.is_none() && raw.colors.is_none() {
            return;
        }
        let (first, corners) = corners_of_vertices(raw);
        let mut at = vec![DVec3::ZERO; forms.len()];
        for (v, p) in self.point_of.iter().enumerate().rev() {
            at[*p as usize] = raw.positions[v].as_dvec3();
        }
        let triangles = std::mem::take(&mut raw.triangles);
        let stars = Stars {
            frames: &frames(&self.topology.face_points, &at),
            face_points: &self.topology.face_points,
            face_nodes: &triangles,
            first: &first,
            corners: &corners,
        };
        let place = |sample: &u32| {
            stars.nearest(&at, self.heirs[self.vertex_at(*sample) as usize], self.place_of_sample(*sample))
        };
        let places: Vec<Place> = self.chosen.samples.par_iter().map(place).collect();
        let loose: Vec<bool> = self.point_of.iter().map(|p| forms[*p as usize].is_some()).collect();
        // By the mean, so that single precision holds the areas of models of any size.
        let scale = self.chosen.weights.len() as f64 / self.chosen.weights.iter().sum::<f64>();
        let weights: Vec<f32> = self.chosen.weights.iter().map(|weight| (weight * scale) as f32).collect();
        let job = AttributeFit {
            weights: &weights,
            chosen: &self.chosen.samples,
            corners: &self.source.triangles,
            triangles: &triangles,
            places: &places,
            loose: &loose,
        };
        for (own, theirs) in [
            (&mut raw.uv0, &self.source.uv0),
            (&mut raw.uv1, &self.source.uv1),
            (&mut raw.atlas_uv, &self.source.atlas_uv),
        ] {
            if let (Some(own), Some(theirs)) = (own, theirs) {
                job.uvs(own, theirs);
            }
        }
        if let (Some(own), Some(theirs)) = (&mut raw.colors, &self.source.colors) {
            job.solve(own, theirs, |color| color.is_finite());
            own.iter_mut().for_each(|color| *color = color.max(Vec4::ZERO));
        }
        if let (Some(own), Some(theirs)) = (&mut raw.normals, &self.source.normals) {
            let old = own.clone();
            job.solve(own, theirs, |normal| normal.is_finite());
            for ((new, old), loose) in own.iter_mut().zip(old).zip(&loose) {
                *new = if *loose { new.normalize_or(old) } else { old };
            }
        }
        if let (Some(own), Some(theirs)) = (&mut raw.tangents, &self.source.tangents) {
            let old = own.clone();
            job.solve(own, theirs, |tangent| tangent.is_finite());
            for ((new, old), loose) in own.iter_mut().zip(old).zip(&loose) {
                // A chart has one hand; mirrored ones meet at seams, where vertices part.
                *new = if *loose { new.truncate().normalize_or(old.truncate()).extend(old.w) } else { old };
            }
        }
        raw.triangles = triangles;
    }
}

/// `(first [vertex_count + 1], corners)`: the corners that use each vertex, ascending.
fn corners_of_vertices(raw: &RawMesh) -> (Vec<u32>, Vec<u32>) {
    let mut first = vec![0u32; raw.positions.len() + 2];
    for v in raw.triangles.iter().flatten() {
        first[*v as usize + 2] += 1;
    }
    for i in 2..first.len() {
        first[i] += first[i - 1];
    }
    let mut corners = vec![0; 3 * raw.triangles.len()];
    for (corner, v) in raw.triangles.iter().flatten().enumerate() {
        let slot = &mut first[*v as usize + 1];
        corners[*slot as usize] = corner as u32;
        *slot += 1;
    }
    first.pop();
    (first, corners)
}

/// What the least squares of one attribute need.
struct AttributeFit<'a> {
    /// The source's vertices that speak, and what each counts.
    chosen: &'a [u32],
    weights: &'a [f32],
    /// Of the source's faces.
    corners: &'a [[u32; 3]],
    triangles: &'a [[u32; 3]],
    places: &'a [Place],
    /// `[vertex_count]`: whether the attribute may change.
    loose: &'a [bool],
}

impl AttributeFit<'_> {
    /// Texture coordinates: vertices of faces that turned over in the UV plane go back.
    fn uvs(&self, own: &mut [Vec2], theirs: &[Vec2]) {
        let start = own.to_vec();
        self.solve(own, theirs, |uv| uv.is_finite());
        loop {
            let mut back: Vec<u32> = Vec::new();
            for triangle in self.triangles {
                let area = |uv: &[Vec2]| {
                    let [a, b, c] = triangle.map(|v| uv[v as usize].as_dvec2());
                    (b - a).perp_dot(c - a)
                };
                let changed = triangle.iter().any(|v| own[*v as usize] != start[*v as usize]);
                let (before, after) = (area(&start), area(own));
                if changed && (before * after < 0.0 || (before != 0.0 && after == 0.0)) {
                    back.extend(triangle);
                }
            }
            if back.is_empty() {
                return;
            }
            for v in back {
                own[v as usize] = start[v as usize];
            }
        }
    }

    /// Values that single precision cannot hold stay as they were.
    fn solve<T>(&self, own: &mut [T], theirs: &[T], finite: impl Fn(&T) -> bool)
    where
        T: Copy + Default + Add<Output = T> + Sub<Output = T> + Mul<f32, Output = T>,
    {
        let mut sums: Vec<(T, f32)> = vec![(T::default(), 0.0); own.len()];
        for _ in 0..ATTRIBUTE_SWEEPS {
            sums.fill((T::default(), 0.0));
            for ((v, area), place) in self.chosen.iter().zip(self.weights).zip(self.places) {
                if place.face == NONE {
                    continue;
                }
                let triangle = self.triangles[place.face as usize].map(|v| v as usize);
                let [a, b, c] = place.bary;
                let on = own[triangle[0]] * a + own[triangle[1]] * b + own[triangle[2]] * c;
                let wanted = match theirs.get(*v as usize) {
                    Some(own) => *own,
                    None => {
                        let [a, b, c] = self.corners[*v as usize - theirs.len()].map(|v| theirs[v as usize]);
                        (a + b + c) * (1.0 / 3.0)
                    }
                };
                let left = wanted - on;
                for k in 0..3 {
                    let weight = area * place.bary[k];
                    let sum = &mut sums[triangle[k]];
                    *sum = (sum.0 + left * weight, sum.1 + weight);
                }
            }
            for ((value, sum), loose) in own.iter_mut().zip(&sums).zip(self.loose) {
                if *loose && sum.1 > f32::MIN_POSITIVE {
                    let new = *value + sum.0 * (1.0 / sum.1);
                    *value = if finite(&new) { new } else { *value };
                }
            }
        }
    }
}
