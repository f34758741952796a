//! Sliding window: picking.
