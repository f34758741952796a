//! Nearest points by branch and bound.
//!
//! Neighbouring places have the same nearest triangle or almost: a [`Hint`] carries the last answer to the next query, which
//! then starts with that triangle's distance as its bound. The hint changes no answer.

use glam::{DVec3, Vec3};

use super::{Bvh, NearestPoint, Node, Stack};
use crate::triangle::{Closest, closest_point};

/// Where the last query of a row of queries ended.
#[derive(Clone, Copy, Debug, Default)]
pub struct Hint {
    /// In tree order.
    position: u32,
}

/// Most subtrees in a [`Nearby`]: more make a sweep longer, fewer the way down from there.
const NEARBY: usize = 24;

/// Subtrees that hold all that is near a small box: where a row of queries looks first. Boxes lie by coordinate, for sweeps
/// without branches.
#[derive(Clone, Debug)]
pub struct Nearby {
    count: usize,
    nodes: [u32; NEARBY],
    lo: [[f32; NEARBY]; 3],
    hi: [[f32; NEARBY]; 3],
    /// Scratch: of each box, no more than the square of its distance.
    squares: [f32; NEARBY],
}

impl Default for Nearby {
    fn default() -> Nearby {
        Nearby { count: 0, nodes: [0; NEARBY], lo: [[0.0; NEARBY]; 3], hi: [[0.0; NEARBY]; 3], squares: [0.0; NEARBY] }
    }
}

/// The nearest so far.
#[derive(Clone, Copy)]
struct Best {
    closest: Closest,
    /// In tree order.
    position: u32,
}

impl Bvh {
    /// The point of the surface nearest to `p` (object space); at equal distance the lower face. `None`: no triangles, or
    /// `p` is not finite.
    pub fn nearest_point(&self, p: Vec3) -> Option<NearestPoint> {
        self.nearest_point_within(p, f32::INFINITY)
    }

    /// [`Bvh::nearest_point`] no further away than `limit` (object units, inclusive); a small limit makes it fast.
    pub fn nearest_point_within(&self, p: Vec3, limit: f32) -> Option<NearestPoint> {
        if !p.is_finite() {
            return None;
        }
        let best = self.search(p, 0, limit as f64 * limit as f64, None, -1.0)?;
        Some(self.answer(&best))
    }

    /// [`Bvh::nearest_point`], faster where `p` lies near the place of the query before.
    pub fn nearest_point_from(&self, p: Vec3, hint: &mut Hint) -> Option<NearestPoint> {
        if !p.is_finite() {
            return None;
        }
        let start = self.start(p.as_dvec3(), *hint)?;
        let best = self.search(p, 0, start.closest.distance_squared, Some(start), -1.0)?;
        hint.position = best.position;
        Some(self.answer(&best))
    }

    /// Whether any triangle lies within `limit` (object units, inclusive) of `p` (object space).
    pub fn is_within(&self, p: Vec3, limit: f32, hint: &mut Hint) -> bool {
        let enough = limit as f64 * limit as f64;
        let Some(start) = self.start(p.as_dvec3(), *hint).filter(|_| p.is_finite()) else { return false };
        if start.closest.distance_squared <= enough {
            return true;
        }
        // A small ball meets few boxes, a large one is soon over.
        let found = self.search(p, 0, enough, None, enough);
        hint.position = found.map_or(hint.position, |best| best.position);
        found.is_some()
    }

