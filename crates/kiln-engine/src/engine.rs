//! The door: open a cache, build a plan, ask why.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use crate::build::{Built, Session};
use crate::disk::{self, Stat};
use crate::error::EngineError;
use crate::files::{Files, GRANULARITY, Seen};
use crate::hash::ContentHash;
use crate::index::{Content, Index, Line};
use crate::noop::{self, Look};
use crate::plan::Plan;
use crate::remote::{Remote, RemoteReport};
use crate::report::{BuildReport, Event, Observer, Record, Why};
use crate::state::{Last, State};
use crate::store::Store;

/// When a write waits for the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Durability {
    /// Never: for tests and throw-away builds.
    Never,
    /// For output files only: a power cut may cost cache entries, which are found damaged and made again.
    #[default]
    Outputs,
    /// For the cache too.
    Always,
}

/// How to build.
#[derive(Clone, Debug)]
pub struct BuildOptions {
    /// Actions at a time; never changes what comes out.
    pub jobs: usize,
    /// Go on with what does not depend on a failed action.
    pub keep_going: bool,
    /// Say what would be done, do nothing.
    pub dry_run: bool,
    /// Set it to stop soon: what runs is asked to end, nothing half is kept.
    pub cancel: Arc<AtomicBool>,
    /// When a write waits for the device.
    pub durability: Durability,
    /// Whether records say how long actions took; without it equal runs leave equal records.
    pub timed: bool,
    /// The coarsest step in which the file system may stamp files; see the module `files`. Smaller is a promise of the caller.
    pub clock_granularity: Duration,
}

impl Default for BuildOptions {
    fn default() -> BuildOptions {
        BuildOptions {
            jobs: std::thread::available_parallelism().map_or(1, usize::from),
            keep_going: false,
            dry_run: false,
            cancel: Arc::default(),
            durability: Durability::default(),
            timed: true,
            clock_granularity: Duration::from_nanos(GRANULARITY as u64),
        }
    }
}

/// A cache folder and the build state of one pipeline.
///
/// Many engines, in one process or in many, on one machine or on several that share the folder, may work at the same time.
pub struct Engine {
    pub(crate) store: Store,
    pub(crate) state: State,
    pub(crate) index_path: PathBuf,
    /// What the last build looked at; `None` inside: there is none.
    pub(crate) index: Option<Option<Index>>,
    /// When this engine was opened, by the process' own watch.
    opened: Instant,
    /// The file system's time before the caller read what makes its plan; set by a look that found work, or by a build.
    pub(crate) opened_at: Option<i64>,
    /// Stats, young ones too, of the entries that make the plan and were looked at closer.
    pub(crate) looked: BTreeMap<String, Option<Stat>>,
    /// What was known of what makes the plan when it was looked at.
    pub(crate) plan_lines: Vec<Line>,
    /// The groups that the last look found changed: the plan is theirs alone.
    pub(crate) partial: Option<Vec<usize>>,
    /// Entries that the last look looked at closer.
    pub(crate) touched: Vec<usize>,
    /// Stats and contents that the last build saw, sorted by path.
    pub(crate) seen: Vec<(String, Seen)>,
    pub(crate) granularity: i64,
    /// Neither reads nor writes what a build leaves for the next one.
    stateless: bool,
}

impl Engine {
    /// An engine on the cache folder `cache` (usually `.kiln` beside the pipeline) for the pipeline called `name`.
    ///
    /// `name` names the state file: the same for the same pipeline, whatever folder it lies in. Reads and writes nothing yet, and
    /// never fails: a state that cannot be read is an empty one.
    pub fn open(cache: impl Into<PathBuf>, name: &str) -> Engine {
        let store = Store::new(cache.into());
        let index_path = store.state_path(&format!("{}.index", state_name(name)));
        let state = State::new(store.state_path(&state_name(name)));
        Engine {
            store,
            state,
            index_path,
            index: None,
            opened: Instant::now(),
            opened_at: None,
            looked: BTreeMap::new(),
            plan_lines: Vec::new(),
            partial: None,
            touched: Vec::new(),
            seen: Vec::new(),
            granularity: GRANULARITY,
            stateless: false,
        }
    }

