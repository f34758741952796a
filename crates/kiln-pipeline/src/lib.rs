//! The TOML language, its diagnostics, the stage graph; one adapter file a stage.

pub mod language;
pub mod plan;
pub mod stages;

mod foreign;
