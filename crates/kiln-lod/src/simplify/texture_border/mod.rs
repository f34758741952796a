//! Texture borders: collapses that would move a border in a texture come later, whatever the metric.
//!
//! **Problem.** A metric of shape is blind to what is painted on it: a flat face with an eye goes as early as a flat face without.
//! In: a mesh, its materials' pictures, a metric's cost of every edge. Out: the cost with a surcharge on the edges that cross a
//! border in one of the pictures. Must not change: the order among edges without a surcharge.
//!
//! **Method.**
//! ```text
//! for each picture that a map named in the options reads:
//!     borders <- Canny on its luma                                               (canny)
//! a segment of a face in UV space crosses if it meets a border texel             (segment)
//! c_e  <- root of the base cost, by one constant a mesh a length over the diagonal
//! area   (published): an edge that crosses pays  weight * (area of the faces on it) / (area of the mesh)
//! shift  (default):   if an edge at `from` crosses, taking it to `to` pays
//!                     weight / 2 * root of the integral over the surface of the square way that the texture moves / diagonal
//! cost <- c_e + what it pays
//! ```
//! The way that the texture moves at `from`: find its old UV in the faces that will be there, in the plane of the face that holds it
//! (or comes nearest to holding it); the distance along the surface from `from` to that place. From there it falls off to 0 at
//! the star's rim like a tent, whose square has a sixth of the star's area as its integral. Where UVs follow the surface evenly it is 0,
//! and the border stays where it is, however few faces carry it.
//!
//! Several maps: a border in any of them counts. Faces on both sides of a seam are asked, each with its own UVs. A collapse
//! changes faces, so every edge of a changed face is asked again.
//!
//! **Colour.** Luma of base colour, emission and normals is 0.2126 R + 0.7152 G + 0.0722 B of the codes as they lie in the file (for
//! base colour and emission that is Rec. 709 luma of sRGB codes, base colour's faded by alpha where coverage follows it); of
//! metallic-roughness the mean of green and blue, of occlusion red.
//!
//! **Departures.** The published surcharge, the area, lowers the image error on none of five models at both 50 and 25 %
//! (`docs/texture-border.md`): it says how large the faces are, not how far the border moves, so it spends triangles where UVs
//! follow the surface and nothing would have moved. Hence `shift`, after the texture deviation of Cohen et al. The thesis adds its area to whatever the metric gives; a
//! squared distance is far below every area, so the square root is taken first, which keeps the metric's own order. It marks
//! affected edges once; here they are asked again. It does not say what its thresholds are shares of: here the high one is a quantile
//! of the ridges' gradients, the low one a share of the high. Its pictures are small; here a picture is halved until no side
//! is longer than [`TextureBorderOptions::side`], so that sigma means the same for all and grain that no level shows is no border.
//!
//! **Limits.** Shifts are measured from collapse to collapse, not against the source. A chart's outline against the picture's
//! background is a border, too. Lost silhouettes cost more picture error than a surcharge can win (the thesis' turtle).
//!
//! **Sources.** C. Gonzalez, PhD thesis, Universitat Jaume I 2010, chapter 4, equations 4.1 and 4.2; J. Cohen, M. Olano, D. Manocha,
//! Appearance-preserving simplification, SIGGRAPH 1998, doi:10.1145/280814.280832 (texture deviation); Canny 1986 (canny).

mod canny;
mod picture;
mod segment;

use std::sync::Arc;

use glam::{DVec2, DVec3, Vec2};
use kiln_asset::{AlphaMode, ImageId, MapRole, MaterialSet, Mesh, Raster, SubmeshId, Wrap};
use serde::{Deserialize, Serialize};

use super::plane::Plane;

pub use canny::BorderImage;
pub use picture::debug_picture;

/// What the surcharge of an affected edge measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BorderCost {
    /// How far the collapse moves the texture along the surface, and on how much of it.
    #[default]
    Shift,
    /// The share of the mesh's area on the edge, as published.
    Area,
}

