//! How far a run is: the files that elements leave, and what `squeue` says of the rest; and the words for what failed.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use super::{ExecutorError, Run, SILENCE, said};

/// Lines of a log that are shown.
const LAST_LINES: usize = 12;
/// Bytes at a log's end that are looked at.
const LOG_END: u64 = 64 << 10;

/// What one look found.
pub(super) enum Poll {
    /// All elements left their files.
    All,
    /// Some did not, and none is in the queue.
    Empty,
    /// What is in the queue is held, and nothing runs.
    Stuck,
    /// Some run or wait.
    Waiting,
}

impl Run<'_> {
    /// Looks at the files, then at the queue.
    pub(super) fn poll(&mut self) -> Result<Poll, ExecutorError> {
        // The queue first: what leaves it between the two looks has left its file.
        let queue = self.queue()?;
        for number in 0..self.arrays.len() {
            self.take_files(number);
        }
        if self.arrays.iter().all(|array| array.ended.len() == array.elements.len()) {
            return Ok(Poll::All);
        }
        let Some(queue) = queue else { return Ok(Poll::Waiting) };
        for array in &mut self.arrays {
            array.gone = array.job.is_some_and(|job| !queue.jobs.contains(&job));
        }
        self.note = queue.note();
        Ok(if queue.jobs.is_empty() {
            Poll::Empty
        } else if queue.is_stuck() {
            Poll::Stuck
        } else {
            Poll::Waiting
        })
    }

    /// What `squeue` says; `None` if it has no answer now.
    fn queue(&mut self) -> Result<Option<Queue>, ExecutorError> {
        let name = format!("--name={}", self.name);
        let asked = said(Command::new("squeue").args(["--noheader", "--format=%F|%T|%r", &name]));
        match asked {
            Ok(text) => {
                self.answered = Instant::now();
                Ok(Some(Queue::parse(&text)))
            }
            Err(error @ ExecutorError::NoProgram { .. }) => Err(error),
            // The controller may be away for a while: what runs goes on.
            Err(error) if self.answered.elapsed() > SILENCE => Err(error),
            Err(_) => {
                self.note = "squeue gives no answer".into();
                Ok(None)
            }
        }
    }

    /// Takes in the files that elements of an array left since the last look.
    fn take_files(&mut self, number: usize) {
        let array = &mut self.arrays[number];
        if array.job.is_none() || array.ended.len() == array.elements.len() {
            return;
        }
        for entry in fs::read_dir(self.folder.join(format!("status/{number}"))).into_iter().flatten().flatten() {
            let Some(element) = entry.file_name().to_str().and_then(|name| name.parse::<usize>().ok()) else {
                continue;
            };
            if element >= array.elements.len() || array.ended.contains(&element) {
                continue;
            }
            let Ok(text) = fs::read_to_string(entry.path()) else { continue };
            array.ended.insert(element);
            for line in text.lines() {
                let codes =
                    line.split_once(' ').and_then(|(task, code)| Some((task.parse().ok()?, code.parse().ok()?)));
                self.codes.extend(codes.filter(|(task, _)| array.elements[element].contains(task)));
            }
        }
    }

    // --- words ---

    /// Why a task failed.
    pub(super) fn failure(&self, array: usize, element: usize, task: usize, cancelled: bool) -> String {
        let log = self.folder.join(format!("logs/{array}-{element}.log"));
        let job = self.arrays[array].job.map_or_else(|| "not handed in".into(), |job| format!("job {job}_{element}"));
        let how = match self.codes.get(&task) {
            Some(code) => format!("exit code {code}"),
            None if cancelled => "cancelled".into(),
            None => "ended without a word: its node died, or Slurm ended it, or it does not see the cache".into(),
        };
        let end = log_end(&log, task);
        let end = if end.is_empty() { String::new() } else { format!("\n{end}") };
        format!("Slurm {job}, {how}; log: {}{end}", log.display())
    }

    /// The end of the first log there is.
    pub(super) fn some_log(&self) -> String {
        let mut logs: Vec<PathBuf> =
            fs::read_dir(self.folder.join("logs")).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        logs.sort();
        match logs.first() {
            Some(log) => format!("{}:\n{}", log.display(), log_end(log, usize::MAX)),
            None => "No log was written.".into(),
        }
    }
}

