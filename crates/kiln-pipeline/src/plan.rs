//! From pipelines to a plan of actions: the stage graph.
//!
//! For each model that the pipeline's input matches: `import`, then the stages. What flows between them are named outputs of
//! earlier actions, never values, so that a fresh stage is never loaded.
//!
//! ```text
//! import            -> mesh, materials, image/N
//! merge             <- mesh                                    -> mesh
//! simplify          <- mesh or levels, materials if locked, images with texture borders -> sequence
//!   parts           <- mesh or levels, sequence                -> dependencies; where there are rules for submeshes
//!   levels          <- mesh or levels, sequence, dependencies, source mesh -> levels
//! atlas             <- levels                                  -> levels
//! bake              <- levels, high mesh, materials, images    -> levels, materials, image/N
//! pack              <- levels, materials, images, and what its layouts ask for -> container
//!   window          <- what the last simplify took, its sequence and levels, source mesh -> window
//!   tree, clusters  <- the last simplify's levels, source mesh -> tree, clusters
//! ```

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use kiln_engine::{ContentHash, Plan, Source, Target};

use crate::language::options::{Kind, PackLayout, PackOptions, PackVertices};
use crate::language::{
    self, AssetBuild, Diagnostic, DirEntry, Family, Pipeline, RelativeTo, ResolvedPipeline, Sources, Stage, StageInput,
    StageSettings, has_errors,
};
use crate::stages::{self, Backend, DebugView, XatlasWorker};

/// What makes a plan beside the pipeline's text.
#[derive(Clone, Default)]
pub struct PlanOptions {
    /// `--set` arguments, `KEY=VALUE`.
    pub sets: Vec<String>,
    /// The folder that paths in `sets` are relative to.
    pub current_folder: PathBuf,
    /// Where GPU passes run.
    pub backend: Backend,
    /// Runs the worker program around xatlas, if it was found.
    pub xatlas: Option<XatlasWorker>,
    /// Plan these models alone, named as [`PlannedAsset::input`] names them; folders are not listed.
    pub only: Option<Vec<String>>,
}

/// One model of a plan.
#[derive(Clone, Debug)]
pub struct PlannedAsset {
    /// The model, relative to the plan's root.
    pub input: String,
    /// The container, relative to the plan's root.
    pub output: String,
    /// Index of the container in the plan's targets.
    pub target: usize,
    /// Its actions in order, each with the stage's id and, where a stage has two actions, which.
    pub actions: Vec<(usize, String)>,
    /// The pipeline as it holds for this model, every default filled, as TOML.
    pub resolved: String,
    /// Its collapses that see textures or views, for debug pictures.
    pub debug_views: Vec<DebugView>,
}

/// A plan and what it was made from.
pub struct Planned {
    /// For the engine.
    pub plan: Plan,
    /// Its models, sorted by input.
    pub assets: Vec<PlannedAsset>,
    /// Files read: the pipeline and its parents, relative to the plan's root.
    pub files: Vec<String>,
    /// Folders listed, relative to the plan's root.
    pub folders: Vec<String>,
    /// What is doubtful but keeps nothing from running.
    pub warnings: Vec<Diagnostic>,
    /// The texts that warnings point into.
    pub sources: Arc<Sources>,
}

/// Why there is no plan.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The pipeline file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Everything that is wrong with the pipeline.
    #[error("{} defects in the pipeline", diagnostics.len())]
    Pipeline {
        /// Sorted by place.
        diagnostics: Vec<Diagnostic>,
        /// The texts that they point into.
        sources: Arc<Sources>,
    },
    /// A GPU was asked for by name and there is none.
    #[error("{0}")]
    Gpu(String),
}

impl PlanError {
    /// Whether it is the command line's fault alone.
    pub fn is_usage(&self) -> bool {
        match self {
            PlanError::Pipeline { diagnostics, .. } => {
                diagnostics.iter().filter(|d| has_errors(std::slice::from_ref(d))).all(|d| d.usage)
            }
            _ => false,
        }
    }

    /// Whether all that is wrong is something that this version does not offer.
    pub fn is_unsupported(&self) -> bool {
        match self {
            PlanError::Pipeline { diagnostics, .. } => {
                diagnostics.iter().all(|d| d.code.family() == Family::Unsupported)
            }
            _ => false,
        }
    }
}

