//! One detail of a container as a mesh: a level, or what an engine draws of a layout with so many triangles.
//!
//! Layouts are picked by the runtime's own functions, so what leaves here is what an engine shows.

use std::fmt;
use std::str::FromStr;

use kiln_asset::{Level, LodSet, MaterialSet, Mesh, Raster, SubmeshId};
use kiln_format::{AlignedBytes, LevelView};
use kiln_runtime::Lods;

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
    let level0 = lods.level(0).ok_or_else(missing)?;
    match layout {
        Layout::Discrete => Err(missing()),
        Layout::SlidingWindow => {
            let window = lods.window().ok_or_else(missing)?;
            let lod = window.lod_for_triangles(u64::from(triangles));
            let mut drawn = Drawn::default();
            for submesh in 0..lods.submesh_count() {
                let mut indices = vec![0; 3 * window.triangles(lod, submesh) as usize];
                window.pick_indices(lod, submesh, 0, &mut indices);
                drawn.add(submesh, &indices);
            }
            let coarser = window.view().checkpoints.iter().find(|c| c.detail >= lod.detail());
            drawn.level(finest, None, coarser.map_or(0.0, |c| c.error))
        }
        Layout::TreeLeaf | Layout::CompactTree => octree(&lods, layout, triangles, &level0, finest).ok_or_else(missing)?,
        Layout::Clusters => {
            let clusters = lods.clusters().ok_or_else(missing)?;
            let error = clusters.error_for_triangles(u64::from(triangles));
            let mut chosen = Vec::new();
            clusters.select(error, &mut chosen);
            let mut drawn = Drawn::default();
            for submesh in 0..lods.submesh_count() {
                for cluster in chosen.iter().filter(|c| clusters.submesh(**c) == Some(submesh as u32)) {
                    drawn.add(submesh, &clusters.indices(*cluster).collect::<Vec<u32>>());
                }
            }
            drawn.level(finest, None, error)
        }
    }
}
