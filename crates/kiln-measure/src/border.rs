//! The open border of a surface: its length tells whether holes and rims were kept.

use kiln_asset::Mesh;
use serde::Serialize;

/// The edges of a surface that are not between exactly two faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Border {
    /// Length of all border edges, object units.
    pub length: f64,
    /// Edges of exactly one face.
    pub edges: usize,
    /// Edges of more than two faces.
    pub crowded_edges: usize,
}

impl Border {
    /// The border of a mesh after welding: vertices at equal positions are one (so seams and boundaries between submeshes are
    /// no border), faces with two corners at one position count as gone.
    pub fn of(mesh: &Mesh) -> Border {
        let place = welded(mesh);
        let mut edges: Vec<[u32; 2]> = Vec::with_capacity(3 * mesh.face_count());
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| place[v as usize]);
            if a != b && b != c && c != a {
                edges.extend([[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]));
            }
        }
        edges.sort_unstable();
        let mut border = Border::default();
        for same in edges.chunk_by(|a, b| a == b) {
            match same {
                [[a, b]] => {
                    let [a, b] = [a, b].map(|v| mesh.positions[*v as usize].as_dvec3());
                    border.length += (a - b).length();
                    border.edges += 1;
                }
                [_, _] => {}
                _ => border.crowded_edges += 1,
            }
        }
        border
    }

    /// The share of the reference's border length that `other` has; `None` where the reference has no border.
    pub fn kept(&self, other: &Border) -> Option<f64> {
        (self.length > 0.0).then(|| other.length / self.length)
    }
}

/// `[vertex_count]`: the lowest vertex at the same position; 0 and -0 are one.
fn welded(mesh: &Mesh) -> Vec<u32> {
    let key = |v: u32| mesh.positions[v as usize].to_array().map(|c| (c + 0.0).to_bits());
    let mut order: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    order.sort_unstable_by_key(|v| (key(*v), *v));
    let mut place = vec![0; order.len()];
    for same in order.chunk_by(|a, b| key(*a) == key(*b)) {
        same.iter().for_each(|v| place[*v as usize] = same[0]);
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use kiln_asset::{RawMesh, SubmeshId};

    /// A soup: every face has corners of its own.
    fn soup(faces: &[[[f32; 3]; 3]]) -> Mesh {
        let count = faces.len() as u32;
        Mesh::new(RawMesh {
            positions: faces.iter().flatten().copied().map(Vec3::from).collect(),
            triangles: (0..count).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
            face_submesh: vec![SubmeshId(0); faces.len()],
            submeshes: vec![Default::default()],
            ..Default::default()
        })
        .expect("valid")
    }

    const O: [f32; 3] = [0.0, 0.0, 0.0];
    const X: [f32; 3] = [1.0, 0.0, 0.0];
    const Y: [f32; 3] = [0.0, 1.0, 0.0];
    const Z: [f32; 3] = [0.0, 0.0, 1.0];
    const XY: [f32; 3] = [1.0, 1.0, 0.0];

    #[test]
    fn a_square_of_two_faces_has_its_outline() {
        let border = Border::of(&soup(&[[O, X, XY], [[-0.0; 3], XY, Y]]));
        assert_eq!(border, Border { length: 4.0, edges: 4, crowded_edges: 0 });
    }

    #[test]
    fn a_closed_surface_has_none_and_keeps_nothing() {
        let closed = Border::of(&soup(&[[O, Y, X], [O, X, Z], [O, Z, Y], [X, Y, Z]]));
        assert_eq!(closed, Border::default());
        assert_eq!(closed.kept(&closed), None);
    }

    #[test]
    fn a_fan_of_three_is_crowded_and_a_needle_counts_as_gone() {
        let border = Border::of(&soup(&[[O, X, Y], [X, O, Z], [O, X, XY], [O, X, X]]));
        assert_eq!((border.edges, border.crowded_edges), (6, 1));
    }

    #[test]
    fn half_of_a_border_is_a_half() {
        let (whole, part) = (
            soup(&[[O, X, XY], [O, XY, Y]]),
            soup(&[[O, [0.5, 0.0, 0.0], [0.5, 0.5, 0.0]], [O, [0.5, 0.5, 0.0], [0.0, 0.5, 0.0]]]),
        );
        assert_eq!(Border::of(&whole).kept(&Border::of(&part)), Some(0.5));
        assert_eq!(Border::of(&soup(&[])).length, 0.0);
    }
}
