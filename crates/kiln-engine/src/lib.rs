//! Incremental execution: actions, fingerprints, store, build state; knows no mesh and no TOML.
//!
//! # Problem
//! In: a [`Plan`] of actions (functions of declared inputs and of files they find) and targets (files to be written). Out: the
//! targets, as a clean build would make them, with as few actions run as possible; and for each action whether it ran and why.
//! Must not matter: times, absolute paths, thread counts, what other processes do to the cache, kills at any moment.
//!
//! # Method
//! ```text
//! for each action, lowest ready index first, on `jobs` threads:
//!     manifest    := kind, version, libraries, classes, parameters, contents of declared inputs
//!     for each list of files that runs with this manifest found before:
//!         fingerprint := hash(manifest, contents of these files)
//!         if the state or the store has a record of fingerprint: fresh, its output hashes flow on
//!     else run it; keep its outputs as blobs, its list, its record
//! for each target: if the file's content is not the output's, write the output beside it and rename
//! ```
//! Fingerprints cover contents of outputs, so an action that runs and gives the same bytes stops the wave (early cut-off).
//! Blobs are read only when an action runs or a target is written. A blob that is lost makes its action run again.
//!
//! # Example
//! ```
//! use kiln_engine::{Action, BuildOptions, Engine, NoObserver, Outputs, Plan, Source, Target};
//!
//! # let folder = tempfile::tempdir()?;
//! # let root = folder.path().to_owned();
//! std::fs::write(root.join("pot.txt"), "a pot")?;
//! let shout = Action::new("pot#shout", "shout", 1, |context| {
//!     let text = context.input("text")?;
//!     Ok(Outputs::new().with("loud", text.to_ascii_uppercase()))
//! });
//! let target = Target { path: "pot.out".into(), action: 0, output: "loud".into() };
//! let plan = Plan {
//!     root: root.clone(),
//!     actions: vec![shout.input("text", Source::file("pot.txt"))],
//!     targets: vec![target],
//! };
//! let mut engine = Engine::open(root.join(".kiln"), "example");
//! assert!(engine.build(&plan, &BuildOptions::default(), &NoObserver)?.succeeded());
//! assert_eq!(std::fs::read(root.join("pot.out"))?, b"A POT");
//! assert!(engine.build(&plan, &BuildOptions::default(), &NoObserver)?.nothing_to_do());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Limits
//! Two caches that write one output at the same moment are not kept apart: the lock lies in the cache.
//!
//! # Sources
//! The lessons of Ninja, n2, Bazel, Buck2, cargo, ccache and sccache; A. Mokhov, N. Mitchell, S. Peyton Jones, "Build systems
//! a la carte", ICFP 2018, doi:10.1145/3236774 (constructive traces with early cut-off; discovered inputs as depth-one traces).
//!
//! Reading order: `plan`, `manifest`, `reason`, `build` (the algorithm), `store`, `files`, `state`, `index`,
//! `noop`, `remember`, `verify`, `engine`, `executor` (other machines).

mod build;
mod context;
mod disk;
mod engine;
mod error;
mod executor;
mod files;
mod hash;
mod index;
mod manifest;
mod noop;
mod plan;
mod reason;
mod remember;
mod remote;
mod report;
mod state;
mod store;
#[cfg(test)]
mod tests;
mod verify;

pub use context::Context;
pub use disk::quiesce;
pub use engine::{BuildOptions, Durability, Engine};
pub use error::{ActionError, EngineError, IoError};
pub use executor::{
    Class, Executed, Executor, ExecutorError, Failure, Local, Progress, Slurm, SlurmOptions, Task, Work, settle, tasks,
};
pub use hash::{ContentHash, Fingerprint, NotADigest};
pub use manifest::{Field, InputField, Manifest, Origin, Topic, Value};
pub use noop::{Group, Look, Memory};
pub use plan::{Action, Input, Outputs, Plan, PlanDefect, Run, Source, Target};
pub use reason::StaleReason;
pub use remember::{AssetFiles, Dependencies};
pub use remote::{PublicKey, Remote, RemoteError, RemoteMode, RemoteOptions, RemoteReport, SigningKey};
pub use report::{
    ActionReport, ActionState, BuildReport, Event, NoObserver, Observer, OutputRecord, Record, TargetError,
    TargetReport, TargetState, Verdict, Why,
};
pub use store::{Cache, CacheStats, Count, GcOptions, GcReport, KindStats, VerifyReport};
pub use verify::{Around, ClaimCheck, Inconsistency, Verification};
