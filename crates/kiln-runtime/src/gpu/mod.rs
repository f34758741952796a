//! Hosts of the picking passes on wgpu.

pub mod clusters;
pub mod tree;
pub mod window;
