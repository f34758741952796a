//! What is to be built: actions in an order in which each comes after those it reads, and the files that people asked for.

use std::collections::BTreeSet;
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

use crate::context::Context;
use crate::error::ActionError;
use crate::hash::{ContentHash, Fingerprint};
use crate::manifest::{Field, InputField, Manifest, Origin, Topic, Value};

/// All actions of one build. Every path in it is relative to `root`, `/`-separated; `root` itself is never hashed.
#[derive(Clone, Default)]
pub struct Plan {
    /// The folder that paths are relative to, usually the pipeline's.
    pub root: PathBuf,
    /// `[action_count]`; an action reads only outputs of actions with a lower index. The lowest ready index runs first.
    pub actions: Vec<Action>,
    /// Files to be written.
    pub targets: Vec<Target>,
}

/// The work of an action.
///
/// It must be a function of what the action declares and of what it reads through the context: no clock, no environment,
/// no other file.
pub type Run = Arc<dyn Fn(&Context<'_>) -> Result<Outputs, ActionError> + Send + Sync>;

/// One step: a function of its declared fields, its inputs and the files that it finds.
#[derive(Clone)]
pub struct Action {
    /// Names the action in this plan, the same in every build, such as `build/pot.kiln#lods`: `why` compares by it. Unique.
    pub id: String,
    /// Shown to people, such as `pot.glb / simplify lods`.
    pub label: String,
    /// Kind of stage.
    pub kind: &'static str,
    /// The stage's semantic version: raised whenever the same inputs give other bytes.
    pub version: u32,
    /// Parameters with defaults filled in; names are unique, order does not matter.
    pub params: Vec<(String, Value)>,
    /// `name@version+features` of the foreign crates and libraries under the stage.
    pub foreign: Vec<String>,
    /// Where results are bit-identical, if the stage depends on it: architecture, target features, C library.
    pub numeric_class: Option<String>,
    /// Backend, vendor, device, driver, shader hash of a GPU stage.
    pub device_class: Option<String>,
    /// What it reads; names are unique.
    pub inputs: Vec<Input>,
    /// The folder (relative to the plan's root, empty for the root) under which it may find further files while it runs.
    pub discovers: Option<String>,
    /// Whether such files may also lie outside that folder (paths that start with `..`).
    pub outside: bool,
    /// What it does.
    pub run: Run,
}

impl Action {
    /// An action without parameters and inputs; the other fields are for the caller to fill.
    pub fn new(
        id: impl Into<String>,
        kind: &'static str,
        version: u32,
        run: impl Fn(&Context<'_>) -> Result<Outputs, ActionError> + Send + Sync + 'static,
    ) -> Action {
        let id = id.into();
        Action {
            label: id.clone(),
            id,
            kind,
            version,
            params: Vec::new(),
            foreign: Vec::new(),
            numeric_class: None,
            device_class: None,
            inputs: Vec::new(),
            discovers: None,
            outside: false,
            run: Arc::new(run),
        }
    }

    /// Adds a parameter.
    pub fn param(mut self, name: impl Into<String>, value: impl Into<Value>) -> Action {
        self.params.push((name.into(), value.into()));
        self
    }

    /// Adds an input.
    pub fn input(mut self, name: impl Into<String>, source: Source) -> Action {
        self.inputs.push(Input { name: name.into(), source });
        self
    }

    /// Digest of all that it declares beside files and what other actions give: kind, version, parameters, libraries, classes of
    /// machine and device, bytes of the plan.
    pub fn declares(&self) -> Fingerprint {
        let bytes = |input: &Input| match &input.source {
            Source::Bytes(bytes) => {
                Some(InputField { name: input.name.clone(), hash: Some(ContentHash::of(bytes)), origin: Origin::Bytes })
            }
            _ => None,
        };
        Manifest::new(self.head(), self.inputs.iter().filter_map(bytes).collect()).fingerprint()
    }

    /// The actions that it reads, each once, ascending.
    pub fn upstream(&self) -> BTreeSet<usize> {
        self.inputs.iter().filter_map(|input| input.source.upstream()).collect()
    }

    /// The fields of the manifest that are no inputs.
    pub(crate) fn head(&self) -> Vec<Field> {
        let field = |topic, name: &str, value: Value| Field { topic, name: name.to_owned(), value };
        let mut head = vec![
            field(Topic::Kind, "", self.kind.into()),
            field(Topic::Kind, "discovers", self.discovers.is_some().into()),
            field(Topic::Version, "", self.version.into()),
        ];
        for foreign in &self.foreign {
            let name = foreign.split('@').next().unwrap_or(foreign);
            head.push(field(Topic::Foreign, name, foreign.as_str().into()));
        }
        head.extend(self.numeric_class.iter().map(|class| field(Topic::NumericClass, "", class.as_str().into())));
        head.extend(self.device_class.iter().map(|class| field(Topic::DeviceClass, "", class.as_str().into())));
        head.extend(self.params.iter().map(|(name, value)| field(Topic::Parameter, name, value.clone())));
        head
    }
}

impl fmt::Debug for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Action").field("id", &self.id).field("inputs", &self.inputs).finish_non_exhaustive()
    }
}

