//! Points on screens, and faces as fragments, all in integers.
//!
//! A point is projected once for each view, in double precision, and rounded; everything after that is whole numbers, so that a device
//! with integers of 32 bits (pairs of them for the products below) comes to the same fragments.
//!
//! | quantity | unit | magnitude |
//! | --- | --- | --- |
//! | x, y of a point | 1/256 pixel, y down | below 2^22; what is farther off screen is drawn in to there |
//! | depth of a point, parallel rays | 1/65536 pixel, greater is farther | at most 2^29 |
//! | depth of a point, rays that meet | -2^24 distance / z: linear on the screen | at most 2^26 |
//! | u, v of a wedge | 1/256 texel of its picture | at most 2^28 |
//! | weights `w`, area `A` ([`kiln_geom::raster`]) | 1/65536 square pixel | below 2^47 |
//! | share of corner `i` | `s_i = w_i floor(2^62 / A) >> 32`, i = 1, 2; of 2^30 | at most 2^30 |
//!
//! Corner 0 is the one at the lowest point id: a face gives the same fragments whatever corner it is written from.
//! ```text
//! value = value_0 + (s_1 (value_1 - value_0) + s_2 (value_2 - value_0) >> 30)        depth, u, v; >> rounds down
//! ```
//! `w_i floor(2^62 / A)` grows by the same number from pixel to pixel, modulo 2^64. Where rays meet, u and v weigh the shares by
//! `q_i = -depth_i >> 10`. The texel is `u >> 8`, brought into the picture by its wrap mode.
//!
//! A face covers the pixels whose centres lie in it, by the top-left rule, whichever way it faces. A face with a corner nearer to the eye
//! than a quarter of the eye's distance from the centre, or whose place is no finite number, covers nothing. Visible is the least (depth, face).

use glam::DVec3;
use kiln_asset::{Mesh, Wrap};
use kiln_geom::raster::{Rect, rasterise_spans};

use super::cameras::View;
use super::regions::{RegionMap, Regions};
use crate::topology::NONE;

/// x of a point that no face may be drawn from.
const NOWHERE: i32 = i32::MIN;
/// Greatest magnitude of x and y, 1/256 pixel.
const SIDE_LIMIT: f64 = (1 << 22) as f64;
/// Greatest magnitude of a depth.
const DEPTH_LIMIT: f64 = (1 << 29) as f64;
/// Greatest magnitude of u and v, 1/256 texel.
const TEXEL_LIMIT: f64 = (1 << 28) as f64;
/// Depth of the centre where rays meet.
const NEAR_DEPTH: f64 = (1 << 24) as f64;
/// The nearest that a point may be to the eye, as a share of the eye's distance from the centre.
const NEAR: f64 = 0.25;

/// What a pixel shows, or would show if nothing were in front.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fragment {
    pub(super) depth: i32,
    pub(super) face: u32,
    pub(super) region: u32,
}

impl Fragment {
    /// Behind everything.
    pub(super) const BACKGROUND: Fragment = Fragment { depth: i32::MAX, face: NONE, region: 0 };

    /// Whether it hides `other`.
    #[inline]
    pub(super) fn hides(&self, other: &Fragment) -> bool {
        (self.depth, self.face) < (other.depth, other.face)
    }
}

/// A face of the mesh as it is now.
#[derive(Clone, Copy, Debug)]
pub(super) struct DrawnFace {
    pub(super) face: u32,
    pub(super) points: [u32; 3],
    pub(super) wedges: [u32; 3],
}

/// What never changes: where points fall on the screens, and what the texels show.
pub(super) struct Screens<'a> {
    /// Number of views.
    pub(super) views: usize,
    /// Width and height of all screens, pixels.
    pub(super) size: u32,
    /// `[point_count * views]`: x, y, depth; the views of a point lie together.
    pub(super) places: Vec<[i32; 3]>,
    /// `[views]`: whether the rays of a view meet.
    pub(super) meets: Vec<bool>,
    /// `[vertex_count]`: u and v; empty where no submesh has a picture.
    pub(super) texels: Vec<[i32; 2]>,
    /// `[face_count]`: submesh; empty where every face is a region.
    pub(super) submesh: Vec<u32>,
    pub(super) regions: Option<&'a Regions>,
    /// Number of regions, the background among them.
    pub(super) region_count: usize,
}

/// `value` to the nearest whole number, at most `limit` in magnitude; 0 for no number.
fn fixed(value: f64, limit: f64) -> i32 {
    value.round_ties_even().clamp(-limit, limit) as i32
}

