//! Hosts of the picking passes on wgpu.

pub mod tree;
pub mod window;
