//! Lines against triangles, watertight.

use glam::{DVec3, Vec3};

use super::{Bvh, LineHit, Node, Stack};

/// How far boxes are widened for a line, in units of the largest coordinate of line and mesh: 32 roundings of f32. The slab
/// test makes at most 8, the triangle test moves a hit by at most 7.
const WIDENING: f32 = 1.0 / (1 << 19) as f32;

/// A line made ready for slabs and triangles.
struct Line {
    /// Origin moved outwards, for the boxes' lower and upper sides.
    to_lo: Vec3,
    to_hi: Vec3,
    /// One over the direction scaled to a largest component of 1; never infinite.
    inverse: Vec3,
    origin: DVec3,
    /// The largest component's axis, then the next two in cyclic order.
    axes: [usize; 3],
    /// Direction along `axes[1]` and `axes[2]` for one unit along `axes[0]`.
    shear: [f64; 2],
    /// `t` for one unit along `axes[0]`.
    along: f64,
    /// From `t` of the given direction to `t` of the scaled one.
    t_scale: f32,
}

impl Line {
    /// `None`: no direction.
    fn new(origin: Vec3, direction: Vec3, reach: f32) -> Option<Line> {
        let size = direction.abs().max_element();
        if !(size > 0.0 && size.is_finite() && origin.is_finite() && direction.is_finite()) {
            return None;
        }
        let axis = if direction.x.abs() == size { 0 } else { if direction.y.abs() == size { 1 } else { 2 } };
        let axes = [axis, (axis + 1) % 3, (axis + 2) % 3];
        let d = direction.as_dvec3();
        let unit = d / size as f64;
        // A component too small to matter over any reach stands for 0: no division gives infinity, so no 0 * inf.
        let inverse = unit.map(|c| 1.0 / if c.abs() < 1e-30 { 1e-30 } else { c }).as_vec3();
        let pad = Vec3::splat(WIDENING * reach.max(origin.abs().max_element()));
        Some(Line {
            to_lo: origin + pad,
            to_hi: origin - pad,
            inverse,
            origin: origin.as_dvec3(),
            axes,
            shear: [d[axes[1]] / d[axis], d[axes[2]] / d[axis]],
            along: 1.0 / d[axis],
            t_scale: size,
        })
    }

    /// Where the line enters the widened box, in scaled `t`; `None` if it passes by. Never later than any hit inside.
    #[inline]
    fn enter(&self, node: &Node, near: f32, far: f32) -> Option<f32> {
        let low = (node.lo - self.to_lo) * self.inverse;
        let high = (node.hi - self.to_hi) * self.inverse;
        // Plain comparisons compile to single instructions; there are no NaNs to care for.
        let less = |a: f32, b: f32| if a < b { a } else { b };
        let more = |a: f32, b: f32| if a > b { a } else { b };
        let enter = more(more(less(low.x, high.x), less(low.y, high.y)), more(less(low.z, high.z), near));
        let leave = less(less(more(low.x, high.x), more(low.y, high.y)), less(more(low.z, high.z), far));
        (enter <= leave).then_some(enter)
    }

    /// The meeting point with a triangle anywhere on the line.
    #[inline]
    fn meet(&self, corners: &[Vec3; 3]) -> Option<(f32, [f64; 3])> {
        let [k, i, j] = self.axes;
        let shifted = corners.map(|c| c.as_dvec3() - self.origin);
        // Rounded once, per corner: triangles that share a corner see it at the same place, so no gap opens between them.
        let [a, b, c] = shifted.map(|p| {
            let depth = p[k];
            [(p[i] - self.shear[0] * depth) as f32 as f64, (p[j] - self.shear[1] * depth) as f32 as f64]
        });
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        if sum == 0.0 {
            return None;
        }
        let bary = [u / sum, v / sum, w / sum];
        let depth = bary[0] * shifted[0][k] + bary[1] * shifted[1][k] + bary[2] * shifted[2][k];
        Some(((depth * self.along) as f32, bary))
    }
}

