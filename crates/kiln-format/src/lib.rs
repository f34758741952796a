//! The container: byte layout, versions, checked zero-copy reader, deterministic writer.
