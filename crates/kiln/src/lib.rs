//! kiln: the offline LOD baker, as a library for build scripts and as a command.
//!
//! ```no_run
//! use kiln::Build;
//!
//! let outcome = Build::new("assets/pot.toml").run(&kiln::NoObserver)?;
//! for asset in &outcome.summary.assets {
//!     println!("{}: {} bytes", asset.output, asset.bytes);
//! }
//! # Ok::<(), kiln::BuildError>(())
//! ```
//!
//! Reading order: [`build`] (what a build does beside the engine), [`stage`] (one stage as a command), [`farm`] (stages on other
//! machines), [`graph`] (the stage graph for other schedulers), [`config`] (the user's own settings), [`summary`] (what it says afterwards), [`exit`] (the one table
//! of exit codes), [`dependencies`] (depfiles, Cargo's lines), [`debug_images`],
//! [`worker`] (the child process around xatlas), `command` (the command line, behind the feature `cli`).

pub mod build;
mod claims;
#[cfg(feature = "cli")]
pub mod command;
pub mod config;
pub mod debug_images;
pub mod dependencies;
pub mod exit;
pub mod farm;
pub mod graph;
pub mod memory;
pub mod stage;
pub mod summary;
pub mod worker;

pub use build::{Build, BuildError, Outcome, WhyOutcome, why};
pub use config::{Config, ConfigError};
pub use debug_images::StagePicture;
pub use dependencies::{cargo_lines, depfile};
pub use exit::Exit;
pub use graph::Graph;
pub use kiln_engine::{
    Dependencies, Event, Executor, Inconsistency, Local, NoObserver, Observer, Slurm, SlurmOptions, Verification,
};
pub use kiln_pipeline::stages::Backend;
pub use stage::{StageOutcome, StageRun};
pub use summary::{AssetSummary, StageState, StageSummary, Summary, Untouched};
