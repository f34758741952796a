//! The hit pass on the CPU; twin of `shaders/mirrored_vertex.wgsl`.
//!
//! ```text
//! for each low face T of a bin:
//!     candidates = high triangles that the tree finds in the hull of T's lines within reach, each with the samples that its
//!                  lines can meet it from (low.rs: bounds by slopes)                                        gather
//!     for each candidate, for each of those samples that T owns:
//!         E of its three edges, polynomials of the place: inside where none is negative
//!         t = (p - o) . n / (d . n), d . n = sum of the three; within the distances; facing the line's way
//!         the better one by the rule stays, of equals the lower face                                        draw
//! ```
//!
//! Watertight: two triangles that share an edge evaluate the same polynomial with opposite sign, bit for bit, and both are opened by
//! a bound on its rounding; so every line through an edge or a corner meets at least one of them.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use kiln_asset::{FaceId, Mesh, SubmeshId};
use kiln_geom::Bvh;
use kiln_geom::raster::Rect;

use super::low::{Lines, Low};
use super::options::{BakeOptions, HitRule, Matching};

/// Roundings of an edge polynomial in units of the square of the largest coordinate: 2^-53 times about 200 operations and terms.
const ROUNDING: f64 = 1.0 / (1u64 << 44) as f64;

/// How far boxes of places are opened, samples.
const SLACK: f64 = 1.0 / 1024.0;

/// A high triangle that lines of one low face may meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    /// The high face.
    pub(crate) high: u32,
    /// It belongs to another submesh and counts only where the low face's own submesh offers nothing.
    pub(crate) fallback: bool,
    /// The samples that can meet it.
    pub(crate) samples: Rect,
}

/// The high mesh, ready to be searched.
pub(crate) struct Search<'a> {
    pub(crate) high: &'a Mesh,
    bvh: Arc<Bvh>,
    pub(crate) hit: HitRule,
    pub(crate) back_faces: bool,
    matching: Matching,
    /// `[low submesh_count]`: the high submesh of the same name.
    same: Vec<Option<SubmeshId>>,
}

/// What one thread keeps between bins.
#[derive(Default)]
pub(crate) struct Scratch {
    found: Vec<u32>,
    pub(crate) candidates: Vec<Candidate>,
    keys: Vec<f64>,
    /// `[samples of the bin]` where the winner was met: its barycentric coordinates 0 and 1. Only where there is one.
    pub(crate) met: Vec<[f32; 2]>,
}

/// A high triangle as functions of the place on the sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    /// Of the edges opposite to corner 0, 1, 2: coefficients of 1, x, y, xx, xy, yy. Their sum is `d . n`.
    edges: [[f64; 6]; 3],
    /// `(p - o) . n`: coefficients of 1, x, y.
    height: [f64; 3],
    /// What an edge's value may be wrong by.
    open: f64,
}

impl Target {
    /// Of a triangle with corners relative to `lines.base`.
    pub(crate) fn new(lines: &Lines, [a, b, c]: [DVec3; 3]) -> Target {
        let [d, m] = [&lines.direction[..], &lines.moment[..]];
        let edge = |p: DVec3, q: DVec3| {
            let (cross, along) = (p.cross(q), q - p);
            [
                d[0].dot(cross) + m[0].dot(along),
                d[1].dot(cross) + m[1].dot(along),
                d[2].dot(cross) + m[2].dot(along),
                m[3].dot(along),
                m[4].dot(along),
                m[5].dot(along),
            ]
        };
        let n = (b - a).cross(c - a);
        let o = &lines.origin;
        let reach = a.abs().max(b.abs()).max(c.abs()).max_element().max(lines.extent);
        Target {
            edges: [edge(b, c), edge(c, a), edge(a, b)],
            height: [(a - o[0]).dot(n), -o[1].dot(n), -o[2].dot(n)],
            open: ROUNDING * reach * reach,
        }
    }
}

