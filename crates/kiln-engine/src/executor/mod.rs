//! Where actions run: in this process, or as commands that a scheduler spreads over machines.
//!
//! # Problem
//! In: the tasks of a build (what a dry run says would run), each a command that runs one action by itself. Out: their records and
//! blobs in the shared cache, and a sentence for each task that gave none. Must not matter: which machine ran what, in which
//! order, how often.
//!
//! # Method
//! ```text
//! dry run                 what would run, or may run once it is known what an action before it gives
//! tasks                   these actions; level: 0 if it waits for none of them, else one above the highest it waits for
//! executor.execute        brings their records into the cache; none for `Local`
//! the ordinary build      finds them fresh, and writes outputs; a task that failed is a failed action, with its log's end
//! ```
//! So an executor cannot change what is built: what it brings is records like any others, verified when they are read.
//!
//! # Limits
//! A task that an early cut-off would spare is started all the same, and finds by itself that there is nothing to do.
//!
//! Parts: [`slurm`].

mod slurm;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use crate::error::{ActionError, IoError};
use crate::plan::Plan;
use crate::report::{ActionState, BuildReport};

pub use slurm::{Slurm, SlurmOptions};

/// What a task needs of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// Cores.
    Cpu,
    /// A graphics device: its action has a device class.
    Gpu,
}

impl Class {
    /// `cpu` or `gpu`.
    pub fn name(self) -> &'static str {
        match self {
            Class::Cpu => "cpu",
            Class::Gpu => "gpu",
        }
    }
}

/// One action to be run as a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Task {
    /// The action's index in the plan.
    pub action: usize,
    /// The action's label.
    pub label: String,
    /// What it needs.
    pub class: Class,
    /// One more than the highest level among `upstream`; 0 without any.
    pub level: usize,
    /// Indices of the tasks that it waits for; each is lower than its own.
    pub upstream: Vec<usize>,
    /// What the command that runs it has after [`Work::command`].
    pub arguments: Vec<OsString>,
}

/// What an executor has to do.
pub struct Work<'a> {
    /// What all tasks' commands begin with: a program and arguments.
    pub command: &'a [OsString],
    /// The folder that they run in.
    pub folder: &'a Path,
    /// The cache that they share; an executor may keep its files in a folder of its own in it.
    pub cache: &'a Path,
    /// In the plan's order.
    pub tasks: &'a [Task],
    /// Set when nothing more shall be begun and what runs shall end.
    pub cancel: &'a AtomicBool,
    /// Is told how far it is.
    pub progress: &'a dyn Fn(&Progress),
}

/// How far an executor is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// All tasks.
    pub tasks: usize,
    /// Tasks that ended well.
    pub done: usize,
    /// Tasks that failed.
    pub failed: usize,
    /// What the scheduler says of the rest.
    pub note: String,
}

/// A task that left no record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Its index among the tasks.
    pub task: usize,
    /// Why, with the end of its log and the log's path.
    pub message: String,
}

/// What came of the tasks. Those not named here have their records in the cache, or wait for one that failed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Executed {
    /// In order of tasks.
    pub failures: Vec<Failure>,
    /// It was stopped by [`Work::cancel`].
    pub cancelled: bool,
}

/// Why an executor did nothing, or lost all.
#[derive(Debug, thiserror::Error)]
pub enum ExecutorError {
    /// A program of the scheduler is not there.
    #[error("`{program}` cannot be run ({error}); {help}")]
    NoProgram {
        /// Its name.
        program: String,
        /// What the system says.
        error: std::io::Error,
        /// What to do.
        help: &'static str,
    },
    /// The scheduler says no.
    #[error("{what}: {said}")]
    Refused {
        /// What was asked.
        what: String,
        /// Its words.
        said: String,
    },
    /// No task left a word.
    #[error(
        "no task left a word in {}: do all nodes see this folder, and kiln at {}? {log}", run.display(), program.display()
    )]
    Silent {
        /// Where they should have left it.
        run: PathBuf,
        /// What they should have run.
        program: PathBuf,
        /// A log's end, if there is any.
        log: String,
    },
    /// Its own files.
    #[error(transparent)]
    Io(#[from] IoError),
}

