//! What an action is given, and whether the cache knows what it gives.

use std::sync::Arc;

use super::Session;
use crate::context::{is_inside, join};
use crate::disk;
use crate::error::{ActionError, IoError};
use crate::hash::{ContentHash, Fingerprint};
use crate::manifest::{InputField, Manifest, Origin};
use crate::plan::Source;
use crate::reason::StaleReason;
use crate::report::Record;

/// An action whose inputs are known.
pub(super) struct Resolved {
    /// Declared fields, and the discovered files of the record (if there is one) or of the last build.
    pub(super) manifest: Manifest,
    /// The fingerprint of the declared fields alone.
    pub(super) declared: Fingerprint,
    /// What a run with these inputs gave.
    pub(super) hit: Option<Arc<Record>>,
    /// Why there is none.
    pub(super) reason: StaleReason,
}

impl Session<'_> {
    /// Resolves an action; `upstream` gives the records of those it reads.
    pub(super) fn resolve(
        &self,
        action: usize,
        upstream: &dyn Fn(usize) -> Option<Arc<Record>>,
    ) -> Result<Resolved, ActionError> {
        let declared = self.declared(action, upstream)?;
        let fingerprint = declared.fingerprint();
        let Some(folder) = &self.plan.actions[action].discovers else {
            let hit = self.known(action, fingerprint);
            let reason = self.explain(action, &declared);
            return Ok(Resolved { manifest: declared, declared: fingerprint, hit, reason });
        };
        let last = self.state.last(&self.plan.actions[action].id);
        let last_list = last.map(|last| last.manifest.discovered().map(str::to_owned).collect::<Vec<_>>());
        let mut now = None;
        let mut tried = Vec::new();
        // The list of the last build first: it is in memory and nearly always right. The store's lists only if it is not.
        for list in last_list.into_iter().chain(std::iter::once_with(|| self.store.lists(&fingerprint)).flatten()) {
            // A list may come from elsewhere: it names only what the action itself may read.
            let outside = self.plan.actions[action].outside;
            if tried.contains(&list) || !list.iter().all(|path| is_inside(path, outside)) {
                continue;
            }
            // A list is a guess: one that names what cannot be read is no help, and the run itself says what is wrong with its files.
            let Ok(contents) = self.contents(folder, &list) else { continue };
            let manifest = declared.with_discovered(&contents);
            if let Some(record) = self.known(action, manifest.fingerprint()) {
                return Ok(Resolved {
                    manifest,
                    declared: fingerprint,
                    hit: Some(record),
                    reason: StaleReason::NoRecord,
                });
            }
            now.get_or_insert(manifest);
            tried.push(list);
        }
        let manifest = now.unwrap_or(declared);
        let reason = self.explain(action, &manifest);
        Ok(Resolved { manifest, declared: fingerprint, hit: None, reason })
    }

    /// The manifest of what the plan declares.
    fn declared(
        &self,
        action: usize,
        upstream: &dyn Fn(usize) -> Option<Arc<Record>>,
    ) -> Result<Manifest, ActionError> {
        let plan = self.plan;
        let mut inputs = Vec::new();
        for input in &plan.actions[action].inputs {
            let mut push = |name: String, hash, origin| inputs.push(InputField { name, hash: Some(hash), origin });
            match &input.source {
                Source::Bytes(bytes) => push(input.name.clone(), ContentHash::of(bytes), Origin::Bytes),
                Source::File { path } => {
                    let absent = || std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such file");
                    let full = plan.root.join(path);
                    let hash = self.files.hash(path)?.ok_or_else(|| IoError::new("read", full)(absent()))?;
                    push(input.name.clone(), hash, Origin::File { path: path.clone() });
                }
                Source::Output { action: before, output } => {
                    let id = &plan.actions[*before].id;
                    let no_output = || ActionError::NoOutput { action: id.clone(), output: output.clone() };
                    let record = upstream(*before).ok_or_else(no_output)?;
                    let hash = record.output(output).ok_or_else(no_output)?.hash;
                    let origin = Origin::Upstream { action: id.clone(), output: output.clone() };
                    push(input.name.clone(), hash, origin);
                }
                Source::Outputs { action: before, prefix } => {
                    let id = &plan.actions[*before].id;
                    let record = upstream(*before)
                        .ok_or_else(|| ActionError::NoOutput { action: id.clone(), output: prefix.clone() })?;
                    for output in &record.outputs {
                        if let Some(rest) = output.name.strip_prefix(prefix) {
                            let origin = Origin::Upstream { action: id.clone(), output: output.name.clone() };
                            push(format!("{}/{rest}", input.name), output.hash, origin);
                        }
                    }
                }
            }
        }
        Ok(Manifest::new(plan.actions[action].head(), inputs))
    }

    /// The contents of the files of a list, now.
    fn contents(&self, folder: &str, list: &[String]) -> Result<Vec<(String, Option<ContentHash>)>, ActionError> {
        let content = |path: &String| Ok((path.clone(), self.files.hash(&join(folder, path))?));
        list.iter().map(content).collect()
    }

    /// What a run with this fingerprint gave, as the state or the store knows it.
    fn known(&self, action: usize, fingerprint: Fingerprint) -> Option<Arc<Record>> {
        let last = self.state.last(&self.plan.actions[action].id);
        match last {
            Some(last) if last.record.fingerprint == fingerprint => Some(last.record.clone()),
            _ => self.store.record(&fingerprint).map(Arc::new),
        }
    }

    /// Why an action with this manifest has to run.
    fn explain(&self, action: usize, manifest: &Manifest) -> StaleReason {
        let Some(last) = self.state.last(&self.plan.actions[action].id) else { return StaleReason::NoRecord };
        let difference = manifest.first_difference(&last.manifest);
        difference.unwrap_or(StaleReason::BlobLost { what: "record".into() })
    }

    /// Why an action that cannot even be resolved is stale: a declared file is gone.
    pub(super) fn missing_file(&self, action: usize) -> Option<StaleReason> {
        let gone =
            |path: &str| std::fs::metadata(self.plan.root.join(path)).is_err_and(|error| disk::is_absent(&error));
        self.plan.actions[action].inputs.iter().find_map(|input| match &input.source {
            Source::File { path } if gone(path) => Some(StaleReason::InputFileMissing { path: path.clone() }),
            _ => None,
        })
    }
}