    /// Fills `nearby` with the smallest subtrees that hold all triangles within `limit` (object units) of the box from `lo` to `hi`
    /// (object space).
    pub fn gather(&self, lo: Vec3, hi: Vec3, limit: f32, nearby: &mut Nearby) {
        let enough = limit as f64 * limit as f64;
        // What compares to nothing (NaN) counts as near.
        let is_far = |node: u32| between(&self.nodes[node as usize], lo, hi) as f64 > enough;
        nearby.count = self.nodes.len().min(1);
        nearby.nodes[0] = 0;
        // Round by round, so that all grow equally deep.
        let mut deeper = true;
        while deeper {
            deeper = false;
            let mut k = 0;
            while k < nearby.count {
                let node = &self.nodes[nearby.nodes[k] as usize];
                if node.count > 0 {
                    k += 1;
                    continue;
                }
                match (is_far(node.first), is_far(node.first + 1)) {
                    (true, true) => {
                        nearby.count -= 1;
                        nearby.nodes[k] = nearby.nodes[nearby.count];
                        continue;
                    }
                    (false, true) => nearby.nodes[k] = node.first,
                    (true, false) => nearby.nodes[k] = node.first + 1,
                    (false, false) if nearby.count < NEARBY => {
                        nearby.nodes[k] = node.first;
                        nearby.nodes[nearby.count] = node.first + 1;
                        nearby.count += 1;
                    }
                    (false, false) => {
                        k += 1;
                        continue;
                    }
                }
                deeper = true;
                k += 1;
            }
        }
        for (k, node) in nearby.nodes[..nearby.count].iter().enumerate() {
            let node = &self.nodes[*node as usize];
            for axis in 0..3 {
                nearby.lo[axis][k] = node.lo[axis];
                nearby.hi[axis][k] = node.hi[axis];
            }
        }
    }

    /// The distance from `p` (object space) to the surface if it is greater than `limit` (object units), else `None`: that is known
    /// as soon as any triangle is found within the limit. `None` too for no triangles, or if `p` is not finite.
    ///
    /// `nearby` is where such a triangle is looked for: a wrong one makes it slow, not wrong.
    pub fn distance_beyond(&self, p: Vec3, limit: f32, nearby: &mut Nearby, hint: &mut Hint) -> Option<f32> {
        if !p.is_finite() {
            return None;
        }
        // The square of an f32 is exact in f64, so this decides as the rounded distances would.
        let enough = limit as f64 * limit as f64;
        let at = |position: u32| {
            let [a, b, c] = self.corners[position as usize];
            closest_point(p.as_dvec3(), a.as_dvec3(), b.as_dvec3(), c.as_dvec3()).distance_squared <= enough
        };
        let is_near = |position: u32| around(self.corners[position as usize], p) as f64 <= enough && at(position);
        if is_near((hint.position).min(self.corners.len().checked_sub(1)? as u32)) {
            return None;
        }
        nearby.sweep(p);
        for k in 0..nearby.count {
            if nearby.squares[k] as f64 > enough {
                continue;
            }
            // Nearly always a leaf: no need of a stack.
            let Node { first, count, .. } = self.nodes[nearby.nodes[k] as usize];
            let found = match count {
                0 => self.search(p, nearby.nodes[k], enough, None, enough).map(|best| best.position),
                _ => (first..first + count).find(|position| is_near(*position)),
            };
            if let Some(position) = found {
                hint.position = position;
                return None;
            }
        }
        let start = self.start(p.as_dvec3(), *hint)?;
        let best = self.search(p, 0, start.closest.distance_squared, Some(start), enough)?;
        hint.position = best.position;
        let distance = best.closest.distance_squared.sqrt() as f32;
        (distance > limit).then_some(distance)
    }

    /// The faces in the tree's order: neighbours in it are neighbours in space.
    pub fn order(&self) -> &[u32] {
        &self.faces
    }

    /// The faces in what was gathered, for the tests.
    #[cfg(test)]
    pub(super) fn gathered(&self, nearby: &Nearby) -> Vec<u32> {
        let mut below = nearby.nodes[..nearby.count].to_vec();
        let mut faces = Vec::new();
        while let Some(node) = below.pop() {
            let Node { first, count, .. } = self.nodes[node as usize];
            match count {
                0 => below.extend([first, first + 1]),
                _ => faces.extend_from_slice(&self.faces[first as usize..(first + count) as usize]),
            }
        }
        faces
    }