/// What counts as a texture border and what crossing one costs. Unitless but for sigma and side.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureBorderOptions {
    /// Maps of the materials whose borders count.
    pub maps: Vec<MapRole>,
    /// Of the Gaussian that smooths a picture first, texels.
    pub sigma: f64,
    /// Low threshold, as a share of the high one, in `[0, 1]`.
    pub low: f64,
    /// High threshold, as a quantile of the gradients along ridges, in `[0, 1]`.
    pub high: f64,
    /// Factor on the surcharge.
    pub weight: f64,
    /// What the surcharge measures.
    pub cost: BorderCost,
    /// Longest side of a picture when borders are looked for, texels.
    pub side: u32,
}

impl Default for TextureBorderOptions {
    fn default() -> Self {
        TextureBorderOptions {
            maps: vec![MapRole::BaseColor],
            sigma: 0.75,
            low: 0.5,
            high: 0.6,
            weight: 1.0,
            cost: BorderCost::Shift,
            side: 512,
        }
    }
}

/// What a texture moved along the surface counts beside a surface moved off its place. 0.15 to 2 were tried on five models: below,
/// borders gain less than they could; above, silhouettes lose more than borders gain.
const MOVED: f64 = 0.5;

/// One picture with its borders.
#[derive(Clone, Debug)]
pub struct MapBorders {
    /// The picture.
    pub image: ImageId,
    /// The role it was read in.
    pub role: MapRole,
    /// What its samplers do beyond its sides, in u and in v.
    pub wrap: [Wrap; 2],
    alpha: bool,
    /// Its borders; smaller than the picture where that was halved.
    pub borders: BorderImage,
}

/// A picture as a submesh reads it.
#[derive(Clone, Copy, Debug)]
struct Reading {
    /// Index in `maps`.
    map: u32,
    uv_set: u32,
}

/// The borders in the pictures of a mesh.
#[derive(Clone, Debug, Default)]
pub struct TextureBorders {
    /// Factor on the surcharge.
    pub weight: f64,
    /// What the surcharge measures.
    pub cost: BorderCost,
    maps: Vec<MapBorders>,
    /// `[submesh_count + 1]`: where the readings of each submesh start.
    first: Vec<u32>,
    readings: Vec<Reading>,
}

/// How many edges of a mesh cross a border.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TextureBorderReport {
    /// Edges of the mesh.
    pub edges: u32,
    /// Edges that cross a border in one of their pictures.
    pub affected: u32,
    /// The pictures.
    pub pictures: Vec<PictureReport>,
}

/// One picture of a [`TextureBorderReport`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PictureReport {
    /// Its name.
    pub name: String,
    /// The map that it was read as.
    pub map: String,
    /// Width at which borders were looked for, texels.
    pub width: u32,
    /// Height at which borders were looked for, texels.
    pub height: u32,
    /// Texels that a border runs through.
    pub border_texels: u64,
    /// Segments of faces in it that cross one.
    pub affected_segments: u32,
}

/// Weights of red, green and blue codes in a role's luma.
fn luma(role: MapRole) -> [f32; 3] {
    match role {
        MapRole::BaseColor | MapRole::Emissive | MapRole::Normal => [0.2126, 0.7152, 0.0722],
        MapRole::MetallicRoughness => [0.0, 0.5, 0.5],
        MapRole::Occlusion => [1.0, 0.0, 0.0],
    }
}

/// Both UV sets of a vertex, zeros where there is none.
pub fn uv_sets(mesh: &Mesh, vertex: u32) -> [Vec2; 2] {
    [&mesh.uv0, &mesh.uv1].map(|set| set.as_ref().map_or(Vec2::ZERO, |uv| uv[vertex as usize]))
}