/// One thing that an action reads.
#[derive(Clone, Debug)]
pub struct Input {
    /// The action's name for it: [`Context::input`] takes it, the fingerprint covers it.
    pub name: String,
    /// Where it comes from: the fingerprint covers its content only.
    pub source: Source,
}

/// Where an input comes from.
#[derive(Clone, Debug)]
pub enum Source {
    /// One output of an earlier action.
    Output {
        /// Index of that action in the plan.
        action: usize,
        /// The output's name.
        output: String,
    },
    /// All outputs of an earlier action whose names begin with `prefix`; input `images` and output `image/3` of prefix
    /// `image/` make the input name `images/3`. There may be none.
    Outputs {
        /// Index of that action in the plan.
        action: usize,
        /// What the names begin with.
        prefix: String,
    },
    /// A file that must exist, relative to the plan's root.
    File {
        /// The path.
        path: String,
    },
    /// Bytes known when the plan is made.
    Bytes(Arc<[u8]>),
}

impl Source {
    /// Output `output` of action `action`.
    pub fn output(action: usize, output: impl Into<String>) -> Source {
        Source::Output { action, output: output.into() }
    }

    /// All outputs of action `action` that begin with `prefix`.
    pub fn outputs(action: usize, prefix: impl Into<String>) -> Source {
        Source::Outputs { action, prefix: prefix.into() }
    }

    /// The file at `path`.
    pub fn file(path: impl Into<String>) -> Source {
        Source::File { path: path.into() }
    }

    /// The action that it waits for.
    pub(crate) fn upstream(&self) -> Option<usize> {
        match self {
            Source::Output { action, .. } | Source::Outputs { action, .. } => Some(*action),
            _ => None,
        }
    }
}

/// A file that people asked for.
#[derive(Clone, Debug)]
pub struct Target {
    /// Where it goes, relative to the plan's root.
    pub path: String,
    /// Index of the action that gives it.
    pub action: usize,
    /// Name of the output that it holds.
    pub output: String,
}

/// What an action gives.
#[derive(Clone, Debug, Default)]
pub struct Outputs {
    /// Named blobs; names are unique.
    pub blobs: Vec<(String, Vec<u8>)>,
    /// The stage's report, JSON bytes or empty: kept with the record, so that a fresh stage still shows its counts.
    pub report: Vec<u8>,
}

impl Outputs {
    /// No outputs yet.
    pub fn new() -> Outputs {
        Outputs::default()
    }

    /// Adds a blob.
    pub fn with(mut self, name: impl Into<String>, bytes: Vec<u8>) -> Outputs {
        self.blobs.push((name.into(), bytes));
        self
    }

    /// Sets the report.
    pub fn report(mut self, json: Vec<u8>) -> Outputs {
        self.report = json;
        self
    }
}

