//! Slurm: tasks as job arrays, through `sbatch`, `squeue` and `scancel` alone.
//!
//! # Method
//! ```text
//! column     tasks that are connected (an asset), `batch` of them together; element of an array = a column
//! chunk      at most `max_array` columns
//! for each chunk, level and class: one array over all columns of the chunk; GPU arrays ask for `gres`
//!     dependency: aftercorr on the arrays of the level before
//! wait: an element that is done leaves a file with its tasks' exit codes; squeue says whether any is still on its way
//! ```
//!
//! # Why `aftercorr`
//! With `afterany` on a whole array one slow asset would hold up all others at every level. With `aftercorr` each column goes on as
//! soon as its own element is done. It asks for exit code 0: so an element always ends with 0, and says in its file which of
//! its tasks failed; those of its assets that are well go on. Only an element that dies with its node and is not taken up again
//! (`--requeue`) ends otherwise: then the later levels of its column are cancelled (`--kill-on-invalid-dep`), and named.
//! A column without a task at some level has an empty element there, so that the chain does not break.
//!
//! ```text
//! CACHE/v1/slurm/<run>/run.sh              the script of all arrays
//!                      tasks/<array>       a line a task: element, tab, task, tab, its arguments quoted for the shell
//!                      status/<array>/<element>   a line a task: task, exit code; whole when it is there
//!                      logs/<array>-<element>.log
//! ```
//!
//! # Limits
//! No accounting database is asked: why an element died is what its log says. Files that a file server shows late are waited for
//! [`GRACE`] long.
//!
//! # Sources
//! The manuals sbatch(1), squeue(1), scancel(1) of Slurm 22.05.

mod script;
mod watch;

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::hash::{BuildHasher, RandomState};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::{Class, Executed, Executor, ExecutorError, Failure, Work, components, downstream};
use crate::disk;
use crate::error::IoError;
use watch::Poll;

/// How long files are waited for after the last element left the queue.
const GRACE: Duration = Duration::from_secs(5);
/// First and longest pause between two looks.
const PAUSE: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(10));
/// So long may `squeue` give no answer in a row.
const SILENCE: Duration = Duration::from_secs(600);
/// How often an array is handed in that the queue has no room for, while nothing of what is in it is done.
const SUBMISSIONS: usize = 360;
/// The same, when nothing of this run is in it.
const LAST_SUBMISSIONS: usize = 5;

const HELP: &str = "`--on slurm` needs Slurm's commands on this machine; `--on local` does without";

/// How arrays are handed in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlurmOptions {
    /// `--partition`.
    pub partition: Option<String>,
    /// `--account`.
    pub account: Option<String>,
    /// `--gres` of GPU tasks.
    pub gres: String,
    /// `--time` of an array element, as Slurm writes it.
    pub time: Option<String>,
    /// `--mem` of an array element, as Slurm writes it.
    pub mem: Option<String>,
    /// `--cpus-per-task`; tasks run as many threads.
    pub cpus: Option<u32>,
    /// Assets an array element: a task then costs a share of what Slurm needs to start an element.
    pub batch: usize,
    /// Elements of one array that may run at once; 0: no limit.
    pub limit: usize,
    /// Longest array: `MaxArraySize` of `slurm.conf`, less one.
    pub max_array: usize,
    /// Further arguments of `sbatch`, those for GPU tasks too.
    pub sbatch: Vec<String>,
}

impl Default for SlurmOptions {
    fn default() -> SlurmOptions {
        SlurmOptions {
            partition: None,
            account: None,
            gres: "gpu:1".into(),
            time: None,
            mem: None,
            cpus: None,
            batch: 1,
            limit: 0,
            max_array: 1000,
            sbatch: Vec::new(),
        }
    }
}

/// Runs tasks through Slurm.
#[derive(Clone, Debug, Default)]
pub struct Slurm {
    /// How.
    pub options: SlurmOptions,
}

/// An array that is to be handed in, or is.
struct Array {
    chunk: usize,
    level: usize,
    class: Class,
    /// Tasks by element; `[columns of the chunk]` of which some may be empty.
    elements: Vec<Vec<usize>>,
    /// Slurm's number.
    job: Option<u64>,
    /// Elements that left their file.
    ended: BTreeSet<usize>,
    /// Seen to be in the queue no more.
    gone: bool,
}

