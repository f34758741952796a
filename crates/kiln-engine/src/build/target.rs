//! Output files: written only if they differ, beside and renamed, one lock per output.

use std::fs;
use std::path::{Path, PathBuf};

use super::{Session, lock};
use crate::disk::{self, is_absent};
use crate::engine::Durability;
use crate::error::{ActionError, IoError};
use crate::reason::StaleReason;
use crate::report::{Event, OutputRecord, TargetError, TargetState};

impl Session<'_> {
    /// Does one target. Its slot says what came of it.
    pub(super) fn deliver(&self, target: usize) {
        let state = self.delivered(target).unwrap_or_else(TargetState::Failed);
        self.observer.event(&Event::TargetFinished { target, state: &state });
        lock(&self.targets[target]).state = Some(state);
    }

    fn delivered(&self, target: usize) -> Result<TargetState, TargetError> {
        let wanted = &self.plan.targets[target];
        let Some(output) = self.wanted_output(target)? else { return Ok(TargetState::Skipped) };
        let Some(reason) = self.target_reason(target, &output)? else {
            self.clear_litter(&wanted.path)?;
            return Ok(TargetState::Unchanged);
        };
        let bytes = self.blob(wanted.action, &wanted.output)?;
        self.write_target(&wanted.path, &bytes)?;
        self.files.wrote(&wanted.path, output.hash);
        Ok(TargetState::Written { reason })
    }

    /// What the target should hold; `None` if its action gave nothing.
    pub(super) fn wanted_output(&self, target: usize) -> Result<Option<OutputRecord>, ActionError> {
        let wanted = &self.plan.targets[target];
        let Some(record) = self.record(wanted.action) else { return Ok(None) };
        let no_output = || ActionError::NoOutput {
            action: self.plan.actions[wanted.action].id.clone(),
            output: wanted.output.clone(),
        };
        record.output(&wanted.output).cloned().map(Some).ok_or_else(no_output)
    }

    /// Why the file has to be written; `None` if it holds the output.
    pub(super) fn target_reason(&self, target: usize, output: &OutputRecord) -> Result<Option<StaleReason>, IoError> {
        let path = &self.plan.targets[target].path;
        let full = self.plan.root.join(path);
        match fs::metadata(&full) {
            Err(error) if is_absent(&error) => {}
            Err(error) => return Err(IoError::new("look at", full)(error)),
            // Another length, other bytes: no need to read them.
            Ok(metadata) if metadata.is_file() && metadata.len() != output.length => {
                return Ok(Some(StaleReason::OutputDiffers { path: path.clone() }));
            }
            Ok(_) => {}
        }
        Ok(match self.files.hash(path)? {
            Some(hash) if hash == output.hash => None,
            Some(_) => Some(StaleReason::OutputDiffers { path: path.clone() }),
            None => Some(StaleReason::OutputMissing { path: path.clone() }),
        })
    }

    fn write_target(&self, path: &str, bytes: &[u8]) -> Result<(), IoError> {
        let full = self.plan.root.join(path);
        disk::create_folder(full.parent().unwrap_or(Path::new("")))?;
        let temporary = temporary(&full);
        let _lock = self.store.lock(path)?;
        let _writing = disk::writing();
        let sync = self.options.durability != Durability::Never;
        let written = disk::write(&temporary, &[bytes], sync).and_then(|()| disk::rename(&temporary, &full));
        if written.is_err() {
            let _ = disk::remove(&temporary);
        }
        written
    }

    /// Removes what a killed build left beside an output that needs no writing.
    fn clear_litter(&self, path: &str) -> Result<(), IoError> {
        let temporary = temporary(&self.plan.root.join(path));
        if temporary.exists() {
            let _lock = self.store.lock(path)?;
            disk::remove(&temporary)?;
        }
        Ok(())
    }
}

/// The file beside `output` that becomes it; one name for all processes, so that what a killed one left is overwritten.
fn temporary(output: &Path) -> PathBuf {
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!(".{name}.kiln-tmp"))
}
