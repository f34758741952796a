//! The container: byte layout, versions, checked zero-copy reader, deterministic writer. `formats/container-v1.md` in the
//! repository is the specification; where this crate and that page differ, one of them is wrong.
//!
//! **Problem.** Levels of detail, their materials and textures come in; one file goes out that engines map and lend to the
//! GPU as it is, whose coarse levels are usable before the rest has arrived, that says when it is damaged, and that readers
//! of other versions read or refuse for a stated reason.
//!
//! **Method.**
//! ```text
//! write:  tables and payload -> sections; place them: tables, coarse to fine geometry with mip tails, layouts, large mips
//!         code payload if asked and smaller; append each at its alignment, zeros between; hash each
//!         write the section table; write the header and its hash
//! open:   tables:   header, hash of header and table, sections tile the file, tables as long as their counts, hashed,
//!                   every reference in range, every number finite; no byte of payload is touched
//!         validate: hash of each payload section, decoded where coded; arrays tile their section, indices below the
//!                   vertex count, boxes the smallest, every promise of the layouts
//! check:  the same walk, all findings instead of the first
//! ```
//! Reading order: [`record`] and [`layout`] (the bytes), [`kind`] (registries), `envelope`, `content` (the checks),
//! [`container`], [`codec`], [`mod@write`], [`error`] (one code a check).
//!
//! **Limits.** Vertex formats are unquantised. Little-endian hosts only. Without feature `std` there are no codecs.
//!
//! Sources: the layout rules follow what KTX 2.0 (Khronos, 2020), PNG (ISO/IEC 15948:2004, the magic) and safetensors
//! (no holes, no overlap, capped counts) do; BLAKE3 by O'Connor, Aumasson, Neves, Wilcox-O'Hearn, 2020.

#![no_std]

extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

pub mod aligned;
pub mod codec;
pub mod container;
mod content;
mod envelope;
pub mod error;
pub mod kind;
pub mod layout;
mod provenance;
pub mod record;
mod spread;
#[cfg(test)]
mod tests;
pub mod write;

/// What the standard prelude has of `alloc`.
mod prelude {
    pub(crate) use alloc::string::{String, ToString};
    pub(crate) use alloc::vec::Vec;
    pub(crate) use alloc::{format, vec};
}

pub use aligned::AlignedBytes;
pub use codec::{Packing, canonical_indices};
pub use container::{Container, Indices, LevelView, Section, check};
pub use content::full_mip_count;
pub use error::{CheckReport, Code, FormatError};
pub use kind::{Channel, ErrorKind, Extra, Kind, Role, Semantic, TextureFormat, VertexFormat};
pub use layout::{ClusterView, CompactTreeView, Layouts, TreeLeafView, WindowView};
pub use provenance::Provenance;
pub use record::{DrawRange, LevelRecord, MaterialRecord, MipRecord, SlotRecord, SubmeshRecord, TextureRecord};
pub use write::{Content, LevelContent, PrivateSection, SubmeshContent, TextureContent, write};

/// Bits that a submesh's attribute set may have: one a semantic.
pub const ATTRIBUTE_BITS: u32 = {
    let (mut bits, mut n) = (0, 1);
    while n <= 8 {
        bits |= 1 << n;
        n += 1;
    }
    bits
};
