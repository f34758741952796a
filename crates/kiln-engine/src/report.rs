//! What a build says while it runs (events) and when it is done (the report).

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::error::{ActionError, IoError};
use crate::executor::Progress;
use crate::hash::{ContentHash, Fingerprint};
use crate::reason::StaleReason;

/// One output of an action.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputRecord {
    /// Its name.
    pub name: String,
    /// Its content.
    pub hash: ContentHash,
    /// Its length, bytes.
    pub length: u64,
}

/// What the cache knows of one run of an action.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// What the action was given.
    pub fingerprint: Fingerprint,
    /// Kind of stage.
    pub kind: String,
    /// Files that it found while it ran: path relative to the action's folder, content or absent. Sorted by path.
    pub discovered: Vec<(String, Option<ContentHash>)>,
    /// What it gave, in the action's order.
    pub outputs: Vec<OutputRecord>,
    /// The stage's report, JSON bytes or empty.
    pub report: Vec<u8>,
    /// How long the run took, seconds.
    pub seconds: f64,
}

impl Record {
    /// The output named `name`.
    pub fn output(&self, name: &str) -> Option<&OutputRecord> {
        self.outputs.iter().find(|output| output.name == name)
    }
}

/// How an action ended.
#[derive(Debug)]
pub enum ActionState {
    /// Its outputs were known; it did not run.
    Fresh,
    /// It ran.
    Ran {
        /// Why.
        reason: StaleReason,
        /// How long, seconds.
        seconds: f64,
    },
    /// Dry run: it would run.
    WouldRun {
        /// Why.
        reason: StaleReason,
    },
    /// Dry run: whether it would run depends on what action `on` gives.
    DependsOn {
        /// Index of the action that would run.
        on: usize,
    },
    /// It failed.
    Failed(ActionError),
    /// It was not reached: an action before it failed, or the build stopped.
    Skipped {
        /// Index of the failed action before it, if that is why.
        because: Option<usize>,
    },
}

/// One action of a build.
#[derive(Debug)]
pub struct ActionReport {
    /// The action's id.
    pub id: String,
    /// The action's label.
    pub label: String,
    /// Kind of stage.
    pub kind: &'static str,
    /// How it ended.
    pub state: ActionState,
    /// What it gave, now or when it ran; `None` if that is not known.
    pub record: Option<Arc<Record>>,
    /// Files that it asked for and failed all the same, relative to its folder, sorted: one of them may mend it.
    pub sought: Vec<String>,
    /// Warnings that it gave in this build.
    pub warnings: Vec<String>,
}

/// How a target ended.
#[derive(Debug)]
pub enum TargetState {
    /// The file holds these bytes already; it was not touched.
    Unchanged,
    /// It was written.
    Written {
        /// [`StaleReason::OutputMissing`] or [`StaleReason::OutputDiffers`].
        reason: StaleReason,
    },
    /// Dry run: it would be written.
    WouldWrite {
        /// Why.
        reason: StaleReason,
    },
    /// Dry run: depends on what action `on` gives.
    DependsOn {
        /// Index of the action that would run.
        on: usize,
    },
    /// It could not be written; the old file, if any, is as it was.
    Failed(TargetError),
    /// Its action gave nothing.
    Skipped,
}

/// Why a target was not written.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    /// The file system refused.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The bytes could not be had.
    #[error(transparent)]
    Action(#[from] ActionError),
}

/// One target of a build.
#[derive(Debug)]
pub struct TargetReport {
    /// Its path, relative to the plan's root.
    pub path: String,
    /// How it ended.
    pub state: TargetState,
    /// Content, if known.
    pub hash: Option<ContentHash>,
    /// Length, bytes, if known.
    pub length: Option<u64>,
}

/// What a build did.
#[derive(Debug, Default)]
pub struct BuildReport {
    /// `[action_count]`, in the plan's order.
    pub actions: Vec<ActionReport>,
    /// `[target_count]`, in the plan's order.
    pub targets: Vec<TargetReport>,
    /// Soft trouble of the engine itself: a damaged cache entry, a state file that could not be written.
    pub warnings: Vec<String>,
    /// Files whose contents were read to be hashed; the others were known by their stat.
    pub files_hashed: usize,
    /// The build was cancelled.
    pub cancelled: bool,
    /// Wall time, seconds.
    pub seconds: f64,
}

impl BuildReport {
    /// No action and no target failed or was skipped, and nothing was cancelled.
    pub fn succeeded(&self) -> bool {
        let action =
            |action: &ActionReport| !matches!(action.state, ActionState::Failed(_) | ActionState::Skipped { .. });
        let target = |target: &TargetReport| !matches!(target.state, TargetState::Failed(_) | TargetState::Skipped);
        !self.cancelled && self.actions.iter().all(action) && self.targets.iter().all(target)
    }

    /// Nothing ran and nothing was written (and nothing would, in a dry run).
    pub fn nothing_to_do(&self) -> bool {
        self.actions.iter().all(|action| matches!(action.state, ActionState::Fresh))
            && self.targets.iter().all(|target| matches!(target.state, TargetState::Unchanged))
    }
}

/// What happens while a build runs. Indices are the plan's.
#[derive(Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// The build begins.
    Planned {
        /// Number of actions.
        actions: usize,
        /// Number of targets.
        targets: usize,
    },
    /// An action runs.
    Started {
        /// Its index.
        action: usize,
        /// Its label.
        label: &'a str,
        /// Why.
        reason: &'a StaleReason,
    },
    /// An action says how far it is.
    Progress {
        /// Its index.
        action: usize,
        /// From 0 to 1.
        fraction: f32,
        /// What it does now.
        label: &'a str,
    },
    /// An action is done with, in whatever way; said again if its outputs were lost and it had to run after all.
    Finished {
        /// Its index.
        action: usize,
        /// How.
        state: &'a ActionState,
        /// Bytes of all its outputs; 0 if it gave none.
        bytes: u64,
    },
    /// A target is done with.
    TargetFinished {
        /// Its index.
        target: usize,
        /// How.
        state: &'a TargetState,
    },
    /// An executor says how far it is.
    Elsewhere(&'a Progress),
    /// Soft trouble.
    Warning {
        /// The action that says so; `None` for the engine.
        action: Option<usize>,
        /// What.
        message: &'a str,
    },
}

/// Someone who looks on; called from worker threads.
pub trait Observer: Sync {
    /// Something happened.
    fn event(&self, event: &Event<'_>);
}

/// Looks away.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoObserver;

impl Observer for NoObserver {
    fn event(&self, _event: &Event<'_>) {}
}

/// Whether something would run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It would not.
    Fresh,
    /// It would, for this reason.
    Stale(StaleReason),
    /// It reads action `on`, which would run: it runs too unless that gives the same bytes as before.
    DependsOn {
        /// Index of the action that would run.
        on: usize,
    },
    /// It would fail.
    Fails {
        /// How.
        message: String,
    },
}

/// The answer to "why would it run again".
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Why {
    /// Actions that the target needs, in the plan's order, each with its verdict.
    pub actions: Vec<(usize, Verdict)>,
    /// The output file itself.
    pub target: Verdict,
}
