//! Levels of a tree as meshes of their own, their measured distance, and the order of vertices that is good to picks.

use glam::Vec3;
use kiln_asset::{Mesh, MeshError, PointId, SubmeshId};

use super::ClusterTree;
use crate::Checkpoint;
use crate::simplify::error::Surface;

/// Faces of the coarsest checkpoint that has any, at least, where the mesh has more.
const FEWEST: f64 = 8.0;

impl ClusterTree {
    /// The mesh at `threshold`: its living faces in their order, corners at their picks' positions with their own wedges' other
    /// attributes; corners that pick one node are one point. At N, the mesh bit for bit.
    ///
    /// # Errors
    /// None for the mesh that the tree is of.
    ///
    /// # Panics
    /// If the tree is of another mesh.
    pub fn level(&self, mesh: &Mesh, threshold: u32) -> Result<Mesh, MeshError> {
        self.alive(mesh, threshold, &self.face_deaths(mesh))
    }

    /// [`ClusterTree::level`] with the faces' deaths at hand.
    fn alive(&self, mesh: &Mesh, threshold: u32, deaths: &[u32]) -> Result<Mesh, MeshError> {
        if threshold >= self.node_count() {
            return Ok(mesh.clone());
        }
        let picks = self.picks(threshold);
        let mut new_index = vec![u32::MAX; mesh.vertex_count()];
        let (mut triangles, mut face_submesh): (Vec<[u32; 3]>, Vec<SubmeshId>) = (Vec::new(), Vec::new());
        for (f, triangle) in mesh.triangles.iter().enumerate().filter(|(f, _)| deaths[*f] < threshold) {
            triangles.push(*triangle);
            face_submesh.push(mesh.face_submesh[f]);
            triangle.iter().for_each(|v| new_index[*v as usize] = 0);
        }
        let keep: Vec<u32> = (0..mesh.vertex_count() as u32).filter(|v| new_index[*v as usize] == 0).collect();
        keep.iter().zip(0..).for_each(|(old, new)| new_index[*old as usize] = new);
        triangles.iter_mut().for_each(|triangle| *triangle = triangle.map(|v| new_index[v as usize]));
        let mut raw = mesh.gather(&keep, triangles, face_submesh);
        // A point is a node (by rank), or a point of the mesh (behind them); then densely, by first use.
        let nodes = self.nodes.len();
        let mut renumbered = vec![u32::MAX; nodes + mesh.point_count()];
        let mut next = 0;
        for (new, old) in keep.iter().enumerate() {
            let pick = picks[*old as usize];
            if let Some(node) = pick {
                raw.positions[new] = Vec3::from_array(self.nodes[node as usize].position);
            }
            let slot = &mut renumbered[pick.map_or(nodes + mesh.points[*old as usize].index(), |node| node as usize)];
            if *slot == u32::MAX {
                *slot = next;
                next += 1;
            }
            raw.points[new] = PointId(*slot);
        }
        Mesh::new(raw)
    }

    /// `[vertex_count]`: [`ClusterTree::pick`] of every vertex, by one pass over the nodes.
    pub fn picks(&self, threshold: u32) -> Vec<Option<u32>> {
        let mut resolved: Vec<Option<u32>> = vec![None; self.nodes.len()];
        for rank in threshold as usize..self.nodes.len() {
            // The parent stands before it.
            resolved[rank] = resolved[self.nodes[rank].parent as usize].or(Some(rank as u32));
        }
        self.terminals.iter().map(|terminal| resolved[*terminal as usize]).collect()
    }

    /// Different picks of all vertices at `threshold`; a vertex that picks itself is one of its own.
    pub fn vertices_at(&self, threshold: u32) -> u32 {
        let top = |rank: usize| rank == 0 || self.nodes[rank].parent < threshold;
        let nodes = (threshold as usize..self.nodes.len()).filter(|rank| top(*rank)).count();
        let own = self.terminals.iter().filter(|terminal| **terminal < threshold).count();
        (nodes + own) as u32
    }

