//! Materials, textures, samplers, images. Textures and images that no material uses are not carried.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec2;

use super::accessor::View;
use super::error::{Defects, ImportError};
use super::image::{check_size, image_format_of_file};
use super::json::Object;
use super::report::{ImageSummary, Notes, RepairKind};
use super::source::{Bytes, Failure, Sources};
use super::{ImageLimits, ImportLimits};
use crate::ids::{ImageId, TextureId};
use crate::material::{
    AlphaMode, Filter, ImageFormat, ImageInfo, MapRole, Material, MaterialSet, Sampler, Texture, TextureRef, Wrap,
};

/// All materials with what they use.
#[derive(Default)]
pub(super) struct Library {
    pub(super) set: MaterialSet,
    /// `[set.materials.len()]`: the UVs that a submesh needs for its material.
    pub(super) uv_slots: Vec<UvSlots>,
    /// `[set.images.len()]`, encoded bytes.
    pub(super) images: Vec<Arc<[u8]>>,
    pub(super) summaries: Vec<ImageSummary>,
}

/// An affine map of UVs: `KHR_texture_transform`, which scales, then turns, then moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvTransform {
    offset: [f64; 2],
    /// Cosine and sine of the angle by which UVs turn, counter-clockwise where V points down.
    turn: [f64; 2],
    scale: [f64; 2],
}

impl UvTransform {
    pub(super) fn apply(&self, uv: Vec2) -> Vec2 {
        let ([u, v], [cos, sin]) = ([0, 1].map(|k| f64::from(uv[k]) * self.scale[k]), self.turn);
        Vec2::new((u * cos + v * sin + self.offset[0]) as f32, (v * cos - u * sin + self.offset[1]) as f32)
    }
}

/// Where UVs come from: a set of the file, perhaps transformed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvSource {
    pub(super) set: u64,
    pub(super) transform: Option<UvTransform>,
}

impl UvSource {
    const fn plain(set: u64) -> UvSource {
        UvSource { set, transform: None }
    }
}

/// What a submesh's two UV sets are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvSlots(pub(super) [UvSource; 2]);

impl Default for UvSlots {
    fn default() -> Self {
        UvSlots([UvSource::plain(0), UvSource::plain(1)])
    }
}