/// Where a place falls.
fn project(view: &View, place: DVec3) -> [i32; 3] {
    let step = place - view.centre;
    let [right, up, back] = [view.right, view.up, view.back].map(|axis| step.dot(axis));
    let middle = 0.5 * f64::from(view.size);
    let (scale, depth) = match view.distance {
        None => (view.pixels_per_unit, -65536.0 * view.pixels_per_unit * back),
        Some(distance) => {
            let nearness = distance / (distance - back);
            if !(0.0..=1.0 / NEAR).contains(&nearness) {
                return [NOWHERE, 0, 0];
            }
            (view.pixels_per_unit * nearness, -NEAR_DEPTH * nearness)
        }
    };
    let (x, y) = (256.0 * (middle + scale * right), 256.0 * (middle - scale * up));
    if !(x.is_finite() && y.is_finite() && depth.is_finite()) {
        return [NOWHERE, 0, 0];
    }
    [fixed(x, SIDE_LIMIT), fixed(y, SIDE_LIMIT), fixed(depth, DEPTH_LIMIT)]
}

impl<'a> Screens<'a> {
    /// `positions`: `[point_count]`, object space. `regions`: `None` where every face is a region. `views`: all of one size, not empty.
    pub(super) fn new(mesh: &Mesh, positions: &[DVec3], views: &[View], regions: Option<&'a Regions>) -> Screens<'a> {
        let places = positions.iter().flat_map(|place| views.iter().map(|view| project(view, *place))).collect();
        let submesh: Vec<u32> = regions.map_or(Vec::new(), |_| mesh.face_submesh.iter().map(|s| s.0).collect());
        let mut texels = Vec::new();
        if let Some(regions) = regions
            && regions.maps.iter().any(|map| matches!(map, RegionMap::Picture { .. }))
        {
            texels = vec![[0; 2]; mesh.vertex_count()];
            for (triangle, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
                let RegionMap::Picture { width, height, set, .. } = &regions.maps[submesh.index()] else { continue };
                let Some(uv) = (if *set == 0 { &mesh.uv0 } else { &mesh.uv1 }) else { continue };
                for v in triangle.map(|v| v as usize) {
                    let texel = |uv: f32, side: u32| fixed(256.0 * f64::from(uv) * f64::from(side), TEXEL_LIMIT);
                    texels[v] = [texel(uv[v].x, *width), texel(uv[v].y, *height)];
                }
            }
        }
        Screens {
            views: views.len(),
            size: views.first().map_or(0, |view| view.size),
            places,
            meets: views.iter().map(|view| view.distance.is_some()).collect(),
            texels,
            submesh,
            regions,
            region_count: regions.map_or(mesh.face_count() + 1, |regions| regions.count as usize),
        }
    }

    /// Fragments of all faces in all views; stops counting beyond `limit`.
    pub(super) fn fragments(&self, mesh: &Mesh, limit: u64) -> u64 {
        let mut count = 0;
        for (f, triangle) in mesh.triangles.iter().enumerate() {
            let points = triangle.map(|v| mesh.points[v as usize].0);
            let face = DrawnFace { face: f as u32, points, wedges: *triangle };
            for view in 0..self.views {
                if let Some(shape) = self.shape(&face, view) {
                    shape.runs(self.size, |from, to| count += (to - from) as u64);
                }
            }
            if count > limit {
                break;
            }
        }
        count
    }

    /// Pixels of a screen.
    pub(super) fn pixels(&self) -> usize {
        self.size as usize * self.size as usize
    }

    #[inline]
    pub(super) fn place(&self, point: u32, view: usize) -> [i32; 3] {
        self.places[point as usize * self.views + view]
    }

    /// A face on a screen; `None` if it covers nothing for being too near.
    #[inline]
    pub(super) fn shape(&self, face: &DrawnFace, view: usize) -> Option<Shape> {
        let [a, b, c] = face.points;
        // Corner 0 at the lowest point; the winding stays.
        let first = if a < b && a < c {
            0
        } else if b < c {
            1
        } else {
            2
        };
        let order = [first, (first + 1) % 3, (first + 2) % 3];
        let corners = order.map(|k| self.place(face.points[k], view));
        let somewhere = corners.iter().all(|corner| corner[0] != NOWHERE);
        somewhere.then(|| Shape { corners, wedges: order.map(|k| face.wedges[k]), face: face.face, view: view as u32 })
    }

    /// What a shape shows.
    #[inline]
    pub(super) fn paint(&self, shape: &Shape) -> Paint<'_> {
        let plain =
            |region| Paint { region, ids: &[], side: [0; 2], wrap: [Wrap::Repeat; 2], uv: [[0; 2]; 3], near: None };
        let Some(regions) = self.regions else { return plain(shape.face + 1) };
        match &regions.maps[self.submesh[shape.face as usize] as usize] {
            RegionMap::Whole(region) => plain(*region),
            RegionMap::Picture { width, height, wrap, ids, .. } => {
                let uv = shape.wedges.map(|w| self.texels[w as usize].map(i64::from));
                let near = || shape.corners.map(|corner| -i64::from(corner[2]) >> 10);
                let near = self.meets[shape.view as usize].then(near);
                Paint { region: 0, ids, side: [*width, *height], wrap: *wrap, uv, near }
            }
        }
    }
}

