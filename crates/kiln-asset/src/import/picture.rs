//! Materials and pictures of formats that name image files: each file once, checked by its header.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::error::{Defects, ImportError};
use super::image::{check_size, image_format_of_file};
use super::material::{FORMATS, stem};
use super::report::{ImageSummary, Notes, RepairKind};
use super::source::{Failure, Sources};
use super::{ImageLimits, uri};
use crate::ids::{ImageId, TextureId};
use crate::material::{ImageFormat, ImageInfo, MaterialSet, Sampler, Texture, TextureRef, Wrap};

/// The materials under construction, with what they use.
pub(super) struct Pictures<'a, 'f> {
    pub(super) sources: &'a mut Sources<'f>,
    pub(super) set: MaterialSet,
    /// `[set.images.len()]`, encoded bytes.
    pub(super) images: Vec<Arc<[u8]>>,
    pub(super) summaries: Vec<ImageSummary>,
    limits: &'a ImageLimits,
    /// By file; `None`: it gave no picture.
    by_file: BTreeMap<String, Option<ImageId>>,
    /// By picture, and whether it is clamped to its edge.
    by_image: BTreeMap<(ImageId, bool), TextureId>,
}

impl<'a, 'f> Pictures<'a, 'f> {
    pub(super) fn new(sources: &'a mut Sources<'f>, limits: &'a ImageLimits) -> Self {
        Pictures {
            sources,
            set: MaterialSet::default(),
            images: Vec::new(),
            summaries: Vec::new(),
            limits,
            by_file: BTreeMap::new(),
            by_image: BTreeMap::new(),
        }
    }

    /// The texture of a picture file, read with UV set 0. `path`: what names the file. `None` where it gives no picture, which is
    /// noted.
    pub(super) fn texture(
        &mut self,
        file: &str,
        clamps: bool,
        path: &str,
        defects: &mut Defects,
        notes: &mut Notes,
    ) -> Option<TextureRef> {
        let image = match self.by_file.get(file) {
            Some(known) => *known,
            None => {
                let read = self.image(file, path, defects, notes);
                self.by_file.insert(file.to_owned(), read);
                read
            }
        }?;
        let texture = *self.by_image.entry((image, clamps)).or_insert_with(|| {
            let wrap = if clamps { Wrap::ClampToEdge } else { Wrap::Repeat };
            self.set
                .textures
                .push(Texture { image, sampler: Sampler { wrap_u: wrap, wrap_v: wrap, ..Default::default() } });
            TextureId(self.set.textures.len() as u32 - 1)
        });
        Some(TextureRef { texture, uv_set: 0 })
    }

    fn image(&mut self, file: &str, path: &str, defects: &mut Defects, notes: &mut Notes) -> Option<ImageId> {
        let bytes = match self.sources.file(file) {
            Ok(bytes) => bytes,
            Err(Failure::Invalid(message)) => {
                defects.invalid(path, message);
                return None;
            }
            Err(Failure::Io(message)) => {
                defects.io(path, message);
                return None;
            }
            Err(Failure::Missing(message)) => {
                notes.repair(RepairKind::ImageMissing, 1, || format!("{path}: {message}"));
                return None;
            }
        };
        let Some(format) = image_format_of_file(file, &bytes).filter(|format| *format != ImageFormat::Raster) else {
            defects.unsupported(path, format!("the bytes of `{file}` are none of {FORMATS}, which alone are read"));
            return None;
        };
        let (width, height) = match check_size(path, format, &bytes, self.limits) {
            Ok(size) => size,
            Err(ImportError::Invalid(list) | ImportError::Unsupported(list) | ImportError::Io(list)) => {
                list.into_iter().for_each(|d| defects.invalid(d.path, format!("`{file}`: {}", d.message)));
                return None;
            }
        };
        let name = stem(file);
        let format_name = format.name().to_owned();
        self.summaries.push(ImageSummary {
            name: name.clone(),
            format: format_name,
            width,
            height,
            bytes: bytes.len() as u64,
        });
        self.set.images.push(ImageInfo { name, format, hash: *blake3::hash(&bytes).as_bytes() });
        self.images.push(bytes);
        Some(ImageId(self.images.len() as u32 - 1))
    }
}

/// A file's name as another file spells it, as a path seen from the model's folder ([`Sources::file`] judges whether it may leave
/// that): quotes around it go, backslashes separate folders too. `beside`: the file that names it, in whose folder it lies.
///
/// # Errors
/// What is wrong with it.
pub(super) fn file_beside(
    beside: &str,
    name: &str,
    path: impl FnOnce() -> String,
    notes: &mut Notes,
) -> Result<String, String> {
    let name = name.strip_prefix('"').and_then(|name| name.strip_suffix('"')).unwrap_or(name);
    notes.repair(RepairKind::BackslashPath, name.contains('\\') as u64, path);
    let name = name.replace('\\', "/");
    // Only a name that is inside by itself, or climbs out of its own folder, may follow a folder.
    let absolute = name.starts_with('/') || name.split('/').next().is_some_and(|first| first.contains(':'));
    match beside.rsplit_once('/').filter(|_| !absolute && !name.is_empty()) {
        Some((folder, _)) => uri::relative(&format!("{folder}/{name}")),
        None => uri::relative(&name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_seen_from_the_model_s_folder_and_never_absolute() {
        let file = |beside: &str, name: &str| file_beside(beside, name, String::new, &mut Notes::default());
        assert_eq!(file("a.mtl", "tex\\wood.png"), Ok("tex/wood.png".into()));
        assert_eq!(file("sub/a.mtl", "wood 2.png"), Ok("sub/wood 2.png".into()));
        assert_eq!(file("sub/a.mtl", "\"..\\wood.png\""), Ok("wood.png".into()));
        assert_eq!(file("sub/a.mtl", "100%.png"), Ok("sub/100%.png".into()));
        assert_eq!(file("a.mtl", "..\\wood.png"), Ok("../wood.png".into()));
        assert_eq!(file("sub/a.mtl", "../../wood.png"), Ok("../wood.png".into()));
        for (beside, name) in [
            ("sub/a.mtl", "/wood.png"),
            ("sub/a.mtl", "C:\\wood.png"),
            ("sub/a.mtl", "\\\\host\\wood.png"),
            ("sub/a.mtl", "http://host/wood.png"),
            ("sub/a.mtl", ""),
            ("a.mtl", "."),
        ] {
            assert!(file(beside, name).is_err(), "{name} was taken");
        }
    }
}