impl TextureBorders {
    /// The borders of the pictures that `mesh`'s materials read in the roles named in `options`. `decode` gives a picture. A submesh
    /// without such a map, or without the UV set that it reads, has no borders.
    ///
    /// # Errors
    /// What `decode` says of a picture.
    pub fn new(
        mesh: &Mesh,
        materials: &MaterialSet,
        decode: &dyn Fn(ImageId) -> Result<Arc<Raster>, String>,
        options: &TextureBorderOptions,
    ) -> Result<TextureBorders, String> {
        let mut out =
            TextureBorders { weight: options.weight, cost: options.cost, first: vec![0], ..TextureBorders::default() };
        let thresholds = canny::Thresholds { sigma: options.sigma, low: options.low, high: options.high };
        for submesh in &mesh.submeshes {
            let material = submesh.material.and_then(|m| materials.materials.get(m.index()));
            for role in &options.maps {
                let Some((material, reference)) = material.and_then(|m| Some((m, m.map(*role)?))) else { continue };
                let has_uv = match reference.uv_set {
                    0 => mesh.uv0.is_some() && submesh.attributes.uv0,
                    1 => mesh.uv1.is_some() && submesh.attributes.uv1,
                    _ => false,
                };
                let Some(texture) = materials.textures.get(reference.texture.index()).filter(|_| has_uv) else {
                    continue;
                };
                let (image, wrap) = (texture.image, [texture.sampler.wrap_u, texture.sampler.wrap_v]);
                let alpha = *role == MapRole::BaseColor && material.alpha_mode != AlphaMode::Opaque;
                let known = |m: &MapBorders| m.image == image && m.role == *role && m.wrap == wrap && m.alpha == alpha;
                let map = match out.maps.iter().position(known) {
                    Some(map) => map,
                    None => {
                        let plane = Plane::of(&*decode(image)?, luma(*role), alpha, options.side);
                        let borders = canny::detect(&plane, &thresholds, wrap);
                        out.maps.push(MapBorders { image, role: *role, wrap, alpha, borders });
                        out.maps.len() - 1
                    }
                };
                out.readings.push(Reading { map: map as u32, uv_set: reference.uv_set });
            }
            out.first.push(out.readings.len() as u32);
        }
        Ok(out)
    }

    /// The pictures, in the order in which submeshes name them.
    pub fn maps(&self) -> &[MapBorders] {
        &self.maps
    }

    /// Whether the segment between two wedges of one face of `submesh`, given by both their UV sets, crosses a border in one of
    /// the submesh's pictures.
    #[inline]
    pub fn affected(&self, submesh: SubmeshId, a: [Vec2; 2], b: [Vec2; 2]) -> bool {
        self.of(submesh).iter().any(|reading| self.crosses(*reading, a, b))
    }

    fn of(&self, submesh: SubmeshId) -> &[Reading] {
        let s = submesh.index();
        &self.readings[self.first[s] as usize..self.first[s + 1] as usize]
    }

    fn crosses(&self, reading: Reading, a: [Vec2; 2], b: [Vec2; 2]) -> bool {
        let map = &self.maps[reading.map as usize];
        let set = reading.uv_set as usize;
        segment::crosses(&map.borders, map.wrap, a[set], b[set])
    }

    /// The segments of `mesh`'s faces in picture `map`, each with whether it crosses a border; a segment that two faces share comes once.
    ///
    /// # Panics
    /// If the mesh has other submeshes than the one that the borders were made for.
    pub fn segments(&self, mesh: &Mesh, map: usize) -> Vec<([Vec2; 2], bool)> {
        let mut ends: Vec<([u32; 2], u32)> = Vec::new();
        for (triangle, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
            for reading in self.of(*submesh).iter().filter(|r| r.map as usize == map) {
                for k in 0..3 {
                    let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
                    ends.push(([a.min(b), a.max(b)], reading.uv_set));
                }
            }
        }
        ends.sort_unstable();
        ends.dedup();
        let map = &self.maps[map];
        let segment = |(ends, set): ([u32; 2], u32)| {
            let [a, b] = ends.map(|v| uv_sets(mesh, v)[set as usize]);
            ([a, b], segment::crosses(&map.borders, map.wrap, a, b))
        };
        ends.into_iter().map(segment).collect()
    }

