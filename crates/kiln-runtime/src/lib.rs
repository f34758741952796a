//! For engines: open a container, choose a level for a view, lend slices.
//!
//! [`Lods::open`] checks everything once; from then on all accessors lend slices of the caller's bytes and allocate nothing.
//! They still bounds-check: a wrong number gives `None` or an empty slice, never a panic.
//!
//! ```no_run
//! use kiln_runtime::{AlignedBytes, Lods, View};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let bytes = AlignedBytes::read_from(&mut std::fs::File::open("pot.kiln")?)?;
//! let lods = Lods::open(&bytes)?;
//! let view = View { distance: 12.0, vertical_fov_radians: 0.9, viewport_height_px: 1080.0 };
//! let level = lods.level(lods.choose_level(&view, 1.0)).ok_or("level is not at hand")?;
//! let (positions, indices) = (level.positions(), level.indices());
//! # let _ = (positions, indices); Ok(()) }
//! ```
//!
//! **Limits.** The bytes must be in memory, on a multiple of 16 (a mapped file is; [`AlignedBytes`] is). A function that maps a
//! file itself waits for the chapter on streaming: the standard library cannot map, and the crate has no dependency but the
//! format.

pub mod clusters;
#[cfg(feature = "gpu")]
pub mod gpu;
mod material;
pub mod tree;
mod view;
pub mod window;

pub use kiln_format::{
    AlignedBytes, Channel, DrawRange, Extra, FormatError, Indices, LevelView, Provenance, Role, Semantic,
    TextureFormat, VertexFormat,
};
pub use material::{AlphaMode, Material, Mip, Sampler, Texture, TextureUse, Wrap};
pub use tree::{Compact, TreeLeaf};
pub use view::View;
pub use window::Window;

use kiln_format::{ClusterView, Container, record::NONE};

/// A checked container.
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
    /// The container in `bytes`: the whole file, on a multiple of 16. Reads every byte once.
    ///
    /// # Errors
    /// The first check of the format that fails.
    pub fn open(bytes: &'a [u8]) -> Result<Lods<'a>, FormatError> {
        Ok(Lods { container: Container::open(bytes)? })
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
        let at_hand = |lod: &usize| self.container.level(*lod).is_some();
        let fine_enough = |lod: &usize| self.error(*lod).is_some_and(|error| error * scale <= max_error_px);
        let mut levels = (0..self.level_count()).filter(at_hand);
        let finest = levels.clone().next().unwrap_or(0);
        levels.rfind(fine_enough).unwrap_or(finest)
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
