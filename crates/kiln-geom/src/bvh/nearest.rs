//! Nearest points by branch and bound.

use glam::Vec3;

use super::{Bvh, NearestPoint, Node, Stack};
use crate::triangle::{Closest, closest_point};

impl Bvh {
    /// The point of the surface nearest to `p` (object space); at equal distance the lower face. `None`: no triangles, or
    /// `p` is not finite.
    pub fn nearest_point(&self, p: Vec3) -> Option<NearestPoint> {
        self.nearest_point_within(p, f32::INFINITY)
    }

    /// [`Bvh::nearest_point`] no further away than `limit` (object units, inclusive); a small limit makes it fast.
    pub fn nearest_point_within(&self, p: Vec3, limit: f32) -> Option<NearestPoint> {
        if !p.is_finite() || self.nodes.is_empty() {
            return None;
        }
        let place = p.as_dvec3();
        let mut bound = limit as f64 * limit as f64;
        let mut best: Option<(Closest, u32)> = None;
        let mut stack: Stack<(u32, f32)> = Stack::new();
        stack.push((0, 0.0));
        while let Some((mut index, lower)) = stack.pop() {
            if lower as f64 > bound {
                continue;
            }
            loop {
                let node = &self.nodes[index as usize];
                if node.count > 0 {
                    for position in node.first as usize..(node.first + node.count) as usize {
                        let [a, b, c] = self.corners[position].map(Vec3::as_dvec3);
                        let found = closest_point(place, a, b, c);
                        let face = self.faces[position];
                        let better = match &best {
                            _ if found.distance_squared > bound => false,
                            None => true,
                            Some((old, old_face)) => (found.distance_squared, face) < (old.distance_squared, *old_face),
                        };
                        if better {
                            bound = found.distance_squared;
                            best = Some((found, face));
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
        best.map(|(found, face)| NearestPoint {
            face,
            point: found.point.as_vec3(),
            bary: found.bary.map(|w| w as f32),
            distance: found.distance_squared.sqrt() as f32,
        })
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
