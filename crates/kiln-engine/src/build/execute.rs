//! Running one action and keeping what it gives; loading blobs, and making lost ones again.

use std::any::Any;
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, PoisonError};
use std::time::Instant;

use super::{Session, lock};
use crate::context::Context;
use crate::disk;
use crate::error::ActionError;
use crate::hash::{ContentHash, Fingerprint};
use crate::manifest::Manifest;
use crate::plan::Outputs;
use crate::reason::StaleReason;
use crate::report::{ActionState, Event, OutputRecord, Record};

/// How often an action is begun anew because a file changed under it.
const ATTEMPTS: usize = 3;

impl Session<'_> {
    /// Does one action: finds it fresh or runs it. Its slot says what came of it.
    pub(super) fn perform(&self, action: usize) {
        let state = match self.fresh_or_run(action) {
            Ok(None) => ActionState::Fresh,
            Ok(Some((reason, seconds))) => ActionState::Ran { reason, seconds },
            Err(error) => ActionState::Failed(error),
        };
        self.finish(action, state);
    }

    fn fresh_or_run(&self, action: usize) -> Result<Option<(StaleReason, f64)>, ActionError> {
        let mut attempt = 1;
        loop {
            let resolved = self.resolve(action, &|before| self.record(before))?;
            if let Some(record) = resolved.hit {
                self.done(action, resolved.manifest, record);
                return Ok(None);
            }
            if self.is_cancelled() {
                return Err(ActionError::Cancelled);
            }
            if !self.begin(resolved.declared) {
                continue;
            }
            let result = self.execute(action, &resolved.manifest, resolved.declared, &resolved.reason, false);
            self.end(resolved.declared);
            match result {
                Err(ActionError::InputChanged { .. }) if attempt < ATTEMPTS => {
                    // What was read is what the next attempt takes for the file's content.
                    attempt += 1;
                }
                Err(error) => return Err(error),
                Ok(seconds) => return Ok(Some((resolved.reason, seconds))),
            }
        }
    }

    /// Takes the right to run `declared`; `false` after another thread that had it is done.
    fn begin(&self, declared: Fingerprint) -> bool {
        let mut running = lock(&self.running);
        if running.insert(declared) {
            return true;
        }
        while running.contains(&declared) {
            running = self.ran.wait(running).unwrap_or_else(PoisonError::into_inner);
        }
        false
    }

    fn end(&self, declared: Fingerprint) {
        lock(&self.running).remove(&declared);
        self.ran.notify_all();
    }

    pub(super) fn done(&self, action: usize, manifest: Manifest, record: Arc<Record>) {
        lock(&self.slots[action]).done = Some((manifest, record));
    }

    /// Runs an action and keeps what it gives, or nothing. `again`: its outputs were lost. Gives the seconds.
    fn execute(
        &self,
        action: usize,
        manifest: &Manifest,
        declared: Fingerprint,
        reason: &StaleReason,
        again: bool,
    ) -> Result<f64, ActionError> {
        let label = &self.plan.actions[action].label;
        self.observer.event(&Event::Started { action, label, reason });
        let context = Context::new(self, action, manifest);
        let start = Instant::now();
        let result = catch_unwind(AssertUnwindSafe(|| (self.plan.actions[action].run)(&context)));
        let seconds = start.elapsed().as_secs_f64();
        let discovered = context.discovered();
        let outputs = context
            .objection()
            .map_or(Ok(()), Err)
            .and_then(|()| result.unwrap_or_else(|panic| Err(ActionError::Panicked { message: message_of(&*panic) })))
            .inspect_err(|_| {
                lock(&self.slots[action]).sought = discovered.iter().map(|(path, _)| path.clone()).collect();
            })?;
        let manifest = manifest.with_discovered(&discovered);
        let _writing = disk::writing();
        let record = Record {
            fingerprint: manifest.fingerprint(),
            kind: self.plan.actions[action].kind.to_owned(),
            outputs: self.keep_blobs(action, &outputs, again)?,
            discovered,
            report: outputs.report,
            seconds: if self.options.timed { seconds } else { 0.0 },
        };
        let record = self.keep_record(action, declared, record, again)?;
        self.done(action, manifest, Arc::new(record));
        Ok(seconds)
    }

    /// Keeps the outputs in the store, and in memory if something reads them; what was lost once (`again`) may be lost again before
    /// whoever asked for it looks into the store.
    fn keep_blobs(&self, action: usize, outputs: &Outputs, again: bool) -> Result<Vec<OutputRecord>, ActionError> {
        let mut names = BTreeSet::new();
        if let Some((name, _)) = outputs.blobs.iter().find(|(name, _)| !names.insert(name)) {
            return Err(ActionError::RepeatedOutput { name: name.clone() });
        }
        let mut records = Vec::new();
        for (name, bytes) in &outputs.blobs {
            let hash = ContentHash::of(bytes);
            self.store.put_blob(&hash, bytes, self.sync_cache())?;
            records.push(OutputRecord { name: name.clone(), hash, length: bytes.len() as u64 });
            let mut slot = lock(&self.slots[action]);
            if slot.readers > 0 || again {
                slot.live.insert(name.clone(), bytes.as_slice().into());
            }
        }
        Ok(records)
    }

    /// Keeps the record, or takes the one that another process wrote first.
    fn keep_record(
        &self,
        action: usize,
        declared: Fingerprint,
        record: Record,
        again: bool,
    ) -> Result<Record, ActionError> {
        let sync = self.sync_cache();
        if self.plan.actions[action].discovers.is_some() {
            let list: Vec<String> = record.discovered.iter().map(|(path, _)| path.clone()).collect();
            self.store.put_list(&declared, &list, sync)?;
        }
        if self.store.put_record(&record, false, sync)? {
            return Ok(record);
        }
        match self.store.record(&record.fingerprint) {
            Some(first) if first.outputs == record.outputs => Ok(first),
            Some(first) if !again => {
                // The first writer wins, so that all builds on this cache go on from the same bytes.
                self.warn(
                    action,
                    "gave other bytes than an earlier run with the same inputs; the earlier ones are used",
                );
                lock(&self.slots[action]).live.clear();
                Ok(first)
            }
            _ => {
                self.store.put_record(&record, true, sync)?;
                Ok(record)
            }
        }
    }

    /// The bytes of an output of an action that is done.
    pub(crate) fn blob(&self, action: usize, output: &str) -> Result<Arc<[u8]>, ActionError> {
        if let Some(bytes) = self.blob_at_hand(action, output)? {
            return Ok(bytes);
        }
        let _repair = lock(&self.repairs[action]);
        match self.blob_at_hand(action, output)? {
            Some(bytes) => Ok(bytes),
            None => self.make_again(action, output),
        }
    }

    /// The bytes if memory or the store has them.
    fn blob_at_hand(&self, action: usize, output: &str) -> Result<Option<Arc<[u8]>>, ActionError> {
        if let Some(bytes) = lock(&self.slots[action]).live.get(output) {
            return Ok(Some(bytes.clone()));
        }
        let id = &self.plan.actions[action].id;
        let no_output = || ActionError::NoOutput { action: id.clone(), output: output.to_owned() };
        let record = self.record(action).ok_or_else(no_output)?;
        let bytes = self.store.blob_of(record.output(output).ok_or_else(no_output)?);
        if let Some(bytes) = &bytes {
            let mut slot = lock(&self.slots[action]);
            if slot.readers > 1 {
                slot.live.insert(output.to_owned(), bytes.clone());
            }
        }
        Ok(bytes)
    }

    /// Runs an action again whose output the cache lost.
    fn make_again(&self, action: usize, output: &str) -> Result<Arc<[u8]>, ActionError> {
        let id = &self.plan.actions[action].id;
        let before = self.record(action);
        let resolved = self.resolve(action, &|before| self.record(before))?;
        let reason = StaleReason::BlobLost { what: output.to_owned() };
        let seconds = self.execute(action, &resolved.manifest, resolved.declared, &reason, true)?;
        self.finish(action, ActionState::Ran { reason, seconds });
        let after = self.record(action);
        let outputs = |record: &Option<Arc<Record>>| record.as_ref().map(|record| record.outputs.clone());
        if outputs(&before) != outputs(&after) {
            return Err(ActionError::NotDeterministic { action: id.clone() });
        }
        let lost = || ActionError::NoOutput { action: id.clone(), output: output.to_owned() };
        self.blob_at_hand(action, output)?.ok_or_else(lost)
    }
}

fn message_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into())
}