    fn start(&self, place: DVec3, hint: Hint) -> Option<Best> {
        let last = self.corners.len().checked_sub(1)?;
        let position = (hint.position as usize).min(last);
        let [a, b, c] = self.corners[position];
        let closest = closest_point(place, a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
        Some(Best { closest, position: position as u32 })
    }

    fn answer(&self, best: &Best) -> NearestPoint {
        let Closest { point, bary, distance_squared } = best.closest;
        NearestPoint {
            face: self.faces[best.position as usize],
            point: point.as_vec3(),
            bary: bary.map(|w| w as f32),
            distance: distance_squared.sqrt() as f32,
        }
    }

    /// Below `root` the nearest triangle whose square distance is at most `bound`, at equal distance the lower face; the first
    /// one found whose square distance is at most `enough`.
    fn search(&self, p: Vec3, root: u32, mut bound: f64, mut best: Option<Best>, enough: f64) -> Option<Best> {
        if self.nodes.is_empty() {
            return best;
        }
        let place = p.as_dvec3();
        let mut stack: Stack<(u32, f32)> = Stack::new();
        stack.push((root, 0.0));
        while let Some((mut index, lower)) = stack.pop() {
            if lower as f64 > bound {
                continue;
            }
            loop {
                let node = &self.nodes[index as usize];
                if node.count > 0 {
                    for position in node.first..node.first + node.count {
                        let corners = self.corners[position as usize];
                        if around(corners, p) as f64 > bound {
                            continue;
                        }
                        let [a, b, c] = corners;
                        let found = closest_point(place, a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
                        let face = self.faces[position as usize];
                        let better = match &best {
                            _ if found.distance_squared > bound => false,
                            None => true,
                            Some(old) => {
                                let old_face = self.faces[old.position as usize];
                                (found.distance_squared, face) < (old.closest.distance_squared, old_face)
                            }
                        };
                        if better {
                            bound = found.distance_squared;
                            best = Some(Best { closest: found, position });
                            if bound <= enough {
                                return best;
                            }
                        }
                    }
                    break;
                }
                // Written out: as a map over [0, 1] it is not inlined, and a third of the time goes into calls.
                let (a, b) = (&self.nodes[node.first as usize], &self.nodes[node.first as usize + 1]);
                let (a, b) = (lower_bound(a, p), lower_bound(b, p));
                let (nearer, least, other) = if b < a { (1, b, a) } else { (0, a, b) };
                if least as f64 > bound {
                    break;
                }
                if other as f64 <= bound {
                    stack.push((node.first + (1 - nearer), other));
                }
                index = node.first + nearer;
            }
        }
        best
    }
}

impl Nearby {
    /// For each box no more than the square of its distance from `p`.
    fn sweep(&mut self, p: Vec3) {
        let Nearby { count, lo: [lx, ly, lz], hi: [hx, hy, hz], squares, .. } = self;
        // In fours: the tail holds whatever was there before, and nobody reads it.
        for k in 0..count.next_multiple_of(4).min(NEARBY) {
            let x = more(more(lx[k] - p.x, p.x - hx[k]), 0.0);
            let y = more(more(ly[k] - p.y, p.y - hy[k]), 0.0);
            let z = more(more(lz[k] - p.z, p.z - hz[k]), 0.0);
            squares[k] = (x * x + y * y + z * z) * LESS;
        }
    }
}

/// What five roundings of f32 may add, taken off.
const LESS: f32 = 1.0 - 5.0 * f32::EPSILON;

#[inline]
fn more(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline]
fn less(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// No more than the square of the distance from `p` to the box.
#[inline]
fn lower_bound(node: &Node, p: Vec3) -> f32 {
    between(node, p, p)
}

/// No more than the square of the distance between the node's box and the one from `lo` to `hi`.
#[inline]
fn between(node: &Node, lo: Vec3, hi: Vec3) -> f32 {
    let gap = |own_lo: f32, own_hi: f32, lo: f32, hi: f32| more(more(own_lo - hi, lo - own_hi), 0.0);
    let x = gap(node.lo.x, node.hi.x, lo.x, hi.x);
    let y = gap(node.lo.y, node.hi.y, lo.y, hi.y);
    let z = gap(node.lo.z, node.hi.z, lo.z, hi.z);
    (x * x + y * y + z * z) * LESS
}

/// No more than the square of the distance from `p` to the box around a triangle: a tenth of the work of the triangle itself.
#[inline]
fn around([a, b, c]: [Vec3; 3], p: Vec3) -> f32 {
    let gap = |a: f32, b: f32, c: f32, p: f32| more(more(less(less(a, b), c) - p, p - more(more(a, b), c)), 0.0);
    let (x, y, z) = (gap(a.x, b.x, c.x, p.x), gap(a.y, b.y, c.y, p.y), gap(a.z, b.z, c.z, p.z));
    (x * x + y * y + z * z) * LESS
}