impl Array {
    fn is_over(&self) -> bool {
        self.gone || self.ended.len() == self.elements.len()
    }
}

/// One call of [`Slurm::execute`].
struct Run<'a> {
    options: &'a SlurmOptions,
    work: &'a Work<'a>,
    /// Name of all its jobs.
    name: String,
    folder: PathBuf,
    arrays: Vec<Array>,
    /// Exit code by task.
    codes: BTreeMap<usize, i32>,
    note: String,
    /// When `squeue` last answered.
    answered: Instant,
}

impl Executor for Slurm {
    fn execute(&self, work: &Work<'_>) -> Result<Executed, ExecutorError> {
        if work.tasks.is_empty() {
            return Ok(Executed::default());
        }
        for program in ["sbatch", "squeue", "scancel"] {
            said(Command::new(program).arg("--version"))?;
        }
        let mut run = Run::prepare(&self.options, work)?;
        let result = run.submit_all().and_then(|()| run.wait());
        if !matches!(result, Ok(false)) {
            // Whatever went wrong: nothing of this run shall stay in the queue.
            let _ = said(Command::new("scancel").arg(format!("--name={}", run.name)));
        }
        let cancelled = result?;
        run.executed(cancelled)
    }
}

/// What a program says on standard output; its own words where it fails.
fn said(command: &mut Command) -> Result<String, ExecutorError> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|error| ExecutorError::NoProgram { program: program.clone(), error, help: HELP })?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
    Err(ExecutorError::Refused { what: program, said })
}