/// Decides where tasks run. See the module's page.
pub trait Executor: Sync {
    /// Brings the tasks' records into the cache.
    ///
    /// # Errors
    /// It could not begin, or all was in vain; what a single task meets is in [`Executed`].
    fn execute(&self, work: &Work<'_>) -> Result<Executed, ExecutorError>;

    /// Whether it does nothing: the build itself runs everything.
    fn is_local(&self) -> bool {
        false
    }
}

/// This process: the build runs everything itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct Local;

impl Executor for Local {
    fn execute(&self, _work: &Work<'_>) -> Result<Executed, ExecutorError> {
        Ok(Executed::default())
    }

    fn is_local(&self) -> bool {
        true
    }
}

/// The tasks of a plan by the report of its dry run, in the plan's order; their arguments are the caller's to fill.
pub fn tasks(plan: &Plan, report: &BuildReport) -> Vec<Task> {
    let mut tasks: Vec<Task> = Vec::new();
    let mut task_of = vec![None; plan.actions.len()];
    for (index, (action, reported)) in plan.actions.iter().zip(&report.actions).enumerate() {
        if !matches!(reported.state, ActionState::WouldRun { .. } | ActionState::DependsOn { .. }) {
            continue;
        }
        let upstream: Vec<usize> = action.upstream().into_iter().filter_map(|before| task_of[before]).collect();
        task_of[index] = Some(tasks.len());
        tasks.push(Task {
            action: index,
            label: action.label.clone(),
            class: if action.device_class.is_some() { Class::Gpu } else { Class::Cpu },
            level: upstream.iter().map(|&before| tasks[before].level + 1).max().unwrap_or(0),
            upstream,
            arguments: Vec::new(),
        });
    }
    tasks
}

/// Makes the actions of failed tasks fail with their messages instead of running, and those that wait for them be skipped.
pub fn settle(plan: &mut Plan, tasks: &[Task], executed: &Executed) {
    for failure in &executed.failures {
        let message = failure.message.clone();
        let action = &mut plan.actions[tasks[failure.task].action];
        action.run = std::sync::Arc::new(move |_| Err(ActionError::failed(message.clone())));
    }
}

/// For each task, the lowest task that it is connected with: what shares a number must keep an order, what does not need not.
fn components(tasks: &[Task]) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..tasks.len()).collect();
    fn root(parent: &mut [usize], mut task: usize) -> usize {
        while parent[task] != task {
            parent[task] = parent[parent[task]];
            task = parent[task];
        }
        task
    }
    for (index, task) in tasks.iter().enumerate() {
        for &before in &task.upstream {
            let (a, b) = (root(&mut parent, index), root(&mut parent, before));
            parent[a.max(b)] = a.min(b);
        }
    }
    (0..tasks.len()).map(|task| root(&mut parent, task)).collect()
}

/// Tasks that wait, directly or not, for one of `failed`.
fn downstream(tasks: &[Task], failed: &BTreeSet<usize>) -> BTreeSet<usize> {
    let mut reached = BTreeSet::new();
    for (index, task) in tasks.iter().enumerate() {
        if task.upstream.iter().any(|before| failed.contains(before) || reached.contains(before)) {
            reached.insert(index);
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task(level: usize, upstream: &[usize]) -> Task {
        let label = String::new();
        Task { action: 0, label, class: Class::Cpu, level, upstream: upstream.to_vec(), arguments: Vec::new() }
    }

    #[test]
    fn tasks_of_one_asset_are_connected_and_those_of_two_are_not() {
        let tasks = [task(0, &[]), task(0, &[]), task(1, &[0]), task(0, &[]), task(2, &[2, 3]), task(1, &[1])];
        assert_eq!(components(&tasks), [0, 1, 0, 0, 0, 1]);
        assert_eq!(downstream(&tasks, &BTreeSet::from([0])), BTreeSet::from([2, 4]));
    }
}
