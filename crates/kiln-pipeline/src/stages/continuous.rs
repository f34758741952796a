//! Continuous layouts: what `pack` writes beside the levels, each an action of its own, so that a changed texture makes none anew.
//!
//! All are made of the finest level that the last simplify stage gives; a bake changes no position and no triangle of it. `window`
//! goes on with that stage's collapse sequence from where the level was cut, `tree` and `clusters` look at the level alone. Each
//! measures its errors against the source asset, as levels do.

use kiln_asset::blob::{BlobReader, BlobWriter};
use kiln_asset::{BlobError, LodSet, Mesh};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};
use kiln_lod::Checkpoint;
use kiln_lod::cluster_dag::{ClusterDag, ClusterDagOptions};
use kiln_lod::cluster_tree::{ClusterTree, Representative, TreeOptions};
use kiln_lod::simplify::CollapseSequence;
use kiln_lod::simplify::error::Surface;
use kiln_lod::sliding_window::SlidingWindow;
use kiln_pack::{TreeLayout, WindowLayout};
use serde::Serialize;

use super::{StageError, json, load_levels, no_level};
use crate::foreign;
use crate::language::options::{PackOptions, TreeNodes};

/// Raised whenever the same sequence gives another window or other errors.
pub(crate) const WINDOW_VERSION: u32 = 1;
/// Raised whenever the same level gives another octree or other errors.
pub(crate) const TREE_VERSION: u32 = 1;
/// Raised whenever the same level gives another cluster DAG.
pub(crate) const CLUSTERS_VERSION: u32 = 1;

/// Sample points a side for each error, as for levels.
const SAMPLES: u32 = kiln_lod::simplify::SAMPLES;

/// What the actions take.
pub(crate) struct Inputs {
    /// Levels of the last simplify stage.
    pub(crate) levels: Source,
    /// The mesh that errors are measured against.
    pub(crate) source: Source,
}

fn finish(mut action: Action, label: String, inputs: &Inputs) -> Action {
    action.label = label;
    action.foreign = vec![foreign::GLAM.into()];
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    action.input("levels", inputs.levels.clone()).input("source", inputs.source.clone())
}

/// Output: `window`. `before` and `sequence`: what the simplify stage took and recorded.
pub(crate) fn window_action(
    id: String,
    label: String,
    options: &PackOptions,
    inputs: &Inputs,
    before: Source,
    sequence: Source,
) -> Action {
    let checkpoints = options.checkpoints;
    let action = Action::new(id, "window", WINDOW_VERSION, move |context| window(context, checkpoints))
        .input("in", before)
        .input("sequence", sequence)
        .param("checkpoints", checkpoints);
    finish(action, label, inputs)
}

/// What a window is, for people.
#[derive(Serialize)]
struct WindowReport {
    collapses: u32,
    base_triangles: u32,
    longest_chain: u32,
    mean_chain: f64,
    checkpoints: usize,
}

fn window(context: &Context<'_>, count: u32) -> Result<Outputs, ActionError> {
    let before = load_levels(context, "in")?;
    let Some(whole) = before.levels.first() else { return Err(no_level()) };
    let sequence = CollapseSequence::from_blob(&context.input("sequence")?).map_err(StageError::Blob)?;
    let levels = load_levels(context, "levels")?;
    let Some(finest) = levels.levels.first() else { return Err(no_level()) };
    let cut = |set: &LodSet| -> Vec<usize> {
        set.levels.iter().map(|level| sequence.reach(level.mesh.face_count() as u32)).collect()
    };
    let cuts = cut(&levels);
    for (cut, level) in cuts.iter().zip(&levels.levels) {
        if sequence.faces_after(*cut) as usize != level.mesh.face_count() {
            let message = "a level is no prefix of its collapse sequence, so that no sliding window holds it";
            return Err(StageError::Defect(message.into()).into());
        }
    }
    let window = SlidingWindow::new(&whole.mesh, &sequence, cuts[0]).map_err(|e| StageError::Layout(e.to_string()))?;
    let cuts: Vec<u32> = cuts.iter().map(|cut| (cut - cuts[0]) as u32).collect();
    let layout = |e: kiln_lod::sliding_window::WindowError| StageError::Layout(e.to_string());
    let ordered = window.apply(&finest.mesh).map_err(layout)?;
    let source = Mesh::from_blob(&context.input("source")?).map_err(StageError::Blob)?;
    let surface = Surface::new(&source, SAMPLES);
    context.progress(0.2, "errors of the sliding window");
    let checkpoints = window.checkpoints(&ordered, &surface, count as usize, &cuts).map_err(layout)?;
    let chains = window.chains();
    let report = WindowReport {
        collapses: window.collapses(),
        base_triangles: checkpoints.last().map_or(0, |c| c.triangles),
        longest_chain: chains.longest,
        mean_chain: chains.mean,
        checkpoints: checkpoints.len(),
    };
    let mut blob = BlobWriter::new(*b"WLAY", 1);
    blob.array(&window.to_blob());
    blob.array(&checkpoints);
    blob.array(&cuts);
    Ok(Outputs::new().with("window", blob.finish()).report(json(&report)))
}