impl<'a> Run<'a> {
    /// Writes the run's files.
    fn prepare(options: &'a SlurmOptions, work: &'a Work<'a>) -> Result<Run<'a>, ExecutorError> {
        let parent = work.cache.join(crate::store::LAYOUT).join("slurm");
        disk::create_folder(&parent)?;
        let (folder, number) = new_folder(&parent)?;
        let nonce = RandomState::new().hash_one(&folder) as u32;
        let mut run = Run {
            options,
            work,
            name: format!("kiln-{number}-{nonce:08x}"),
            folder,
            arrays: arrays(options, work),
            codes: BTreeMap::new(),
            note: String::new(),
            answered: Instant::now(),
        };
        for name in ["tasks", "logs", "status"] {
            disk::create_folder(&run.folder.join(name))?;
        }
        disk::write(&run.folder.join("run.sh"), &[script::SCRIPT.as_bytes()], false)?;
        for (number, array) in run.arrays.iter_mut().enumerate() {
            disk::create_folder(&run.folder.join(format!("status/{number}")))?;
            let lines = script::lines(work.tasks, &array.elements);
            disk::write(&run.folder.join(format!("tasks/{number}")), &[lines.as_bytes()], false)?;
        }
        Ok(run)
    }

    /// Hands in all arrays, those of a chunk level by level.
    fn submit_all(&mut self) -> Result<(), ExecutorError> {
        for number in 0..self.arrays.len() {
            let (mut tried, mut pause) = (0, PAUSE.0);
            while self.arrays[number].job.is_none() && !self.is_cancelled() {
                match self.submit(number) {
                    Ok(job) => self.arrays[number].job = Some(job),
                    // A full queue has room again when some of what is in it is done.
                    Err(ExecutorError::Refused { .. }) if tried < self.patience() => {
                        tried += 1;
                        self.sleep(pause);
                        pause = (pause * 2).min(PAUSE.1);
                        let known = self.codes.len();
                        self.poll()?;
                        if self.codes.len() > known {
                            tried = 0;
                        }
                    }
                    Err(error) => return Err(error),
                }
            }
            self.tell();
        }
        Ok(())
    }

    /// How often a refusal is taken for a full queue.
    fn patience(&self) -> usize {
        match self.arrays.iter().any(|array| array.job.is_some()) {
            true if self.is_under_way() => SUBMISSIONS,
            true => LAST_SUBMISSIONS,
            false => 0,
        }
    }

    fn is_under_way(&self) -> bool {
        self.arrays.iter().any(|array| array.job.is_some() && !array.is_over())
    }

    fn submit(&self, number: usize) -> Result<u64, ExecutorError> {
        let array = &self.arrays[number];
        let mut command = Command::new("sbatch");
        let last = array.elements.len() - 1;
        let limit = if self.options.limit > 0 { format!("%{}", self.options.limit) } else { String::new() };
        // Slurm takes `%` in it for a pattern of its own.
        let folder = self.folder.to_string_lossy().replace('%', "%%");
        command
            .args(["--parsable", "--requeue", "--open-mode=append", "--kill-on-invalid-dep=yes"])
            .arg(format!("--job-name={}", self.name))
            .arg(format!("--array=0-{last}{limit}"))
            .arg(format!("--output={folder}/logs/{number}-%a.log"))
            .arg(joined("--chdir=", self.work.folder));
        let before: Vec<String> = self.arrays[..number]
            .iter()
            .filter(|other| (other.chunk, other.level + 1) == (array.chunk, array.level) && !other.is_over())
            .filter_map(|other| other.job)
            .map(|job| format!(":{job}"))
            .collect();
        if !before.is_empty() {
            command.arg(format!("--dependency=aftercorr{}", before.concat()));
        }
        let options = self.options;
        for (flag, value) in [
            ("partition", options.partition.clone()),
            ("account", options.account.clone()),
            ("time", options.time.clone()),
            ("mem", options.mem.clone()),
            ("cpus-per-task", options.cpus.map(|cpus| cpus.to_string())),
            ("gres", Some(options.gres.clone()).filter(|gres| array.class == Class::Gpu && !gres.is_empty())),
        ] {
            if let Some(value) = value {
                command.arg(format!("--{flag}={value}"));
            }
        }
        command.args(&options.sbatch);
        command.arg(self.folder.join("run.sh")).arg(&self.folder).arg(number.to_string()).args(self.work.command);
        let answer = said(&mut command)?;
        // JOB or JOB;CLUSTER
        let job = answer.trim().split(';').next().and_then(|job| job.parse().ok());
        job.ok_or_else(|| ExecutorError::Refused {
            what: "sbatch".into(),
            said: format!("an answer without a job: {answer}"),
        })
    }

    fn is_cancelled(&self) -> bool {
        self.work.cancel.load(Ordering::Relaxed)
    }

    /// Waits until all elements left their files or the queue; `true` if it was cancelled.
    fn wait(&mut self) -> Result<bool, ExecutorError> {
        let mut pause = PAUSE.0;
        let mut empty_since: Option<Instant> = None;
        loop {
            if self.is_cancelled() {
                return Ok(true);
            }
            let known = self.codes.len();
            match self.poll()? {
                Poll::All => return Ok(false),
                Poll::Empty => {
                    if empty_since.get_or_insert_with(Instant::now).elapsed() > GRACE {
                        return Ok(false);
                    }
                }
                // Nothing of it will ever run: scancel, and say which.
                Poll::Stuck => {
                    said(Command::new("scancel").arg(format!("--name={}", self.name)))?;
                }
                Poll::Waiting => empty_since = None,
            }
            self.tell();
            // What moves is looked at more often than what waits in a queue for hours.
            pause = if self.codes.len() > known { PAUSE.0 } else { (pause * 3 / 2).min(PAUSE.1) };
            if empty_since.is_some() {
                pause = pause.min(GRACE / 10);
            }
            self.sleep(pause);
        }
    }

    fn sleep(&self, time: Duration) {
        let end = Instant::now() + time;
        while !self.is_cancelled() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(50).min(time));
        }
    }

    fn tell(&self) {
        let failed = self.codes.values().filter(|&&code| code != 0).count();
        (self.work.progress)(&super::Progress {
            tasks: self.work.tasks.len(),
            done: self.codes.len() - failed,
            failed,
            note: self.note.clone(),
        });
    }

    /// What came of each task.
    fn executed(&self, cancelled: bool) -> Result<Executed, ExecutorError> {
        if self.codes.is_empty() && !cancelled {
            let program = PathBuf::from(self.work.command.first().cloned().unwrap_or_default());
            return Err(ExecutorError::Silent { run: self.folder.clone(), program, log: self.some_log() });
        }
        let failed: BTreeSet<usize> =
            (0..self.work.tasks.len()).filter(|task| self.codes.get(task).is_none_or(|&code| code != 0)).collect();
        // What waited for a failed task says nothing new.
        let because = downstream(self.work.tasks, &failed);
        let mut failures = Vec::new();
        for (number, array) in self.arrays.iter().enumerate() {
            for (element, tasks) in array.elements.iter().enumerate() {
                for &task in tasks.iter().filter(|task| failed.contains(task) && !because.contains(task)) {
                    let message = self.failure(number, element, task, cancelled);
                    failures.push(Failure { task, message });
                }
            }
        }
        failures.sort_by_key(|failure| failure.task);
        Ok(Executed { failures, cancelled })
    }
}