impl<'a> Search<'a> {
    /// `bvh`: the tree over `high`.
    pub(crate) fn new(high: &'a Mesh, bvh: Arc<Bvh>, low: &Mesh, options: &BakeOptions) -> Search<'a> {
        let named = |l: &kiln_asset::Submesh| high.submeshes.iter().position(|h| h.name == l.name);
        let same = low.submeshes.iter().map(|l| named(l).map(|s| SubmeshId(s as u32))).collect();
        Search { high, bvh, hit: options.hit, back_faces: options.back_faces, matching: options.matching, same }
    }

    /// Corners of a high face relative to `base`.
    #[inline]
    pub(crate) fn corners(&self, high: u32, base: DVec3) -> [DVec3; 3] {
        self.high.face_positions(FaceId(high)).map(|p| p.as_dvec3() - base)
    }

    /// The candidates of a low face for the samples in `rect`, ascending by high face.
    pub(crate) fn gather(
        &self,
        low: &Low<'_>,
        face: usize,
        lines: &Lines,
        rect: Rect,
        found: &mut Vec<u32>,
        out: &mut Vec<Candidate>,
    ) {
        out.clear();
        let Some(rect) = bounds(low, face, rect) else { return };
        let (points, axes) = hull(low, lines, rect);
        self.bvh.overlapping_hull(&points, &axes, found);
        let same = self.same[low.mesh.face_submesh[face].index()];
        let edges = Side::of(low, face);
        for high in found.iter().copied() {
            let fallback = match self.matching {
                Matching::Any => false,
                Matching::Prefer => same.is_some_and(|s| s != self.high.face_submesh[high as usize]),
                Matching::Name if same != Some(self.high.face_submesh[high as usize]) => continue,
                Matching::Name => false,
            };
            let corners = self.corners(high, lines.base);
            if !self.back_faces && lines.behind(&corners) {
                continue;
            }
            let Some([lo, hi]) = lines.places(&corners) else { continue };
            // The first sample whose centre lies at or behind a place, and the first behind it.
            let after = |c: f64, k: usize, slack: f64| {
                let at = (c + f64::from(lines.pixel[k])) * f64::from(low.samples) - 0.5 + slack;
                let whole = at.max(0.0) as u32;
                whole + u32::from(f64::from(whole) < at)
            };
            let first = |c: f64, k: usize| after(c, k, -SLACK);
            let end = |c: f64, k: usize| after(c, k, SLACK);
            let samples = Rect {
                x0: first(lo.x, 0).max(rect.x0),
                y0: first(lo.y, 1).max(rect.y0),
                x1: end(hi.x, 0).min(rect.x1),
                y1: end(hi.y, 1).min(rect.y1),
            };
            if samples.x0 < samples.x1 && samples.y0 < samples.y1 && edges.iter().all(|e| e.reaches(&samples)) {
                out.push(Candidate { high, fallback, samples });
            }
        }
    }

    /// `winners` becomes `[rows x columns]` of `rect`: high face + 1 of the best hit, 0 = none. `owners` as [`super::sheet::Sheet::own`]
    /// makes them from `faces`. The number of candidates looked at.
    pub(crate) fn find(
        &self,
        low: &Low<'_>,
        faces: &[u32],
        rect: Rect,
        owners: &[u32],
        winners: &mut Vec<u32>,
        scratch: &mut Scratch,
    ) -> u64 {
        winners.clear();
        winners.resize(owners.len(), 0);
        scratch.keys.clear();
        scratch.keys.resize(owners.len(), f64::INFINITY);
        scratch.met.resize(owners.len(), [0.0; 2]);
        let mut pairs = 0;
        for face in faces.iter().map(|f| *f as usize) {
            let Some(lines) = low.lines(face) else { continue };
            let Scratch { found, candidates, keys, met } = scratch;
            self.gather(low, face, &lines, rect, found, candidates);
            pairs += candidates.len() as u64;
            let mut bin = Bin { rect, owner: face as u32 + 1, samples: low.samples, owners, winners, keys, met };
            for candidate in candidates.iter().filter(|c| !c.fallback) {
                self.draw(&lines, candidate, &mut bin);
            }
            if candidates.iter().any(|c| c.fallback) && bin.close(bounds(low, face, rect)) {
                for candidate in candidates.iter().filter(|c| c.fallback) {
                    self.draw(&lines, candidate, &mut bin);
                }
            }
        }
        pairs
    }

    #[inline]
    fn draw(&self, lines: &Lines, candidate: &Candidate, bin: &mut Bin<'_>) {
        let target = Target::new(lines, self.corners(candidate.high, lines.base));
        let Rect { x0, y0, x1, y1 } = candidate.samples;
        let width = (bin.rect.x1 - bin.rect.x0) as usize;
        let step = 1.0 / f64::from(bin.samples);
        let corner = lines.place([x0, y0], bin.samples);
        let first = corner.x;
        let spans = Spans::new(&target, corner, step, [x1 - x0, y1 - y0]);
        for y in y0..y1 {
            let v = corner.y + f64::from(y - y0) * step;
            let (from, to) = if self.back_faces { (0, x1 - x0) } else { spans.at(v, step, x1 - x0) };
            if from >= to {
                continue;
            }
            // In one row the edges are quadratics in x.
            let row = |e: &[f64; 6]| [e[0] + v * (e[2] + v * e[5]), e[1] + v * e[4], e[3]];
            let [a, b, c] = [row(&target.edges[0]), row(&target.edges[1]), row(&target.edges[2])];
            let height = target.height[0] + target.height[2] * v;
            let start = (y - bin.rect.y0) as usize * width + (x0 - bin.rect.x0) as usize;
            for k in from..to {
                let index = start + k as usize;
                let u = first + f64::from(k) * step;
                let value = |e: &[f64; 3]| e[0] + u * (e[1] + u * e[2]);
                let (ea, eb, ec) = (value(&a), value(&b), value(&c));
                let sum = ea + eb + ec;
                let inside = if sum > 0.0 {
                    ea.min(eb).min(ec) >= -target.open
                } else {
                    self.back_faces && ea.max(eb).max(ec) <= target.open
                };
                // Edge on: no meeting point worth its name.
                if !inside || sum.abs() <= 3.0 * target.open || bin.owners[index] != bin.owner {
                    continue;
                }
                let t = (height + target.height[1] * u) / sum;
                let at = DVec2::new(u, v);
                let (_, direction) = lines.line(at);
                let [front, back] = lines.limits(at, direction.length());
                if !(t <= front && -t <= back) {
                    continue;
                }
                let key = match self.hit {
                    HitRule::Outermost => -t,
                    HitRule::Nearest => t.abs(),
                };
                // Candidates ascend, so of equals the lower face stays.
                if key < bin.keys[index] {
                    bin.keys[index] = key;
                    bin.winners[index] = candidate.high + 1;
                    let share = 1.0 / sum;
                    bin.met[index] = [(ea * share) as f32, (eb * share) as f32];
                }
            }
        }
    }
}

/// Where in each row of a box of samples a triangle can lie. Over the box an edge's quadratic is its tangent plane at the middle and at
/// most a little more; where that is negative, so is the edge.
struct Spans {
    /// Half of a row's length, places.
    half: f64,
    /// The middle's y.
    middle: f64,
    /// For each edge the x (from the middle) at which its bound changes sign, in the middle row, and its change with y.
    roots: [[f64; 2]; 3],
    /// Whether the bound is positive right of the root; `None`: it says nothing about x.
    right: [Option<bool>; 3],
}

impl Spans {
    /// `first`: the place of the box's first sample; `step`: from sample to sample; `count`: columns and rows.
    fn new(target: &Target, first: DVec2, step: f64, count: [u32; 2]) -> Spans {
        let half = [0.5 * f64::from(count[0]) * step, 0.5 * f64::from(count[1]) * step];
        let (x, y) = (first.x + half[0] - 0.5 * step, first.y + half[1] - 0.5 * step);
        let (mut roots, mut right) = ([[0.0; 2]; 3], [None; 3]);
        for (k, e) in target.edges.iter().enumerate() {
            let slack = e[3].abs() * half[0] * half[0]
                + e[4].abs() * half[0] * half[1]
                + e[5].abs() * half[1] * half[1]
                + target.open;
            let value = e[0] + y * (e[2] + y * e[5]) + x * (e[1] + y * e[4] + x * e[3]) + slack;
            let (along, down) = (e[1] + 2.0 * e[3] * x + e[4] * y, e[2] + 2.0 * e[5] * y + e[4] * x);
            let inverse = -1.0 / along;
            if inverse.is_finite() {
                roots[k] = [value * inverse, down * inverse];
                right[k] = Some(along > 0.0);
            }
        }
        Spans { half: half[0], middle: y, roots, right }
    }

