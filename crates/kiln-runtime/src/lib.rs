//! For engines: map a container, choose a level for a view, lend slices.
//!
//! ```text
//! MappedFile, AlignedBytes or any bytes on a multiple of 16
//!   Lods::open         every byte is read and checked once (hashes, indices, layouts)
//!   Lods::open_tables  header and tables only, whatever the file's size; validate() does the rest, when and if wanted
//!   Lods::open_prefix  what has arrived of a file
//! choose_level, choose_by_error, choose_by_triangles -> level(lod) -> slices
//! layouts() -> window, trees, clusters: see those modules
//! ```
//! All accessors lend slices and allocate nothing, but for sections that are stored in a codec: those are decoded when they are
//! first asked for, or all at once by [`Lods::decode`], and kept. They check bounds: a wrong number gives `None` or an empty
//! slice, never a panic, and so does payload that nobody validated.
//!
//! ```no_run
//! # #[cfg(feature = "map")]
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use kiln_runtime::{Lods, MappedFile, View};
//!
//! // SAFETY: nobody writes into this file; new ones are renamed over it.
//! let bytes = unsafe { MappedFile::open("pot.kiln")? };
//! let lods = Lods::open(&bytes)?;
//! let view = View { distance: 12.0, vertical_fov_radians: 0.9, viewport_height_px: 1080.0 };
//! let level = lods.level(lods.choose_level(&view, 1.0)).ok_or("level is not at hand")?;
//! let (positions, indices) = (level.positions(), level.indices());
//! # let _ = (positions, indices); Ok(()) }
//! # #[cfg(not(feature = "map"))]
//! # fn main() {}
//! ```
//!
//! **Features.** `std` (threads, files), `codecs` (coded sections), `map` ([`MappedFile`]), all on; `gpu`. Without any the crate
//! wants an allocator and nothing else.
//!
//! **Limits.** The bytes must lie on a multiple of 16 (mapped files and [`AlignedBytes`] do). Little-endian hosts only.

#![cfg_attr(not(any(feature = "std", test)), no_std)]

extern crate alloc;

pub mod clusters;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(feature = "map")]
mod map;
mod material;
pub mod tree;
mod view;
pub mod window;

pub use kiln_format::{
    AlignedBytes, Channel, ClusterView, CompactTreeView, DrawRange, Extra, FormatError, Indices, Layouts, LevelView,
    Provenance, Role, Semantic, TextureFormat, TreeLeafView, VertexFormat, WindowView,
};
#[cfg(feature = "map")]
pub use map::MappedFile;
pub use material::{AlphaMode, Material, Mip, Sampler, Texture, TextureUse, Wrap};
pub use tree::{Compact, TreeLeaf};
pub use view::View;
pub use window::Window;

use kiln_format::{Container, record::NONE};

/// A container whose tables are sound; by [`Lods::open`] or after [`Lods::validate`] all of it is.
pub struct Lods<'a> {
    container: Container<'a>,
}

/// A submesh: what a draw range draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Submesh<'a> {
    /// Name, unique in its asset.
    pub name: &'a str,
    /// Number of its material; `None`: glTF's default material.
    pub material: Option<usize>,
}

impl<'a> Lods<'a> {
    /// The container in `bytes`: the whole file, on a multiple of 16. Reads and checks every byte once.
    ///
    /// # Errors
    /// The first check of the format that fails.
    pub fn open(bytes: &'a [u8]) -> Result<Lods<'a>, FormatError> {
        Ok(Lods { container: Container::open(bytes)? })
    }

    /// As [`Lods::open`], but only header and tables are read, so that the time does not depend on the file's size. What is lent
    /// before [`Lods::validate`] may be wrong where the file is damaged: indices may be out of range for the vertices.
    ///
    /// # Errors
    /// The first check of header, section table or tables that fails.
    pub fn open_tables(bytes: &'a [u8]) -> Result<Lods<'a>, FormatError> {
        Ok(Lods { container: Container::open_tables(bytes)? })
    }

    /// Reads and checks all payload once; coded sections are decoded and kept.
    ///
    /// # Errors
    /// The first check of payload that fails.
    pub fn validate(&self) -> Result<(), FormatError> {
        self.container.validate()
    }

    /// Decodes all coded sections at hand, on up to `threads` threads.
    pub fn decode(&self, threads: usize) {
        self.container.decode(threads);
    }

    /// The container whose first bytes are `bytes`: levels and mips that are not whole yet are not offered.
    ///
    /// # Errors
    /// The first failed check of header, section table and tables, which must be whole.
    pub fn open_prefix(bytes: &'a [u8]) -> Result<Lods<'a>, FormatError> {
        Ok(Lods { container: Container::open_prefix(bytes)? })
    }

    /// The container underneath: all records and private sections.
    pub fn container(&self) -> &Container<'a> {
        &self.container
    }

    /// Number of levels, also of those that are not at hand.
    pub fn level_count(&self) -> usize {
        self.container.level_records().len()
    }

    /// A level, 0 the finest, if it is at hand.
    pub fn level(&self, lod: usize) -> Option<LevelView<'_>> {
        self.container.level(lod)
    }

    /// The sliding window, trees and clusters over the finest level, as far as they are at hand.
    pub fn layouts(&self) -> Layouts<'_> {
        self.container.layouts()
    }

