//! Errors in three families: *invalid* (the plan), *unsupported* (none here), *io* (the system's), plus what an action says.

use std::error::Error;
use std::io;
use std::path::PathBuf;

use crate::plan::PlanDefect;

/// A file-system step that failed, with the path that it was about.
#[derive(Debug, thiserror::Error)]
#[error("cannot {doing} `{}`: {source}", path.display())]
pub struct IoError {
    /// What was tried, such as `write`.
    pub doing: &'static str,
    /// Where.
    pub path: PathBuf,
    /// What the system said.
    pub source: io::Error,
}

impl IoError {
    pub(crate) fn new(doing: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> IoError {
        let path = path.into();
        move |source| IoError { doing, path, source }
    }
}

/// Why a build could not begin or go on at all. What one action or target meets is in the report instead.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// The plan contradicts itself.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    InvalidPlan(Vec<PlanDefect>),
    /// The cache folder cannot be used.
    #[error(transparent)]
    Io(#[from] IoError),
}

/// Why an action gave nothing. Nothing of it is kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ActionError {
    /// The stage's own error.
    #[error("{0}")]
    Failed(Box<dyn Error + Send + Sync>),
    /// A file that the plan names cannot be read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The build was cancelled while it ran.
    #[error("cancelled")]
    Cancelled,
    /// It asked for an input that it did not declare, or that the action before did not give.
    #[error("there is no input `{name}`")]
    NoInput {
        /// The input's name.
        name: String,
    },
    /// The action before gave no such output.
    #[error("action `{action}` gave no output `{output}`")]
    NoOutput {
        /// Id of the action before.
        action: String,
        /// The output's name.
        output: String,
    },
    /// It gave two outputs of one name.
    #[error("two outputs are named `{name}`")]
    RepeatedOutput {
        /// The name.
        name: String,
    },
    /// A file changed between the moment it was hashed and the moment it was read, more than once.
    #[error("`{path}` changes while it is being read; build again when it is quiet")]
    InputChanged {
        /// The file.
        path: String,
    },
    /// An action that had to run again, because its cache entry was lost, gave other bytes than before.
    #[error("action `{action}` gives other bytes each time it runs; build again, and report this stage")]
    NotDeterministic {
        /// Id of that action.
        action: String,
    },
    /// It panicked: a defect of the stage.
    #[error("the stage panicked: {message}")]
    Panicked {
        /// The panic's message.
        message: String,
    },
}

impl ActionError {
    /// The stage's own error.
    pub fn failed(error: impl Into<Box<dyn Error + Send + Sync>>) -> ActionError {
        ActionError::Failed(error.into())
    }
}
