//! Cluster DAG: clusters of at most 128 triangles whose groups replace one another, so that detail changes over the surface.
//!
//! **Problem.** In: a mesh (level 0). Out: clusters over its own vertices, in groups; a group's error says how far what replaces its
//! clusters is from level 0. Whoever draws each cluster whose group's error is too large and whose maker's is not draws every part of the
//! surface once, without cracks, whatever error is allowed where. Must not change: submeshes (a cluster is of one), charts, vertices.
//!
//! **Method.**
//! ```text
//! clusters <- level 0's triangles, submesh by submesh, in meshlets                      (meshlets)
//! while there are clusters, level by level:
//!     groups <- clusters that share most points, about 16 each                          (round)
//!     fixed  <- points of several groups, and of roots
//!     each group, on all threads: half of its triangles by half-edge collapses; fixed points stay   (patch)
//!         error  <- greatest error of the groups that made its clusters, and the measured distance to what it was
//!         sphere <- holds its clusters' and its makers'                                  (bounds)
//!         the result goes into meshlets again: clusters of the next level
//!     a group that keeps more than 85 % passes on what it had, at no further error, to be grouped otherwise; a group without
//!         neighbours, or one that did so twice, becomes a root: nothing replaces it, its points stay where they are
//! ```
//! *No cracks:* two groups meet in points that both hold, so each may change alone. No edge comes between two held points that was not
//! there, so what neighbours do at the same time cannot meet: a closed manifold stays one in every cut.
//!
//! **Departures** from the engines: planes of level 0 are remembered through all levels; boundaries of submeshes and seams are lines as
//! in `simplify`, no locks; errors are measured and no estimate, and add up, so they are too large rather than too small;
//! a group that is stuck is not given up at once.
//!
//! **Limits.** What `simplify` cannot do (points where lines meet, points without a fan) no level does: such meshes have large roots.
//! Errors that add up make coarse levels look worse than they are. There is no hierarchy over groups: a selection asks every cluster.
//!
//! **Sources.** B. Karis, R. Stubbe, G. Wihlidal, "A deep dive into Nanite virtualized geometry", SIGGRAPH 2021 course. F. Ponchio,
//! "Multiresolution structures for interactive visualization of very large 3D datasets", PhD thesis, Clausthal 2008. A. Kapoulkine,
//! `clusterlod`, meshoptimizer (locks, partition, the rule of 85 %).

mod blob;
mod bounds;
mod meshlets;
mod patch;
mod round;

use bytemuck::{Pod, Zeroable};
use kiln_asset::{Mesh, MeshDefect, MeshError, SubmeshId};
use rayon::prelude::*;

use crate::simplify::{SimplifyOptions, first_forms};
use crate::topology::NONE;
use meshlets::{Pieces, Unit};
use patch::{Outcome, Patch};
use round::Round;

/// Most triangles of a cluster.
pub const MAX_TRIANGLES: u32 = 128;
/// Most vertices of a cluster.
pub const MAX_VERTICES: u32 = 256;
/// Greatest coordinate, object units: squares of lengths are far from the end of f32.
const MAX_COORDINATE: f32 = 1e15;
/// Share of its triangles above which a simplified group counts as stuck.
const STUCK: f64 = 0.85;
/// How many levels in a row a stuck group may pass on what it has.
const PATIENCE: u8 = 2;
/// Share of a level's triangles above which all of its stuck groups become roots: others did not shrink enough to help them.
const IDLE: f64 = 0.97;

/// One cluster; the container's cluster record, field by field.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Cluster {
    /// First of its references.
    pub first_reference: u32,
    /// Its vertices, 1 to [`MAX_VERTICES`].
    pub vertex_count: u32,
    /// First of its triangles.
    pub first_triangle: u32,
    /// Its triangles, 1 to [`MAX_TRIANGLES`].
    pub triangle_count: u32,
    /// Its submesh.
    pub submesh: u32,
    /// The group whose simplification replaces it.
    pub group: u32,
    /// The group whose simplification made it, or [`NONE`] for clusters of the mesh's own triangles.
    pub made_by: u32,
    /// Level of the DAG, 0 the finest.
    pub level: u32,
    /// Sphere over its vertices: centre and radius, object units.
    pub sphere: [f32; 4],
    /// Axis of its normals' cone and cutoff: all its triangles face away from an eye `e` if
    /// `dot(normalize(centre - e), axis) >= cutoff + radius / length(centre - e)`; 1: never.
    pub cone: [f32; 4],
}

