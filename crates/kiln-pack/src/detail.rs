//! One detail of a container as a mesh: a level, or what an engine draws of a layout with so many triangles.
//!
//! Layouts are picked by the runtime's own functions, so what leaves here is what an engine shows.

use std::fmt;
use std::str::FromStr;

use glam::Vec3;
use kiln_asset::{Level, LodSet, MaterialSet, Mesh, Raster, SubmeshId};
use kiln_format::AlignedBytes;
use kiln_format::layout::Checkpoint;
use kiln_runtime::tree::{alive_count, draw_list};
use kiln_runtime::{Lods, clusters};

use crate::PackError;
use crate::pack::Layout;
use crate::unpack::unpack;

/// Which detail: `2`, or `sliding-window:5000`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// A level, 0 the finest.
    Level(usize),
    /// The finest detail of a layout with at most so many triangles.
    Of(Layout, u32),
}

impl Layout {
    /// All, in the order of the specification.
    pub const ALL: [Layout; 5] =
        [Layout::Discrete, Layout::SlidingWindow, Layout::TreeLeaf, Layout::CompactTree, Layout::Clusters];

    /// The name in pipelines and reports.
    pub fn name(self) -> &'static str {
        match self {
            Layout::Discrete => "discrete",
            Layout::SlidingWindow => "sliding-window",
            Layout::TreeLeaf => "tree-leaf",
            Layout::CompactTree => "compact-tree",
            Layout::Clusters => "clusters",
        }
    }
}

impl FromStr for Detail {
    type Err = String;

    fn from_str(text: &str) -> Result<Detail, String> {
        if let Ok(level) = text.parse() {
            return Ok(Detail::Level(level));
        }
        let of = |name: &str| Layout::ALL.into_iter().skip(1).find(|layout| layout.name() == name);
        let parts = text.split_once(':').and_then(|(name, count)| Some((of(name)?, count.parse().ok()?)));
        let names: Vec<&str> = Layout::ALL.iter().skip(1).map(|layout| layout.name()).collect();
        parts.map(|(layout, triangles)| Detail::Of(layout, triangles)).ok_or_else(|| {
            format!("{text:?} is neither a level (0 = finest) nor LAYOUT:TRIANGLES with one of {}", names.join(", "))
        })
    }
}

impl fmt::Display for Detail {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Detail::Level(level) => write!(f, "{level}"),
            Detail::Of(layout, triangles) => write!(f, "{}:{triangles}", layout.name()),
        }
    }
}

/// The detail as the only level of a set, with materials and pictures as [`unpack`] gives them.
///
/// # Errors
/// As for [`unpack`]; a level or a layout that the container has not.
pub fn unpack_detail(bytes: &[u8], detail: Detail) -> Result<(LodSet, MaterialSet, Vec<Raster>), PackError> {
    let (mut levels, materials, rasters) = unpack(bytes)?;
    let count = levels.levels.len();
    let level = match detail {
        Detail::Level(asked) if asked < count => levels.levels.swap_remove(asked),
        Detail::Level(asked) => return Err(PackError::NoSuchLevel { asked, count }),
        Detail::Of(layout, triangles) => {
            let finest = levels.levels.swap_remove(0).mesh;
            picked(bytes, layout, triangles, &finest)?
        }
    };
    levels.levels = vec![level];
    Ok((levels, materials, rasters))
}

