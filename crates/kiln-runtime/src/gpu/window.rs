//! Sliding window on the GPU.