/// A window out of its action's output.
pub(crate) fn window_from_blob(bytes: &[u8]) -> Result<WindowLayout, BlobError> {
    let mut blob = BlobReader::open(bytes, *b"WLAY", 1)?;
    let window = SlidingWindow::from_blob(&blob.array::<u8>()?)?;
    let layout = WindowLayout { window, checkpoints: blob.array()?, cuts: blob.array()? };
    blob.finish()?;
    Ok(layout)
}

/// Output: `tree`.
pub(crate) fn tree_action(id: String, label: String, options: &PackOptions, inputs: &Inputs) -> Action {
    let (nodes, checkpoints) = (options.nodes, options.checkpoints);
    let action = Action::new(id, "tree", TREE_VERSION, move |context| tree(context, nodes, checkpoints))
        .param("nodes", nodes.as_str())
        .param("checkpoints", checkpoints);
    finish(action, label, inputs)
}

/// What an octree is, for people.
#[derive(Serialize)]
struct TreeReport {
    nodes: usize,
    rows: usize,
    checkpoints: usize,
}

fn tree(context: &Context<'_>, nodes: TreeNodes, count: u32) -> Result<Outputs, ActionError> {
    let levels = load_levels(context, "levels")?;
    let Some(finest) = levels.levels.first() else { return Err(no_level()) };
    let representative = match nodes {
        TreeNodes::Mean => Representative::Mean,
        TreeNodes::Quadric => Representative::Quadric,
    };
    let options = TreeOptions { representative };
    let tree = ClusterTree::new(&finest.mesh, &options);
    let source = Mesh::from_blob(&context.input("source")?).map_err(StageError::Blob)?;
    let surface = Surface::new(&source, SAMPLES);
    context.progress(0.2, "errors of the octree");
    let checkpoints =
        tree.checkpoints(&finest.mesh, &surface, count as usize).map_err(|e| StageError::Layout(e.to_string()))?;
    let report =
        TreeReport { nodes: tree.nodes().len(), rows: tree.row_starts().len() - 1, checkpoints: checkpoints.len() };
    let mut blob = BlobWriter::new(*b"TLAY", 1);
    blob.array(&tree.to_blob());
    blob.array(&checkpoints);
    Ok(Outputs::new().with("tree", blob.finish()).report(json(&report)))
}

/// A tree out of its action's output.
pub(crate) fn tree_from_blob(bytes: &[u8]) -> Result<TreeLayout, BlobError> {
    let mut blob = BlobReader::open(bytes, *b"TLAY", 1)?;
    let tree = ClusterTree::from_blob(&blob.array::<u8>()?)?;
    let checkpoints: Vec<Checkpoint> = blob.array()?;
    blob.finish()?;
    Ok(TreeLayout { tree, checkpoints })
}

/// Output: `clusters`.
pub(crate) fn clusters_action(id: String, label: String, inputs: &Inputs) -> Action {
    let mut action = finish(Action::new(id, "clusters", CLUSTERS_VERSION, clusters), label, inputs);
    // Clusters and their groups are found by C++.
    action.foreign.push(foreign::MESHOPT.into());
    action.numeric_class = Some(foreign::cxx_class());
    action
}

fn clusters(context: &Context<'_>) -> Result<Outputs, ActionError> {
    let levels = load_levels(context, "levels")?;
    let Some(finest) = levels.levels.first() else { return Err(no_level()) };
    context.progress(0.0, "cluster DAG");
    // It counts errors from the finest level; a place that far from it is at most that and the level's own error from the source.
    let dag = ClusterDag::new(&finest.mesh, &ClusterDagOptions::default());
    let mut dag = dag.map_err(|e| StageError::Layout(e.to_string()))?;
    let counted = dag.groups.iter_mut().filter(|group| group.error < f32::MAX);
    counted.for_each(|group| group.error += finest.error);
    Ok(Outputs::new().with("clusters", dag.to_blob()).report(json(&dag.report())))
}