fn picked(bytes: &[u8], layout: Layout, triangles: u32, finest: &Mesh) -> Result<Level, PackError> {
    let aligned = AlignedBytes::copy_of(bytes);
    let lods = Lods::open(&aligned)?;
    let missing = || PackError::Unsupported(format!("the container has no layout \"{}\"", layout.name()));
    let mut drawn = Drawn::default();
    let error = match layout {
        Layout::Discrete => return Err(missing()),
        Layout::SlidingWindow => {
            let window = lods.window().ok_or_else(missing)?;
            let lod = window.lod_for_triangles(u64::from(triangles));
            for submesh in 0..lods.submesh_count() {
                let mut indices = vec![0; 3 * window.triangles(lod, submesh) as usize];
                window.pick_indices(lod, submesh, 0, &mut indices);
                drawn.add(submesh, indices.as_chunks().0);
            }
            coarser_error(window.view().checkpoints.iter().find(|c| c.detail >= lod.detail()))
        }
        Layout::TreeLeaf => {
            let tree = lods.tree_leaf().ok_or_else(missing)?;
            let threshold = tree.scale().within_triangles(triangles);
            let mut picks = vec![[0.0; 3]; tree.vertex_count()];
            tree.pick_at(threshold, 0..tree.vertex_count(), &mut picks);
            drawn.alive(finest, threshold, |triangles, deaths| tree.deaths(triangles, deaths));
            drawn.picks = Some(picks);
            coarser_error(tree.scale().checkpoints.iter().find(|c| c.detail <= threshold))
        }
        Layout::CompactTree => {
            let tree = lods.compact_tree().ok_or_else(missing)?;
            let threshold = tree.scale().within_triangles(triangles);
            let mut picks = vec![[0.0; 3]; tree.vertex_count()];
            tree.pick(threshold, 0..tree.vertex_count(), &mut picks);
            drawn.alive(finest, threshold, |triangles, deaths| tree.deaths(triangles, deaths));
            drawn.picks = Some(picks);
            coarser_error(tree.scale().checkpoints.iter().find(|c| c.detail <= threshold))
        }
        Layout::Clusters => {
            let view = lods.clusters().ok_or_else(missing)?;
            let detail = clusters::within_budget(&view, clusters::Detail::Error(0.0), u64::from(triangles));
            let mut chosen = Vec::new();
            clusters::select(&view, detail, &mut chosen);
            let submesh = |cluster: &u32| view.clusters.get(*cluster as usize).map(|c| c.submesh);
            chosen.sort_by_key(submesh);
            for cluster in &chosen {
                let triangles: Vec<[u32; 3]> = clusters::triangles(&view, *cluster).collect();
                drawn.add(submesh(cluster).unwrap_or(0) as usize, &triangles);
            }
            match detail {
                clusters::Detail::Error(error) => error,
                clusters::Detail::View { .. } => 0.0,
            }
        }
    };
    drawn.level(finest, error)
}

/// What is known of the error of a detail: that of the next coarser checkpoint.
fn coarser_error(checkpoint: Option<&Checkpoint>) -> f32 {
    checkpoint.map_or(0.0, |checkpoint| checkpoint.error)
}

/// Triangles over level 0's vertices, and where these stand if not where they do.
#[derive(Default)]
struct Drawn {
    triangles: Vec<[u32; 3]>,
    submeshes: Vec<SubmeshId>,
    picks: Option<Vec<[f32; 3]>>,
}

impl Drawn {
    fn add(&mut self, submesh: usize, triangles: &[[u32; 3]]) {
        self.triangles.extend_from_slice(triangles);
        self.submeshes.resize(self.triangles.len(), SubmeshId(submesh as u32));
    }

    /// Level 0's triangles that are alive at a tree's threshold.
    fn alive(&mut self, finest: &Mesh, threshold: u32, find: impl Fn(&[[u32; 3]], &mut [u32])) {
        let mut deaths = vec![0; finest.face_count()];
        find(&finest.triangles, &mut deaths);
        for submesh in 0..finest.submeshes.len() {
            let faces = finest.submesh_faces(SubmeshId(submesh as u32));
            let (triangles, deaths) = (&finest.triangles[faces.clone()], &deaths[faces]);
            let mut list = vec![[0; 3]; alive_count(deaths, threshold)];
            draw_list(triangles, deaths, threshold, &mut list);
            self.add(submesh, &list);
        }
    }

    /// The mesh without the vertices that no triangle uses.
    fn level(self, finest: &Mesh, error: f32) -> Result<Level, PackError> {
        let mut raw = finest.clone().into_raw();
        if let Some(picks) = self.picks {
            raw.positions = picks.into_iter().map(Vec3::from_array).collect();
            // Vertices that were apart may stand together now.
            raw.points.clear();
        }
        let broken = |error| PackError::Mesh { level: 0, error };
        let placed = Mesh::new(raw).map_err(broken)?;
        let mut keep: Vec<u32> = self.triangles.iter().flatten().copied().collect();
        keep.sort_unstable();
        keep.dedup();
        let mut place = vec![0; placed.vertex_count()];
        keep.iter().zip(0..).for_each(|(v, new)| place[*v as usize] = new);
        let triangles = self.triangles.iter().map(|t| t.map(|v| place[v as usize])).collect();
        let mesh = Mesh::new(placed.gather(&keep, triangles, self.submeshes)).map_err(broken)?;
        Ok(Level { mesh, error, quadrics: Vec::new() })
    }
}
