//! The implicit first action: a model file and what it refers to become an asset.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use kiln_asset::blob::{BlobError, BlobReader, BlobWriter};
use kiln_asset::import::{self, Files, ImageLimits, ImportLimits};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};

use super::{StageError, json, split_path};
use crate::foreign;
use crate::language::options::AssetOptions;
use crate::language::setting::Options;

/// Raised whenever the same files give another asset.
pub(crate) const VERSION: u32 = 3;

/// Imports `model` (relative to the plan's root). Outputs: `mesh`, `materials`, `image/N`, and `inputs`: names and contents of
/// the files read, for the container's provenance. There the model is called `model`, so that a renamed one changes nothing.
pub(crate) fn action(id: String, label: String, model: &str, options: &AssetOptions) -> Action {
    let limits = limits(options);
    let (folder, file) = split_path(model);
    let file = file.to_owned();
    let extension = file.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase()).unwrap_or_default();
    let mut action = Action::new(id, "import", VERSION, move |context| run(context, &file, &limits))
        // The name itself is no parameter: a renamed but equal file imports to the same asset. Its kind is.
        .param("format", extension)
        .input("model", Source::file(model));
    // A limit is a parameter, so that what an earlier, more generous build let in does not stand.
    let limits = options.values().into_iter().filter(|(key, _)| key != "input" && key != "output");
    action.params.extend(limits.map(|(key, value)| (key, value.to_toml().into())));
    action.outside = options.allow_outside;
    action.label = label;
    action.foreign =
        [foreign::DRACO, foreign::GLAM, foreign::IMAGE, foreign::LIBM, foreign::MESHOPT, foreign::SERDE_JSON]
            .map(Into::into)
            .into();
    action.foreign.extend(foreign::oiio());
    // The decoders of compressed views are C++. Where their bits are the same all the same, what follows is fresh.
    action.numeric_class = Some(format!("{}; {}", foreign::NUMERIC_CLASS, foreign::cxx_class()));
    action.discovers = Some(folder.to_owned());
    action
}

fn limits(options: &AssetOptions) -> ImportLimits {
    let side = options.max_image_side;
    ImportLimits {
        max_file_bytes: u64::from(options.max_file_size) << 20,
        max_vertices: options.max_vertices.into(),
        max_triangles: options.max_triangles.into(),
        max_submeshes: options.max_submeshes.into(),
        max_node_depth: options.max_node_depth,
        images: ImageLimits { max_side: side, max_texels: u64::from(side) * u64::from(side) },
        allow_outside: options.allow_outside,
        ..Default::default()
    }
}

/// The model itself is a declared input; what it refers to is discovered, so that the model's name stays out of the record.
struct Recorded<'a, 'b> {
    context: &'a Context<'b>,
    file: &'a str,
    model: Arc<[u8]>,
    read: Mutex<BTreeMap<String, [u8; 32]>>,
}

impl Files for Recorded<'_, '_> {
    fn read(&self, relative: &str) -> io::Result<Vec<u8>> {
        if relative == self.file {
            return Ok(self.model.to_vec());
        }
        let bytes = self.context.read_file(relative)?;
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        read.insert(relative.to_owned(), *blake3::hash(&bytes).as_bytes());
        Ok(bytes.to_vec())
    }
}

fn run(context: &Context<'_>, file: &str, limits: &ImportLimits) -> Result<Outputs, ActionError> {
    let files = Recorded { context, file, model: context.input("model")?, read: Mutex::default() };
    let (asset, report) = import::import(&files, file, limits).map_err(StageError::Import)?;
    let mut outputs = Outputs::new()
        .with("mesh", asset.mesh.to_blob())
        .with("materials", asset.materials.to_blob())
        .with("inputs", inputs_to_blob(&files))
        .report(json(&report));
    for (index, bytes) in asset.images.iter().enumerate() {
        outputs = outputs.with(format!("image/{index}"), bytes.to_vec());
    }
    Ok(outputs)
}

/// Name and BLAKE3 of every file of the model, by name.
pub(crate) type InputHashes = Vec<(String, [u8; 32])>;

fn inputs_to_blob(files: &Recorded<'_, '_>) -> Vec<u8> {
    let mut list: InputHashes = vec![("model".into(), *blake3::hash(&files.model).as_bytes())];
    let read = files.read.lock().unwrap_or_else(PoisonError::into_inner);
    list.extend(read.iter().map(|(name, hash)| (name.clone(), *hash)));
    let mut blob = BlobWriter::new(*b"INPS", 1);
    blob.meta(&list);
    blob.finish()
}

/// The output `inputs`.
pub(crate) fn inputs_from_blob(bytes: &[u8]) -> Result<InputHashes, BlobError> {
    let mut blob = BlobReader::open(bytes, *b"INPS", 1)?;
    let list = blob.meta()?;
    blob.finish()?;
    Ok(list)
}
