//! Import: files to an [`crate::Asset`].