/// One group of clusters that are simplified together; the container's group record, field by field.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Group {
    /// Holds the spheres of its clusters and of the groups that made them: centre and radius, object units.
    pub sphere: [f32; 4],
    /// Error of what replaces its clusters, object units; [`f32::MAX`] where nothing does (roots).
    pub error: f32,
    /// First of its clusters.
    pub first_cluster: u32,
    /// Its clusters, at least one.
    pub cluster_count: u32,
    /// Level of its clusters.
    pub level: u32,
}

const _: () = assert!(size_of::<Cluster>() == 64 && size_of::<Group>() == 32);

/// How to build.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClusterDagOptions {
    /// Clusters of a group, about; up to a third more. Large groups hold fewer points, small ones follow the view more closely.
    pub group_size: u32,
    /// Most sample points a side with which a group's error is measured.
    pub samples: u32,
    /// How groups are simplified; metric and floor are the DAG's own.
    pub simplify: SimplifyOptions,
}

impl Default for ClusterDagOptions {
    fn default() -> Self {
        ClusterDagOptions { group_size: 16, samples: 8192, simplify: SimplifyOptions::default() }
    }
}

/// Why there is no DAG.
#[derive(Clone, Debug, thiserror::Error)]
pub enum DagError {
    /// A coordinate is beyond what spheres and meshlets can be computed with.
    #[error("vertex {vertex} lies {found:e} from the origin; clusters take at most {MAX_COORDINATE:e}")]
    TooLarge {
        /// The vertex.
        vertex: u32,
        /// Its greatest coordinate, object units.
        found: f32,
    },
    /// The triangles of all levels are more than a 32-bit number of corners can name.
    #[error("{0} triangles in clusters of all levels are more than a 32-bit id can name the corners of")]
    TooMany(u64),
    /// A part of the mesh is no mesh: never for a valid one.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// Clusters, groups, and what they are made of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClusterDag {
    /// Ordered by group.
    pub clusters: Vec<Cluster>,
    /// Ordered by level.
    pub groups: Vec<Group>,
    /// Vertices of the mesh, cluster by cluster.
    pub references: Vec<u32>,
    /// Three a triangle: places in the cluster's references.
    pub corners: Vec<u8>,
    /// Levels.
    pub levels: u32,
    /// Vertices of the mesh.
    pub vertices: u32,
}

/// What came out.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct DagReport {
    /// Levels.
    pub levels: u32,
    /// Clusters of all levels.
    pub clusters: u32,
    /// Groups of all levels.
    pub groups: u32,
    /// Triangles of all clusters.
    pub triangles: u32,
    /// Of them, those of the mesh itself.
    pub mesh_triangles: u32,
    /// Mean triangles of a cluster by the most there may be.
    pub fill: f64,
    /// Groups that nothing replaces.
    pub roots: u32,
    /// Triangles of their clusters: the coarsest cut.
    pub root_triangles: u32,
    /// Groups that passed on what they had.
    pub passed_on: u32,
    /// Bytes of the arrays.
    pub bytes: u64,
}