    /// At most `count` (at least 2) measured thresholds from N down to 0, the others evenly spaced in the logarithm of their faces.
    /// Errors are those of [`Surface::distance`], not falling; without faces, of what the vertices have moved.
    ///
    /// # Errors
    /// None for the mesh that the tree is of.
    ///
    /// # Panics
    /// If the tree is of another mesh.
    pub fn checkpoints(&self, mesh: &Mesh, source: &Surface<'_>, count: usize) -> Result<Vec<Checkpoint>, MeshError> {
        let deaths = self.face_deaths(mesh);
        let mut list: Vec<Checkpoint> = Vec::new();
        for threshold in self.thresholds(count) {
            let triangles = self.faces_at(threshold);
            let measured = match triangles {
                0 => self.greatest_move(mesh, threshold),
                _ => source.distance(&self.alive(mesh, threshold, &deaths)?),
            };
            let error = measured.min(f32::MAX).max(list.last().map_or(0.0, |finer| finer.error));
            list.push(Checkpoint { detail: threshold, vertices: self.vertices_at(threshold), triangles, error });
        }
        Ok(list)
    }

    /// Thresholds for checkpoints, strictly descending.
    fn thresholds(&self, count: usize) -> Vec<u32> {
        let all = f64::from(self.faces_at(u32::MAX));
        let steps = count.max(2) - 2;
        let ratio = (FEWEST.min(all) / all.max(1.0)).max(f64::MIN_POSITIVE);
        let mut thresholds = vec![self.node_count()];
        for step in 1..=steps {
            let share = libm::pow(ratio, step as f64 / steps as f64);
            thresholds.push(self.threshold_for((all * share).round() as u32).threshold);
        }
        thresholds.push(0);
        thresholds.dedup();
        thresholds
    }

    /// Greatest distance of a vertex to its pick, object units.
    fn greatest_move(&self, mesh: &Mesh, threshold: u32) -> f32 {
        let moved = |(pick, place): (&Option<u32>, &Vec3)| {
            let pick = pick.map_or(*place, |node| Vec3::from_array(self.nodes[node as usize].position));
            pick.as_dvec3().distance(place.as_dvec3()) as f32
        };
        self.picks(threshold).iter().zip(&mesh.positions).map(moved).fold(0.0, f32::max)
    }

    /// `[vertex_count]`: the vertices in the order in which a walk through the tree meets them, submesh by submesh: the order in which
    /// a pick's reads lie close together. `order[i]` is the vertex to put at place i.
    ///
    /// # Panics
    /// If the tree is of another mesh.
    pub fn vertex_order(&self, mesh: &Mesh) -> Vec<u32> {
        assert_eq!(mesh.vertex_count(), self.terminals.len(), "the tree is of another mesh");
        let mut submesh = vec![0u32; mesh.vertex_count()];
        for (triangle, face_submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
            triangle.iter().for_each(|v| submesh[*v as usize] = face_submesh.0);
        }
        let visits = self.visits();
        let mut order: Vec<u32> = (0..self.terminals.len() as u32).collect();
        order.sort_by_cached_key(|v| (submesh[*v as usize], visits[self.terminals[*v as usize] as usize]));
        order
    }

    /// `[node_count]`: each node's turn in a walk from the root, parents before children, children by rank.
    pub(super) fn visits(&self) -> Vec<u32> {
        let mut sizes = vec![1u32; self.nodes.len()];
        for rank in (1..self.nodes.len()).rev() {
            sizes[self.nodes[rank].parent as usize] += sizes[rank];
        }
        // The turn of a node, and of its next child.
        let (mut visits, mut next) = (vec![0u32; self.nodes.len()], vec![1u32; self.nodes.len()]);
        for rank in 1..self.nodes.len() {
            let slot = &mut next[self.nodes[rank].parent as usize];
            visits[rank] = *slot;
            *slot += sizes[rank];
            next[rank] = visits[rank] + 1;
        }
        visits
    }
}