    /// An engine for a part of a pipeline: it knows records and blobs alone, and leaves the build state of the whole as it is.
    pub fn stateless(cache: impl Into<PathBuf>) -> Engine {
        Engine { stateless: true, index: Some(None), ..Engine::open(cache, "") }
    }

    /// Reads these cache folders where its own lacks something, in order; they are never written, and what they give is not
    /// copied. Each is verified as the own one is; a damaged entry is a miss and a warning.
    pub fn with_layers(mut self, folders: Vec<PathBuf>) -> Engine {
        self.store = self.store.with_layers(folders);
        self
    }

    /// Does `work` under a lease: a garbage collection spares what is made or read meanwhile, by whatever process.
    ///
    /// # Errors
    /// The cache folder cannot be used.
    pub fn during<R>(&self, work: impl FnOnce() -> R) -> Result<R, EngineError> {
        self.store.prepare()?;
        Ok(self.store.during(&Arc::default(), work))
    }

    /// Copies a record and its blobs into the own cache where only a layer has them; whether all is there now.
    ///
    /// # Errors
    /// The file system refuses.
    pub fn adopt(&self, record: &Record) -> Result<bool, EngineError> {
        for output in &record.outputs {
            let Some(bytes) = self.store.blob(&output.hash) else { return Ok(false) };
            self.store.put_blob(&output.hash, &bytes, false)?;
        }
        self.store.put_record(record, false, false)?;
        Ok(true)
    }

    /// Asks `remote` for what the cache lacks while [`Engine::build`] runs, and sends it what ran if its mode is to write.
    ///
    /// Dry runs and [`Engine::why`] do not ask it: they say what would be done without it.
    pub fn with_remote(mut self, remote: Remote) -> Engine {
        self.store = self.store.with_remote(remote);
        self
    }

    /// What the remote did during the last build; `None` without one.
    pub fn remote_report(&self) -> Option<RemoteReport> {
        self.store.remote_report()
    }

    /// Which assets can have anything to do, by the stats and contents of files alone: a stat for each file.
    ///
    /// Call it before the pipeline is read or folders are listed; where it finds work it makes the cache folder, to learn the file
    /// system's time. `key` as in [`Memory`](crate::Memory), `root` as in [`Plan`]. After [`Look::Changed`], build a plan of these
    /// assets alone, or call [`Engine::widen`] first.
    pub fn look(&mut self, root: &Path, key: &ContentHash, options: &BuildOptions) -> Look {
        self.granularity = granularity(options);
        let mut index = self.take_index();
        let look = match &mut index {
            Some(index) => self.look_by(index, root, key),
            None => {
                self.learn_time();
                Look::Unknown
            }
        };
        self.index = Some(index);
        look
    }

    fn look_by(&mut self, index: &mut Index, root: &Path, key: &ContentHash) -> Look {
        let keyed = index.key == Some(*key);
        let closer = match keyed {
            true => noop::moved(index, root),
            // All will be planned; what makes the plan is looked at now, before the caller reads it.
            false => (0..index.entries.len()).filter(|&entry| index.entries[entry].plan).collect(),
        };
        let open: Vec<usize> = (0..index.groups.len()).filter(|&group| index.groups[group].open).collect();
        if keyed && closer.is_empty() && open.is_empty() {
            return Look::Fresh;
        }
        self.learn_time();
        let (changed, settled) = self.look_closer(index, root, &closer);
        let plan_changed = changed.iter().any(|&entry| index.entries[entry].plan || index.owners(entry).is_empty());
        if !keyed || plan_changed {
            return Look::Unknown;
        }
        let groups: HashSet<usize> =
            changed.iter().flat_map(|&entry| index.owners(entry)).map(|&g| g as usize).collect();
        let mut groups: Vec<usize> = groups.into_iter().chain(open).collect();
        groups.sort_unstable();
        groups.dedup();
        if groups.is_empty() {
            if settled {
                // Stats that may stand for contents from now on spare the next look; that they cannot be kept costs time only.
                let _ = index.update(&self.index_path, &self.store, &closer, &[]);
            }
            return Look::Fresh;
        }
        let frames: Vec<_> = groups.iter().flat_map(|&group| index.frames(group)).copied().collect();
        if !self.state.load_some(index.state, &frames) {
            return Look::Unknown;
        }
        let names = groups.iter().map(|&group| index.group_name(group).to_owned()).collect();
        self.partial = Some(groups);
        self.touched = closer;
        Look::Changed(names)
    }

