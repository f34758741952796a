//! A level set to a container and back; GLB, PNG, EXR and KTX2 out.
//!
//! [`pack()`] writes, [`unpack()`] reads back into asset values, [`unpack_detail()`] what an engine draws of a layout, [`inspect()`] tells
//! what is in a file, [`glb`] hands levels to other tools, [`files`] textures, [`trees`] tree and leaf buffers. Bytes only: the caller reads and writes files.

mod bc;
pub mod detail;
pub mod files;
pub mod glb;
pub mod inspect;
pub mod layouts;
pub mod mips;
mod order;
pub mod pack;
pub mod picture;
#[cfg(test)]
mod tests;
mod textures;
pub mod trees;
pub mod unpack;

pub use detail::{Detail, unpack_detail};
pub use glb::{ExportLevels, ExportReport, export_container_glb, export_glb};
pub use inspect::{InspectLayout, InspectReport, inspect};
pub use kiln_format::{FormatError, Provenance};
pub use layouts::{Continuous, TreeLayout, WindowLayout};
pub use pack::{Coding, Compression, Layout, PackOptions, PackReport, PackedLevel, Vertices, pack};
pub use picture::Picture;
pub use unpack::{unpack, unpack_pictures};

/// Why packing, unpacking or exporting failed.
#[derive(Debug, Clone, thiserror::Error)]
pub enum PackError {
    /// The container, or what should become one, breaks a rule of the format.
    #[error("invalid container: {0}")]
    Format(#[from] FormatError),
    /// A level's mesh breaks a promise.
    #[error("level {level}: {error}")]
    Mesh {
        /// Which level.
        level: usize,
        /// What is broken.
        error: kiln_asset::MeshError,
    },
    /// A picture could not be had.
    #[error("image {image} ({name:?}): {message}")]
    Image {
        /// Which image.
        image: u32,
        /// Its name.
        name: String,
        /// Why.
        message: String,
    },
    /// A reference of the material set or mesh is out of range.
    #[error("{path}: expected an index below {expected}, found {found}")]
    Reference {
        /// Where.
        path: String,
        /// Number of things there are.
        expected: usize,
        /// The index.
        found: u32,
    },
    /// Levels that do not belong together.
    #[error("level {level}: {message}")]
    Levels {
        /// Which level.
        level: usize,
        /// What does not fit.
        message: String,
    },
    /// The level asked for does not exist.
    #[error("no level {asked}: there are {count}, numbered from 0 (finest)")]
    NoSuchLevel {
        /// What was asked for.
        asked: usize,
        /// How many there are.
        count: usize,
    },
    /// More than a format can say.
    #[error("unsupported: {0}")]
    Unsupported(String),
}
