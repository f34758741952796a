//! Materials, textures, samplers, images. Textures and images that no material uses are not carried.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::accessor::View;
use super::error::{Defects, ImportError};
use super::image::{check_size, image_format};
use super::json::Object;
use super::report::{ImageSummary, Notes, RepairKind};
use super::source::{Bytes, Failure, Sources};
use super::{ImageLimits, ImportLimits};
use crate::ids::{ImageId, TextureId};
use crate::material::{
    AlphaMode, Filter, ImageFormat, ImageInfo, Material, MaterialSet, Sampler, Texture, TextureRef, Wrap,
};

/// All materials with what they use.
#[derive(Default)]
pub(super) struct Library {
    pub(super) set: MaterialSet,
    /// `[set.images.len()]`, encoded bytes.
    pub(super) images: Vec<Arc<[u8]>>,
    pub(super) summaries: Vec<ImageSummary>,
}

/// Reads everything that the document's `materials` use. The material of index `i` in the file keeps that index.
pub(super) fn read_materials(
    root: &Object<'_>,
    views: &[Option<View>],
    buffers: &[Bytes<'_>],
    sources: &mut Sources<'_>,
    limits: &ImportLimits,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Library {
    let samplers: Vec<Sampler> = (root.objects("samplers", defects).iter())
        .map(|sampler| sampler.as_ref().map_or(Sampler::default(), |sampler| read_sampler(sampler, defects)))
        .collect();
    let mut reader = Textures {
        textures: root.objects("textures", defects),
        images: root.objects("images", defects),
        samplers,
        views,
        buffers,
        sources,
        limits: &limits.images,
        texture_ids: BTreeMap::new(),
        image_ids: BTreeMap::new(),
        origins: BTreeMap::new(),
        library: Library::default(),
    };
    for material in root.objects("materials", defects) {
        let material = match material {
            Some(material) => read_material(&material, &mut reader, defects, notes),
            None => Material::default(),
        };
        reader.library.set.materials.push(material);
    }
    reader.library
}

fn read_material(
    object: &Object<'_>,
    textures: &mut Textures<'_, '_, '_>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Material {
    let mut out =
        Material { name: object.string("name", defects).unwrap_or_default().to_owned(), ..Default::default() };
    note_extensions(object, &[], defects, notes);
    if let Some(pbr) = object.object("pbrMetallicRoughness", defects) {
        if let Some(factor) = pbr.floats::<4>("baseColorFactor", defects) {
            out.base_color_factor = clamped(factor, &pbr.path_of("baseColorFactor"), notes);
        }
        out.metallic_factor = unit(&pbr, "metallicFactor", 1.0, defects, notes);
        out.roughness_factor = unit(&pbr, "roughnessFactor", 1.0, defects, notes);
        out.base_color = textures.reference(&pbr, "baseColorTexture", defects, notes);
        out.metallic_roughness = textures.reference(&pbr, "metallicRoughnessTexture", defects, notes);
    }
    out.normal = textures.reference(object, "normalTexture", defects, notes);
    out.occlusion = textures.reference(object, "occlusionTexture", defects, notes);
    out.emissive = textures.reference(object, "emissiveTexture", defects, notes);
    if let Some(normal) = object.object("normalTexture", defects) {
        out.normal_scale = normal.float("scale", defects).unwrap_or(1.0);
    }
    if let Some(occlusion) = object.object("occlusionTexture", defects) {
        out.occlusion_strength = unit(&occlusion, "strength", 1.0, defects, notes);
    }
    if let Some(factor) = object.floats::<3>("emissiveFactor", defects) {
        out.emissive_factor = clamped(factor, &object.path_of("emissiveFactor"), notes);
    }
    out.alpha_mode = match object.string("alphaMode", defects) {
        None | Some("OPAQUE") => AlphaMode::Opaque,
        Some("MASK") => AlphaMode::Mask,
        Some("BLEND") => AlphaMode::Blend,
        Some(other) => {
            defects.invalid(object.path_of("alphaMode"), format!("`{other}`; expected OPAQUE, MASK or BLEND"));
            AlphaMode::Opaque
        }
    };
    let cutoff = object.float("alphaCutoff", defects).unwrap_or(0.5);
    out.alpha_cutoff = cutoff.max(0.0);
    notes.repair(RepairKind::FactorClamped, (cutoff < 0.0) as u64, || object.path_of("alphaCutoff"));
    out.double_sided = object.boolean("doubleSided", defects).unwrap_or(false);
    out
}

fn unit(object: &Object<'_>, key: &str, default: f32, defects: &mut Defects, notes: &mut Notes) -> f32 {
    let value = object.float(key, defects).unwrap_or(default);
    let [value] = clamped([value as f64], &object.path_of(key), notes);
    value
}

fn clamped<const N: usize>(values: [f64; N], path: &str, notes: &mut Notes) -> [f32; N] {
    let outside = values.iter().any(|v| !(0.0..=1.0).contains(v));
    notes.repair(RepairKind::FactorClamped, outside as u64, || path.to_owned());
    values.map(|v| v.clamp(0.0, 1.0) as f32)
}

/// Counts an object's extensions as not carried, but for those in `handled`.
pub(super) fn note_extensions(object: &Object<'_>, handled: &[&str], defects: &mut Defects, notes: &mut Notes) {
    if let Some(extensions) = object.object("extensions", defects) {
        for name in extensions.keys().filter(|name| !handled.contains(name)) {
            notes.not_carried(&format!("extension {name}"), 1);
        }
    }
}

fn read_sampler(object: &Object<'_>, defects: &mut Defects) -> Sampler {
    let mut wrap = |key| match object.unsigned(key, defects) {
        None | Some(10497) => Wrap::Repeat,
        Some(33648) => Wrap::MirroredRepeat,
        Some(33071) => Wrap::ClampToEdge,
        Some(other) => {
            defects.invalid(object.path_of(key), format!("{other} is no wrap mode"));
            Wrap::Repeat
        }
    };
    let (wrap_u, wrap_v) = (wrap("wrapS"), wrap("wrapT"));
    let mag = match object.unsigned("magFilter", defects) {
        None | Some(9729) => Filter::Linear,
        Some(9728) => Filter::Nearest,
        Some(other) => {
            defects.invalid(object.path_of("magFilter"), format!("{other} is no magnification filter"));
            Filter::Linear
        }
    };
    let (min, mip) = match object.unsigned("minFilter", defects) {
        Some(9728) => (Filter::Nearest, None),
        Some(9729) => (Filter::Linear, None),
        Some(9984) => (Filter::Nearest, Some(Filter::Nearest)),
        Some(9985) => (Filter::Linear, Some(Filter::Nearest)),
        Some(9986) => (Filter::Nearest, Some(Filter::Linear)),
        None | Some(9987) => (Filter::Linear, Some(Filter::Linear)),
        Some(other) => {
            defects.invalid(object.path_of("minFilter"), format!("{other} is no minification filter"));
            (Filter::Linear, None)
        }
    };
    Sampler { wrap_u, wrap_v, mag, min, mip }
}

/// Extensions by which a texture has a source that kiln does not decode.
const TEXTURE_SOURCES: [&str; 4] = ["KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds"];

/// Where an image's bytes come from; equal origins are one image.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Origin {
    /// (buffer, first byte, bytes).
    Range(usize, u64, u64),
    /// A file or a data URI.
    Uri(String),
}

struct Textures<'j, 'b, 'f> {
    textures: Vec<Option<Object<'j>>>,
    images: Vec<Option<Object<'j>>>,
    samplers: Vec<Sampler>,
    views: &'b [Option<View>],
    buffers: &'b [Bytes<'b>],
    sources: &'b mut Sources<'f>,
    limits: &'b ImageLimits,
    /// By index in the file; `None`: it has no picture.
    texture_ids: BTreeMap<usize, Option<TextureId>>,
    image_ids: BTreeMap<usize, Option<ImageId>>,
    origins: BTreeMap<Origin, ImageId>,
    library: Library,
}

