//! Runs the worker: one child a request, limited in time and memory, killed when it overstays or when asked to.
//!
//! The memory limit is the shell's `ulimit -v` (address space) in front of an `exec`, so that no unsafe code of ours runs
//! between fork and exec; it holds on Unix only. The worker itself looks whether its parent is still there, so that a parent that
//! is killed leaves nothing running. Standard input is written and the outputs are read by threads of their own,
//! so that neither side waits for the other; all they hold is bounded.

use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How often the child is looked after.
const POLL: Duration = Duration::from_millis(5);

/// Most of the child's standard error that is kept, bytes.
const ERROR_TEXT_MAX: u64 = 4096;

/// What a worker may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkerLimits {
    /// Wall-clock time, `None` for any. A worker that needs more is killed, and that is an error: time never chooses a result.
    pub time: Option<Duration>,
    /// Address space, bytes; Unix only.
    pub memory_bytes: u64,
}

impl Default for WorkerLimits {
    /// Ten minutes and 8 GiB: xatlas takes about a minute and less than 1 GiB for 70,000 triangles.
    fn default() -> Self {
        WorkerLimits { time: Some(Duration::from_secs(600)), memory_bytes: 8 << 30 }
    }
}

/// Why there is no reply. None of these may be cached.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The program could not be started.
    #[error("the worker {program} could not be started: {error}; use unwrapper = \"uvunwrap\" or \"auto\"")]
    Start {
        /// Its path.
        program: String,
        /// The system's reason.
        error: std::io::Error,
    },
    /// It ran out of time.
    #[error(
        "xatlas did not finish within {:.0} s; use unwrapper = \"uvunwrap\" or \"auto\", or a coarser base level",
        .limit.as_secs_f64()
    )]
    TimeLimit {
        /// The limit.
        limit: Duration,
    },
    /// It was asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// It failed.
    #[error(
        "the worker ended with {status}{}{text} (it may use {} MiB); use unwrapper = \"uvunwrap\" or \"auto\", or a coarser \
         base level",
        separator(.text),
        .memory_bytes >> 20
    )]
    Failed {
        /// What it was allowed.
        memory_bytes: u64,
        /// How it ended.
        status: ExitStatus,
        /// What it said on standard error.
        text: String,
    },
    /// It sent more than any reply to that request can be.
    #[error("the worker sent more than {limit} bytes; use unwrapper = \"uvunwrap\" or \"auto\"")]
    TooLong {
        /// The most that is read, bytes.
        limit: u64,
    },
    /// A pipe broke.
    #[error("the worker's pipes failed: {0}; use unwrapper = \"uvunwrap\" or \"auto\"")]
    Io(#[from] std::io::Error),
}

fn separator(text: &str) -> &'static str {
    if text.is_empty() { "" } else { ": " }
}

/// The reply of the program `exe` to `request`, as bytes from outside. The child is killed when `cancel` becomes true, when
/// the time is over, and when this function leaves early for any reason.
///
/// # Errors
/// See [`WorkerError`].
pub fn run_worker(
    exe: &Path,
    request: &[u8],
    limits: &WorkerLimits,
    cancel: &AtomicBool,
) -> Result<Vec<u8>, WorkerError> {
    run(limited(exe, limits), request, limits, cancel)
}

#[cfg(unix)]
fn limited(exe: &Path, limits: &WorkerLimits) -> Command {
    let mut command = Command::new("/bin/sh");
    command.args(["-c", "ulimit -v \"$1\" && exec \"$2\"", "sh"]);
    command.arg((limits.memory_bytes / 1024).to_string()).arg(exe);
    command
}

#[cfg(not(unix))]
fn limited(exe: &Path, _limits: &WorkerLimits) -> Command {
    Command::new(exe)
}

/// Kills its child when dropped.
struct Kept(Child);