/// The plan of a pipeline file.
///
/// # Errors
/// The file cannot be read, or everything that is wrong with it.
pub fn plan(pipeline: &Path, options: &PlanOptions) -> Result<Planned, PlanError> {
    let root = folder_of(pipeline);
    let name = pipeline.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let text = fs::read_to_string(pipeline).map_err(|source| PlanError::Io { path: pipeline.to_path_buf(), source })?;
    let read_base = |relative: &str| fs::read_to_string(root.join(relative));
    let loaded = language::load(&name, &text, &options.sets, &read_base);
    let sources = loaded.sources;
    let Some(pipeline) = loaded.pipeline else {
        return Err(PlanError::Pipeline { diagnostics: loaded.diagnostics, sources });
    };
    let mut warnings = loaded.diagnostics;

    let paths = Paths { root: &root, current: &options.current_folder };
    let asset = &pipeline.asset;
    let list = |folder: &str| {
        let folder = paths.place(&asset.input.relative_to, folder);
        options.only.as_ref().map_or_else(|| list_folder(&root.join(&folder)), |models| Ok(listing_of(models, &folder)))
    };
    let expansion = language::expand_inputs(&pipeline, &list);
    if has_errors(&expansion.diagnostics) {
        warnings.extend(expansion.diagnostics);
        return Err(PlanError::Pipeline { diagnostics: warnings, sources });
    }
    warnings.extend(expansion.diagnostics);

    let backend = stages::open_backend(options.backend, &pipeline).map_err(PlanError::Gpu)?;
    let mut planner =
        Planner { plan: Plan { root: root.clone(), ..Plan::default() }, backend, xatlas: &options.xatlas };
    let mut assets = Vec::new();
    for build in &expansion.builds {
        let resolved = pipeline
            .for_asset(&build.relative)
            .map_err(|diagnostics| PlanError::Pipeline { diagnostics, sources: Arc::clone(&sources) })?;
        assets.push(planner.asset(&pipeline, build, &resolved, &paths));
    }
    let files = sources.0.iter().filter(|s| !s.command_line).map(|s| s.name.clone()).collect();
    let folders = expansion.listed.iter().map(|f| paths.place(&asset.input.relative_to, f)).collect();
    Ok(Planned { plan: planner.plan, assets, files, folders, warnings, sources })
}

/// The folder of a file as a path that can be joined to: never empty.
pub fn folder_of(file: &Path) -> PathBuf {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    }
}

/// What a folder would hold if there were these models alone.
fn listing_of(models: &[String], folder: &str) -> Vec<DirEntry> {
    let parts = |path| str::split(path, '/').filter(|part| !part.is_empty() && *part != ".");
    let mut entries = BTreeSet::new();
    for model in models {
        let mut rest = parts(model);
        if parts(folder).all(|part| rest.next() == Some(part))
            && let Some(name) = rest.next()
        {
            entries.insert(DirEntry { name: name.to_owned(), is_dir: rest.next().is_some() });
        }
    }
    entries.into_iter().collect()
}

fn list_folder(folder: &Path) -> io::Result<Vec<DirEntry>> {
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        // A name that is no UTF-8 cannot be written in a pipeline and matches nothing.
        if let Ok(name) = entry.file_name().into_string() {
            // The folder itself tells in most cases: no stat for each of ten thousand models.
            let kind = entry.file_type()?;
            entries.push(DirEntry { name, is_dir: kind.is_dir() || kind.is_symlink() && entry.path().is_dir() });
        }
    }
    Ok(entries)
}

/// Where the language's relative paths lie, seen from the plan's root.
struct Paths<'a> {
    root: &'a Path,
    current: &'a Path,
}

impl Paths<'_> {
    fn place(&self, relative_to: &RelativeTo, path: &str) -> String {
        match relative_to {
            RelativeTo::File(_) => relative_to.join(path),
            RelativeTo::CurrentFolder if Path::new(path).is_absolute() => path.to_owned(),
            RelativeTo::CurrentFolder => {
                let absolute = self.current.join(path);
                let root = self.current.join(self.root);
                match absolute.strip_prefix(&root) {
                    Ok(inside) => inside.to_string_lossy().into_owned(),
                    Err(_) => absolute.to_string_lossy().into_owned(),
                }
            }
        }
    }
}

/// Where a stage's result lies.
#[derive(Clone, Copy)]
struct Placed {
    action: usize,
    output: &'static str,
    /// Action whose `materials` and `image/N` belong to it.
    materials: usize,
}

impl Placed {
    fn source(self) -> Source {
        Source::output(self.action, self.output)
    }
}

struct Planner<'a> {
    plan: Plan,
    backend: stages::OpenBackend,
    xatlas: &'a Option<XatlasWorker>,
}

