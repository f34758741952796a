//! One adapter a stage: options of the language to options of the stage, blobs to values and back, a typed report to JSON.
//!
//! Each file holds the stage's semantic version, its action (what the fingerprint covers) and its run. To add a stage: a row in
//! [`crate::language::options::Kind`], a file here, an arm in [`crate::plan`].

pub(crate) mod atlas;
pub(crate) mod bake;
pub(crate) mod continuous;
mod debug;
pub(crate) mod import;
pub(crate) mod merge;
pub(crate) mod pack;
pub(crate) mod simplify;

use std::sync::Arc;

use kiln_asset::import::ImportError;
use kiln_asset::{BlobError, LodSet, MaterialSet, Mesh};
use kiln_engine::{ActionError, Context, Value};
use kiln_gpu::Gpu;
use serde::Serialize;

pub use atlas::XatlasWorker;
pub use debug::{DebugPicture, DebugView};
pub use kiln_lod::merge::Survey as MeshSurvey;
pub use merge::{Repaired as MergeRepaired, Report as MergeSummary, preview as preview_merge};

use crate::language::options::Kind;
use crate::language::value::Value as Setting;
use crate::language::{Pipeline, StageSettings};

/// Why a stage failed: the stage's own error, by family.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// The model cannot be imported.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// The atlas failed.
    #[error(transparent)]
    Atlas(#[from] kiln_bake::atlas::AtlasError),
    /// The bake failed.
    #[error(transparent)]
    Bake(#[from] kiln_bake::transfer::BakeError),
    /// The container could not be made.
    #[error(transparent)]
    Pack(#[from] kiln_pack::PackError),
    /// A value out of the cache breaks its promises.
    #[error("a value in the cache is damaged: {0}")]
    Blob(#[from] BlobError),
    /// A stage's result breaks its own post-condition: a defect of kiln.
    #[error("{0}")]
    Defect(String),
    /// A picture cannot be read.
    #[error("a picture cannot be read: {0}")]
    Picture(String),
    /// The views of a metric cannot be used.
    #[error("{0}")]
    Views(#[from] kiln_lod::simplify::viewpoint::ViewpointError),
    /// A layout cannot be made of these levels.
    #[error("{0}")]
    Layout(String),
    /// No GPU where one was asked for.
    #[error("{0}")]
    Gpu(String),
}

impl From<StageError> for ActionError {
    fn from(error: StageError) -> ActionError {
        ActionError::failed(error)
    }
}

/// A report as JSON bytes.
pub(crate) fn json<T: Serialize>(report: &T) -> Vec<u8> {
    serde_json::to_vec(report).expect("invariant: reports are plain structs with string keys")
}

/// Folder and file of a `/`-separated path.
pub(crate) fn split_path(path: &str) -> (&str, &str) {
    path.rsplit_once('/').unwrap_or(("", path))
}

/// The parameters of a stage as its fingerprint has them: every key with its value, but for those in `not`, which are structure.
pub(crate) fn params(settings: &StageSettings, not: &[&str]) -> Vec<(String, Value)> {
    settings
        .values()
        .into_iter()
        .filter(|(name, _)| !not.contains(&name.as_str()))
        .map(|(name, value)| {
            let value = match value {
                Setting::Text(text) => Value::Text(text),
                Setting::Integer(number) => Value::Integer(number),
                Setting::Number(number) => Value::from(number),
                Setting::Boolean(flag) => Value::Flag(flag),
                // Lists and tables: their canonical text, numbers in the shortest form that reads back bit for bit.
                other => Value::Text(other.to_toml()),
            };
            (name, value)
        })
        .collect()
}

/// The input `name` as levels; a mesh, as merge gives it, is one level without error.
pub(crate) fn load_levels(context: &Context<'_>, name: &str) -> Result<LodSet, ActionError> {
    Ok(levels_of(&context.input(name)?).map_err(StageError::Blob)?)
}

pub(crate) fn no_level() -> ActionError {
    StageError::Defect("the stage before gave no level".into()).into()
}

/// Levels, or a mesh as one level, out of a stage's bytes.
pub(crate) fn levels_of(bytes: &[u8]) -> Result<LodSet, BlobError> {
    if bytes.starts_with(b"LODS") {
        return LodSet::from_blob(bytes);
    }
    let mesh = Mesh::from_blob(bytes)?;
    let source_triangles = mesh.submeshes.iter().map(|s| s.source_triangles).sum();
    let level = kiln_asset::Level { mesh, error: 0.0, quadrics: Vec::new() };
    Ok(LodSet { levels: vec![level], layout: None, source_triangles })
}

/// The input `name` as materials.
pub(crate) fn load_materials(context: &Context<'_>, name: &str) -> Result<MaterialSet, ActionError> {
    Ok(MaterialSet::from_blob(&context.input(name)?).map_err(StageError::Blob)?)
}

/// The image inputs `images/0`, `images/1`, ... of a material set, encoded.
pub(crate) fn load_images(context: &Context<'_>, materials: &MaterialSet) -> Result<Vec<Arc<[u8]>>, ActionError> {
    (0..materials.images.len()).map(|i| context.input(&format!("images/{i}"))).collect()
}

/// Where GPU passes run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// A hardware GPU where there is one, else the CPU twin.
    #[default]
    Auto,
    /// A GPU, software adapters included; an error where there is none.
    Gpu,
    /// The CPU twin.
    Cpu,
}

/// The backend that a plan's GPU stages run on: opened once, while the plan is made, since its class is part of fingerprints.
#[derive(Clone, Default)]
pub(crate) struct OpenBackend(pub(crate) Option<Arc<Gpu>>);

impl OpenBackend {
    /// The class of device that a stage of this kind depends on.
    pub(crate) fn device_class(&self, kind: Kind) -> Option<String> {
        let gpu = self.0.as_ref().filter(|_| kind == Kind::Bake)?;
        Some(gpu.class().to_string())
    }
}

/// Opens what `backend` names, if the pipeline has a stage that would use it.
///
/// # Errors
/// A GPU was asked for by name and there is none.
pub(crate) fn open_backend(backend: Backend, pipeline: &Pipeline) -> Result<OpenBackend, String> {
    let uses = pipeline.stages.iter().any(|stage| stage.kind() == Kind::Bake);
    match backend {
        Backend::Auto if uses => Ok(OpenBackend(Gpu::open(false).ok().map(Arc::new))),
        Backend::Gpu if uses => Gpu::open(true).map(|gpu| OpenBackend(Some(Arc::new(gpu)))).map_err(|e| e.to_string()),
        _ => Ok(OpenBackend::default()),
    }
}

/// The semantic version of a stage kind, as a container's provenance tells it.
pub(crate) fn version(kind: Kind) -> String {
    match kind {
        Kind::Merge => merge::VERSION.to_string(),
        Kind::Simplify => {
            format!("{}.{}.{}", simplify::COLLAPSE_VERSION, simplify::PARTS_VERSION, simplify::LEVELS_VERSION)
        }
        Kind::Atlas => atlas::VERSION.to_string(),
        Kind::Bake => bake::VERSION.to_string(),
        Kind::Pack => {
            let layouts = [continuous::WINDOW_VERSION, continuous::TREE_VERSION, continuous::CLUSTERS_VERSION];
            format!("{}.{}.{}.{}", pack::VERSION, layouts[0], layouts[1], layouts[2])
        }
    }
}

/// Everything in this program that a fingerprint may cover: two programs of equal identity make equal plans.
pub fn identity() -> String {
    let stages: String = Kind::ALL.iter().map(|kind| format!("{} {} ", kind.as_str(), version(*kind))).collect();
    let foreign: Vec<String> =
        crate::foreign::all().map(String::from).into_iter().chain(crate::foreign::oiio()).collect();
    format!("import {} {stages}{} {}", import::VERSION, crate::foreign::NUMERIC_CLASS, foreign.join(" "))
}
