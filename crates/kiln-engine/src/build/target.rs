//! Output files: written only if they differ, beside and renamed, one lock per output.

use std::fs::{self, OpenOptions};
use std::path::Path;

use super::{Session, lock};
use crate::disk::{self, is_absent};
use crate::engine::Sync;
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
        let Some(reason) = self.target_reason(target, &output)? else { return Ok(TargetState::Unchanged) };
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
        let folder = full.parent().unwrap_or(Path::new(""));
        disk::create_folder(folder)?;
        let name = full.file_name().unwrap_or_default().to_string_lossy();
        // One name for all processes, so that what a killed one left is overwritten by the next.
        let temporary = folder.join(format!(".{name}.kiln-tmp"));
        let lock_path = self.store.lock_path(path);
        let lock = OpenOptions::new().write(true).create(true).truncate(false).open(&lock_path);
        let lock = lock.map_err(IoError::new("open", &lock_path))?;
        lock.lock().map_err(IoError::new("lock", &lock_path))?;
        let written = disk::write(&temporary, &[bytes], self.options.sync != Sync::Never)
            .map(drop)
            .and_then(|()| disk::rename(&temporary, &full));
        if written.is_err() {
            let _ = disk::remove(&temporary);
        }
        written
    }
}