    /// The first sample of the row at `y` and one behind the last that the triangle can reach.
    #[inline]
    fn at(&self, y: f64, step: f64, count: u32) -> (u32, u32) {
        let (mut from, mut to) = (-self.half, self.half);
        let row = y - self.middle;
        for ([root, change], right) in self.roots.iter().zip(self.right) {
            let root = root + change * row;
            match right {
                Some(true) => from = if root > from { root } else { from },
                Some(false) => to = if root < to { root } else { to },
                None => {}
            }
        }
        // A sample more on either side for what rounding does to the roots. Casts saturate.
        let (from, to) = ((from + self.half) / step - 0.5, (to + self.half) / step + 1.5);
        (from as u32, (to as u32).min(count))
    }
}

/// The inner side of an edge of a low face on the sheet of samples: `a x + b y + c >= 0`.
struct Side {
    a: f64,
    b: f64,
    c: f64,
}

impl Side {
    fn of(low: &Low<'_>, face: usize) -> [Side; 3] {
        let corners = low.texels(face).map(|t| t.as_dvec2() * f64::from(low.samples));
        let turn = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]).signum();
        std::array::from_fn(|k| {
            let (p, q) = (corners[k], corners[(k + 1) % 3]);
            let (a, b) = (-turn * (q.y - p.y), turn * (q.x - p.x));
            // Owners come from corners rounded to 1/256 sample.
            Side { a, b, c: -(a * p.x + b * p.y) + (a.abs() + b.abs()) / 64.0 }
        })
    }

    /// Whether a sample of `rect` may lie on it.
    fn reaches(&self, rect: &Rect) -> bool {
        let x = f64::from(if self.a > 0.0 { rect.x1 } else { rect.x0 });
        let y = f64::from(if self.b > 0.0 { rect.y1 } else { rect.y0 });
        self.a * x + self.b * y + self.c >= 0.0
    }
}

