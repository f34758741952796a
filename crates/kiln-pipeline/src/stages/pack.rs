//! `pack`: levels, materials and pictures into container bytes.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use kiln_asset::import::{ImageLimits, decode_image};
use kiln_asset::{DeepRaster, ImageFormat, ImageId, Raster};
use kiln_engine::{Action, ActionError, ContentHash, Context, Outputs, Source};
use kiln_lod::cluster_dag::ClusterDag;
use kiln_pack::{Coding, Compression, Continuous, Layout, PackOptions, Picture, Provenance, Vertices, pack};

use super::{StageError, continuous, import, json, load_images, load_levels, load_materials, params};
use crate::foreign;
use crate::language::StageSettings;
use crate::language::options::{self, PackCompression, PackLayout, PackVertices, TextureCoding};

/// Raised whenever the same input and parameters give other bytes.
pub(crate) const VERSION: u32 = 1;

/// What the container says of its making, beside its inputs.
#[derive(Clone)]
pub(crate) struct MadeBy {
    /// The pipeline as it holds for the asset, every default filled.
    pub(crate) pipeline: ContentHash,
    /// Stages in order: id and semantic version.
    pub(crate) stages: Vec<(String, String)>,
    /// The GPU that baked, if one did.
    pub(crate) device_class: Option<String>,
}

/// What is packed.
pub(crate) struct Inputs {
    /// The levels.
    pub(crate) levels: Source,
    /// The action whose `materials` and `image/N` belong to them.
    pub(crate) materials: usize,
    /// Names and hashes of the files that the model was read from.
    pub(crate) files: Source,
    /// The continuous layouts that were made: `window`, `tree`, `clusters`.
    pub(crate) layouts: Vec<(&'static str, Source)>,
}

/// Keys that only the layouts' own actions read.
const LAYOUT_KEYS: [&str; 2] = ["nodes", "checkpoints"];

/// Output: `container`.
pub(crate) fn action(
    id: String,
    label: String,
    options: &options::PackOptions,
    inputs: Inputs,
    made_by: MadeBy,
) -> Action {
    let stages: String = made_by.stages.iter().map(|(id, version)| format!("{id} {version}; ")).collect();
    let made = made_by.clone();
    let own = own_options(options);
    let mut action = Action::new(id, "pack", VERSION, move |context| run(context, &made, &own))
        .input("levels", inputs.levels)
        .input("materials", Source::output(inputs.materials, "materials"))
        .input("images", Source::outputs(inputs.materials, "image/"))
        .input("inputs", inputs.files);
    for (name, source) in inputs.layouts {
        action = action.input(name, source);
    }
    action.label = label;
    action.params = params(&StageSettings::Pack(options.clone()), &LAYOUT_KEYS);
    // The container tells these, so they are part of what it is made from. Nearly every change changes the pipeline's hash: as an
    // input it is explained after what the change did to the levels.
    action = action.param("stages", stages).param("tool", TOOL);
    action = action.input("pipeline", Source::Bytes(made_by.pipeline.0.as_slice().into()));
    if let Some(class) = made_by.device_class {
        action = action.param("device", class);
    }
    action.foreign = vec![foreign::BASISU.into(), foreign::EXR.into(), foreign::GLAM.into(), foreign::IMAGE.into()];
    action.foreign.extend(foreign::oiio());
    action.numeric_class = Some(numeric_class(&own_options(options)));
    if options.textures == TextureCoding::Bc {
        action.foreign.push(foreign::BC7F.into());
    }
    if options.vertices == PackVertices::Shared || options.compression == PackCompression::Meshopt {
        action.foreign.push(foreign::MESHOPT.into());
    }
    if options.compression != PackCompression::None {
        action.foreign.push(foreign::ZSTD.into());
    }
    action
}

/// Where the same bytes come out: the encoder of BC7 and what orders triangles for a cache are C++ with floating point.
fn numeric_class(options: &PackOptions) -> String {
    let cxx = options.textures == Coding::Bc
        || options.vertices == Vertices::Shared
        || options.compression == Compression::Meshopt;
    if cxx { foreign::cxx_class() } else { foreign::NUMERIC_CLASS.into() }
}

fn own_options(options: &options::PackOptions) -> PackOptions {
    let layout = |layout: &PackLayout| match layout {
        PackLayout::Discrete => Layout::Discrete,
        PackLayout::SlidingWindow => Layout::SlidingWindow,
        PackLayout::TreeLeaf => Layout::TreeLeaf,
        PackLayout::CompactTree => Layout::CompactTree,
        PackLayout::Clusters => Layout::Clusters,
    };
    PackOptions {
        layouts: options.layouts.iter().map(layout).collect(),
        textures: match options.textures {
            TextureCoding::Raw => Coding::Raw,
            TextureCoding::Bc => Coding::Bc,
        },
        vertices: match options.vertices {
            PackVertices::Own => Vertices::Own,
            PackVertices::Shared => Vertices::Shared,
        },
        compression: match options.compression {
            PackCompression::None => Compression::None,
            PackCompression::Meshopt => Compression::Meshopt,
            PackCompression::Zstd => Compression::Zstd,
        },
        ..PackOptions::default()
    }
}

/// The tool's name in provenance.
const TOOL: &str = concat!("kiln ", env!("CARGO_PKG_VERSION"));

fn run(context: &Context<'_>, made_by: &MadeBy, options: &PackOptions) -> Result<Outputs, ActionError> {
    let levels = load_levels(context, "levels")?;
    let materials = load_materials(context, "materials")?;
    let images = load_images(context, &materials)?;
    let inputs = import::inputs_from_blob(&context.input("inputs")?).map_err(StageError::Blob)?;
    let provenance = Provenance {
        pipeline: made_by.pipeline.0,
        tool: TOOL.into(),
        numeric_class: numeric_class(options),
        device_class: made_by.device_class.clone().unwrap_or_default(),
        inputs,
        stages: made_by.stages.clone(),
    };
    let pictures = Pictures::new(&images, materials.images.iter().map(|i| i.format).collect());
    let decode = |image: ImageId| pictures.picture(image);
    let layouts = layouts(context)?;
    let (bytes, report) =
        pack(&levels, &materials, &decode, &provenance, options, &layouts).map_err(StageError::Pack)?;
    Ok(Outputs::new().with("container", bytes).report(json(&report)))
}

/// The continuous layouts among the inputs.
fn layouts(context: &Context<'_>) -> Result<Continuous, ActionError> {
    let mut layouts = Continuous::default();
    if context.has_input("window") {
        layouts.window = Some(continuous::window_from_blob(&context.input("window")?).map_err(StageError::Blob)?);
    }
    if context.has_input("tree") {
        layouts.tree = Some(continuous::tree_from_blob(&context.input("tree")?).map_err(StageError::Blob)?);
    }
    if context.has_input("clusters") {
        layouts.clusters = Some(ClusterDag::from_blob(&context.input("clusters")?).map_err(StageError::Blob)?);
    }
    Ok(layouts)
}

/// Pictures decoded when they are first asked for.
pub(crate) struct Pictures<'a> {
    encoded: &'a [Arc<[u8]>],
    formats: Vec<ImageFormat>,
    decoded: Mutex<BTreeMap<ImageId, Arc<Raster>>>,
}

