//! Tree and leaf buffers: picking.