/// The samples at work.
struct Bin<'a> {
    rect: Rect,
    owner: u32,
    samples: u32,
    owners: &'a [u32],
    winners: &'a mut Vec<u32>,
    keys: &'a mut Vec<f64>,
    met: &'a mut Vec<[f32; 2]>,
}

impl Bin<'_> {
    /// From here on nothing beats what the face's samples have. Whether any has nothing yet.
    fn close(&mut self, bounds: Option<Rect>) -> bool {
        let Some(Rect { x0, y0, x1, y1 }) = bounds else { return false };
        let width = (self.rect.x1 - self.rect.x0) as usize;
        let mut open = false;
        for y in (y0 - self.rect.y0) as usize..(y1 - self.rect.y0) as usize {
            for index in y * width + (x0 - self.rect.x0) as usize..y * width + (x1 - self.rect.x0) as usize {
                if self.owners[index] != self.owner {
                    continue;
                }
                if self.winners[index] == 0 {
                    open = true;
                } else {
                    self.keys[index] = f64::NEG_INFINITY;
                }
            }
        }
        open
    }
}

/// The samples of `rect` that a face can own.
pub(crate) fn bounds(low: &Low<'_>, face: usize, rect: Rect) -> Option<Rect> {
    let [a, b, c] = low.texels(face).map(|t| t * low.samples as f32);
    let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
    let bounds = Rect {
        x0: ((lo.x - 1.0).max(0.0) as u32).max(rect.x0),
        y0: ((lo.y - 1.0).max(0.0) as u32).max(rect.y0),
        x1: ((hi.x + 1.0).max(0.0) as u32).min(rect.x1),
        y1: ((hi.y + 1.0).max(0.0) as u32).min(rect.y1),
    };
    (bounds.x0 < bounds.x1 && bounds.y0 < bounds.y1).then_some(bounds)
}

/// Points whose hull holds all lines of the samples in `rect` within reach, and directions along which it may be thin.
fn hull(low: &Low<'_>, lines: &Lines, rect: Rect) -> ([glam::Vec3; 8], [glam::Vec3; 4]) {
    let ends = |o: DVec3, d: DVec3| [-lines.reach[1], lines.reach[0]].map(|t| (lines.base + o + t * d).as_vec3());
    let side = |along: DVec3, d: DVec3| along.cross(d).normalize_or_zero().as_vec3();
    let normal = lines.normal.as_vec3();
    let texels = f64::from((rect.x1 - rect.x0) * (rect.y1 - rect.y0)) / f64::from(low.samples * low.samples);
    if texels <= lines.texel_area {
        // A part of a large face: lines are linear in the place, so those of the corners enclose the others.
        let half = 0.5 / f64::from(low.samples);
        let [a, b] = [[rect.x0, rect.y0], [rect.x1, rect.y1]].map(|s| lines.place(s, low.samples) - half);
        let corners = [a, DVec2::new(b.x, a.y), DVec2::new(a.x, b.y), b].map(|place| lines.line(place));
        let points = corners.map(|(o, d)| ends(o, d));
        let [(o, d), (right, _), (down, _), _] = corners;
        let axes = [normal, side(right - o, d), side(down - o, d), glam::Vec3::ZERO];
        return (std::array::from_fn(|k| points[k / 2][k % 2]), axes);
    }
    let [p0, p1, p2] = lines.corners;
    let [d0, d1, d2] = lines.corner_directions;
    let points = [ends(p0, d0), ends(p1, d1), ends(p2, d2), ends(p2, d2)];
    let axes = [normal, side(p1 - p0, d0 + d1), side(p2 - p1, d1 + d2), side(p0 - p2, d2 + d0)];
    (std::array::from_fn(|k| points[k / 2][k % 2]), axes)
}