    /// Takes in the contents of entries. Gives those that have another one, and whether any stat stands for its content now.
    fn look_closer(&mut self, index: &mut Index, root: &Path, entries: &[usize]) -> (Vec<usize>, bool) {
        let (mut changed, mut any_settled) = (Vec::new(), false);
        for found in noop::look_closer(index, root, entries) {
            let settled = found.stat.filter(|stat| self.is_settled(stat));
            any_settled |= settled.is_some();
            if index.entries[found.entry].plan {
                self.looked.insert(index.path(found.entry), found.stat);
            }
            let entry = &mut index.entries[found.entry];
            if found.content == Content::Unknown || found.content != entry.content {
                changed.push(found.entry);
            }
            (entry.stat, entry.content) = (settled, found.content);
        }
        (changed, any_settled)
    }

    /// Whether a file of this stat was last written long before this engine looked at anything.
    pub(crate) fn is_settled(&self, stat: &Stat) -> bool {
        self.opened_at.is_some_and(|now| stat.latest() < now.saturating_sub(self.granularity))
    }

    fn learn_time(&mut self) {
        // Without a time there is nothing to remember by: the next build looks closer again.
        if self.opened_at.is_none() && self.store.prepare().is_ok() {
            self.opened_at = self.store.now().ok();
        }
    }

    /// After [`Look::Changed`]: all is built all the same.
    pub fn widen(&mut self) {
        self.partial = None;
    }

    /// The index, read at most once; the caller puts it back.
    fn take_index(&mut self) -> Option<Index> {
        self.index.take().unwrap_or_else(|| Index::read(&self.index_path))
    }

    /// Builds a plan. What a single action or target meets is in the report.
    ///
    /// # Errors
    /// The plan contradicts itself, or the cache folder cannot be used.
    pub fn build(
        &mut self,
        plan: &Plan,
        options: &BuildOptions,
        observer: &dyn Observer,
    ) -> Result<BuildReport, EngineError> {
        let start = Instant::now();
        self.check(plan)?;
        let mut now = self.opened_at;
        if !options.dry_run {
            self.store.prepare()?;
            if now.is_none() {
                // Nobody looked: the plan was made since this engine was opened, and no file was read for an action yet.
                self.learn_time();
                now = self.opened_at;
                let passed = i64::try_from(self.opened.elapsed().as_nanos()).unwrap_or(i64::MAX);
                self.opened_at = now.map(|now| now.saturating_sub(passed));
            }
        }
        if self.partial.is_none() && !self.stateless {
            self.state.load();
        }
        self.granularity = granularity(options);
        observer.event(&Event::Planned { actions: plan.actions.len(), targets: plan.targets.len() });
        let index = self.take_index();
        let files = Files::new(&plan.root, index.as_ref(), now, self.granularity);
        let session = Session::new(plan, options, observer, &self.store, &self.state, files);
        let work = || session.run();
        let built = if options.dry_run { work() } else { self.store.during(&options.cancel, work) };
        let Built { mut report, seen, lasts } = built;
        self.index = Some(index);
        if !options.dry_run && !self.stateless {
            self.keep(plan, &report, seen, lasts);
        }
        report.warnings.extend(self.store.take_warnings());
        for message in &report.warnings {
            observer.event(&Event::Warning { action: None, message });
        }
        report.seconds = start.elapsed().as_secs_f64();
        Ok(report)
    }