/// A mistake in a plan: the caller's fault, all of them at once.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanDefect {
    /// Two actions of one id.
    #[error("actions[{action}]: a second action named `{id}`")]
    RepeatedId {
        /// Index of the second.
        action: usize,
        /// The id.
        id: String,
    },
    /// An input or parameter name is there twice.
    #[error("actions[{action}]: a second input, parameter or library named `{name}`")]
    RepeatedName {
        /// Index of the action.
        action: usize,
        /// The name.
        name: String,
    },
    /// An input reads an action that does not come before.
    #[error("actions[{action}].inputs: `{input}` reads action {upstream}, which does not come before it")]
    NotBefore {
        /// Index of the reading action.
        action: usize,
        /// The input.
        input: String,
        /// Index of the action that it reads.
        upstream: usize,
    },
    /// A target names an action that is not there.
    #[error("targets[{target}]: there is no action {action}")]
    NoAction {
        /// Index of the target.
        target: usize,
        /// The index it names.
        action: usize,
    },
    /// Two targets are one file, or a target is also read as an input.
    #[error("targets[{target}]: `{path}` is already another target or an input")]
    PathTaken {
        /// Index of the target.
        target: usize,
        /// The path.
        path: String,
    },
}

impl Plan {
    /// The part that action `last` needs, itself included and last, without targets; and the indices that its actions have here.
    ///
    /// # Panics
    /// If there is no such action, or one of them reads an action that does not come before it.
    pub fn upto(&self, last: usize) -> (Plan, Vec<usize>) {
        let mut needed = BTreeSet::new();
        let mut open = vec![last];
        while let Some(action) = open.pop() {
            if needed.insert(action) {
                open.extend(self.actions[action].upstream());
            }
        }
        let kept: Vec<usize> = needed.into_iter().collect();
        let place = |old: usize| kept.binary_search(&old).expect("invariant: what is read is kept");
        let mut actions: Vec<Action> = kept.iter().map(|&old| self.actions[old].clone()).collect();
        for input in actions.iter_mut().flat_map(|action| &mut action.inputs) {
            if let Source::Output { action, .. } | Source::Outputs { action, .. } = &mut input.source {
                *action = place(*action);
            }
        }
        (Plan { root: self.root.clone(), actions, targets: Vec::new() }, kept)
    }

    /// All mistakes in the plan; empty for a sound one.
    pub fn defects(&self) -> Vec<PlanDefect> {
        let mut defects = Vec::new();
        let mut ids = BTreeSet::new();
        let mut paths = BTreeSet::new();
        for (index, action) in self.actions.iter().enumerate() {
            if !ids.insert(action.id.as_str()) {
                defects.push(PlanDefect::RepeatedId { action: index, id: action.id.clone() });
            }
            let mut names = BTreeSet::new();
            for field in action.head() {
                if !names.insert((field.topic, field.name.clone())) {
                    defects.push(PlanDefect::RepeatedName { action: index, name: field.name });
                }
            }
            let mut inputs = BTreeSet::new();
            for input in &action.inputs {
                if !inputs.insert(input.name.as_str()) {
                    defects.push(PlanDefect::RepeatedName { action: index, name: input.name.clone() });
                }
                match &input.source {
                    Source::File { path } => {
                        paths.insert(path.as_str());
                    }
                    source => {
                        if let Some(upstream) = source.upstream().filter(|&upstream| upstream >= index) {
                            let input = input.name.clone();
                            defects.push(PlanDefect::NotBefore { action: index, input, upstream });
                        }
                    }
                }
            }
        }
        for (index, target) in self.targets.iter().enumerate() {
            if target.action >= self.actions.len() {
                defects.push(PlanDefect::NoAction { target: index, action: target.action });
            }
            if !paths.insert(target.path.as_str()) {
                defects.push(PlanDefect::PathTaken { target: index, path: target.path.clone() });
            }
        }
        defects
    }
}
