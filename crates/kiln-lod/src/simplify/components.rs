//! Small loose components: what a budget may take when collapses cannot.

use kiln_asset::{Mesh, SubmeshId};

/// `mesh` without its smallest disjoint components, as many as it takes to come to `faces` triangles, and how many went. A component
/// hangs together through points; only those whose bounding box has a diagonal of at most `size` (object units) and that
/// have no face in a submesh of `kept` may go; smaller ones first, then those with the lower first face.
pub(super) fn prune(mesh: &Mesh, size: f32, faces: u32, kept: &[bool]) -> (Mesh, Vec<u32>, u32) {
    let whole = || (mesh.clone(), (0..mesh.point_count() as u32).collect(), 0);
    if mesh.face_count() <= faces as usize {
        return whole();
    }
    let mut leader: Vec<u32> = (0..mesh.point_count() as u32).collect();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.points[v as usize].0);
        unite(&mut leader, a, b);
        unite(&mut leader, b, c);
    }
    // By leading point: bounds, number of faces, first face, and whether it may go.
    let mut low = vec![glam::Vec3::INFINITY; leader.len()];
    let mut high = vec![glam::Vec3::NEG_INFINITY; leader.len()];
    let mut count = vec![0_u32; leader.len()];
    let mut first = vec![0_u32; leader.len()];
    let mut free = vec![true; leader.len()];
    for (f, triangle) in mesh.triangles.iter().enumerate() {
        let top = find(&mut leader, mesh.points[triangle[0] as usize].0) as usize;
        for v in triangle {
            low[top] = low[top].min(mesh.positions[*v as usize]);
            high[top] = high[top].max(mesh.positions[*v as usize]);
        }
        if count[top] == 0 {
            first[top] = f as u32;
        }
        count[top] += 1;
        free[top] &= !kept[mesh.face_submesh[f].index()];
    }
    let diagonal = |top: usize| (high[top] - low[top]).length();
    let mut order: Vec<usize> =
        (0..leader.len()).filter(|top| count[*top] > 0 && free[*top] && diagonal(*top) <= size).collect();
    order.sort_by(|a, b| diagonal(*a).total_cmp(&diagonal(*b)).then(first[*a].cmp(&first[*b])));
    let mut goes = vec![false; leader.len()];
    let (mut left, mut pruned) = (mesh.face_count() as u32, 0);
    for top in order {
        if left <= faces {
            break;
        }
        goes[top] = true;
        left -= count[top];
        pruned += 1;
    }
    if pruned == 0 {
        return whole();
    }
    let mut triangles = Vec::with_capacity(left as usize);
    let mut face_submesh: Vec<SubmeshId> = Vec::with_capacity(left as usize);
    let mut new_index = vec![u32::MAX; mesh.vertex_count()];
    for (triangle, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
        if !goes[find(&mut leader, mesh.points[triangle[0] as usize].0) as usize] {
            triangles.push(*triangle);
            face_submesh.push(*submesh);
            triangle.iter().for_each(|v| new_index[*v as usize] = 0);
        }
    }
    let keep: Vec<u32> = (0..mesh.vertex_count() as u32).filter(|v| new_index[*v as usize] == 0).collect();
    for (i, v) in keep.iter().enumerate() {
        new_index[*v as usize] = i as u32;
    }
    for triangle in &mut triangles {
        *triangle = triangle.map(|v| new_index[v as usize]);
    }
    let level = Mesh::new(mesh.gather(&keep, triangles, face_submesh)).expect("invariant: a part of a sound mesh");
    let mut origin = vec![0; level.point_count()];
    for (v, old) in keep.iter().enumerate() {
        origin[level.points[v].index()] = mesh.points[*old as usize].0;
    }
    (level, origin, pruned)
}

/// The point that leads the component of `at`.
pub(super) fn find(leader: &mut [u32], mut at: u32) -> u32 {
    while leader[at as usize] != at {
        leader[at as usize] = leader[leader[at as usize] as usize];
        at = leader[at as usize];
    }
    at
}

/// Joins two components; the lower point leads.
pub(super) fn unite(leader: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find(leader, a), find(leader, b));
    leader[a.max(b) as usize] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    /// Three tetrahedra of sizes 1, 2 and 3 beside each other, each its own submesh.
    fn three() -> Mesh {
        let mut raw = fixtures::soup(&[]).into_raw();
        raw.submeshes.clear();
        for size in [2, 1, 3] {
            let first = raw.positions.len() as u32;
            let s = size as f32;
            let places = [[0.0; 3], [s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]];
            raw.positions.extend(places.map(|p| glam::Vec3::from(p) + glam::Vec3::X * 10.0 * s));
            for t in [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]] {
                raw.triangles.push(t.map(|v| v + first));
                raw.face_submesh.push(SubmeshId(raw.submeshes.len() as u32));
            }
            raw.submeshes.push(kiln_asset::Submesh { name: format!("{size}"), ..Default::default() });
        }
        raw.points.clear();
        Mesh::new(raw).unwrap()
    }

    #[test]
    fn the_smallest_go_first_and_no_more_than_the_budget_asks() {
        let mesh = three();
        let left = |size: f32, faces: u32, kept: [bool; 3]| {
            let (level, origin, pruned) = prune(&mesh, size, faces, &kept);
            assert_eq!(origin.len(), level.point_count());
            let left: Vec<usize> = (0..3).map(|s| level.submesh_faces(SubmeshId(s)).len()).collect();
            (left, pruned)
        };
        assert_eq!(left(10.0, 12, [false; 3]), (vec![4, 4, 4], 0));
        assert_eq!(left(10.0, 8, [false; 3]), (vec![4, 0, 4], 1));
        assert_eq!(left(10.0, 7, [false; 3]), (vec![0, 0, 4], 2));
        assert_eq!(left(2.0, 0, [false; 3]), (vec![4, 0, 4], 1), "larger ones stay, whatever is asked");
        assert_eq!(left(10.0, 4, [false, true, false]), (vec![0, 4, 0], 2), "kept ones stay");
    }
}
