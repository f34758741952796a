//! One build: resolve each action, run what is stale, write what differs.
//!
//! Parts: [`resolve`] (what an action is given, and whether the cache knows what it gives), [`execute`] (running one action
//! and keeping what it gives; loading blobs, and making lost ones again), [`target`] (output files), [`schedule`] (the order,
//! on threads), [`why`] (the same without running).

mod execute;
mod resolve;
mod schedule;
mod target;
mod why;

use std::collections::{BTreeMap, HashSet};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::engine::{BuildOptions, Durability};
use crate::files::{Files, Seen};
use crate::hash::Fingerprint;
use crate::manifest::Manifest;
use crate::plan::Plan;
use crate::report::{ActionReport, ActionState, BuildReport, Event, Observer, Record, TargetReport, TargetState};
use crate::state::{Last, State};
use crate::store::Store;

/// What is known of one action so far.
#[derive(Default)]
struct Slot {
    state: Option<ActionState>,
    /// What it was given and gave.
    done: Option<(Manifest, Arc<Record>)>,
    /// Outputs in memory, while something that reads them may still run.
    live: BTreeMap<String, Arc<[u8]>>,
    /// Actions and targets that read it and are not done.
    readers: usize,
    /// Files that it asked for and failed.
    sought: Vec<String>,
    warnings: Vec<String>,
}

/// What is known of one target so far.
#[derive(Default)]
struct TargetSlot {
    state: Option<TargetState>,
}

/// What came of a build.
pub(crate) struct Built {
    pub(crate) report: BuildReport,
    /// Files looked at, sorted by path.
    pub(crate) seen: Vec<(String, Seen)>,
    /// Each done action's index, manifest and record.
    pub(crate) lasts: Vec<(usize, Last)>,
}

pub(crate) struct Session<'a> {
    pub(crate) plan: &'a Plan,
    options: &'a BuildOptions,
    pub(crate) observer: &'a dyn Observer,
    store: &'a Store,
    state: &'a State,
    pub(crate) files: Files<'a>,
    /// `[action_count]`
    slots: Vec<Mutex<Slot>>,
    /// `[target_count]`
    targets: Vec<Mutex<TargetSlot>>,
    /// `[action_count]`: held while an action's lost outputs are made again.
    repairs: Vec<Mutex<()>>,
    /// Declared fingerprints that run now, so that two equal actions run once.
    running: Mutex<HashSet<Fingerprint>>,
    ran: Condvar,
    warnings: Mutex<Vec<String>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Actions' panics are caught; a poisoned lock could only come from a defect here, and its data is whole all the same.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'a> Session<'a> {
    pub(crate) fn new(
        plan: &'a Plan,
        options: &'a BuildOptions,
        observer: &'a dyn Observer,
        store: &'a Store,
        state: &'a State,
        files: Files<'a>,
    ) -> Session<'a> {
        let mut slots: Vec<Slot> = plan.actions.iter().map(|_| Slot::default()).collect();
        for action in &plan.actions {
            for upstream in action.inputs.iter().filter_map(|input| input.source.upstream()) {
                slots[upstream].readers += 1;
            }
        }
        for target in &plan.targets {
            slots[target.action].readers += 1;
        }
        Session {
            plan,
            options,
            observer,
            store,
            state,
            files,
            slots: slots.into_iter().map(Mutex::new).collect(),
            targets: plan.targets.iter().map(|_| Mutex::default()).collect(),
            repairs: plan.actions.iter().map(|_| Mutex::default()).collect(),
            running: Mutex::default(),
            ran: Condvar::new(),
            warnings: Mutex::default(),
        }
    }

    /// Builds, or says what would be built.
    pub(crate) fn run(self) -> Built {
        if self.options.dry_run {
            self.judge_all();
        } else {
            self.schedule();
        }
        let cancelled = self.is_cancelled();
        let files_hashed = self.files.hashed();
        let mut lasts = Vec::new();
        let mut actions = Vec::new();
        for (index, (slot, action)) in self.slots.into_iter().zip(&self.plan.actions).enumerate() {
            let slot = slot.into_inner().unwrap_or_else(PoisonError::into_inner);
            let record = slot.done.as_ref().map(|(_, record)| record.clone());
            if let Some((manifest, record)) = slot.done {
                lasts.push((index, Last { manifest, record }));
            }
            actions.push(ActionReport {
                id: action.id.clone(),
                label: action.label.clone(),
                kind: action.kind,
                state: slot.state.unwrap_or(ActionState::Skipped { because: None }),
                record,
                sought: slot.sought,
                warnings: slot.warnings,
            });
        }
        let mut targets = Vec::new();
        for (slot, target) in self.targets.into_iter().zip(&self.plan.targets) {
            let slot = slot.into_inner().unwrap_or_else(PoisonError::into_inner);
            let record = actions[target.action].record.as_ref();
            let output = record.and_then(|record| record.output(&target.output));
            targets.push(TargetReport {
                path: target.path.clone(),
                state: slot.state.unwrap_or(TargetState::Skipped),
                hash: output.map(|output| output.hash),
                length: output.map(|output| output.length),
            });
        }
        let warnings = self.warnings.into_inner().unwrap_or_else(PoisonError::into_inner);
        let report = BuildReport { actions, targets, warnings, files_hashed, cancelled, seconds: 0.0 };
        Built { report, seen: self.files.into_seen(), lasts }
    }

    pub(crate) fn is_cancelled(&self) -> bool {
        self.options.cancel.load(Ordering::Relaxed)
    }

    /// A warning of an action.
    pub(crate) fn warn(&self, action: usize, message: &str) {
        lock(&self.slots[action]).warnings.push(message.to_owned());
        self.observer.event(&Event::Warning { action: Some(action), message });
    }

    fn record(&self, action: usize) -> Option<Arc<Record>> {
        lock(&self.slots[action]).done.as_ref().map(|(_, record)| record.clone())
    }

    fn sync_cache(&self) -> bool {
        self.options.durability == Durability::Always
    }

    /// Ends an action, in whatever way.
    fn finish(&self, action: usize, state: ActionState) {
        let bytes = self.record(action).map_or(0, |record| record.outputs.iter().map(|output| output.length).sum());
        self.observer.event(&Event::Finished { action, state: &state, bytes });
        lock(&self.slots[action]).state = Some(state);
    }

    /// One reader of `action` is done with it; the last one frees its outputs.
    fn release(&self, action: usize) {
        let mut slot = lock(&self.slots[action]);
        slot.readers = slot.readers.saturating_sub(1);
        if slot.readers == 0 {
            slot.live.clear();
        }
    }
}
