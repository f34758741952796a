//! `kiln build --watch`: builds again whenever something changes that the last build looked at.
//!
//! ```text
//! loop: build; watch the folders of everything that it looked at; wait for an event that concerns it; wait until it is quiet
//! ```
//! Every build finds out by itself what changed: an event only says when to look. An event concerns a build if it is of a file that
//! the build looked at or looked for, or of anything in a folder that it listed: a log beside the pipeline starts nothing. A build
//! that fails leaves the last good outputs where they are, and what was watched.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use kiln_engine::Dependencies;
use notify::{Event, EventKind, RecursiveMode, Watcher};

use super::complain;
use crate::exit::Exit;

/// An editor saves a file in several steps, and an export writes several files: so long must it be quiet.
const QUIET: Duration = Duration::from_millis(200);
/// Where it is never quiet, this long and no longer.
const MOST: Duration = Duration::from_secs(4);

/// What one build leaves for the watch.
pub(super) struct Once {
    pub(super) exit: Exit,
    /// What to watch; `None`: what the build before said, since this one could not tell.
    pub(super) watched: Option<Watched>,
}

/// What a build looked at. Folders are canonical, so that names in events, whatever they begin with, find them.
#[derive(Default)]
pub(super) struct Watched {
    /// Folders that something of interest lies in.
    folders: BTreeSet<PathBuf>,
    /// Of these, the ones in which every name is of interest.
    listed: BTreeSet<PathBuf>,
    /// Folder and name of what was looked at or for.
    files: HashSet<(PathBuf, OsString)>,
}

/// Builds by `once` until it is cancelled; gives the last build's exit.
pub(super) fn run(cancel: &AtomicBool, once: &mut dyn FnMut() -> Once) -> Exit {
    let (sender, events) = channel();
    let mut watcher = match notify::recommended_watcher(sender) {
        Ok(watcher) => watcher,
        Err(error) => return complain(Exit::Failed, &format!("nothing can be watched here: {error}")),
    };
    let mut watched = Watched::default();
    loop {
        let Once { exit, watched: now } = once();
        let mut is_new = false;
        if let Some(now) = now {
            for gone in watched.folders.difference(&now.folders) {
                // It may be gone itself.
                let _ = watcher.unwatch(gone);
            }
            for folder in now.folders.difference(&watched.folders) {
                match watcher.watch(folder, RecursiveMode::NonRecursive) {
                    Ok(()) => is_new = true,
                    Err(error) => eprintln!("warning: {} cannot be watched: {error}", folder.display()),
                }
            }
            watched = now;
        }
        // What changed before its folder was watched is found by one more look.
        if !is_new && !wait(&events, &watched, cancel) {
            return exit;
        }
        if cancel.load(Ordering::Relaxed) {
            return exit;
        }
    }
}

/// Waits for an event and for quiet after it; `false` if it was cancelled.
fn wait(events: &Receiver<notify::Result<Event>>, watched: &Watched, cancel: &AtomicBool) -> bool {
    loop {
        if cancel.load(Ordering::Relaxed) {
            return false;
        }
        match events.recv_timeout(QUIET) {
            Ok(event) if watched.concerned_by(&event) => break,
            Ok(_) | Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
    let first = Instant::now();
    let mut last = first;
    while first.elapsed() < MOST {
        match events.recv_timeout(QUIET.saturating_sub(last.elapsed())) {
            Ok(event) if watched.concerned_by(&event) => last = Instant::now(),
            Ok(_) => {}
            Err(_) => break,
        }
    }
    true
}

impl Watched {
    /// Adds what a build of a pipeline in `root` looked at.
    pub(super) fn add(&mut self, dependencies: &Dependencies, root: &Path) {
        let assets = dependencies.assets.iter().flat_map(|a| a.inputs.iter().chain(&a.outputs).chain(&a.absent));
        // Few folders, many files: each folder is asked for once.
        let mut by_folder: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for path in dependencies.files.iter().chain(assets) {
            let (folder, name) = path.rsplit_once('/').unwrap_or(("", path));
            by_folder.entry(folder).or_default().push(name);
        }
        for (folder, names) in by_folder {
            if let Some(folder) = self.add_folder(&root.join(folder)) {
                self.files.extend(names.into_iter().map(|name| (folder.clone(), name.into())));
            }
        }
        for folder in &dependencies.folders {
            let there = self.add_folder(&root.join(folder));
            self.listed.extend(there);
        }
    }

    /// Adds a pipeline that may be broken: it is watched for its repair.
    pub(super) fn add_pipeline(&mut self, pipeline: &Path, root: &Path) {
        if let (Some(folder), Some(name)) = (self.add_folder(root), pipeline.file_name()) {
            self.files.insert((folder, name.to_owned()));
        }
    }

    /// Watches a folder and gives its canonical path; of one that is absent, the nearest that is there, for the name that is missing.
    fn add_folder(&mut self, folder: &Path) -> Option<PathBuf> {
        let mut missing = None;
        for ancestor in folder.ancestors() {
            let ancestor = if ancestor.as_os_str().is_empty() { Path::new(".") } else { ancestor };
            if let Some(there) = ancestor.canonicalize().ok().filter(|path| path.is_dir()) {
                let is_whole = missing.is_none();
                self.files.extend(missing.map(|name: &OsStr| (there.clone(), name.to_owned())));
                self.folders.insert(there.clone());
                return is_whole.then_some(there);
            }
            missing = ancestor.file_name();
        }
        None
    }

    /// Whether an event may change what a build gives: no reading, and no file that kiln is just writing.
    fn concerned_by(&self, event: &notify::Result<Event>) -> bool {
        match event {
            Ok(event) => {
                let of_interest = event.paths.is_empty() || event.paths.iter().any(|path| self.is_of_interest(path));
                !matches!(event.kind, EventKind::Access(_)) && of_interest
            }
            // The watch lost events: a look tells.
            Err(_) => true,
        }
    }

    fn is_of_interest(&self, path: &Path) -> bool {
        let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { return true };
        // A folder that is gone is of interest itself.
        let Ok(folder) = folder.canonicalize() else { return true };
        let own = Path::new(name).extension().is_some_and(|extension| extension == "kiln-tmp" || extension == "part");
        let place = (folder, name.to_owned());
        let is_folder = self.folders.contains(&place.0.join(name));
        is_folder || !own && (self.listed.contains(&place.0) || self.files.contains(&place))
    }
}
