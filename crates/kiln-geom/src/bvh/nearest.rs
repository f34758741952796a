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
        let best = self.search(p, limit as f64 * limit as f64, None, -1.0)?;
        Some(self.answer(&best))
    }

    /// [`Bvh::nearest_point`], faster where `p` lies near the place of the query before.
    pub fn nearest_point_from(&self, p: Vec3, hint: &mut Hint) -> Option<NearestPoint> {
        if !p.is_finite() {
            return None;
        }
        let start = self.start(p.as_dvec3(), *hint)?;
        let best = self.search(p, start.closest.distance_squared, Some(start), -1.0)?;
        hint.position = best.position;
        Some(self.answer(&best))
    }

    /// The distance from `p` (object space) to the surface if it is greater than `limit` (object units), else `None`: that is known
    /// as soon as any triangle is found within the limit. `None` too for no triangles, or if `p` is not finite.
    pub fn distance_beyond(&self, p: Vec3, limit: f32, hint: &mut Hint) -> Option<f32> {
        if !p.is_finite() {
            return None;
        }
        // The square of an f32 is exact in f64, so this decides as the rounded distances would.
        let enough = limit as f64 * limit as f64;
        let start = self.start(p.as_dvec3(), *hint)?;
        if start.closest.distance_squared <= enough {
            return None;
        }
        let best = self.search(p, start.closest.distance_squared, Some(start), enough)?;
        hint.position = best.position;
        let distance = best.closest.distance_squared.sqrt() as f32;
        (distance > limit).then_some(distance)
    }

    fn start(&self, place: DVec3, hint: Hint) -> Option<Best> {
        let last = self.corners.len().checked_sub(1)?;
        let position = (hint.position as usize).min(last);
        let [a, b, c] = self.corners[position].map(Vec3::as_dvec3);
        Some(Best { closest: closest_point(place, a, b, c), position: position as u32 })
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

    /// The nearest triangle whose square distance is at most `bound`, at equal distance the lower face; the first one found
    /// whose square distance is at most `enough`.
    fn search(&self, p: Vec3, mut bound: f64, mut best: Option<Best>, enough: f64) -> Option<Best> {
        if self.nodes.is_empty() {
            return best;
        }
        let place = p.as_dvec3();
        let mut stack: Stack<(u32, f32)> = Stack::new();
        stack.push((0, 0.0));
        while let Some((mut index, lower)) = stack.pop() {
            if lower as f64 > bound {
                continue;
            }
            loop {
                let node = &self.nodes[index as usize];
                if node.count > 0 {
                    for position in node.first..node.first + node.count {
                        let [a, b, c] = self.corners[position as usize].map(Vec3::as_dvec3);
                        let found = closest_point(place, a, b, c);
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
                let [a, b] = [0, 1].map(|k| lower_bound(&self.nodes[(node.first + k) as usize], p));
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

/// No more than the square of the distance from `p` to the box: five roundings of f32 are taken off.
#[inline]
fn lower_bound(node: &Node, p: Vec3) -> f32 {
    let more = |a: f32, b: f32| if a > b { a } else { b };
    let outside = |lo: f32, p: f32, hi: f32| more(more(lo - p, p - hi), 0.0);
    let (x, y, z) =
        (outside(node.lo.x, p.x, node.hi.x), outside(node.lo.y, p.y, node.hi.y), outside(node.lo.z, p.z, node.hi.z));
    (x * x + y * y + z * z) * (1.0 - 5.0 * f32::EPSILON)
}
