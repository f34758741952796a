//! Whether stages keep their promise, and whether a remote's records do: the same fingerprint, the same bytes.
//!
//! ```text
//! verify          build all actions twice, each time in an empty scratch cache, targets left alone
//!                 for each action with one fingerprint in both: its outputs must be the same
//!                 and the same as in this cache, if it has a record of that fingerprint
//! check_claims    for a sample of the records that the last build took from the remote:
//!                 run the action alone in a scratch cache, on the very inputs that the record is about
//!                 other outputs: run it once more; the same again: the record lied, and what was made is the truth from now on
//! ```
//! An action behind a guilty one has another fingerprint and is not blamed. The second build of `verify` runs one action at a time
//! (the first as many as asked for), and the caller may run it in a smaller pool of threads.
//!
//! Source: Unity's "Check the consistency of the import process", which compares the same two ways.

use std::collections::HashSet;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::disk;
use crate::engine::{BuildOptions, Durability, Engine};
use crate::error::{EngineError, IoError};
use crate::hash::ContentHash;
use crate::plan::{Action, Input, Plan, Source};
use crate::report::{ActionState, BuildReport, NoObserver, Observer, Record};
use crate::state::Last;

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
    /// The other is not the second run but the record of an earlier build, or of the remote.
    pub cached: bool,
}

