//! From a wanted number of faces to a threshold: exactly, and as the paper estimates it.

use super::ClusterTree;

/// A place on the paper's scale: `r_level = row + k / n`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RLevel {
    /// Integer part.
    pub row: u32,
    /// Numerator, `0..=n`.
    pub k: u32,
    /// Denominator, at least 1.
    pub n: u32,
}

impl RLevel {
    /// As a number, rounded.
    pub fn value(&self) -> f64 {
        f64::from(self.row) + f64::from(self.k) / f64::from(self.n.max(1))
    }
}

/// The thresholds whose number of faces is nearest to a wanted one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ThresholdChoice {
    /// The greatest of them: as many faces as the others, and the most nodes split.
    pub threshold: u32,
    /// The least of them; those between have as many faces.
    pub first: u32,
    /// Faces alive there.
    pub triangles: u32,
    /// The number of faces above the wanted one that is as near, if there is one.
    pub tied: Option<u32>,
}

impl ClusterTree {
    /// r_level of a node, exactly: `n` nodes are in its row, it is the k-th.
    ///
    /// # Panics
    /// If `rank` is no node's.
    ///
    /// # Source
    /// Kanaya et al. 2011, equation 2.
    pub fn r_level(&self, rank: u32) -> RLevel {
        let row = self.row_of(rank);
        let [start, end] = [self.row_starts[row as usize], self.row_starts[row as usize + 1]];
        RLevel { row, k: rank - start + 1, n: end - start }
    }

    /// The threshold that splits the nodes whose r_level is at most `r`.
    pub fn threshold_at(&self, r: RLevel) -> u32 {
        let Some(end) = self.row_starts.get(r.row as usize + 1) else { return self.node_count() };
        let start = self.row_starts[r.row as usize];
        let within = u64::from(r.k) * u64::from(end - start) / u64::from(r.n.max(1));
        start + within.min(u64::from(end - start)) as u32
    }

    /// Faces alive at `threshold`; beyond N, all.
    pub fn faces_at(&self, threshold: u32) -> u32 {
        self.face_counts.get(threshold as usize).or(self.face_counts.last()).copied().unwrap_or(0)
    }

    /// The thresholds with the number of faces nearest to `triangles`; of two numbers as near, the lower.
    pub fn threshold_for(&self, triangles: u32) -> ThresholdChoice {
        let counts = &self.face_counts;
        // One behind the last with at most as many: counts[0] is 0.
        let above = counts.partition_point(|count| *count <= triangles);
        let lower = counts[above - 1];
        let upper = counts.get(above).copied();
        let near = upper.filter(|upper| upper - triangles < triangles - lower);
        let tied = upper.filter(|upper| upper - triangles == triangles - lower);
        let reached = near.unwrap_or(lower);
        let first = counts.partition_point(|count| *count < reached) as u32;
        let threshold = counts.partition_point(|count| *count <= reached) as u32 - 1;
        ThresholdChoice { threshold, first, triangles: reached, tied }
    }

    /// The greatest threshold with at most `triangles` faces.
    pub fn threshold_within(&self, triangles: u32) -> u32 {
        self.face_counts.partition_point(|count| *count <= triangles) as u32 - 1
    }

    /// The paper's estimate of the r_level with `triangles` faces: a straight line between the numbers at the two integer levels
    /// around it. Knows those numbers alone.
    ///
    /// # Source
    /// Kanaya et al. 2011, equation 3.
    pub fn paper_estimate(&self, triangles: u32) -> RLevel {
        let at = |row: usize| self.face_counts[self.row_starts[row] as usize];
        let rows = self.rows() as usize;
        match (0..rows).rev().find(|row| at(*row) <= triangles) {
            Some(row) if triangles < at(row + 1) => {
                RLevel { row: row as u32, k: triangles - at(row), n: at(row + 1) - at(row) }
            }
            _ => RLevel { row: rows as u32, k: 0, n: 1 },
        }
    }

    /// Faces that the paper's s_level asks for: `s` thousandths of all, rounded down. `s` is 1 to 1000; others count as the nearer end.
    ///
    /// # Source
    /// Kanaya et al. 2011, section 3.
    pub fn faces_of_s_level(&self, s: u32) -> u32 {
        (u64::from(self.faces_at(u32::MAX)) * u64::from(s.clamp(1, 1000)) / 1000) as u32
    }
}
