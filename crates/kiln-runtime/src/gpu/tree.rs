//! Tree and leaf buffers on the GPU.