impl ClusterDag {
    /// The DAG over `mesh`.
    ///
    /// # Errors
    /// Coordinates or numbers of triangles beyond what it can be built with.
    pub fn new(mesh: &Mesh, options: &ClusterDagOptions) -> Result<ClusterDag, DagError> {
        let greatest = mesh.positions.iter().map(|p| p.abs().max_element());
        if let Some((vertex, found)) = (0..).zip(greatest).find(|(_, greatest)| *greatest > MAX_COORDINATE) {
            return Err(DagError::TooLarge { vertex, found });
        }
        let simplify = SimplifyOptions { floor: 0.5, ..options.simplify };
        let unit = Unit::new(mesh);
        let mut forms = first_forms(mesh, &simplify);
        let mut dag = ClusterDag { vertices: mesh.vertex_count() as u32, ..Default::default() };
        let mut fixed_for_good = vec![false; mesh.point_count()];
        let mut pieces = Pieces::of_mesh(mesh, &unit);
        while !pieces.clusters.is_empty() {
            let round = Round::new(mesh, &unit, &pieces, options.group_size.max(2) as usize, &fixed_for_good);
            let make = |members: &[u32]| -> Result<Outcome, DagError> {
                let patch = Patch::new(mesh, &pieces, members)?;
                patch.halve(mesh, &unit, &round, &forms, &simplify, options.samples)
            };
            let mut made: Vec<Outcome> = round.groups.par_iter().map(|g| make(g)).collect::<Result<_, _>>()?;
            round.settle(&pieces, &mut made);
            let mut next = Pieces::default();
            for (members, outcome) in round.groups.iter().zip(made) {
                let group = dag.emit(&pieces, members, outcome.error)?;
                for (point, gained) in &outcome.gained {
                    forms[*point as usize].iter_mut().zip(gained).for_each(|(sum, gain)| *sum += gain);
                }
                match outcome.made {
                    Some(made) => next.append(&made, group, outcome.passed_on),
                    None => {
                        let vertices = members.iter().flat_map(|c| pieces.references_of(*c));
                        vertices.for_each(|v| fixed_for_good[mesh.points[*v as usize].index()] = true);
                    }
                }
            }
            dag.levels += 1;
            pieces = next;
        }
        Ok(dag)
    }

    /// Appends a group of pieces, with the distance to what replaces it, or `None` for a root; its number.
    fn emit(&mut self, pieces: &Pieces, members: &[u32], distance: Option<f32>) -> Result<u32, DagError> {
        let number = self.groups.len() as u32;
        let first_cluster = self.clusters.len() as u32;
        let (mut spheres, mut error) = (Vec::with_capacity(2 * members.len()), 0.0_f32);
        for c in members {
            let piece = &pieces.clusters[*c as usize];
            spheres.push(piece.sphere);
            if piece.made_by != NONE {
                let maker = &self.groups[piece.made_by as usize];
                spheres.push(maker.sphere);
                error = error.max(bounds::above(maker.error));
            }
            self.clusters.push(Cluster {
                first_reference: self.references.len() as u32,
                first_triangle: (self.corners.len() / 3) as u32,
                group: number,
                level: self.levels,
                ..*piece
            });
            self.references.extend_from_slice(pieces.references_of(*c));
            self.corners.extend_from_slice(pieces.corners_of(*c));
        }
        if self.corners.len() >= u32::MAX as usize {
            return Err(DagError::TooMany((self.corners.len() / 3) as u64));
        }
        self.groups.push(Group {
            sphere: bounds::around(&spheres),
            error: distance.map_or(f32::MAX, |distance| error + distance),
            first_cluster,
            cluster_count: members.len() as u32,
            level: self.levels,
        });
        Ok(number)
    }

    /// Whether cluster `cluster` is drawn where `threshold` object units are allowed; roots are, whatever is allowed.
    fn is_drawn(&self, cluster: &Cluster, threshold: f32) -> bool {
        let is_above = |group: u32| {
            let error = self.groups[group as usize].error;
            error > threshold || error == f32::MAX
        };
        is_above(cluster.group) && (cluster.made_by == NONE || !is_above(cluster.made_by))
    }

    /// The clusters to draw where an error of `threshold` object units is allowed all over, ascending.
    pub fn cut(&self, threshold: f32) -> Vec<u32> {
        (0..).zip(&self.clusters).filter(|(_, cluster)| self.is_drawn(cluster, threshold)).map(|(c, _)| c).collect()
    }

    /// Triangles of [`ClusterDag::cut`]; does not rise with the threshold.
    pub fn triangles_at(&self, threshold: f32) -> u64 {
        let drawn = self.clusters.iter().filter(|cluster| self.is_drawn(cluster, threshold));
        drawn.map(|cluster| u64::from(cluster.triangle_count)).sum()
    }