impl Planner<'_> {
    fn push(&mut self, action: kiln_engine::Action) -> usize {
        self.plan.actions.push(action);
        self.plan.actions.len() - 1
    }

    /// The actions that make the continuous layouts of a pack, by the name of their output.
    fn layouts(&mut self, id: &str, label: &str, options: &PackOptions, of: &Simplified) -> Vec<(&'static str, usize)> {
        use stages::continuous::{Inputs, clusters_action, tree_action, window_action};
        let inputs = Inputs { levels: of.levels.clone(), source: of.source.clone() };
        let named = |name: &str| (format!("{id}/{name}"), format!("{label}, {name}"));
        let wanted = |layouts: &[PackLayout]| layouts.iter().any(|layout| options.layouts.contains(layout));
        let mut made = Vec::new();
        if wanted(&[PackLayout::SlidingWindow]) {
            let (id, label) = named("window");
            let action = window_action(id, label, options, &inputs, of.before.clone(), of.sequence.clone());
            made.push(("window", self.push(action)));
        }
        if wanted(&[PackLayout::TreeLeaf, PackLayout::CompactTree]) {
            let (id, label) = named("tree");
            made.push(("tree", self.push(tree_action(id, label, options, &inputs))));
        }
        if wanted(&[PackLayout::Clusters]) {
            let (id, label) = named("clusters");
            made.push(("clusters", self.push(clusters_action(id, label, &inputs))));
        }
        made
    }

    fn asset(
        &mut self,
        pipeline: &Pipeline,
        build: &AssetBuild,
        resolved: &ResolvedPipeline,
        paths: &Paths<'_>,
    ) -> PlannedAsset {
        let input = paths.place(&pipeline.asset.input.relative_to, &build.input);
        let output = paths.place(&pipeline.asset.output.relative_to, &build.output);
        let id = |part: &str| format!("{output}#{part}");
        let label = |part: &str| format!("{} / {part}", build.relative);
        let import = self.push(stages::import::action(id("import"), label("import"), &input, &pipeline.asset.options));
        let mut actions = vec![(import, "import".to_owned())];
        let mut results: Vec<Placed> = Vec::new();
        let mut simplified: Vec<Option<Simplified>> = Vec::new();
        let shares = last_simplify(&resolved.stages).filter(|_| shares_vertices(&resolved.stages));
        let mut debug_views = Vec::new();
        let mut container = import;
        for (number, stage) in resolved.stages.iter().enumerate() {
            let mut cut = None;
            let before = match stage.input {
                StageInput::Asset => Placed { action: import, output: "mesh", materials: import },
                StageInput::Stage(index) => results[index],
            };
            let (id, label) = (id(&stage.id), label(&stage.id));
            let result = match &stage.settings {
                StageSettings::Merge(options) => {
                    let action = self.push(stages::merge::action(id, label, options, before.source()));
                    Placed { action, output: "mesh", ..before }
                }
                StageSettings::Simplify(options) => {
                    let inputs = stages::simplify::Inputs {
                        before: before.source(),
                        materials: Source::output(before.materials, "materials"),
                        images: Source::outputs(before.materials, "image/"),
                    };
                    let collapse = stages::simplify::collapse_action(
                        format!("{id}/collapse"),
                        format!("{label}, collapse"),
                        options,
                        &inputs,
                    );
                    let collapse = self.push(collapse);
                    debug_views.extend(DebugView::of(collapse, &stage.id, options));
                    actions.push((collapse, format!("{}, collapse", stage.id)));
                    let sequence = Source::output(collapse, "sequence");
                    let rules = rules_of(stage, &resolved.stages);
                    let dependencies = (!rules.is_empty()).then(|| {
                        let (id, label) = (format!("{id}/parts"), format!("{label}, parts"));
                        let parts = stages::simplify::parts_action(id, label, &inputs, sequence.clone());
                        let parts = self.push(parts);
                        actions.push((parts, format!("{}, parts", stage.id)));
                        Source::output(parts, "dependencies")
                    });
                    let source = source_mesh(stage, &resolved.stages, &results, import);
                    let by = stages::simplify::Cut {
                        rules,
                        sequence: sequence.clone(),
                        source: source.clone(),
                        dependencies,
                        shares_vertices: shares == Some(number),
                    };
                    let action = self.push(stages::simplify::levels_action(id, label, options, &inputs, by));
                    let levels = Placed { action, output: "levels", ..before };
                    cut = Some(Simplified { before: before.source(), sequence, levels: levels.source(), source });
                    levels
                }
                StageSettings::Atlas(options) => {
                    let action = stages::atlas::action(id, label, options, before.source(), self.xatlas.clone());
                    Placed { action: self.push(action), output: "levels", ..before }
                }
                StageSettings::Bake(options) => {
                    let high = stage.high.and_then(|index| results.get(index)).copied().unwrap_or(before);
                    let cage = options.cage.as_ref().zip(stage.cage_from.as_ref()).map(|(cage, from)| {
                        let path = paths.place(from, &build.filled(cage));
                        let (id, label) = (format!("{id}/cage"), format!("{label}, cage"));
                        let cage = self.push(stages::import::action(id, label, &path, &pipeline.asset.options));
                        actions.push((cage, format!("{}, cage", stage.id)));
                        Source::output(cage, "mesh")
                    });
                    let inputs = stages::bake::Inputs {
                        low: before.source(),
                        high: high.source(),
                        materials: before.materials,
                        cage,
                    };
                    let action = stages::bake::action(id, label, options, inputs, &self.backend);
                    let action = self.push(action);
                    Placed { action, output: "levels", materials: action }
                }
                StageSettings::Pack(options) => {
                    let made_by = stages::pack::MadeBy {
                        pipeline: ContentHash::of(resolved.to_resolved_toml().as_bytes()),
                        stages: resolved.stages.iter().map(|s| (s.id.clone(), stages::version(s.kind()))).collect(),
                        device_class: resolved.stages.iter().find_map(|s| self.backend.device_class(s.kind())),
                    };
                    let of = last_simplify(&resolved.stages).and_then(|index| simplified[index].as_ref());
                    let layouts = of.map(|of| self.layouts(&id, &label, options, of)).unwrap_or_default();
                    actions.extend(layouts.iter().map(|(name, action)| (*action, format!("{}, {name}", stage.id))));
                    let inputs = stages::pack::Inputs {
                        levels: before.source(),
                        materials: before.materials,
                        files: Source::output(import, "inputs"),
                        layouts: layouts
                            .into_iter()
                            .map(|(name, action)| (name, Source::output(action, name)))
                            .collect(),
                    };
                    container = self.push(stages::pack::action(id, label, options, inputs, made_by));
                    Placed { action: container, output: "container", ..before }
                }
            };
            actions.push((result.action, stage.id.clone()));
            results.push(result);
            simplified.push(cut);
        }
        let target = self.plan.targets.len();
        self.plan.targets.push(Target { path: output.clone(), action: container, output: "container".into() });
        PlannedAsset { input, output, target, actions, resolved: resolved.to_resolved_toml(), debug_views }
    }
}

