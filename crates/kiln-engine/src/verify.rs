//! Whether stages keep their promise: the same fingerprint, the same bytes.
//!
//! ```text
//! build all actions twice, each time in an empty scratch cache, targets left alone
//! for each action with one fingerprint in both: its outputs must be the same
//! and the same as in this cache, if it has a record of that fingerprint
//! ```
//! An action behind a guilty one has another fingerprint and is not blamed. The second build runs one action at a time (the first
//! as many as asked for), and the caller may run it in a smaller pool of threads.
//!
//! Source: Unity's "Check the consistency of the import process", which compares the same two ways.

use std::fs;

use crate::disk;
use crate::engine::{BuildOptions, Engine};
use crate::error::{EngineError, IoError};
use crate::hash::ContentHash;
use crate::plan::Plan;
use crate::report::{ActionState, BuildReport, Observer, Record};

/// What `verify` came to.
#[derive(Debug, Default)]
pub struct Verification {
    /// Actions that were run twice.
    pub compared: usize,
    /// Actions that gave other bytes, in the plan's order.
    pub inconsistent: Vec<Inconsistency>,
    /// Actions that failed, with their errors: what depends on them was not compared.
    pub failed: Vec<(String, String)>,
    /// The build was cancelled: no more was compared.
    pub cancelled: bool,
}

/// An action that gave other bytes for one fingerprint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inconsistency {
    /// The action's label.
    pub label: String,
    /// The first output that differs; empty if the outputs' names do.
    pub output: String,
    /// Its content in the first run.
    pub first: Option<ContentHash>,
    /// Its content in the other.
    pub other: Option<ContentHash>,
    /// The other is not the second run but the record of an earlier build.
    pub cached: bool,
}

/// Runs the second build; the caller may do so in a pool of threads of its own.
pub type Around<'a> = dyn Fn(&mut (dyn FnMut() + Send)) + 'a;

impl Engine {
    /// Builds `plan` twice in scratch caches below this one, and compares. No target is written, nothing is kept.
    ///
    /// # Errors
    /// The plan contradicts itself, or the cache folder cannot be used.
    pub fn verify(
        &self,
        plan: &Plan,
        options: &BuildOptions,
        observer: &dyn Observer,
        around: &Around<'_>,
    ) -> Result<Verification, EngineError> {
        self.store.prepare()?;
        // The temporary file gives a name that no other process has.
        let marker = self.store.write_temporary(&[], false)?;
        let scratch = marker.with_extension("verify");
        let found = self.verify_in(&scratch, plan, options, observer, around);
        disk::remove(&marker)?;
        match fs::remove_dir_all(&scratch) {
            Err(error) if !disk::is_absent(&error) => Err(IoError::new("remove", scratch)(error).into()),
            _ => found,
        }
    }

    fn verify_in(
        &self,
        scratch: &std::path::Path,
        plan: &Plan,
        options: &BuildOptions,
        observer: &dyn Observer,
        around: &Around<'_>,
    ) -> Result<Verification, EngineError> {
        let plan = Plan { targets: Vec::new(), ..plan.clone() };
        let options = BuildOptions { dry_run: false, keep_going: true, ..options.clone() };
        let first = Engine::open(scratch.join("first"), "verify").build(&plan, &options, observer)?;
        let one = BuildOptions { jobs: 1, ..options.clone() };
        let mut second = None;
        around(&mut || second = Some(Engine::open(scratch.join("second"), "verify").build(&plan, &one, observer)));
        let second = second.unwrap_or_else(|| Ok(BuildReport { cancelled: true, ..BuildReport::default() }))?;
        Ok(self.compare(&first, &second))
    }

    fn compare(&self, first: &BuildReport, second: &BuildReport) -> Verification {
        let mut found = Verification { cancelled: first.cancelled || second.cancelled, ..Verification::default() };
        for (one, two) in first.actions.iter().zip(&second.actions) {
            for action in [one, two] {
                if let ActionState::Failed(error) = &action.state {
                    let failure = (action.label.clone(), error.to_string());
                    if !found.failed.contains(&failure) {
                        found.failed.push(failure);
                    }
                }
            }
            let (Some(a), Some(b)) = (&one.record, &two.record) else { continue };
            if a.fingerprint != b.fingerprint {
                continue;
            }
            found.compared += 1;
            let earlier = self.store.record(&a.fingerprint);
            let between = difference(a, b).map(|found| (found, false));
            let before = || earlier.and_then(|record| difference(a, &record)).map(|found| (found, true));
            if let Some(((output, first, other), cached)) = between.or_else(before) {
                found.inconsistent.push(Inconsistency { label: one.label.clone(), output, first, other, cached });
            }
        }
        found
    }
}

type Difference = (String, Option<ContentHash>, Option<ContentHash>);

/// The first output in which two records differ.
fn difference(a: &Record, b: &Record) -> Option<Difference> {
    if a.outputs == b.outputs {
        return None;
    }
    let mut pairs = a.outputs.iter().zip(&b.outputs);
    let found = pairs.find(|(a, b)| a.name == b.name && a.hash != b.hash);
    let found = found.map(|(a, b)| (a.name.clone(), Some(a.hash), Some(b.hash)));
    Some(found.unwrap_or_default())
}
