//! The one BVH: lines, nearest points, boxes and prisms against the triangles of a mesh.
//!
//! Comes in: positions and triangles, copied once in tree order. Goes out: faces by their index in the input. Nothing that a
//! query should find is lost to rounding, and no answer depends on the tree's shape but the order of `line_hits`.
//!
//! ```text
//! build      triangle boxes, scaled into the unit cube -> obvhs (PLOC, reinsertion, collapsed leaves): topology only;
//!            exact boxes are gathered again from the leaves up
//! line       slabs in f32, widened per line by 32 roundings of the largest coordinate in play, near child first;
//!            triangle: shift, shear along the line's largest axis in f64, round to f32, edge functions exactly in f64;
//!            hit if all three have one sign or are 0; t from the f64 depths
//! nearest    near child first, pruned by a lower bound of the box distance; triangles in f64; rows of queries start from the
//!            last answer, and those for a maximum end at any triangle near enough
//! box, prism descend where no separating axis is found
//! ```
//!
//! Departures: Woop et al. compute edge functions in f32 and repeat zeros in f64. Products of two f32 are exact in f64 and
//! their difference has the exact sign, so one f64 pass decides as well and yields better barycentric coordinates; shearing
//! in f64 before the rounding keeps them good when the origin is far away.
//!
//! Limits: coordinates up to 1e18 in magnitude; triangles with a corner that is no finite number are never found; a line
//! that lies in a triangle's plane does not meet that triangle (its neighbours across the silhouette are met). Two-wide
//! nodes without SIMD: wide trees would be faster.
//!
//! Sources: S. Woop, C. Benthin, I. Wald, Watertight Ray/Triangle Intersection, JCGT 2(1), 2013; T. Ize, Robust BVH Ray
//! Traversal, JCGT 2(2), 2013; D. Meister, J. Bittner, Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy
//! Construction, TVCG 24(3), 2018, doi:10.1109/TVCG.2017.2669983, and Parallel Reinsertion for Bounding Volume Hierarchy
//! Optimization, CGF 37(2), 2018, doi:10.1111/cgf.13376 (both through the crate `obvhs`).

mod build;
mod line;
mod nearest;
mod overlap;
#[cfg(test)]
mod tests;

use glam::Vec3;

pub use nearest::{Hint, Nearby};

/// A tree over the triangles of a mesh.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    /// Root first; children lie behind their parent, two in a row. Empty for no triangles.
    nodes: Vec<Node>,
    /// Corners of the triangles in tree order.
    corners: Vec<[Vec3; 3]>,
    /// `[corners.len()]`, the face of each.
    faces: Vec<u32>,
    /// Greatest magnitude of a coordinate.
    reach: f32,
}

/// A box with two children or a run of triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Node {
    lo: Vec3,
    /// Inner: the first child. Leaf: the first triangle.
    first: u32,
    hi: Vec3,
    /// 0: inner.
    count: u32,
}

/// A triangle met by a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineHit {
    /// The face, by its index in the input.
    pub face: u32,
    /// Where on the line: `origin + t direction`.
    pub t: f32,
    /// Barycentric coordinates of the meeting point, all in `[0, 1]`.
    pub bary: [f32; 3],
}

/// The nearest point of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestPoint {
    /// The face, by its index in the input.
    pub face: u32,
    /// The point, object space.
    pub point: Vec3,
    /// Barycentric coordinates of the point, all in `[0, 1]`.
    pub bary: [f32; 3],
    /// Its distance, object units.
    pub distance: f32,
}

impl Bvh {
    /// Number of triangles in the tree: those with finite corners.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// Least and greatest corner of the box around all triangles, object units; `None` for no triangle.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        self.nodes.first().map(|root| (root.lo, root.hi))
    }

    /// Visits leaves below every node that passes `meets`; `visit` gets positions in tree order.
    fn descend(&self, meets: impl Fn(&Node) -> bool, mut visit: impl FnMut(usize)) {
        let mut stack = Stack::new();
        if self.nodes.first().is_some_and(&meets) {
            stack.push(0u32);
        }
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                (node.first as usize..(node.first + node.count) as usize).for_each(&mut visit);
                continue;
            }
            for child in [node.first + 1, node.first] {
                if meets(&self.nodes[child as usize]) {
                    stack.push(child);
                }
            }
        }
    }
}

/// A stack that reaches for the heap only in trees deeper than any sane one.
struct Stack<T> {
    inline: [T; 64],
    len: usize,
    spill: Vec<T>,
}

impl<T: Copy + Default> Stack<T> {
    #[inline]
    fn new() -> Self {
        Stack { inline: [T::default(); 64], len: 0, spill: Vec::new() }
    }

    #[inline]
    fn push(&mut self, value: T) {
        match self.inline.get_mut(self.len) {
            Some(slot) => {
                *slot = value;
                self.len += 1;
            }
            None => self.spill.push(value),
        }
    }

    #[inline]
    fn pop(&mut self) -> Option<T> {
        if !self.spill.is_empty() {
            return self.spill.pop();
        }
        self.len = self.len.checked_sub(1)?;
        Some(self.inline[self.len])
    }
}
