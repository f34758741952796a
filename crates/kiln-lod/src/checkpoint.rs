//! A measured place on the scale of detail of a continuous layout.

use bytemuck::{Pod, Zeroable};

/// How far a layout is from its source at one detail. Lists of them stand finest first; triangles do not rise and errors do not
/// fall from one to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Checkpoint {
    /// Window: collapses done, ascending from 0. Tree: threshold rank, descending from the node count.
    pub detail: u32,
    /// Window: vertices alive. Tree: different picks of all vertices.
    pub vertices: u32,
    /// Triangles alive.
    pub triangles: u32,
    /// Measured distance to the source's surface ([`crate::simplify::surface_error`]), object units; the greatest of it and the
    /// finer checkpoints'.
    pub error: f32,
}
