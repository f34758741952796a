//! `kiln build --watch`: builds again whenever something changes that the last build looked at.
//!
//! ```text
//! loop: build; watch the folders of everything that it looked at; wait for an event; wait until it is quiet
//! ```
//! Every build finds out by itself what changed: an event only says when to look. A build that fails leaves the last good outputs
//! where they are, and the folders that were watched.

use std::collections::BTreeSet;
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
    /// Folders to watch; `None`: those of the build before, since this one could not tell.
    pub(super) folders: Option<BTreeSet<PathBuf>>,
}

/// Builds by `once` until it is cancelled; gives the last build's exit.
pub(super) fn run(cancel: &AtomicBool, once: &mut dyn FnMut() -> Once) -> Exit {
    let (sender, events) = channel();
    let mut watcher = match notify::recommended_watcher(sender) {
        Ok(watcher) => watcher,
        Err(error) => return complain(Exit::Failed, &format!("nothing can be watched here: {error}")),
    };
    let mut watched = BTreeSet::new();
    loop {
        let Once { exit, folders } = once();
        let mut is_new = false;
        if let Some(folders) = folders {
            for gone in watched.difference(&folders) {
                // It may be gone itself.
                let _ = watcher.unwatch(gone);
            }
            for folder in folders.difference(&watched) {
                match watcher.watch(folder, RecursiveMode::NonRecursive) {
                    Ok(()) => is_new = true,
                    Err(error) => eprintln!("warning: {} cannot be watched: {error}", folder.display()),
                }
            }
            watched = folders;
        }
        // What changed before its folder was watched is found by one more look.
        if !is_new && !wait(&events, cancel) {
            return exit;
        }
        if cancel.load(Ordering::Relaxed) {
            return exit;
        }
    }
}

/// Waits for an event and for quiet after it; `false` if it was cancelled.
fn wait(events: &Receiver<notify::Result<Event>>, cancel: &AtomicBool) -> bool {
    loop {
        if cancel.load(Ordering::Relaxed) {
            return false;
        }
        match events.recv_timeout(QUIET) {
            Ok(event) if concerns(&event) => break,
            Ok(_) | Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
    let first = Instant::now();
    let mut last = first;
    while first.elapsed() < MOST {
        match events.recv_timeout(QUIET.saturating_sub(last.elapsed())) {
            Ok(event) if concerns(&event) => last = Instant::now(),
            Ok(_) => {}
            Err(_) => break,
        }
    }
    true
}

/// Whether an event may change what a build gives: no reading, and no file that kiln is just writing.
fn concerns(event: &notify::Result<Event>) -> bool {
    let own = |path: &PathBuf| {
        path.extension().is_some_and(|extension| extension == "kiln-tmp" || extension == "part")
            || path.components().any(|part| part.as_os_str() == ".kiln")
    };
    match event {
        Ok(event) => {
            !matches!(event.kind, EventKind::Access(_)) && (event.paths.is_empty() || !event.paths.iter().all(own))
        }
        // The watch lost events: a look tells.
        Err(_) => true,
    }
}

/// The folders of everything that a build looked at; of one that is absent, the nearest that is there.
pub(super) fn folders(dependencies: &Dependencies, root: &Path) -> BTreeSet<PathBuf> {
    let assets = dependencies.assets.iter().flat_map(|a| a.inputs.iter().chain(&a.outputs).chain(&a.absent));
    let above =
        dependencies.files.iter().chain(assets).map(|path| path.rsplit_once('/').map_or("", |(folder, _)| folder));
    // Few folders, many files: each folder is asked for once.
    let wanted: BTreeSet<&str> = dependencies.folders.iter().map(String::as_str).chain(above).collect();
    let nearest = |folder: &str| root.join(folder).ancestors().find(|folder| folder.is_dir()).map(Path::to_path_buf);
    wanted.into_iter().filter_map(nearest).collect()
}