/// Two slots for all `sources` of a material, and the slot of each source; `None` where two do not suffice.
///
/// What is plain and of set 0 or 1 keeps its number if all are; else the slots are taken in order, a plain set 0 first.
fn assign_slots(sources: &[UvSource]) -> Option<(UvSlots, Vec<u32>)> {
    let UvSlots(mut slots) = UvSlots::default();
    if sources.iter().any(|source| !slots.contains(source)) {
        match sources {
            [one] => slots[0] = *one,
            [first, second] if *second == UvSource::plain(0) || *first == UvSource::plain(1) => {
                slots = [*second, *first]
            }
            [first, second] => slots = [*first, *second],
            _ => return None,
        }
    }
    let slot = |source: &UvSource| slots.iter().position(|slot| slot == source).unwrap_or(0) as u32;
    Some((UvSlots(slots), sources.iter().map(slot).collect()))
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
        uv_sources: Vec::new(),
        library: Library::default(),
    };
    for object in root.objects("materials", defects) {
        let mut slots = UvSlots::default();
        let mut material = Material::default();
        if let Some(object) = object {
            reader.uv_sources.clear();
            material = read_material(&object, &mut reader, defects, notes);
            match assign_slots(&reader.uv_sources) {
                Some((assigned, places)) => {
                    slots = assigned;
                    for role in MapRole::ALL {
                        if let Some(map) = material.map_mut(role) {
                            map.uv_set = places[map.uv_set as usize];
                        }
                    }
                }
                None => defects.unsupported(
                    object.path,
                    format!("its textures need {} different sets of UVs; two are carried", reader.uv_sources.len()),
                ),
            }
        }
        reader.library.uv_slots.push(slots);
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
    note_extensions(object, &[EMISSIVE_STRENGTH, SPECULAR_GLOSSINESS], defects, notes);
    let extension = |name, defects: &mut Defects| object.object("extensions", defects)?.object(name, defects);
    if let Some(old) = extension(SPECULAR_GLOSSINESS, defects).filter(|_| !object.has("pbrMetallicRoughness")) {
        // The diffuse colour of what is no metal is its base colour; glossiness is what roughness lacks to 1. What a picture
        // says of specular colour and gloss is not carried.
        if let Some(factor) = old.floats::<4>("diffuseFactor", defects) {
            out.base_color_factor = clamped(factor, &old.path_of("diffuseFactor"), notes);
        }
        out.base_color = textures.reference(&old, "diffuseTexture", defects, notes);
        out.metallic_factor = 0.0;
        out.roughness_factor = 1.0 - unit(&old, "glossinessFactor", 1.0, defects, notes);
        notes.not_carried("specular colours of materials", 1);
        notes.not_carried("specular-glossiness textures", old.has("specularGlossinessTexture") as u64);
    }
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
    if let Some(strength) = extension(EMISSIVE_STRENGTH, defects) {
        let path = strength.path_of("emissiveStrength");
        let strength = strength.float("emissiveStrength", defects).unwrap_or(1.0);
        notes.repair(RepairKind::FactorClamped, (strength < 0.0) as u64, || path.clone());
        out.emissive_factor = out.emissive_factor.map(|factor| factor * strength.max(0.0));
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

const EMISSIVE_STRENGTH: &str = "KHR_materials_emissive_strength";
const SPECULAR_GLOSSINESS: &str = "KHR_materials_pbrSpecularGlossiness";

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

/// Extensions by which a texture has a source in another format, best first. A plain `source` beside them comes before all: it
/// is the same picture with less loss.
const SOURCES: [&str; 2] = ["EXT_texture_webp", "KHR_texture_basisu"];
/// The same of formats that kiln does not decode.
const OTHER_SOURCES: [&str; 2] = ["EXT_texture_avif", "MSFT_texture_dds"];

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
    /// Different UVs that the material at hand reads.
    uv_sources: Vec<UvSource>,
    library: Library,
}

impl Textures<'_, '_, '_> {
    /// The texture that `object.key` refers to; its `uv_set` is an index into `uv_sources`.
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
        let set_at = transform.as_ref().filter(|transform| transform.has("texCoord")).unwrap_or(&info);
        let set = if set_at.has("texCoord") { set_at.unsigned("texCoord", defects) } else { Some(0) };
        let transform = transform.and_then(|transform| read_uv_transform(&transform, defects));
        let index = info.need_index("index", "textures", self.textures.len(), defects)?;
        let set = set?;
        let texture = match self.texture_ids.get(&index) {
            Some(known) => *known,
            None => {
                let read = self.texture(index, defects, notes);
                self.texture_ids.insert(index, read);
                read
            }
        };
        let (texture, source) = (texture?, UvSource { set, transform });
        let uv_set = self.uv_sources.iter().position(|known| *known == source).unwrap_or_else(|| {
            self.uv_sources.push(source);
            self.uv_sources.len() - 1
        });
        Some(TextureRef { texture, uv_set: uv_set as u32 })
    }

    fn texture(&mut self, index: usize, defects: &mut Defects, notes: &mut Notes) -> Option<TextureId> {
        let texture = self.textures[index].clone()?;
        note_extensions(&texture, &SOURCES, defects, notes);
        let sampler = match texture.has("sampler") {
            true => self.samplers[texture.index("sampler", "samplers", self.samplers.len(), defects)?],
            false => Sampler::default(),
        };
        let extensions = texture.object("extensions", defects);
        let named = |names: &[&'static str]| {
            names.iter().copied().find(|name| extensions.as_ref().is_some_and(|extensions| extensions.has(name)))
        };
        let source_at = match (texture.has("source"), named(&SOURCES), named(&OTHER_SOURCES)) {
            (true, ..) => texture,
            (false, Some(name), _) => extensions.as_ref()?.object(name, defects)?,
            (false, None, Some(name)) => {
                let path = format!("{}.extensions.{name}", texture.path);
                defects.unsupported(path, format!("{FORMATS} are read; give the texture a `source` of these"));
                return None;
            }
            (false, None, None) => {
                defects.invalid(texture.path_of("source"), "is missing: a material uses this texture");
                return None;
            }
        };
        let source = source_at.need_index("source", "images", self.images.len(), defects)?;
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
                let View { buffer, start, length, encoded, .. } = self.views[view]?;
                if encoded.is_some() {
                    defects.unsupported(image.path_of("bufferView"), "an image in a compressed view");
                    return None;
                }
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
        let format = self.format(&image, file.as_deref().unwrap_or(""), &bytes, defects, notes)?;
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
        let kind = format.name().to_owned();
        let summary = ImageSummary { name: name.clone(), format: kind, width, height, bytes: bytes.len() as u64 };
        self.library.summaries.push(summary);
        self.library.set.images.push(ImageInfo { name, format, hash: *blake3::hash(&bytes).as_bytes() });
        self.library.images.push(bytes);
        self.origins.insert(origin, id);
        Some(id)
    }

    fn format(
        &self,
        image: &Object<'_>,
        file: &str,
        bytes: &[u8],
        defects: &mut Defects,
        notes: &mut Notes,
    ) -> Option<ImageFormat> {
        let claimed = match image.string("mimeType", defects) {
            None => None,
            Some("image/png") => Some(ImageFormat::Png),
            Some("image/jpeg" | "image/jpg") => Some(ImageFormat::Jpeg),
            Some("image/webp") => Some(ImageFormat::Webp),
            Some("image/ktx2") => Some(ImageFormat::Ktx2),
            Some("image/tiff") => Some(ImageFormat::Tiff),
            Some("image/x-exr" | "image/exr") => Some(ImageFormat::Exr),
            Some("image/x-tga" | "image/x-targa" | "image/tga") => Some(ImageFormat::Tga),
            Some(other) => {
                defects.unsupported(image.path_of("mimeType"), format!("`{other}`; {FORMATS} are read"));
                return None;
            }
        };
        let tga = claimed.filter(|claimed| *claimed == ImageFormat::Tga);
        match image_format_of_file(file, bytes).or(tga) {
            Some(found) if found != ImageFormat::Raster => {
                let wrong = claimed.is_some_and(|claimed| claimed != found);
                notes.repair(RepairKind::MimeTypeWrong, wrong as u64, || image.path_of("mimeType"));
                Some(found)
            }
            _ if claimed.is_some() => {
                defects.invalid(image.path.clone(), format!("its bytes are none of {FORMATS}"));
                None
            }
            _ => {
                defects
                    .unsupported(image.path.clone(), format!("its bytes are none of {FORMATS}, which alone are read"));
                None
            }
        }
    }
}

/// The formats of images, to be read by people.
pub(super) const FORMATS: &str = "PNG, JPEG, WebP, TIFF, TGA, EXR and KTX2 of Basis Universal";

/// A transform of UVs; `None` for the identity.
fn read_uv_transform(object: &Object<'_>, defects: &mut Defects) -> Option<UvTransform> {
    let offset = object.floats::<2>("offset", defects).unwrap_or([0.0; 2]);
    let scale = object.floats::<2>("scale", defects).unwrap_or([1.0; 2]);
    let angle = f64::from(object.float("rotation", defects).unwrap_or(0.0));
    let identity = offset == [0.0; 2] && scale == [1.0; 2] && angle == 0.0;
    (!identity).then(|| UvTransform { offset, turn: [libm::cos(angle), libm::sin(angle)], scale })
}

pub(super) fn stem(path: &str) -> String {
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