    /// Counts for `mesh`.
    ///
    /// # Panics
    /// If the mesh has other submeshes than the one that the borders were made for.
    pub fn report(&self, mesh: &Mesh, materials: &MaterialSet) -> TextureBorderReport {
        let mut edges: Vec<([u32; 2], bool)> = Vec::new();
        for (triangle, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
            for k in 0..3 {
                let ends = [triangle[k], triangle[(k + 1) % 3]];
                let [a, b] = ends.map(|v| uv_sets(mesh, v));
                let [p, q] = ends.map(|v| mesh.points[v as usize].0);
                edges.push(([p.min(q), p.max(q)], self.affected(*submesh, a, b)));
            }
        }
        edges.sort_unstable();
        let runs = edges.chunk_by(|a, b| a.0 == b.0);
        let (mut count, mut affected) = (0, 0);
        for run in runs {
            count += 1;
            affected += u32::from(run.iter().any(|edge| edge.1));
        }
        let picture = |(index, map): (usize, &MapBorders)| PictureReport {
            name: materials.images.get(map.image.index()).map_or_else(String::new, |image| image.name.clone()),
            map: map.role.name().into(),
            width: map.borders.width,
            height: map.borders.height,
            border_texels: map.borders.count(),
            affected_segments: self.segments(mesh, index).iter().filter(|s| s.1).count() as u32,
        };
        TextureBorderReport { edges: count, affected, pictures: self.maps.iter().enumerate().map(picture).collect() }
    }
}

/// A face at the point that goes, that point first.
#[derive(Clone, Copy, Debug)]
pub(super) struct StarFace {
    pub(super) submesh: SubmeshId,
    pub(super) wedges: [u32; 3],
    pub(super) places: [DVec3; 3],
    /// Which of its corners is the point that stays, if it is on the edge.
    pub(super) to: Option<usize>,
}

/// The extension's part in the cost of an edge, with what is constant over a mesh.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surcharge<'a> {
    borders: &'a TextureBorders,
    /// Weight over the area of the mesh, in the unit of the root of a base cost: 1 / square object unit.
    share: f64,
    /// Half the weight over the square diagonal: 1 / square object unit.
    moved: f64,
    /// What makes the root of a base cost a length over the diagonal.
    length: f64,
}

