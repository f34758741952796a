//! Which way round faces run, and which of them to turn over.
//!
//! A *patch* is a set of faces that hang together over edges with exactly two faces each. In an orientable patch the two faces of
//! every such edge can run along it in opposite directions; a flood from its lowest face says which faces have to be turned for
//! that, up to turning all of them. Of these two answers a closed patch takes the one that encloses a positive volume, any other
//! the one that leaves more of its area as it was; in a tie its lowest face stays.
//!
//! Edges with more than two faces tie nothing: each sheet that ends there is a patch of its own.

use std::collections::VecDeque;

use glam::{DVec3, Vec3};
use kiln_asset::{FaceId, Mesh, PointId};

/// No link.
const NONE: u32 = u32::MAX;

/// A volume below this share of `area^1.5` has no sign worth following: the area decides. A sphere's share is 0.094, and the
/// rounding of `f32` positions gives about 1e-8 for a flat pocket; one box in a thousand long and wide has 2.5e-4.
const FLAT: f64 = 1e-6;

/// What the flood finds.
#[derive(Clone, Debug, Default)]
pub(super) struct Winding {
    /// The faces to turn over, ascending.
    pub(super) flips: Vec<FaceId>,
    /// Edges with one face.
    pub(super) border_edges: u32,
    /// Edges with more than two faces.
    pub(super) crowded_edges: u32,
    /// Edges with two faces that run along it in one direction.
    pub(super) disagreeing_edges: u32,
    /// Patches in all; of them: without a border or crowded edge; closed and wound inwards throughout.
    pub(super) patches: u32,
    pub(super) closed_patches: u32,
    pub(super) inside_out_patches: u32,
    /// The lowest face of each patch without orientation.
    pub(super) unorientable: Vec<FaceId>,
}

/// The winding of the sound faces `kept` over `points` `[vertex_count]`.
pub(super) fn flood(mesh: &Mesh, points: &[PointId], kept: &[FaceId]) -> Winding {
    let mut found = Winding::default();
    let links = links(mesh, points, kept, &mut found);
    // Per face: not reached, or 0 / 1 for as it is / turned in relation to the patch's lowest face.
    let mut side = vec![u8::MAX; kept.len()];
    let mut queue = VecDeque::new();
    let mut patch: Vec<u32> = Vec::new();
    for start in 0..kept.len() as u32 {
        if side[start as usize] != u8::MAX {
            continue;
        }
        patch.clear();
        side[start as usize] = 0;
        queue.push_back(start);
        let (mut closed, mut orientable) = (true, true);
        while let Some(f) = queue.pop_front() {
            patch.push(f);
            for (neighbour, against) in links[f as usize] {
                if neighbour == NONE {
                    closed = false;
                    continue;
                }
                let wanted = side[f as usize] ^ u8::from(against);
                if side[neighbour as usize] == u8::MAX {
                    side[neighbour as usize] = wanted;
                    queue.push_back(neighbour);
                } else if side[neighbour as usize] != wanted {
                    orientable = false;
                }
            }
        }
        found.patches += 1;
        found.closed_patches += u32::from(closed);
        if !orientable {
            found.unorientable.push(kept[start as usize]);
            continue;
        }
        // Fixed summation order, whatever way the flood took.
        patch.sort_unstable();
        let turn = side_to_turn(mesh, kept, &patch, &side, closed);
        let before = found.flips.len();
        found.flips.extend(patch.iter().filter(|f| side[**f as usize] == turn).map(|f| kept[*f as usize]));
        found.inside_out_patches += u32::from(closed && found.flips.len() - before == patch.len());
    }
    found.flips.sort_unstable();
    found
}

/// `[kept] x 3`: the face across each edge with two faces, as an index into `kept`, and whether both run along it in one
/// direction; counts edges by kind.
fn links(mesh: &Mesh, points: &[PointId], kept: &[FaceId], found: &mut Winding) -> Vec<[(u32, bool); 3]> {
    // (lower point, higher point, face, edge of the face, whether from lower to higher)
    let mut half_edges: Vec<(u32, u32, u32, u8, bool)> = Vec::with_capacity(3 * kept.len());
    for (i, f) in kept.iter().enumerate() {
        let p = mesh.triangles[f.index()].map(|v| points[v as usize].0);
        for k in 0..3 {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            half_edges.push((a.min(b), a.max(b), i as u32, k as u8, a < b));
        }
    }
    half_edges.sort_unstable();
    let mut links = vec![[(NONE, false); 3]; kept.len()];
    for edge in half_edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        match edge {
            [_] => found.border_edges += 1,
            [a, b] => {
                let against = a.4 == b.4;
                found.disagreeing_edges += u32::from(against);
                links[a.2 as usize][a.3 as usize] = (b.2, against);
                links[b.2 as usize][b.3 as usize] = (a.2, against);
            }
            _ => found.crowded_edges += 1,
        }
    }
    links
}

/// Which side of an orientable patch is to be turned over.
fn side_to_turn(mesh: &Mesh, kept: &[FaceId], patch: &[u32], side: &[u8], closed: bool) -> u8 {
    let corners = |f: u32| mesh.face_positions(kept[f as usize]).map(|p| p.as_dvec3());
    let origin = corners(patch[0])[0];
    // Six times the volume that is enclosed if side 1 is turned, and twice the area of each side.
    let (mut volume, mut areas) = (0.0, [0.0; 2]);
    for f in patch {
        let [a, b, c] = corners(*f).map(|p| p - origin);
        let s = side[*f as usize];
        areas[usize::from(s)] += (b - a).cross(c - a).length();
        volume += a.dot(b.cross(c)) * if s == 0 { 1.0 } else { -1.0 };
    }
    let area = areas[0] + areas[1];
    if closed && volume.abs() > FLAT * area * area.sqrt() {
        u8::from(volume > 0.0)
    } else {
        u8::from(areas[0] >= areas[1])
    }
}

/// `mesh` with `flips` turned over. Normals of the vertices that these faces use are turned round where they then look away from
/// the `kept` faces that use them; tangents keep their direction, their sign follows the normal.
pub(super) fn turn(mesh: &Mesh, kept: &[FaceId], flips: &[FaceId]) -> Mesh {
    let mut raw = (**mesh).clone();
    let mut touched = vec![false; mesh.vertex_count()];
    for f in flips {
        raw.triangles[f.index()].swap(1, 2);
        for v in raw.triangles[f.index()] {
            touched[v as usize] = mesh.submeshes[mesh.face_submesh[f.index()].index()].attributes.normals;
        }
    }
    if let Some(mut normals) = raw.normals.take() {
        let sums = face_sums(&raw.triangles, &raw.positions, kept);
        for v in 0..normals.len() {
            if touched[v] && normals[v].as_dvec3().dot(sums[v]) < 0.0 {
                normals[v] = -normals[v];
                if let Some(tangents) = &mut raw.tangents {
                    tangents[v].w = -tangents[v].w;
                }
            }
        }
        raw.normals = Some(normals);
    }
    Mesh::new(raw).expect("invariant: corners changed places within their faces, numbers their signs")
}

/// `[vertex_count]`: the sum of the normals of the `kept` faces at each vertex, each as long as twice its area.
pub(super) fn face_sums(triangles: &[[u32; 3]], positions: &[Vec3], kept: &[FaceId]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for f in kept {
        let triangle = triangles[f.index()];
        let [a, b, c] = triangle.map(|v| positions[v as usize].as_dvec3());
        let normal = (b - a).cross(c - a);
        for v in triangle {
            sums[v as usize] += normal;
        }
    }
    sums
}