    /// Distance of a level to the source surface, object units.
    pub fn error(&self, lod: usize) -> Option<f32> {
        self.container.level_records().get(lod).map(|record| record.error)
    }

    /// Least and greatest corner of the finest level's box, object units.
    pub fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        self.container.level_records().first().map_or(([0.0; 3], [0.0; 3]), |r| (r.bounds_min, r.bounds_max))
    }

    /// The coarsest level at hand whose error covers at most `max_error_px` pixels in `view`; if there is none, the finest at
    /// hand (0 if nothing is).
    ///
    /// A level's error in pixels is `error * View::pixels_per_unit`.
    pub fn choose_level(&self, view: &View, max_error_px: f32) -> usize {
        let scale = view.pixels_per_unit();
        self.coarsest(|lod| self.error(lod).is_some_and(|error| error * scale <= max_error_px))
    }

    /// The coarsest level at hand whose error is at most `max_error` object units; if there is none, the finest at hand (0 if
    /// nothing is).
    pub fn choose_by_error(&self, max_error: f32) -> usize {
        self.coarsest(|lod| self.error(lod).is_some_and(|error| error <= max_error))
    }

    /// The finest level at hand with at most `budget` triangles; if there is none, the coarsest at hand (0 if nothing is).
    pub fn choose_by_triangles(&self, budget: u32) -> usize {
        let within = |lod: &usize| self.triangles(*lod).is_some_and(|triangles| triangles <= budget);
        let coarsest = self.at_hand().next_back().unwrap_or(0);
        self.at_hand().find(within).unwrap_or(coarsest)
    }

    /// Triangles of a level.
    pub fn triangles(&self, lod: usize) -> Option<u32> {
        self.container.level_records().get(lod).map(|record| record.triangles)
    }

    /// Levels at hand, finest first.
    fn at_hand(&self) -> impl DoubleEndedIterator<Item = usize> {
        (0..self.level_count()).filter(|lod| self.container.is_at_hand(*lod))
    }

    fn coarsest(&self, fine_enough: impl Fn(usize) -> bool) -> usize {
        let finest = self.at_hand().next().unwrap_or(0);
        self.at_hand().rfind(|lod| fine_enough(*lod)).unwrap_or(finest)
    }

    /// The sliding window over level 0, if there is one and level 0 is at hand.
    pub fn window(&self) -> Option<Window<'_>> {
        Some(Window::of_level(self.container.layouts().window?, &self.level(0)?))
    }

    /// Tree and leaf buffers, if there are some.
    pub fn tree_leaf(&self) -> Option<TreeLeaf<'_>> {
        Some(TreeLeaf::new(self.container.layouts().tree_leaf?))
    }

    /// The compact tree over level 0's positions, if there is one and level 0 is at hand.
    pub fn compact_tree(&self) -> Option<Compact<'_>> {
        Some(Compact::new(self.container.layouts().compact_tree?, self.level(0)?.positions()))
    }

    /// The cluster DAG over level 0's vertices, if there is one ([`clusters`]).
    pub fn clusters(&self) -> Option<ClusterView<'_>> {
        self.container.layouts().clusters
    }

    /// Number of submeshes; every level has one draw range for each.
    pub fn submesh_count(&self) -> usize {
        self.container.submeshes().len()
    }

    /// A submesh.
    pub fn submesh(&self, number: usize) -> Option<Submesh<'a>> {
        let record = self.container.submeshes().get(number)?;
        let material = (record.material != NONE).then_some(record.material as usize);
        Some(Submesh { name: self.container.string(record.name), material })
    }

    /// Number of materials.
    pub fn material_count(&self) -> usize {
        self.container.materials().len()
    }

    /// A material.
    pub fn material(&self, number: usize) -> Option<Material<'a>> {
        let record = self.container.materials().get(number)?;
        Some(Material::new(record, self.container.string(record.name)))
    }

    /// Number of textures.
    pub fn texture_count(&self) -> usize {
        self.container.textures().len()
    }

    /// A texture.
    pub fn texture(&self, number: usize) -> Option<Texture<'a>> {
        let record = self.container.textures().get(number)?;
        Texture::new(record, self.container.string(record.name))
    }

    /// A mip of a texture, 0 the picture itself, if it is at hand.
    pub fn mip(&self, texture: usize, mip: usize) -> Option<Mip<'_>> {
        let record = self.container.mips(texture).get(mip)?;
        let texels = self.container.mip(texture, mip)?;
        Some(Mip { width: record.width, height: record.height, texels })
    }

    /// The largest mip at hand, with its number.
    pub fn finest_mip(&self, texture: usize) -> Option<(usize, Mip<'_>)> {
        (0..self.container.mips(texture).len()).find_map(|k| Some((k, self.mip(texture, k)?)))
    }
}

#[cfg(test)]
mod tests;