/// What `check_claims` came to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ClaimCheck {
    /// Records that the build took from the remote.
    pub claims: usize,
    /// Of those, records that were recomputed.
    pub checked: usize,
    /// Records that lied; the truth stands in their place now. In the plan's order.
    pub lies: Vec<Inconsistency>,
    /// Actions that give other bytes each time: nobody can tell whether their records lie.
    pub inconsistent: Vec<Inconsistency>,
    /// Actions that could not be run, with their errors.
    pub failed: Vec<(String, String)>,
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
        self.in_scratch(|scratch| self.verify_in(scratch, plan, options, observer, around))
    }

    /// Recomputes a sample of the records that the last build of `plan` took from the remote; `report` is that build's. Build again
    /// if any lied: what was made from them is put right then.
    ///
    /// The sample is [`RemoteOptions::check_share`](crate::RemoteOptions) of them, by a seed that the records' writers do not know.
    ///
    /// # Errors
    /// The cache folder cannot be used.
    pub fn check_claims(
        &mut self,
        plan: &Plan,
        report: &BuildReport,
        options: &BuildOptions,
    ) -> Result<ClaimCheck, EngineError> {
        let mut found = ClaimCheck::default();
        let mut truths = Vec::new();
        self.in_scratch(|scratch| {
            for (number, (action, done)) in plan.actions.iter().zip(&report.actions).enumerate() {
                let Some(claim) = done.record.as_ref().filter(|record| self.store.is_claim(&record.fingerprint)) else {
                    continue;
                };
                found.claims += 1;
                if self.store.wants_check(&claim.fingerprint) && !options.cancel.load(Ordering::Relaxed) {
                    let scratch = scratch.join(number.to_string());
                    self.check_claim(&scratch, plan, action, report, claim, options, &mut found, &mut truths)?;
                }
            }
            Ok(())
        })?;
        if truths.is_empty() {
            return Ok(found);
        }
        for (id, made) in &truths {
            // The build state knows the lie too.
            if let Some(last) = self.state.last(id).cloned() {
                self.state.set_last(id, Last { record: made.clone(), ..last });
            }
        }
        self.state.save(&self.store, &HashSet::new(), false)?;
        let sync = options.durability == Durability::Always;
        self.store.during(&options.cancel, || truths.iter().try_for_each(|(_, made)| self.store.refute(made, sync)))?;
        Ok(found)
    }

    #[allow(clippy::too_many_arguments, reason = "the loop's body, for its length")]
    fn check_claim(
        &self,
        scratch: &Path,
        plan: &Plan,
        action: &Action,
        report: &BuildReport,
        claim: &Record,
        options: &BuildOptions,
        found: &mut ClaimCheck,
        truths: &mut Vec<(String, Arc<Record>)>,
    ) -> Result<(), EngineError> {
        let (id, label) = (action.id.clone(), &action.label);
        let fail = |found: &mut ClaimCheck, why: String| found.failed.push((label.clone(), why));
        let Some(action) = self.on_its_own(action, report) else {
            fail(found, "an input of it is no longer in the cache".into());
            return Ok(());
        };
        let alone = Plan { root: plan.root.clone(), actions: vec![action], targets: Vec::new() };
        let run = |name: &str| -> Result<(Engine, Result<Arc<Record>, String>), EngineError> {
            let mut engine = Engine::open(scratch.join(name), "check");
            let mut done = engine.build(&alone, options, &NoObserver)?.actions;
            let record = match done.pop().map(|action| (action.state, action.record)) {
                Some((ActionState::Failed(error), _)) => Err(error.to_string()),
                Some((_, Some(record))) => Ok(record),
                _ => Err("it was not run".into()),
            };
            Ok((engine, record))
        };
        let (engine, made) = run("first")?;
        let made = match made {
            Ok(made) => made,
            Err(why) => {
                fail(found, why);
                return Ok(());
            }
        };
        if made.fingerprint != claim.fingerprint {
            fail(found, "a file that it reads has changed since".into());
            return Ok(());
        }
        found.checked += 1;
        let Some((output, first, other)) = difference(&made, claim) else { return Ok(()) };
        let told = Inconsistency { label: label.clone(), output, first, other, cached: true };
        match run("second")?.1 {
            Ok(again) if again.outputs != made.outputs => {
                let (output, first, other) = difference(&made, &again).unwrap_or_default();
                found.inconsistent.push(Inconsistency { output, first, other, cached: false, ..told });
            }
            _ => {
                self.take_over(&engine, &made)?;
                truths.push((id, made));
                found.lies.push(told);
            }
        }
        Ok(())
    }

    /// Keeps the outputs that were made in a scratch cache.
    fn take_over(&self, scratch: &Engine, made: &Record) -> Result<(), EngineError> {
        for output in &made.outputs {
            if let Some(bytes) = scratch.store.blob(&output.hash) {
                self.store.put_blob(&output.hash, &bytes, false)?;
            }
        }
        Ok(())
    }

    /// An action with its fingerprint, that reads no other action: it is given the bytes. `None` if some of them are lost.
    fn on_its_own(&self, action: &Action, report: &BuildReport) -> Option<Action> {
        let mut inputs = Vec::new();
        for input in &action.inputs {
            let mut given = |name: String, hash: &ContentHash| {
                inputs.push(Input { name, source: Source::Bytes(self.store.blob(hash)?) });
                Some(())
            };
            match &input.source {
                Source::Output { action, output } => {
                    let record = report.actions[*action].record.as_ref()?;
                    given(input.name.clone(), &record.output(output)?.hash)?;
                }
                Source::Outputs { action, prefix } => {
                    for output in &report.actions[*action].record.as_ref()?.outputs {
                        if let Some(rest) = output.name.strip_prefix(prefix) {
                            given(format!("{}/{rest}", input.name), &output.hash)?;
                        }
                    }
                }
                _ => inputs.push(input.clone()),
            }
        }
        Some(Action { inputs, ..action.clone() })
    }

    /// Does `work` with a folder that is gone afterwards.
    fn in_scratch<T>(&self, work: impl FnOnce(&Path) -> Result<T, EngineError>) -> Result<T, EngineError> {
        self.store.prepare()?;
        // The temporary file gives a name that no other process has.
        let marker = self.store.write_temporary(&[], false)?;
        let scratch = marker.with_extension("verify");
        let found = work(&scratch);
        disk::remove(&marker)?;
        match fs::remove_dir_all(&scratch) {
            Err(error) if !disk::is_absent(&error) => Err(IoError::new("remove", scratch)(error).into()),
            _ => found,
        }
    }

    fn verify_in(
        &self,
        scratch: &Path,
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