/// What a simplify stage took and gave.
struct Simplified {
    before: Source,
    sequence: Source,
    levels: Source,
    source: Source,
}

/// The simplify stage whose levels are packed.
fn last_simplify(stages: &[Stage]) -> Option<usize> {
    let mut input = stages.last()?.input;
    while let StageInput::Stage(index) = input {
        if stages[index].kind() == Kind::Simplify {
            return Some(index);
        }
        input = stages[index].input;
    }
    None
}

/// Whether the packed levels are to have vertices of the finest alone.
fn shares_vertices(stages: &[Stage]) -> bool {
    match stages.last().map(|stage| &stage.settings) {
        Some(StageSettings::Pack(pack)) => {
            pack.vertices == PackVertices::Shared || pack.layouts.contains(&PackLayout::SlidingWindow)
        }
        _ => false,
    }
}

/// The rules for submeshes that hold in a simplify stage: those of earlier stages first, since later ones win.
fn rules_of(stage: &Stage, stages: &[Stage]) -> Vec<stages::simplify::HeldRule> {
    let of = |stage: &Stage, met: bool| match &stage.settings {
        StageSettings::Simplify(options) => options.submesh.0.iter().map(|rule| (rule.clone(), met)).collect(),
        _ => Vec::new(),
    };
    let mut rules: Vec<stages::simplify::HeldRule> = of(stage, false);
    let mut input = stage.input;
    while let StageInput::Stage(index) = input {
        rules.splice(0..0, of(&stages[index], true));
        input = stages[index].input;
    }
    rules
}

/// The mesh that a simplify stage's errors are measured against: the first mesh that it descends from.
fn source_mesh(stage: &Stage, stages: &[Stage], results: &[Placed], import: usize) -> Source {
    let mut input = stage.input;
    let mut source = Source::output(import, "mesh");
    while let StageInput::Stage(index) = input {
        if results[index].output == "mesh" {
            source = results[index].source();
        }
        input = stages[index].input;
    }
    source
}