/// What a shape shows: one region, or a part of a picture.
pub(super) struct Paint<'a> {
    region: u32,
    /// Empty where it shows one region.
    ids: &'a [u32],
    side: [u32; 2],
    wrap: [Wrap; 2],
    /// Of the corners, 1/256 texel.
    uv: [[i64; 2]; 3],
    /// Of the corners, where rays meet: in proportion to 1 / distance from the eye.
    near: Option<[i64; 3]>,
}

impl Paint<'_> {
    /// The region where corners 1 and 2 have these shares.
    #[inline]
    pub(super) fn region(&self, shares: [i64; 2]) -> u32 {
        if self.ids.is_empty() {
            return self.region;
        }
        let [u, v] = match &self.near {
            None => [0, 1].map(|k| between(self.uv.map(|c| c[k]), shares)),
            Some(near) => self.between_meeting(near, shares),
        };
        let [column, row] =
            [self.wrap[0].texel(u >> 8, self.side[0] as usize), self.wrap[1].texel(v >> 8, self.side[1] as usize)];
        self.ids[row * self.side[0] as usize + column]
    }

    /// u and v where rays meet.
    #[cold]
    fn between_meeting(&self, near: &[i64; 3], [p, q]: [i64; 2]) -> [i64; 2] {
        let weights = [(1 << 30) - p - q, p, q];
        let [a, b, c] = [0, 1, 2].map(|k| (weights[k] >> 14) * near[k]);
        let sum = (a + b + c).max(1);
        let [o, x, y] = self.uv;
        [0, 1].map(|k| o[k] + (b * (x[k] - o[k]) + c * (y[k] - o[k])).div_euclid(sum))
    }
}

/// The value where corners 1 and 2 have these shares.
#[inline]
fn between([a, b, c]: [i64; 3], shares: [i64; 2]) -> i64 {
    a + ((shares[0] * (b - a) + shares[1] * (c - a)) >> 30)
}

/// A face on a screen, from its lowest point on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    corners: [[i32; 3]; 3],
    wedges: [u32; 3],
    pub(super) face: u32,
    view: u32,
}

impl Shape {
    /// Visits the runs of pixels that it covers: index of the first, behind the last, in a screen of that size.
    #[inline]
    pub(super) fn runs(&self, size: u32, mut visit: impl FnMut(usize, usize)) {
        let corners = self.corners.map(|[x, y, _]| [i64::from(x), i64::from(y)]);
        rasterise_spans(corners, Rect::whole(size, size), |span| {
            let row = span.y as usize * size as usize;
            visit(row + span.x0 as usize, row + span.x1 as usize);
        });
    }

    /// Visits the pixels that it covers: index, depth, shares of corners 1 and 2 (of 2^30).
    #[inline]
    pub(super) fn fragments(&self, size: u32, mut visit: impl FnMut(usize, i32, [i64; 2])) {
        let corners = self.corners.map(|[x, y, _]| [i64::from(x), i64::from(y)]);
        let depths = self.corners.map(|corner| i64::from(corner[2]));
        let mut scale = 0;
        rasterise_spans(corners, Rect::whole(size, size), |span| {
            if scale == 0 {
                scale = (1_i64 << 62) / span.area;
            }
            let row = span.y as usize * size as usize;
            let [_, mut p, mut q] = span.weights.map(|w| w * scale);
            let [_, p_step, q_step] = span.steps.map(|step| step.wrapping_mul(scale));
            for pixel in row + span.x0 as usize..row + span.x1 as usize {
                let shares = [p >> 32, q >> 32];
                visit(pixel, between(depths, shares) as i32, shares);
                p = p.wrapping_add(p_step);
                q = q.wrapping_add(q_step);
            }
        });
    }
}
