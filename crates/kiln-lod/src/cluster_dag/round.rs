//! One level: which clusters make a group, and which points a group may not touch.

use kiln_asset::Mesh;
use meshopt::{VertexDataAdapter, partition_clusters_with_positions};

use super::meshlets::{Pieces, Unit};
use super::patch::Outcome;
use super::{IDLE, PATIENCE};
use crate::topology::NONE;

/// Several groups have the point.
const SEVERAL: u32 = NONE - 1;

/// The groups of a level. Its arrays are as large as the level, not as the mesh.
pub(super) struct Round {
    /// Clusters of each group: by submesh, then number.
    pub(super) groups: Vec<Vec<u32>>,
    /// The mesh's points that the level has, ascending.
    points: Vec<u32>,
    /// `[points]`: the group that has it, [`SEVERAL`], or that it is held for good.
    owners: Vec<u32>,
    /// `[groups]`: whether it shares a point with another.
    beside: Vec<bool>,
}

impl Round {
    pub(super) fn new(mesh: &Mesh, unit: &Unit, pieces: &Pieces, size: usize, for_good: &[bool]) -> Round {
        let clusters = 0..pieces.clusters.len() as u32;
        let point = |v: &u32| mesh.points[*v as usize].0;
        // Where every vertex is a point and has its own name, most of this is copying.
        let mut of_clusters: Vec<u32> = clusters.clone().flat_map(|c| pieces.references_of(c)).map(point).collect();
        let counts: Vec<u32> = pieces.clusters.iter().map(|c| c.vertex_count).collect();
        let mut places: Vec<(u32, u32)> =
            clusters.clone().flat_map(|c| pieces.references_of(c)).map(|v| (point(v), *v)).collect();
        places.sort_unstable();
        places.dedup_by_key(|place| place.0);
        let points: Vec<u32> = places.iter().map(|place| place.0).collect();
        let positions: Vec<[f32; 3]> = places.iter().map(|place| unit.positions[place.1 as usize]).collect();
        let local = |p: u32| points.partition_point(|q| *q < p) as u32;
        of_clusters.iter_mut().for_each(|p| *p = local(*p));
        let groups = grouped(pieces, &of_clusters, &counts, &positions, size);
        let mut first = vec![0; counts.len() + 1];
        for (c, count) in counts.iter().enumerate() {
            first[c + 1] = first[c] + *count as usize;
        }
        let mut owners = vec![NONE; points.len()];
        let mut beside = vec![false; groups.len()];
        for (g, members) in (0..).zip(&groups) {
            for p in members.iter().flat_map(|c| &of_clusters[first[*c as usize]..first[*c as usize + 1]]) {
                let owner = &mut owners[*p as usize];
                *owner = match *owner {
                    NONE => g,
                    same if same == g => g,
                    other => {
                        beside[g as usize] = true;
                        if other != SEVERAL {
                            beside[other as usize] = true;
                        }
                        SEVERAL
                    }
                };
            }
        }
        for (owner, p) in owners.iter_mut().zip(&points) {
            if for_good[*p as usize] {
                *owner = SEVERAL;
            }
        }
        Round { groups, points, owners, beside }
    }

    /// Whether faces beyond its group hang on a point of the mesh.
    pub(super) fn is_fixed(&self, point: u32) -> bool {
        self.points.binary_search(&point).is_ok_and(|at| self.owners[at] == SEVERAL)
    }

    /// Makes roots of the stuck groups that waiting would not help.
    pub(super) fn settle(&self, pieces: &Pieces, made: &mut [Outcome]) {
        let all: Vec<u32> = (0..pieces.clusters.len() as u32).collect();
        let left: usize = made.iter().map(|outcome| outcome.triangles).sum();
        let in_vain = left as f64 > IDLE * pieces.triangles(&all) as f64;
        for (g, outcome) in made.iter_mut().enumerate().filter(|(_, outcome)| outcome.passed_on) {
            let waited = self.groups[g].iter().map(|c| pieces.idle[*c as usize]).max().unwrap_or(0);
            if in_vain || !self.beside[g] || waited >= PATIENCE {
                *outcome = Outcome::root();
            } else if let Some(made) = &mut outcome.made {
                made.rest(waited);
            }
        }
    }
}

/// Clusters by group: those that share most points, then those that lie near each other.
fn grouped(pieces: &Pieces, points: &[u32], counts: &[u32], positions: &[[f32; 3]], size: usize) -> Vec<Vec<u32>> {
    let mut group_of = vec![0; counts.len()];
    let mut count = 1;
    if let (true, Ok(adapter)) =
        (counts.len() > size, VertexDataAdapter::new(bytemuck::cast_slice(positions), size_of::<[f32; 3]>(), 0))
    {
        count = partition_clusters_with_positions(&mut group_of, points, counts, &adapter, size);
    }
    let mut groups = vec![Vec::new(); count];
    for (c, group) in (0..).zip(&group_of) {
        groups[*group as usize].push(c);
    }
    groups.iter_mut().for_each(|group| group.sort_by_key(|c| pieces.clusters[*c as usize].submesh));
    groups.retain(|group| !group.is_empty());
    groups
}