impl Textures<'_, '_, '_> {
    /// The texture that `object.key` refers to.
    fn reference(
        &mut self,
        object: &Object<'_>,
        key: &str,
        defects: &mut Defects,
        notes: &mut Notes,
    ) -> Option<TextureRef> {
        const TRANSFORM: &str = "KHR_texture_transform";
        let info = object.object(key, defects)?;
        note_extensions(&info, &[TRANSFORM], defects, notes);
        let transform = info.object("extensions", defects).and_then(|e| e.object(TRANSFORM, defects));
        if let Some(transform) = transform
            && !is_identity(&transform, defects)
        {
            defects.unsupported(transform.path, "UV transforms are not read; apply it to the UVs");
            return None;
        }
        let set = if info.has("texCoord") { info.unsigned("texCoord", defects) } else { Some(0) };
        let index = info.need_index("index", "textures", self.textures.len(), defects)?;
        let set = set?;
        if set > 1 {
            defects.unsupported(info.path_of("texCoord"), format!("UV set {set}; only 0 and 1 are read"));
            return None;
        }
        let texture = match self.texture_ids.get(&index) {
            Some(known) => *known,
            None => {
                let read = self.texture(index, defects, notes);
                self.texture_ids.insert(index, read);
                read
            }
        };
        Some(TextureRef { texture: texture?, uv_set: set as u32 })
    }

    fn texture(&mut self, index: usize, defects: &mut Defects, notes: &mut Notes) -> Option<TextureId> {
        let texture = self.textures[index].clone()?;
        note_extensions(&texture, &[], defects, notes);
        let sampler = match texture.has("sampler") {
            true => self.samplers[texture.index("sampler", "samplers", self.samplers.len(), defects)?],
            false => Sampler::default(),
        };
        if !texture.has("source") {
            let extensions = texture.object("extensions", defects);
            match extensions.and_then(|e| TEXTURE_SOURCES.iter().find(|name| e.has(name))) {
                Some(name) => defects.unsupported(
                    format!("{}.extensions.{name}", texture.path),
                    "only PNG and JPEG images are read; give the texture a `source` of these",
                ),
                None => defects.invalid(texture.path_of("source"), "is missing: a material uses this texture"),
            }
            return None;
        }
        let source = texture.index("source", "images", self.images.len(), defects)?;
        let image = match self.image_ids.get(&source) {
            Some(known) => *known,
            None => {
                let read = self.image(source, defects, notes);
                self.image_ids.insert(source, read);
                read
            }
        }?;
        self.library.set.textures.push(Texture { image, sampler });
        Some(TextureId(self.library.set.textures.len() as u32 - 1))
    }

    fn image(&mut self, index: usize, defects: &mut Defects, notes: &mut Notes) -> Option<ImageId> {
        let image = self.images[index].clone()?;
        note_extensions(&image, &[], defects, notes);
        let (origin, bytes, file) = match (image.has("uri"), image.has("bufferView")) {
            (true, false) => {
                let uri = image.string("uri", defects)?;
                match self.sources.uri(uri) {
                    Ok((bytes, file)) => (Origin::Uri(file.clone().unwrap_or_else(|| uri.to_owned())), bytes, file),
                    Err(Failure::Invalid(message)) => {
                        defects.invalid(image.path_of("uri"), message);
                        return None;
                    }
                    Err(Failure::Io(message)) => {
                        defects.io(image.path_of("uri"), message);
                        return None;
                    }
                    Err(Failure::Missing(message)) => {
                        notes.repair(RepairKind::ImageMissing, 1, || format!("{}: {message}", image.path_of("uri")));
                        return None;
                    }
                }
            }
            (false, true) => {
                let view = image.index("bufferView", "bufferViews", self.views.len(), defects)?;
                let View { buffer, start, length, .. } = self.views[view]?;
                let origin = Origin::Range(buffer, start, length);
                if let Some(known) = self.origins.get(&origin) {
                    return Some(*known);
                }
                // A buffer shorter than it claims is a defect already.
                let range = usize::try_from(start).ok()?..usize::try_from(start.checked_add(length)?).ok()?;
                (origin, Arc::from(self.buffers.get(buffer)?.get(range)?), None)
            }
            (true, true) => {
                defects.invalid(image.path, "has both `uri` and `bufferView`");
                return None;
            }
            (false, false) => {
                defects.invalid(image.path, "has neither `uri` nor `bufferView`");
                return None;
            }
        };
        if let Some(known) = self.origins.get(&origin) {
            return Some(*known);
        }
        let format = self.format(&image, &bytes, defects, notes)?;
        let (width, height) = match check_size(&image.path, format, &bytes, self.limits) {
            Ok(size) => size,
            Err(ImportError::Invalid(list) | ImportError::Unsupported(list) | ImportError::Io(list)) => {
                list.into_iter().for_each(|defect| defects.invalid(defect.path, defect.message));
                return None;
            }
        };
        let id = ImageId(self.library.images.len() as u32);
        let name = match image.string("name", defects).filter(|name| !name.is_empty()) {
            Some(name) => name.to_owned(),
            None => file.as_deref().map_or_else(|| format!("image{index}"), stem),
        };
        let kind = if format == ImageFormat::Png { "png" } else { "jpeg" };
        let summary =
            ImageSummary { name: name.clone(), format: kind.into(), width, height, bytes: bytes.len() as u64 };
        self.library.summaries.push(summary);
        self.library.set.images.push(ImageInfo { name, format, hash: *blake3::hash(&bytes).as_bytes() });
        self.library.images.push(bytes);
        self.origins.insert(origin, id);
        Some(id)
    }

    fn format(
        &self,
        image: &Object<'_>,
        bytes: &[u8],
        defects: &mut Defects,
        notes: &mut Notes,
    ) -> Option<ImageFormat> {
        let claimed = match image.string("mimeType", defects) {
            None => None,
            Some("image/png") => Some(ImageFormat::Png),
            Some("image/jpeg" | "image/jpg") => Some(ImageFormat::Jpeg),
            Some(other) => {
                defects.unsupported(image.path_of("mimeType"), format!("`{other}`; only PNG and JPEG are read"));
                return None;
            }
        };
        match image_format(bytes) {
            Some(found @ (ImageFormat::Png | ImageFormat::Jpeg)) => {
                let wrong = claimed.is_some_and(|claimed| claimed != found);
                notes.repair(RepairKind::MimeTypeWrong, wrong as u64, || image.path_of("mimeType"));
                Some(found)
            }
            _ if claimed.is_some() => {
                defects.invalid(image.path.clone(), "its bytes are neither PNG nor JPEG");
                None
            }
            _ => {
                defects.unsupported(image.path.clone(), "its bytes are neither PNG nor JPEG, which alone are read");
                None
            }
        }
    }
}

fn is_identity(transform: &Object<'_>, defects: &mut Defects) -> bool {
    transform.floats::<2>("offset", defects).is_none_or(|o| o == [0.0; 2])
        && transform.floats::<2>("scale", defects).is_none_or(|s| s == [1.0; 2])
        && transform.float("rotation", defects).is_none_or(|r| r == 0.0)
        && !transform.has("texCoord")
}

fn stem(path: &str) -> String {
    let name = path.rsplit('/').next().unwrap_or(path);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_is_named_by_the_stem_of_its_file() {
        assert_eq!(stem("textures/wood.base.png"), "wood.base");
        assert_eq!(stem("wood"), "wood");
    }
}
