//! Where internal nodes stand: where the planes of the faces at their points are nearest.

use glam::{DVec3, Vec3};
use kiln_asset::{FaceId, Mesh};

use super::ClusterTree;
use crate::simplify::Quadric;

/// Pull to the mean, relative to the planes' weight: what the planes leave open the mean decides. A hundredth of it moves nodes of
/// flat regions along the surface by noise, a hundred times as much rounds edges.
const PULL: f64 = 1e-3;

/// A tight cell, object units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cuboid {
    pub(super) lo: [f32; 3],
    pub(super) hi: [f32; 3],
}

/// Moves all nodes from the mean to where the area-weighted plane forms of the faces at their points are least, with a weak pull to
/// the mean, and into their cells. `boxes`: `[node_count]`.
///
/// # Source
/// Lindstrom 2000, section 3: a face's form goes to the cells of its three points. He weighs by the square of the area and solves by a
/// singular value decomposition; the pull makes the matrix regular instead.
pub(super) fn improve(tree: &mut ClusterTree, mesh: &Mesh, boxes: &[Cuboid]) {
    let means: Vec<DVec3> = tree.nodes.iter().map(|node| Vec3::from_array(node.position).as_dvec3()).collect();
    // Each about the node's mean.
    let mut forms = vec![Quadric::default(); means.len()];
    for face in 0..mesh.face_count() {
        let [a, b, c] = mesh.face_positions(FaceId(face as u32)).map(Vec3::as_dvec3);
        let cross = (b - a).cross(c - a);
        let double_area = cross.length();
        let normal = cross / double_area;
        if !normal.is_finite() {
            continue;
        }
        // About a corner, where the plane is.
        let plane = Quadric::plane(normal, 0.5 * double_area, 0.5 * double_area);
        for vertex in mesh.triangles[face] {
            let node = tree.terminals[vertex as usize] as usize;
            forms[node].add(&plane.about(means[node] - a));
        }
    }
    for (rank, cuboid) in boxes.iter().enumerate().rev() {
        let form = forms[rank];
        let parent = tree.nodes[rank].parent as usize;
        if rank > 0 {
            forms[parent].add(&form.about(means[parent] - means[rank]));
        }
        if let Some(step) = form.least(PULL * form.weight) {
            let place = (means[rank] + step).as_vec3().to_array();
            tree.nodes[rank].position = [0, 1, 2].map(|k| place[k].clamp(cuboid.lo[k], cuboid.hi[k]));
        }
    }
}
