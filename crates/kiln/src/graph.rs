//! The stage graph of a pipeline, for schedulers and build systems that are not ours: `kiln plan`.
//!
//! # The JSON, version 1
//! ```text
//! version     1; another number means that a key below changed its meaning, new keys do not
//! kiln        kiln's version
//! pipeline    the pipeline as it was given
//! files       the pipeline and its parents; folders: folders that were listed for models. A change to either may change this graph
//! assets[]    input, output: model and container
//!   stages[]  id       unique in the asset
//!             kind, label
//!             class    "cpu" or "gpu": what its machine must have
//!             digest   of kind, version, parameters, libraries, classes of machine and device, bytes of the plan: `--expect` holds to it
//!             command  argv; runs this stage alone where the cache has the results of `upstream`
//!             inputs   files that it reads, as far as they are known before it runs; the others stand in its depfile
//!             upstream ids of stages of the same asset
//!             outputs  names that others read; `image/*` stands for any number of them
//!   after     id of the stage that gives the container
//!   command   argv; writes the container from the cache, once `after` is done
//! ```
//! Paths are relative to the current folder where the pipeline's is, and commands run in the current folder. Stages of one asset
//! share the cache and nothing else; stages of different assets are independent. Every command may run any number of times.

use std::collections::BTreeSet;
use std::path::Path;

use kiln_engine::{Plan, Source};
use kiln_pipeline::plan::{PlannedAsset, folder_of};
use serde::Serialize;

use crate::build::{Build, BuildError};
use crate::dependencies::place;
use crate::farm::{self, DIGITS};
use crate::stage::{declared_files, stage_name};

/// Version of the JSON.
const VERSION: u32 = 1;

/// All assets and stages of a pipeline; see the module's page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Graph {
    /// Of this form.
    pub version: u32,
    /// Of kiln.
    pub kiln: String,
    /// As it was given.
    pub pipeline: String,
    /// The pipeline and its parents.
    pub files: Vec<String>,
    /// Folders that were listed.
    pub folders: Vec<String>,
    /// In order of input.
    pub assets: Vec<AssetNode>,
}

/// One asset.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AssetNode {
    /// The model.
    pub input: String,
    /// The container.
    pub output: String,
    /// Each after those that it reads.
    pub stages: Vec<StageNode>,
    /// The stage that gives the container.
    pub after: String,
    /// Writes the container.
    pub command: Vec<String>,
}

/// One stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageNode {
    /// Unique in the asset.
    pub id: String,
    /// Kind of stage.
    pub kind: String,
    /// For people.
    pub label: String,
    /// `cpu` or `gpu`.
    pub class: &'static str,
    /// Of all that it declares beside files and what other stages give.
    pub digest: String,
    /// Runs it.
    pub command: Vec<String>,
    /// Files that it is known to read.
    pub inputs: Vec<String>,
    /// Stages that it reads.
    pub upstream: Vec<String>,
    /// Outputs that others read.
    pub outputs: Vec<String>,
}

impl Build {
    /// The stage graph of the pipeline; its commands begin with `program`.
    ///
    /// # Errors
    /// The pipeline's defects, or an asset that it does not build.
    pub fn graph(&self, program: &str) -> Result<Graph, BuildError> {
        let planned = self.plan_asked()?;
        let root = folder_of(&self.pipeline);
        let places = |paths: &[String]| paths.iter().map(|path| place(&root, path)).collect();
        let common: Vec<String> =
            farm::common(self).into_iter().map(|argument| argument.to_string_lossy().into_owned()).collect();
        let assets = planned.assets.iter().map(|asset| node(&planned.plan, asset, &root, program, &common)).collect();
        Ok(Graph {
            version: VERSION,
            kiln: env!("CARGO_PKG_VERSION").into(),
            pipeline: self.pipeline.display().to_string(),
            files: places(&planned.files),
            folders: places(&planned.folders),
            assets,
        })
    }
}

fn node(plan: &Plan, asset: &PlannedAsset, root: &Path, program: &str, common: &[String]) -> AssetNode {
    let command = |verb: &[&str], more: &[&str]| -> Vec<String> {
        let own = |words: &[&str]| words.iter().map(|&word| word.to_owned()).collect::<Vec<_>>();
        [own(&[program]), own(verb), common.to_vec(), own(more)].concat()
    };
    let name = |action: usize| stage_name(&plan.actions[action]).to_owned();
    let mut actions: Vec<usize> = asset.actions.iter().map(|(action, _)| *action).collect();
    actions.sort_unstable();
    actions.dedup();
    let read = read_outputs(plan, asset, &actions);
    let stages = actions.iter().map(|&index| {
        let action = &plan.actions[index];
        let digest = action.declares().hex();
        let own = ["--asset", &asset.input, "--stage", stage_name(action), "--expect", &digest[..DIGITS]];
        StageNode {
            id: name(index),
            kind: action.kind.to_owned(),
            label: action.label.clone(),
            class: farm::class(action).name(),
            command: command(&["stage", "run"], &own),
            inputs: declared_files(action).map(|path| place(root, path)).collect(),
            upstream: action.upstream().into_iter().map(name).collect(),
            outputs: read.iter().filter(|(of, _)| *of == index).map(|(_, output)| output.clone()).collect(),
            digest,
        }
    });
    AssetNode {
        input: asset.input.clone(),
        output: place(root, &asset.output),
        stages: stages.collect(),
        after: name(plan.targets[asset.target].action),
        command: command(&["build"], &["--asset", &asset.input]),
    }
}

/// Outputs of an asset's actions that something reads.
fn read_outputs(plan: &Plan, asset: &PlannedAsset, actions: &[usize]) -> BTreeSet<(usize, String)> {
    let target = &plan.targets[asset.target];
    let mut read = BTreeSet::from([(target.action, target.output.clone())]);
    for input in actions.iter().flat_map(|&action| &plan.actions[action].inputs) {
        match &input.source {
            Source::Output { action, output } => read.insert((*action, output.clone())),
            Source::Outputs { action, prefix } => read.insert((*action, format!("{prefix}*"))),
            _ => false,
        };
    }
    read
}
