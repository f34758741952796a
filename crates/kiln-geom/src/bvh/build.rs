//! Building: topology from `obvhs`, boxes and order from here.

use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ploc::{PlocSearchDistance, SortPrecision};
use obvhs::{Boundable, BvhBuildParams};

use super::{Bvh, Node};

/// Build time against query time, tried on a bumpy sphere of 70,000 triangles: search distance 14 with ten times the
/// reinsertion builds five times slower and answers no faster; no reinsertion at all, leaves of one or of up to eight
/// triangles answer no faster either.
const BUILD: BvhBuildParams = BvhBuildParams {
    pre_split: false,
    ploc_search_distance: PlocSearchDistance::Low,
    search_depth_threshold: 2,
    reinsertion_batch_ratio: 0.05,
    post_collapse_reinsertion_batch_ratio_multiplier: 1.0,
    sort_precision: SortPrecision::U64,
    max_prims_per_leaf: 4,
    collapse_traversal_cost: 1.0,
};

struct UnitBox(Aabb);

impl Boundable for UnitBox {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl Bvh {
    /// A tree over `triangles` `[face_count] x 3`, indices into `positions` (object units). The same input gives the same
    /// tree on any thread count.
    ///
    /// # Panics
    /// If a triangle refers to no position.
    pub fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Bvh {
        let mut faces = Vec::with_capacity(triangles.len());
        let mut corners = Vec::with_capacity(triangles.len());
        for (face, triangle) in triangles.iter().enumerate() {
            let own = triangle.map(|v| positions[v as usize]);
            if own.iter().all(|p| p.is_finite()) {
                faces.push(face as u32);
                corners.push(own);
            }
        }
        if faces.is_empty() {
            return Bvh::default();
        }
        let reach = corners.iter().flatten().fold(0.0, |reach: f32, p| reach.max(p.abs().max_element()));

        // The builder compares sums of areas; inside the unit cube they can neither overflow nor vanish.
        let (lo, hi) =
            corners.iter().flatten().fold((corners[0][0], corners[0][0]), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let (lo, extent) = (lo.as_dvec3(), (hi.as_dvec3() - lo.as_dvec3()).max_element());
        let scale = if extent > 0.0 { 1.0 / extent } else { 1.0 };
        let unit = |p: Vec3| Vec3A::from(((p.as_dvec3() - lo) * scale).as_vec3());
        let boxes: Vec<UnitBox> = corners
            .iter()
            .map(|c| {
                let [a, b, c] = c.map(unit);
                UnitBox(Aabb { min: a.min(b).min(c), max: a.max(b).max(c) })
            })
            .collect();
        let tree = build_bvh2(&boxes, BUILD, &mut std::time::Duration::default());

        let order = &tree.primitive_indices;
        let mut nodes: Vec<Node> = Vec::with_capacity(tree.nodes.len());
        // Renumbered breadth first, so that children lie behind their parent, two in a row, whatever the builder left.
        let mut source = vec![0usize];
        let (mut next_leaf, mut placed) = (0u32, Vec::with_capacity(order.len()));
        let mut k = 0;
        while k < source.len() {
            let node = &tree.nodes[source[k]];
            let first = if node.is_leaf() {
                let run = node.first_index as usize..(node.first_index + node.prim_count) as usize;
                // Inside a leaf the lower face first.
                let start = placed.len();
                placed.extend(order[run].iter().copied());
                placed[start..].sort_unstable();
                let first = next_leaf;
                next_leaf += node.prim_count;
                first
            } else {
                let first = source.len() as u32;
                source.extend([node.first_index as usize, node.first_index as usize + 1]);
                first
            };
            nodes.push(Node { lo: Vec3::INFINITY, hi: Vec3::NEG_INFINITY, first, count: node.prim_count });
            k += 1;
        }
        let faces: Vec<u32> = placed.iter().map(|p| faces[*p as usize]).collect();
        let corners: Vec<[Vec3; 3]> = placed.iter().map(|p| corners[*p as usize]).collect();
        for k in (0..nodes.len()).rev() {
            let Node { first, count, .. } = nodes[k];
            let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            if count > 0 {
                for p in corners[first as usize..(first + count) as usize].iter().flatten() {
                    (lo, hi) = (lo.min(*p), hi.max(*p));
                }
            } else {
                for child in &nodes[first as usize..first as usize + 2] {
                    (lo, hi) = (lo.min(child.lo), hi.max(child.hi));
                }
            }
            (nodes[k].lo, nodes[k].hi) = (lo, hi);
        }
        Bvh { nodes, corners, faces, reach }
    }
}