impl<'a> Pictures<'a> {
    pub(crate) fn new(encoded: &'a [Arc<[u8]>], formats: Vec<ImageFormat>) -> Pictures<'a> {
        Pictures { encoded, formats, decoded: Mutex::default() }
    }

    /// The picture in its own depth, or why it cannot be had. Deep ones are not kept: each is asked for once.
    pub(crate) fn picture(&self, image: ImageId) -> Result<Picture, String> {
        match (self.encoded.get(image.index()), self.formats.get(image.index())) {
            (Some(bytes), Some(ImageFormat::Deep)) => {
                DeepRaster::from_blob(bytes).map(Picture::from).map_err(|e| e.to_string())
            }
            _ => self.get(image).map(Picture::Plain),
        }
    }

    /// The picture in 8 bits, or why it cannot be had.
    pub(crate) fn get(&self, image: ImageId) -> Result<Arc<Raster>, String> {
        let mut decoded = self.decoded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = decoded.get(&image) {
            return Ok(Arc::clone(known));
        }
        let (Some(bytes), Some(format)) = (self.encoded.get(image.index()), self.formats.get(image.index())) else {
            return Err(format!("there is no image {image}"));
        };
        let raster = match format {
            ImageFormat::Raster => Raster::from_blob(bytes).map_err(|e| e.to_string())?,
            _ => decode_image(*format, bytes, &ImageLimits::default()).map_err(|e| e.to_string())?,
        };
        Ok(Arc::clone(decoded.entry(image).or_insert(Arc::new(raster))))
    }
}