/// `flag` and a path, as one argument.
fn joined(flag: &str, path: &Path) -> OsString {
    let mut joined = OsString::from(flag);
    joined.push(path);
    joined
}

/// A folder of the next free number.
fn new_folder(parent: &Path) -> Result<(PathBuf, usize), IoError> {
    let numbers = std::fs::read_dir(parent).into_iter().flatten().flatten();
    let last = numbers.filter_map(|entry| entry.file_name().to_str()?.parse::<usize>().ok()).max().unwrap_or(0);
    let mut number = last + 1;
    loop {
        let folder = parent.join(format!("{number:04}"));
        match std::fs::create_dir(&folder) {
            Ok(()) => return Ok((folder, number)),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(IoError::new("create", folder)(error)),
        }
    }
}

/// Spreads tasks over arrays; those of a chunk follow each other level by level.
fn arrays(options: &SlurmOptions, work: &Work<'_>) -> Vec<Array> {
    let components = components(work.tasks);
    let mut column_of = BTreeMap::new();
    for &component in &components {
        let next = column_of.len();
        column_of.entry(component).or_insert(next);
    }
    let columns = column_of.len().div_ceil(options.batch.max(1));
    let longest = options.max_array.max(1);
    let mut arrays: BTreeMap<(usize, usize, Class), Array> = BTreeMap::new();
    for (index, task) in work.tasks.iter().enumerate() {
        let column = column_of[&components[index]] / options.batch.max(1);
        let (chunk, element) = (column / longest, column % longest);
        let length = longest.min(columns - chunk * longest);
        let (level, class) = (task.level, task.class);
        let array = arrays.entry((chunk, level, class)).or_insert_with(|| Array {
            chunk,
            level,
            class,
            elements: vec![Vec::new(); length],
            job: None,
            ended: BTreeSet::new(),
            gone: false,
        });
        array.elements[element].push(index);
    }
    arrays.into_values().collect()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::super::Task;
    use super::*;

    fn spread(options: &SlurmOptions, tasks: &[Task]) -> Vec<(usize, usize, Class, Vec<Vec<usize>>)> {
        let cancel = AtomicBool::new(false);
        let (folder, cache) = (Path::new("."), Path::new(".kiln"));
        let work = Work { command: &[], folder, cache, tasks, cancel: &cancel, progress: &|_| {} };
        arrays(options, &work).into_iter().map(|a| (a.chunk, a.level, a.class, a.elements)).collect()
    }

    fn task(class: Class, upstream: &[usize], level: usize) -> Task {
        Task { action: 0, label: String::new(), class, level, upstream: upstream.to_vec(), arguments: Vec::new() }
    }

    #[test]
    fn assets_are_columns_and_levels_are_arrays() {
        use Class::{Cpu, Gpu};
        // Three assets: import, bake; the third one's bake is of another class, and has an action between.
        let tasks = [
            task(Cpu, &[], 0),
            task(Cpu, &[0], 1),
            task(Cpu, &[], 0),
            task(Cpu, &[2], 1),
            task(Cpu, &[], 0),
            task(Cpu, &[4], 1),
            task(Gpu, &[5], 2),
        ];
        let options = SlurmOptions { max_array: 2, ..SlurmOptions::default() };
        let expected = vec![
            (0, 0, Cpu, vec![vec![0], vec![2]]),
            (0, 1, Cpu, vec![vec![1], vec![3]]),
            (1, 0, Cpu, vec![vec![4]]),
            (1, 1, Cpu, vec![vec![5]]),
            (1, 2, Gpu, vec![vec![6]]),
        ];
        assert_eq!(spread(&options, &tasks), expected);
        let options = SlurmOptions { batch: 2, ..SlurmOptions::default() };
        let expected = vec![
            (0, 0, Cpu, vec![vec![0, 2], vec![4]]),
            (0, 1, Cpu, vec![vec![1, 3], vec![5]]),
            (0, 2, Gpu, vec![vec![], vec![6]]),
        ];
        assert_eq!(spread(&options, &tasks), expected);
    }
}
