//! The tree as bytes for the private cache.

use kiln_asset::blob::{BlobError, BlobReader, BlobWriter};

use super::{ClusterTree, MAX_ROWS};

impl ClusterTree {
    /// The tree as bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = BlobWriter::new(*b"CTRE", 1);
        blob.array(&self.nodes);
        blob.array(&self.row_starts);
        blob.array(&self.terminals);
        blob.array(&self.face_counts);
        blob.finish()
    }

    /// The tree out of [`ClusterTree::to_blob`] bytes.
    ///
    /// # Errors
    /// Wrong type, version or length, or what is no tree.
    pub fn from_blob(bytes: &[u8]) -> Result<ClusterTree, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"CTRE", 1)?;
        let tree = ClusterTree {
            nodes: blob.array()?,
            row_starts: blob.array()?,
            terminals: blob.array()?,
            face_counts: blob.array()?,
        };
        blob.finish()?;
        match tree.defect() {
            Some(defect) => Err(BlobError::Content(format!("cluster tree: {defect}"))),
            None => Ok(tree),
        }
    }

    /// What keeps it from being a tree.
    fn defect(&self) -> Option<&'static str> {
        let (nodes, starts, counts) = (&self.nodes, &self.row_starts, &self.face_counts);
        let rows_tile = starts.first() == Some(&0)
            && starts.last().map(|end| *end as usize) == Some(nodes.len())
            && starts.is_sorted()
            && starts.len() <= MAX_ROWS as usize + 1;
        if !rows_tile {
            return Some("rows do not follow each other");
        }
        if starts.get(1).is_some_and(|end| *end != 1) {
            return Some("more than one root");
        }
        if counts.len() != nodes.len() + 1 || counts[0] != 0 || !counts.is_sorted() {
            return Some("face counts do not ascend from 0");
        }
        if !nodes.iter().flat_map(|node| node.position).all(f32::is_finite) {
            return Some("a position is not finite");
        }
        if nodes.first().is_some_and(|root| root.parent != 0) {
            return Some("the root has a parent");
        }
        let above = |row: &[u32]| (row[0].max(1)..row[1]).all(|rank| nodes[rank as usize].parent < row[0]);
        if !starts.windows(2).all(above) {
            return Some("a parent is not in a row above");
        }
        if self.terminals.iter().any(|terminal| *terminal as usize >= nodes.len()) {
            return Some("a terminal node does not exist");
        }
        self.without_vertex().then_some("a node is over no vertex")
    }

    fn without_vertex(&self) -> bool {
        let mut used = vec![false; self.nodes.len()];
        self.terminals.iter().for_each(|terminal| used[*terminal as usize] = true);
        for rank in (0..used.len()).rev() {
            if !used[rank] {
                return true;
            }
            used[self.nodes[rank].parent as usize] = true;
        }
        false
    }
}
