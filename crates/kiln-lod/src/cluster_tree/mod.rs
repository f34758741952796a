//! The octree of Kanaya et al.