impl Drop for Kept {
    fn drop(&mut self) {
        // Both fail only for a child that has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn run(
    mut command: Command,
    request: &[u8],
    limits: &WorkerLimits,
    cancel: &AtomicBool,
) -> Result<Vec<u8>, WorkerError> {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let program = command.get_args().last().unwrap_or(command.get_program()).to_string_lossy().into_owned();
    let child = command.spawn().map_err(|error| WorkerError::Start { program, error })?;
    let mut child = Kept(child);
    let pipes = (child.0.stdin.take(), child.0.stdout.take(), child.0.stderr.take());
    let (Some(mut input), Some(output), Some(errors)) = pipes else {
        return Err(std::io::Error::other("no pipes").into());
    };
    // A reply holds 28 bytes a face, a request 16 bytes a face and 12 a point.
    let limit = 4 * request.len() as u64 + 65536;
    let start = Instant::now();
    let request = request.to_vec();
    // Not scoped: a grandchild that holds a pipe open must not keep us here after the kill.
    let writer = thread::spawn(move || input.write_all(&request));
    let reader = thread::spawn(move || read_at_most(output, limit + 1));
    let listener = thread::spawn(move || read_at_most(errors, ERROR_TEXT_MAX));
    let status = loop {
        if let Some(status) = child.0.try_wait()? {
            break status;
        }
        if cancel.load(Ordering::Relaxed) {
            return Err(WorkerError::Cancelled);
        }
        if let Some(limit) = limits.time.filter(|limit| start.elapsed() >= *limit) {
            return Err(WorkerError::TimeLimit { limit });
        }
        if reader.is_finished() {
            // Its output is closed or too long; either way it has nothing more to say to us.
            if let Some(status) = wait_a_moment(&mut child.0)? {
                break status;
            }
            return match joined(reader)? {
                reply if reply.len() as u64 > limit => Err(WorkerError::TooLong { limit }),
                _ => Err(std::io::Error::other("the worker closed its output and went on").into()),
            };
        }
        thread::sleep(POLL);
    };
    let reply = joined(reader)?;
    if reply.len() as u64 > limit {
        // Its status then only says that its pipe was closed.
        return Err(WorkerError::TooLong { limit });
    }
    if !status.success() {
        let text = joined(listener).unwrap_or_default();
        let text = String::from_utf8_lossy(&text).trim().to_owned();
        return Err(WorkerError::Failed { memory_bytes: limits.memory_bytes, status, text });
    }
    writer.join().map_err(|_| std::io::Error::other("the writer panicked"))??;
    Ok(reply)
}

/// The child's status if it ends within a second.
fn wait_a_moment(child: &mut Child) -> std::io::Result<Option<ExitStatus>> {
    let until = Instant::now() + Duration::from_secs(1);
    loop {
        match child.try_wait()? {
            None if Instant::now() < until => thread::sleep(POLL),
            status => return Ok(status),
        }
    }
}

fn read_at_most(from: impl Read, limit: u64) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(limit).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn joined(thread: thread::JoinHandle<std::io::Result<Vec<u8>>>) -> std::io::Result<Vec<u8>> {
    thread.join().map_err(|_| std::io::Error::other("the reader panicked"))?
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    const LIMITS: WorkerLimits = WorkerLimits { time: Some(Duration::from_secs(60)), memory_bytes: 1 << 30 };

    fn script(text: &str, limits: WorkerLimits, cancel: bool) -> Result<Vec<u8>, WorkerError> {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", text]);
        run(command, &[7; 200_000], &limits, &AtomicBool::new(cancel))
    }

    fn assert_names_the_alternatives(error: &WorkerError) {
        let text = error.to_string();
        assert!(text.contains("\"uvunwrap\"") && text.contains("\"auto\""), "{text}");
    }

    /// Runs a script that first writes its process id, then `rest`; ends it as `limits` and `cancel` say. The error, and the id.
    fn noted(rest: &str, limits: WorkerLimits, cancel: &AtomicBool) -> (WorkerError, u32) {
        let note = std::env::temp_dir().join(format!("kiln-xatlas-{}-{}", std::process::id(), rest.len()));
        let mut command = Command::new("/bin/sh");
        command.args(["-c", &format!("echo $$ > '{0}.part' && mv '{0}.part' '{0}'; {rest}", note.display())]);
        let error = thread::scope(|scope| {
            let child = scope.spawn(|| run(command, &[], &limits, cancel).expect_err("it never ends by itself"));
            while !note.is_file() && !child.is_finished() {
                thread::yield_now();
            }
            if limits.time.is_none() {
                cancel.store(true, Ordering::Relaxed);
            }
            child.join().expect("no panic")
        });
        let id = std::fs::read_to_string(&note).expect("written").trim().parse().expect("a number");
        std::fs::remove_file(&note).expect("there");
        (error, id)
    }

    /// Whether a process of that id is there (a zombie, too).
    fn is_there(id: u32) -> bool {
        let status = Command::new("/bin/sh").args(["-c", &format!("kill -0 {id}")]).stderr(Stdio::null()).status();
        status.expect("sh").success()
    }

    #[test]
    fn a_child_that_is_cancelled_at_work_is_gone_when_the_error_is_here() {
        let limits = WorkerLimits { time: None, ..LIMITS };
        let (error, id) = noted("while :; do :; done", limits, &AtomicBool::new(false));
        assert!(matches!(error, WorkerError::Cancelled), "{error}");
        assert!(!is_there(id), "killed and waited for");
    }

    #[test]
    fn a_child_that_overstays_at_work_is_gone_when_the_error_is_here() {
        let limits = WorkerLimits { time: Some(Duration::from_secs(2)), ..LIMITS };
        let (error, id) = noted("while true; do :; done", limits, &AtomicBool::new(false));
        assert!(matches!(error, WorkerError::TimeLimit { .. }), "{error}");
        assert!(!is_there(id), "killed and waited for");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_child_that_wants_more_memory_than_it_may_use_fails_and_the_error_names_the_alternatives() {
        let greedy = "x=0123456789abcdef; while :; do x=$x$x; done";
        let limits = WorkerLimits { memory_bytes: 64 << 20, ..LIMITS };
        // A shell without arguments takes its script from standard input.
        let error = run(limited(Path::new("/bin/sh"), &limits), greedy.as_bytes(), &limits, &AtomicBool::new(false))
            .expect_err("64 MiB");
        assert!(matches!(&error, WorkerError::Failed { .. }), "{error}");
        assert!(error.to_string().contains("64 MiB"), "{error}");
        assert_names_the_alternatives(&error);
    }

    #[test]
    fn what_the_child_writes_comes_back() {
        let cat = run_worker(Path::new("/bin/cat"), &[9; 300_000], &LIMITS, &AtomicBool::new(false)).expect("echo");
        assert_eq!(cat, [9; 300_000]);
    }

    #[test]
    fn a_child_that_fails_is_an_error_with_its_words() {
        let error =
            script("while read -r line; do :; done; echo broken >&2; exit 3", LIMITS, false).expect_err("exit 3");
        assert!(matches!(&error, WorkerError::Failed { text, .. } if text == "broken"), "{error}");
    }

    #[test]
    fn a_child_that_overstays_is_killed() {
        let limits = WorkerLimits { time: Some(Duration::ZERO), ..LIMITS };
        let error = script("while :; do :; done", limits, false).expect_err("endless");
        assert!(matches!(error, WorkerError::TimeLimit { limit: Duration::ZERO }), "{error}");
        assert_names_the_alternatives(&error);
    }

    #[test]
    fn a_cancelled_child_is_killed() {
        assert!(matches!(script("while :; do :; done", LIMITS, true), Err(WorkerError::Cancelled)));
    }

    #[test]
    fn a_child_that_talks_without_end_is_stopped() {
        let error = script("while :; do echo talk; done", LIMITS, false).expect_err("endless output");
        assert!(matches!(error, WorkerError::TooLong { limit: 865_536 }), "{error}");
    }

    #[test]
    fn a_program_that_is_not_there_is_an_error() {
        let missing = Path::new("/no/such/worker");
        let error = run_worker(missing, &[], &LIMITS, &AtomicBool::new(false)).expect_err("missing");
        assert!(matches!(&error, WorkerError::Failed { text, .. } if text.contains("/no/such/worker")), "{error}");
    }

    #[test]
    fn the_memory_limit_reaches_the_child() {
        // The shell's own builtin reports what an exec'd program would inherit.
        let mut command = limited(Path::new("/bin/sh"), &WorkerLimits { memory_bytes: 512 << 20, ..LIMITS });
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("sh");
        child.stdin.take().expect("piped").write_all(b"ulimit -v").expect("written");
        let output = child.wait_with_output().expect("ends");
        assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "524288");
    }
}