/// The last lines that a task wrote; of the whole log if it is not named in it.
fn log_end(log: &Path, task: usize) -> String {
    use std::io::{Read, Seek, SeekFrom};
    let Ok(mut file) = fs::File::open(log) else { return String::new() };
    let length = file.metadata().map_or(0, |metadata| metadata.len());
    let mut bytes = Vec::new();
    let start = SeekFrom::Start(length.saturating_sub(LOG_END));
    if file.seek(start).is_err() || file.take(LOG_END).read_to_end(&mut bytes).is_err() {
        return String::new();
    }
    let text = String::from_utf8_lossy(&bytes);
    let begins = |line: &str, task: usize| line.starts_with(&format!("== task {task} "));
    let lines: Vec<&str> = text.lines().collect();
    let first = lines.iter().rposition(|line| begins(line, task)).map_or(0, |at| at + 1);
    let count = match first {
        0 => lines.len(),
        _ => lines[first..].iter().take_while(|line| !line.starts_with("== task ")).count(),
    };
    let own = &lines[first..first + count];
    own[own.len().saturating_sub(LAST_LINES)..].iter().map(|line| format!("  | {line}")).collect::<Vec<_>>().join("\n")
}

/// What is in the queue.
#[derive(Default)]
struct Queue {
    jobs: BTreeSet<u64>,
    /// Lines by state, or by the reason why it waits.
    states: BTreeMap<String, usize>,
    held: usize,
    lines: usize,
}

impl Queue {
    /// Of lines `JOB|STATE|REASON`; elements that wait are one line an array.
    fn parse(text: &str) -> Queue {
        let mut queue = Queue::default();
        for line in text.lines() {
            let mut parts = line.trim().splitn(3, '|');
            let Some(job) = parts.next().and_then(|job| job.parse().ok()) else { continue };
            let (state, reason) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
            queue.jobs.insert(job);
            queue.lines += 1;
            let waits = state == "PENDING";
            let held = waits && (reason.to_ascii_lowercase().contains("held") || reason == "DependencyNeverSatisfied");
            queue.held += usize::from(held);
            // What waits for a held one waits for ever.
            let shown = if waits { reason.trim_matches(['(', ')']) } else { state }.to_ascii_lowercase();
            *queue.states.entry(shown).or_default() += 1;
        }
        queue
    }

    /// Whether nothing will move: some is held by Slurm, and all the rest waits for it.
    fn is_stuck(&self) -> bool {
        let waits = self.states.get("dependency").copied().unwrap_or(0);
        self.held > 0 && self.held + waits == self.lines
    }

    fn note(&self) -> String {
        let states: Vec<String> = self.states.iter().map(|(state, count)| format!("{count} {state}")).collect();
        states.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_queue_where_all_waits_for_what_is_held_is_stuck() {
        let queue = Queue::parse("12|PENDING|Dependency\n11|PENDING|launch failed requeued held\n");
        assert!(queue.is_stuck() && queue.jobs == BTreeSet::from([11, 12]));
        let queue = Queue::parse("12|PENDING|Dependency\n11|RUNNING|None\n11|PENDING|JobHeldAdmin\n");
        assert!(!queue.is_stuck());
        assert_eq!(queue.note(), "1 dependency, 1 jobheldadmin, 1 running");
        assert!(!Queue::parse("11|PENDING|Resources\n").is_stuck());
        assert!(Queue::parse("slurm_load_jobs error\n").jobs.is_empty());
    }

    #[test]
    fn a_failed_task_shows_the_end_of_its_own_part_of_the_log() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log");
        let many: String = (0..20).map(|line| format!("line {line}\n")).collect();
        fs::write(&log, format!("== task 1 on a\nfirst\n== task 12 on a\n{many}== task 3 on a\nlast\n")).unwrap();
        assert_eq!(log_end(&log, 1), "  | first");
        assert_eq!(log_end(&log, 3), "  | last");
        let shown = log_end(&log, 12);
        assert!(shown.starts_with("  | line 8\n") && shown.ends_with("line 19"), "{shown}");
        assert_eq!(log_end(&folder.path().join("none"), 1), "");
    }
}