impl Bvh {
    /// Every triangle that the line `origin + t direction`, `t` in `[t_min, t_max]`, meets, in any order; both facings.
    /// Watertight: a line through an edge or a corner that faces share meets at least one of them. `t` is in units of the
    /// direction's length and may be negative or infinite; a direction of zero length meets nothing.
    pub fn line_hits(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32, mut visit: impl FnMut(LineHit)) {
        let Some(line) = Line::new(origin, direction, self.reach) else { return };
        let (near, far) = line.range(t_min, t_max);
        self.descend(
            |node| line.enter(node, near, far).is_some(),
            |position| {
                if let Some((t, bary)) = line.meet(&self.corners[position])
                    && (t_min..=t_max).contains(&t)
                {
                    visit(LineHit { face: self.faces[position], t, bary: bary.map(|w| w as f32) });
                }
            },
        );
    }

    /// The hit with the least `t` of those that [`Bvh::line_hits`] finds; at equal `t` the lower face.
    pub fn closest_hit(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Option<LineHit> {
        let line = Line::new(origin, direction, self.reach)?;
        let (near, mut far) = line.range(t_min, t_max);
        let mut best: Option<(f32, u32, [f64; 3])> = None;
        let mut stack: Stack<(u32, f32)> = Stack::new();
        stack.push((0, line.enter(self.nodes.first()?, near, far)?));
        while let Some((mut index, enter)) = stack.pop() {
            if enter > far {
                continue;
            }
            loop {
                let node = &self.nodes[index as usize];
                if node.count > 0 {
                    for position in node.first as usize..(node.first + node.count) as usize {
                        let Some((t, bary)) = line.meet(&self.corners[position]) else { continue };
                        let face = self.faces[position];
                        if (t_min..=t_max).contains(&t) && best.is_none_or(|(bt, bf, _)| (t, face) < (bt, bf)) {
                            best = Some((t, face, bary));
                            far = line.range(t, t).1;
                        }
                    }
                    break;
                }
                let enter = [0, 1].map(|k| line.enter(&self.nodes[(node.first + k) as usize], near, far));
                match enter {
                    [Some(a), Some(b)] => {
                        let nearer = u32::from(b < a);
                        stack.push((node.first + (1 - nearer), if nearer == 0 { b } else { a }));
                        index = node.first + nearer;
                    }
                    [Some(_), None] => index = node.first,
                    [None, Some(_)] => index = node.first + 1,
                    [None, None] => break,
                }
            }
        }
        best.map(|(t, face, bary)| LineHit { face, t, bary: bary.map(|w| w as f32) })
    }
}

impl Bvh {
    /// Whether [`Bvh::line_hits`] finds any hit: ends at the first one met.
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> bool {
        let Some(line) = Line::new(origin, direction, self.reach) else { return false };
        let (near, far) = line.range(t_min, t_max);
        let mut stack: Stack<u32> = Stack::new();
        if self.nodes.first().is_some_and(|root| line.enter(root, near, far).is_some()) {
            stack.push(0);
        }
        while let Some(mut index) = stack.pop() {
            loop {
                let node = &self.nodes[index as usize];
                if node.count > 0 {
                    let own = &self.corners[node.first as usize..(node.first + node.count) as usize];
                    if own.iter().any(|corners| line.meet(corners).is_some_and(|(t, _)| (t_min..=t_max).contains(&t))) {
                        return true;
                    }
                    break;
                }
                let enter = [0, 1].map(|k| line.enter(&self.nodes[(node.first + k) as usize], near, far));
                match enter {
                    // The nearer box first: what stands close hides most.
                    [Some(a), Some(b)] => {
                        let nearer = u32::from(b < a);
                        stack.push(node.first + (1 - nearer));
                        index = node.first + nearer;
                    }
                    [Some(_), None] => index = node.first,
                    [None, Some(_)] => index = node.first + 1,
                    [None, None] => break,
                }
            }
        }
        false
    }
}

impl Line {
    /// A range of `t` in scaled units, opened by a few roundings so that a hit at its very end is inside.
    fn range(&self, t_min: f32, t_max: f32) -> (f32, f32) {
        let open = 4.0 * f32::EPSILON;
        let (near, far) = (t_min * self.t_scale, t_max * self.t_scale);
        (near - near.abs() * open, far + far.abs() * open)
    }
}
