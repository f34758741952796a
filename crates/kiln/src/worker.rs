//! The child process around xatlas: where its program lies, and how it is run.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use kiln_pipeline::stages::XatlasWorker;
use kiln_xatlas::spawn::{WorkerLimits, run_worker};

/// The worker program: `KILN_XATLAS`, or `kiln-xatlas` beside this program.
pub fn find() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("KILN_XATLAS").filter(|v| !v.is_empty()) {
        return Some(PathBuf::from(named));
    }
    let own = std::env::current_exe().ok()?;
    let name = format!("kiln-xatlas{}", std::env::consts::EXE_SUFFIX);
    // Test programs lie one folder below the programs.
    own.ancestors().skip(1).take(2).map(|folder| folder.join(&name)).find(|path| path.is_file())
}

/// Runs `program` once for a request: limited in memory and by what is left of the stage's time, killed when `cancel` is set.
pub fn runner(program: PathBuf, cancel: Arc<AtomicBool>) -> XatlasWorker {
    Arc::new(move |request: &[u8], left: Option<Duration>| run(&program, request, left, &cancel))
}

fn run(program: &Path, request: &[u8], left: Option<Duration>, cancel: &AtomicBool) -> Result<Vec<u8>, String> {
    let limits = WorkerLimits { time: left, ..WorkerLimits::default() };
    run_worker(program, request, &limits, cancel).map_err(|error| error.to_string())
}