impl<'a> Surcharge<'a> {
    /// For base costs of square distance times area over the diagonal's fourth power.
    pub(super) fn new(borders: &'a TextureBorders, mesh: &Mesh) -> Surcharge<'a> {
        let area: f64 = mesh.triangles.iter().map(|t| area(t.map(|v| mesh.positions[v as usize].as_dvec3()))).sum();
        let diagonal = f64::from(mesh.diagonal());
        // A form stands for the area at its point: over the root of the mean of those areas, the root of a base cost is a length.
        let length = diagonal * (mesh.point_count() as f64 / area).sqrt();
        let finite = |v: f64| if v.is_finite() { v } else { 0.0 };
        let share = finite(borders.weight / area / length);
        Surcharge { borders, share, moved: finite(MOVED * borders.weight / (diagonal * diagonal)), length }
    }

    /// Whether an edge at a point with these faces crosses a border.
    pub(super) fn near(&self, mesh: &Mesh, star: impl Iterator<Item = StarFace> + Clone) -> bool {
        // Looking for the next face spares asking an edge twice, but takes the square of the faces at a hub.
        let few = star.size_hint().0 <= 32;
        star.clone().any(|face| {
            let [p, a, b] = face.wedges;
            let crosses = |end: u32| self.borders.affected(face.submesh, uv_sets(mesh, p), uv_sets(mesh, end));
            // Inside a chart the next face has the last edge of this one.
            crosses(a) || (!(few && star.clone().any(|next| next.wedges[..2] == [p, b])) && crosses(b))
        })
    }

    /// The cost of an edge with base cost `base`, as a base cost; `star`: the faces at the point that goes, `near` what
    /// [`Surcharge::near`] says of them.
    #[inline]
    pub(super) fn cost(&self, mesh: &Mesh, base: f64, near: bool, star: impl Iterator<Item = StarFace> + Clone) -> f64 {
        if !near {
            return base;
        }
        let surcharge = self.root(mesh, star);
        if surcharge <= 0.0 {
            return base;
        }
        // (c_e + share)^2 over the unit's square: as good an order as c_e + share, and edges that cross nothing keep their rank's bits.
        let root = base.max(0.0).sqrt() + surcharge;
        root * root
    }

    /// The surcharge in the unit of the root of a base cost.
    #[inline]
    fn root(&self, mesh: &Mesh, star: impl Iterator<Item = StarFace> + Clone) -> f64 {
        match self.borders.cost {
            BorderCost::Area => self.share * self.area_on_edge(mesh, star),
            BorderCost::Shift => self.moved * self.shift(mesh, star),
        }
    }

    /// The surcharge of an edge near a border on its own: for [`BorderCost::Area`] the weight times the share of the mesh's area on
    /// the edge, as published. Unitless.
    pub(super) fn alone(&self, mesh: &Mesh, star: impl Iterator<Item = StarFace> + Clone) -> f64 {
        let sum = self.length * self.root(mesh, star);
        if sum.is_finite() { sum } else { 0.0 }
    }

    /// Area of the faces on the edge if it crosses a border, else 0; square object units.
    fn area_on_edge(&self, mesh: &Mesh, star: impl Iterator<Item = StarFace>) -> f64 {
        let (mut crosses, mut sum) = (false, 0.0);
        let mut asked = [u32::MAX; 2];
        for face in star {
            let Some(to) = face.to else { continue };
            sum += area(face.places);
            // Both faces of an edge inside a chart have the same segment.
            let wedges = [face.wedges[0], face.wedges[to]];
            if !crosses && asked != wedges {
                let [a, b] = wedges.map(|w| uv_sets(mesh, w));
                crosses = self.borders.affected(face.submesh, a, b);
                asked = wedges;
            }
        }
        if crosses { sum } else { 0.0 }
    }

    /// Root of the integral over the surface of the square way that the collapse moves the texture; square object units.
    fn shift(&self, mesh: &Mesh, star: impl Iterator<Item = StarFace> + Clone) -> f64 {
        let mut most = 0.0_f64;
        for dying in star.clone() {
            // Each side of a seam by its own UVs; a side whose material has no such texture does not count.
            let (Some(to), Some(reading)) = (dying.to, self.borders.of(dying.submesh).first()) else { continue };
            let uv = |w: u32| uv_sets(mesh, w)[reading.uv_set as usize].as_dvec2();
            let (goes, stays) = (uv(dying.wedges[0]), uv(dying.wedges[to]));
            let mut best: Option<(f64, f64)> = None;
            for face in star.clone().filter(|face| face.to.is_none() && face.wedges[0] == dying.wedges[0]) {
                let places = [dying.places[to], face.places[1], face.places[2]];
                let shares = barycentric(goes, [stays, uv(face.wedges[1]), uv(face.wedges[2])]);
                if let Some((inside, shares)) = shares
                    && best.is_none_or(|b| inside > b.0)
                {
                    let step = places[0] * shares[0] + places[1] * shares[1] + places[2] * shares[2] - dying.places[0];
                    let normal = (places[1] - places[0]).cross(places[2] - places[0]).normalize_or_zero();
                    best = Some((inside, (step - normal * step.dot(normal)).length()));
                }
            }
            most = most.max(best.map_or(0.0, |b| b.1));
        }
        let around: f64 = star.map(|face| area(face.places)).sum();
        most * (around / 6.0).sqrt()
    }
}

/// The barycentric coordinates in a triangle of the point in it that stands for `p`, the negative ones cut off, and the least of
/// them before that: how far `p` is inside. `None` for a triangle without area.
fn barycentric(p: DVec2, [a, b, c]: [DVec2; 3]) -> Option<(f64, [f64; 3])> {
    let whole = (b - a).perp_dot(c - a);
    let shares = [(b - p).perp_dot(c - p), (c - p).perp_dot(a - p), (a - p).perp_dot(b - p)].map(|part| part / whole);
    if !shares.iter().all(|share| share.is_finite()) {
        return None;
    }
    let cut = shares.map(|share| share.max(0.0));
    let sum: f64 = cut.iter().sum();
    Some((shares[0].min(shares[1]).min(shares[2]), cut.map(|share| share / sum)))
}

/// Area of a triangle.
fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

#[cfg(test)]
mod tests;