    /// Why target `target` (an index) would be made again, or that it would not. Runs nothing, and changes nothing but that a
    /// damaged record is moved aside.
    ///
    /// # Errors
    /// The plan contradicts itself.
    ///
    /// # Panics
    /// If the plan has no such target.
    pub fn why(&mut self, plan: &Plan, target: usize) -> Result<Why, EngineError> {
        self.check(plan)?;
        self.state.load();
        let options = BuildOptions { dry_run: true, ..BuildOptions::default() };
        let index = self.take_index();
        let files = Files::new(&plan.root, index.as_ref(), None, GRANULARITY);
        let session = Session::new(plan, &options, &crate::report::NoObserver, &self.store, &self.state, files);
        let why = session.why(target);
        self.index = Some(index);
        Ok(why)
    }

    /// The bytes of an output that a record names, out of the store; `None` if they are no longer there.
    pub fn blob(&self, hash: &ContentHash) -> Option<Arc<[u8]>> {
        self.store.blob(hash)
    }

    fn check(&self, plan: &Plan) -> Result<(), EngineError> {
        let defects = plan.defects();
        if defects.is_empty() { Ok(()) } else { Err(EngineError::InvalidPlan(defects)) }
    }

    /// Notes what the build saw.
    fn keep(&mut self, plan: &Plan, report: &BuildReport, seen: Vec<(String, Seen)>, lasts: Vec<(usize, Last)>) {
        for (action, last) in lasts {
            self.state.set_last(&plan.actions[action].id, last);
        }
        self.seen = seen;
        let _writing = disk::writing();
        let live = plan.actions.iter().map(|action| action.id.as_str()).collect();
        let mut kept = self.state.save(&self.store, &live, self.partial.is_none());
        if self.partial.is_none() {
            // What the build did not come to look at is as known as it was.
            let old = self.index.iter().flatten().filter(|_| !report.succeeded()).flat_map(Index::lines);
            let old = old.filter(|line| !line.plan && self.seen_of(&line.path).is_none());
            let old = old.map(|line| Line { owners: Vec::new(), ..line });
            let mut memo =
                Index::new(None, self.seen.iter().map(|(path, seen)| seen.line(path)).chain(old).collect(), &[]);
            // What the plan was made of is known until `remember` says what it is made of now.
            self.plan_lines = self.index.iter().flatten().flat_map(Index::lines).filter(|line| line.plan).collect();
            if self.index.as_ref().and_then(Option::as_ref) != Some(&memo) {
                kept = kept.and(memo.write(&self.index_path, &self.store));
                self.index = Some(Some(memo));
            }
        }
        if let Err(error) = kept {
            self.store.warn(format!("{error}; the next build will look closer"));
        }
    }

    /// What the last build saw of a file.
    pub(crate) fn seen_of(&self, path: &str) -> Option<Seen> {
        let at = self.seen.binary_search_by(|(seen, _)| seen.as_str().cmp(path)).ok()?;
        Some(self.seen[at].1)
    }

    /// Puts a wrong entry into the memo.
    #[cfg(test)]
    pub(crate) fn lie(&mut self, path: &str, stat: Stat, hash: ContentHash) {
        self.store.prepare().expect("a writable folder");
        let line = Seen { hash: Some(hash), stat: Some(stat) }.line(path);
        let mut memo = Index::new(None, vec![line], &[]);
        memo.write(&self.index_path, &self.store).expect("a writable folder");
    }
}

fn granularity(options: &BuildOptions) -> i64 {
    i64::try_from(options.clock_granularity.as_nanos()).unwrap_or(i64::MAX)
}

/// A file name for any pipeline name: its readable part and a digest.
fn state_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let readable: String = name.chars().map(plain).take(40).collect();
    format!("{readable}-{}", ContentHash::of(name.as_bytes()).short())
}
