//! What an action sees while it runs: its inputs, files it finds, a place to say how far it is.

use std::collections::BTreeMap;
use std::io;
use std::path::{Component, Path};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::build::Session;
use crate::error::{ActionError, IoError};
use crate::files::Content;
use crate::hash::ContentHash;
use crate::manifest::{Manifest, Origin};
use crate::plan::Source;
use crate::report::Event;

/// The only door between an action and the world.
pub struct Context<'a> {
    session: &'a Session<'a>,
    action: usize,
    manifest: &'a Manifest,
    /// Files that it asked for, by their paths relative to the action's folder.
    found: Mutex<BTreeMap<String, Content>>,
    /// A file that is there but could not be read: nothing that was made without it may be kept.
    unreadable: Mutex<Option<IoError>>,
    changed: Mutex<Option<String>>,
    saw_cancel: AtomicBool,
}

impl<'a> Context<'a> {
    pub(crate) fn new(session: &'a Session<'a>, action: usize, manifest: &'a Manifest) -> Context<'a> {
        Context {
            session,
            action,
            manifest,
            found: Mutex::default(),
            unreadable: Mutex::default(),
            changed: Mutex::default(),
            saw_cancel: AtomicBool::new(false),
        }
    }

    /// The names of its inputs, sorted; an input of a prefix stands there once for each output, such as `images/3`.
    pub fn inputs(&self) -> impl Iterator<Item = &str> {
        let declared = |origin: &Origin| !matches!(origin, Origin::Discovered { .. });
        self.manifest.inputs.iter().filter(move |input| declared(&input.origin)).map(|input| input.name.as_str())
    }

    /// Whether there is an input `name`.
    pub fn has_input(&self, name: &str) -> bool {
        self.inputs().any(|input| input == name)
    }

    /// The bytes of an input; loaded now, so that what is not asked for costs nothing.
    ///
    /// # Errors
    /// There is no such input, its file cannot be read, or the cache lost it and making it again failed. Return it as it is.
    pub fn input(&self, name: &str) -> Result<Arc<[u8]>, ActionError> {
        let no_input = || ActionError::NoInput { name: name.to_owned() };
        let field = self.manifest.inputs.iter().find(|input| input.name == name).ok_or_else(no_input)?;
        match &field.origin {
            Origin::Discovered { .. } => Err(no_input()),
            Origin::Upstream { output, .. } => self.session.blob(self.upstream_of(name).ok_or_else(no_input)?, output),
            Origin::File { path } => {
                let read = self.session.files.read(path)?;
                match read {
                    Some((bytes, hash)) if Some(hash) == field.hash => Ok(bytes),
                    _ => {
                        *lock(&self.changed) = Some(path.clone());
                        Err(ActionError::InputChanged { path: path.clone() })
                    }
                }
            }
            Origin::Bytes => {
                let inputs = &self.session.plan.actions[self.action].inputs;
                inputs
                    .iter()
                    .find_map(|input| match &input.source {
                        Source::Bytes(bytes) if input.name == name => Some(bytes.clone()),
                        _ => None,
                    })
                    .ok_or_else(no_input)
            }
        }
    }

    /// The action before that gives input `name`.
    fn upstream_of(&self, name: &str) -> Option<usize> {
        let inputs = &self.session.plan.actions[self.action].inputs;
        inputs.iter().find_map(|input| match &input.source {
            Source::Output { action, .. } if input.name == name => Some(*action),
            Source::Outputs { action, .. } if name.strip_prefix(&input.name)?.starts_with('/') => Some(*action),
            _ => None,
        })
    }

    /// The bytes of a file under the action's folder, `/`-separated path relative to it. The file becomes an input of the
    /// action, present or absent; one run sees one content.
    ///
    /// # Errors
    /// `NotFound` if it is absent (recorded too: its appearance makes the action stale); `InvalidInput` for a path that is
    /// absolute or leaves the folder; `PermissionDenied` if the action declares no folder; else what the system says, and then
    /// the action fails even if it goes on.
    pub fn read_file(&self, relative: &str) -> io::Result<Arc<[u8]>> {
        let Some(folder) = &self.session.plan.actions[self.action].discovers else {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "this action declares no folder to read from"));
        };
        if !is_inside(relative, self.session.plan.actions[self.action].outside) {
            let message = format!("`{relative}` is no relative path inside the model's folder");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
        }
        let absent = || io::Error::new(io::ErrorKind::NotFound, format!("`{relative}` does not exist"));
        if let Some(known) = lock(&self.found).get(relative) {
            return known.as_ref().map(|(bytes, _)| bytes.clone()).ok_or_else(absent);
        }
        match self.session.files.read(&join(folder, relative)) {
            Ok(read) => {
                // Another thread of the action may have read it meanwhile: its content stands.
                let mut found = lock(&self.found);
                let known = found.entry(relative.to_owned()).or_insert(read);
                known.as_ref().map(|(bytes, _)| bytes.clone()).ok_or_else(absent)
            }
            Err(error) => {
                let told = io::Error::new(error.source.kind(), error.source.to_string());
                lock(&self.unreadable).get_or_insert(error);
                Err(told)
            }
        }
    }

    /// Says how far the action is: `fraction` from 0 to 1, `label` what it does now.
    pub fn progress(&self, fraction: f32, label: &str) {
        self.session.observer.event(&Event::Progress { action: self.action, fraction, label });
    }

    /// Says that something is not as it should be. What must be seen after a fresh build too belongs in the stage's report.
    pub fn warn(&self, message: &str) {
        self.session.warn(self.action, message);
    }

    /// Whether the build is being cancelled: an action that asks should return [`ActionError::Cancelled`] soon.
    pub fn is_cancelled(&self) -> bool {
        let cancelled = self.session.is_cancelled();
        if cancelled {
            self.saw_cancel.store(true, Ordering::Relaxed);
        }
        cancelled
    }

    /// What spoils the run whatever the action returned.
    pub(crate) fn objection(&self) -> Option<ActionError> {
        if self.saw_cancel.load(Ordering::Relaxed) {
            return Some(ActionError::Cancelled);
        }
        if let Some(path) = lock(&self.changed).take() {
            return Some(ActionError::InputChanged { path });
        }
        lock(&self.unreadable).take().map(ActionError::Io)
    }

    /// The files that the action found, sorted by path.
    pub(crate) fn discovered(&self) -> Vec<(String, Option<ContentHash>)> {
        let found = lock(&self.found);
        found.iter().map(|(path, read)| (path.clone(), read.as_ref().map(|(_, hash)| *hash))).collect()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A path of plain components only; where it may go `outside`, with steps up too.
pub(crate) fn is_inside(relative: &str, outside: bool) -> bool {
    let plain = |component: Component<'_>| match component {
        Component::Normal(_) => true,
        Component::ParentDir => outside,
        _ => false,
    };
    !relative.is_empty() && !relative.contains(['\\', '\0']) && Path::new(relative).components().all(plain)
}

/// `folder/relative`, both relative to the plan's root.
pub(crate) fn join(folder: &str, relative: &str) -> String {
    if folder.is_empty() { relative.to_owned() } else { format!("{folder}/{relative}") }
}
