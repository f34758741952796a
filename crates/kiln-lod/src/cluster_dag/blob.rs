//! The DAG as bytes, and what has to hold of it.

use kiln_asset::blob::{BlobError, BlobReader, BlobWriter};

use super::{Cluster, ClusterDag, Group, MAX_TRIANGLES, MAX_VERTICES};
use crate::topology::NONE;

impl ClusterDag {
    /// The DAG as bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = BlobWriter::new(*b"CDAG", 1);
        blob.meta(&(self.levels, self.vertices));
        blob.array(&self.clusters);
        blob.array(&self.groups);
        blob.array(&self.references);
        blob.array(&self.corners);
        blob.finish()
    }

    /// The DAG out of [`ClusterDag::to_blob`] bytes.
    ///
    /// # Errors
    /// Wrong type, version or length, or [`ClusterDag::validate`].
    pub fn from_blob(bytes: &[u8]) -> Result<ClusterDag, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"CDAG", 1)?;
        let (levels, vertices) = blob.meta()?;
        let dag = ClusterDag {
            levels,
            vertices,
            clusters: blob.array()?,
            groups: blob.array()?,
            references: blob.array()?,
            corners: blob.array()?,
        };
        blob.finish()?;
        dag.validate().map_err(|what| BlobError::Content(format!("cluster DAG: {what}")))?;
        Ok(dag)
    }

    /// Whether all of the layout's promises hold that can be told without the mesh.
    ///
    /// # Errors
    /// What does not hold.
    pub fn validate(&self) -> Result<(), String> {
        if !self.corners.len().is_multiple_of(3) || self.corners.len() >= u32::MAX as usize {
            return Err(format!("{} corners", self.corners.len()));
        }
        let (mut cluster, mut level) = (0_u64, 0);
        for (g, group) in self.groups.iter().enumerate() {
            self.check_group(group, cluster, level).map_err(|what| format!("groups[{g}]: {what}"))?;
            cluster += u64::from(group.cluster_count);
            level = group.level;
        }
        let levels = if self.groups.is_empty() { 0 } else { u64::from(level) + 1 };
        if cluster != self.clusters.len() as u64 || u64::from(self.levels) != levels {
            return Err("groups or levels do not cover all clusters".into());
        }
        let (mut reference, mut triangle) = (0_u64, 0_u64);
        for (c, cluster) in self.clusters.iter().enumerate() {
            self.check_cluster(c, cluster, reference, triangle).map_err(|what| format!("clusters[{c}]: {what}"))?;
            reference += u64::from(cluster.vertex_count);
            triangle += u64::from(cluster.triangle_count);
        }
        if reference != self.references.len() as u64 || 3 * triangle != self.corners.len() as u64 {
            return Err("clusters do not cover all references and corners".into());
        }
        if let Some(v) = self.references.iter().find(|v| **v >= self.vertices) {
            return Err(format!("vertex {v} of {}", self.vertices));
        }
        Ok(())
    }

    fn check_group(&self, group: &Group, first: u64, level: u32) -> Result<(), String> {
        let steps = group.level == level || group.level == level + 1 && first > 0;
        match () {
            () if u64::from(group.first_cluster) != first || group.cluster_count == 0 => Err("its clusters".into()),
            () if first + u64::from(group.cluster_count) > self.clusters.len() as u64 => Err("its clusters".into()),
            () if !steps => Err(format!("level {} behind level {level}", group.level)),
            () if !is_sphere(&group.sphere) => Err(format!("sphere {:?}", group.sphere)),
            () if !(group.error.is_finite() && group.error >= 0.0) => Err(format!("error {}", group.error)),
            () => Ok(()),
        }
    }

    fn check_cluster(&self, c: usize, cluster: &Cluster, reference: u64, triangle: u64) -> Result<(), String> {
        let Some(group) = self.groups.get(cluster.group as usize) else { return Err("its group".into()) };
        let members = group.first_cluster as usize..(group.first_cluster + group.cluster_count) as usize;
        let sizes =
            (1..=MAX_VERTICES).contains(&cluster.vertex_count) && (1..=MAX_TRIANGLES).contains(&cluster.triangle_count);
        if !members.contains(&c) || cluster.level != group.level {
            return Err("it is not its group's".into());
        }
        if !sizes || u64::from(cluster.first_reference) != reference || u64::from(cluster.first_triangle) != triangle {
            return Err("its references or triangles".into());
        }
        let corners = 3 * triangle as usize..3 * (triangle as usize + cluster.triangle_count as usize);
        let inside = |corners: &[u8]| corners.iter().all(|place| u32::from(*place) < cluster.vertex_count);
        if !self.corners.get(corners).is_some_and(inside) {
            return Err("a corner beyond its vertices".into());
        }
        if !is_sphere(&cluster.sphere) || !cluster.cone.iter().all(|x| x.is_finite()) {
            return Err("its sphere or cone".into());
        }
        if (cluster.made_by == NONE) != (cluster.level == 0) {
            return Err("clusters of level 0 and no others are the mesh's own".into());
        }
        if cluster.made_by == NONE {
            return Ok(());
        }
        let Some(maker) = self.groups.get(cluster.made_by as usize).filter(|_| cluster.made_by < cluster.group) else {
            return Err("its maker comes after it".into());
        };
        if maker.level + 1 != cluster.level || maker.error > group.error || maker.error == f32::MAX {
            return Err("level or error of its maker".into());
        }
        Ok(())
    }
}

fn is_sphere(sphere: &[f32; 4]) -> bool {
    sphere.iter().all(|x| x.is_finite()) && sphere[3] >= 0.0
}