    /// The least threshold whose cut has at most `triangles`, object units; the greatest finite error if none has so few.
    pub fn threshold_for(&self, triangles: u64) -> f32 {
        // Numbers that are not negative are ordered as their bits are.
        let (mut low, mut high) = (0, f32::MAX.to_bits() - 1);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.triangles_at(f32::from_bits(middle)) <= triangles { high = middle } else { low = middle + 1 }
        }
        f32::from_bits(low)
    }

    /// A cluster's triangles as vertices of the mesh.
    pub fn triangles_of(&self, cluster: u32) -> impl Iterator<Item = [u32; 3]> + '_ {
        let cluster = &self.clusters[cluster as usize];
        let references = &self.references[cluster.first_reference as usize..][..cluster.vertex_count as usize];
        let corners =
            3 * cluster.first_triangle as usize..3 * (cluster.first_triangle + cluster.triangle_count) as usize;
        self.corners[corners].chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(|place| references[place as usize]))
    }

    /// What [`ClusterDag::cut`] draws, as a mesh; `mesh` is the one that the DAG was built over.
    ///
    /// # Errors
    /// The DAG belongs to another mesh.
    pub fn level(&self, mesh: &Mesh, threshold: f32) -> Result<Mesh, MeshError> {
        self.mesh_of(mesh, &self.cut(threshold))
    }

    /// These clusters as a mesh.
    ///
    /// # Errors
    /// The DAG belongs to another mesh.
    ///
    /// # Panics
    /// If one is no cluster.
    pub fn mesh_of(&self, mesh: &Mesh, clusters: &[u32]) -> Result<Mesh, MeshError> {
        if self.vertices as usize != mesh.vertex_count() {
            let message = format!("{} of them where the cluster DAG has {}", mesh.vertex_count(), self.vertices);
            return Err(MeshError(vec![MeshDefect { path: "positions".into(), message }]));
        }
        let mut order = clusters.to_vec();
        order.sort_by_key(|c| self.clusters[*c as usize].submesh);
        let mut place = vec![NONE; mesh.vertex_count()];
        let (mut triangles, mut face_submesh) = (Vec::new(), Vec::new());
        for c in order {
            for triangle in self.triangles_of(c) {
                triangle.iter().for_each(|v| place[*v as usize] = 0);
                triangles.push(triangle);
                face_submesh.push(SubmeshId(self.clusters[c as usize].submesh));
            }
        }
        let keep: Vec<u32> = (0..mesh.vertex_count() as u32).filter(|v| place[*v as usize] == 0).collect();
        (0..).zip(&keep).for_each(|(new, old)| place[*old as usize] = new);
        triangles.iter_mut().flatten().for_each(|v| *v = place[*v as usize]);
        Mesh::new(mesh.gather(&keep, triangles, face_submesh))
    }

    /// What came out.
    pub fn report(&self) -> DagReport {
        let members = |group: &Group| &self.clusters[group.first_cluster as usize..][..group.cluster_count as usize];
        let count = |clusters: &[Cluster]| clusters.iter().map(|c| c.triangle_count).sum::<u32>();
        let triangles = (self.corners.len() / 3) as u32;
        let mut made = vec![0; self.groups.len()];
        for cluster in self.clusters.iter().filter(|c| c.made_by != NONE) {
            made[cluster.made_by as usize] += cluster.triangle_count;
        }
        let roots = || self.groups.iter().filter(|group| group.error == f32::MAX);
        let passed_on = self.groups.iter().zip(&made).filter(|(group, made)| count(members(group)) == **made);
        let mesh_triangles = self.clusters.iter().filter(|c| c.made_by == NONE).map(|c| c.triangle_count).sum();
        DagReport {
            levels: self.levels,
            clusters: self.clusters.len() as u32,
            groups: self.groups.len() as u32,
            triangles,
            mesh_triangles,
            fill: f64::from(triangles) / (f64::from(MAX_TRIANGLES) * self.clusters.len().max(1) as f64),
            roots: roots().count() as u32,
            root_triangles: roots().map(|group| count(members(group))).sum(),
            passed_on: passed_on.count() as u32,
            bytes: (64 * self.clusters.len() + 32 * self.groups.len() + 4 * self.references.len() + self.corners.len())
                as u64,
        }
    }
}

#[cfg(test)]
mod tests;
