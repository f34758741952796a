//! Levels as a GLB that other tools read.
//!
//! **Problem.** One level, or all with `MSFT_lod`, with materials and PNG textures, goes out as a glTF 2.0 binary that Khronos'
//! validator passes without error, whatever the values.
//!
//! **Method.**
//! ```text
//! each level   -> one node with one mesh; the first node of several names the others in MSFT_lod
//! each submesh -> one primitive with arrays of its own, unless it is empty
//! each texture -> one PNG in the binary chunk
//! repair values that glTF forbids: lengths of normals and tangents, w, colours and factors outside [0, 1]
//! ```
//! `MSFT_screencoverage` says from which share of the screen's height on a level serves: the coverage at which the next level's
//! error is one pixel on a screen of 1,080 lines; the last entry is 0.
//!
//! **Limits.** Pictures leave in 8 bits: deep ones are rounded (colours to sRGB), blocks decoded, extras left out. Joints and
//! weights are left out, since there is no skeleton to refer to. A submesh has the attributes its source had, or that vary over
//! it; a UV set that its material reads is made up of zeros where there is none. Where the joined mesh filled an attribute in,
//! the export leaves it out again.
//!
//! Sources: glTF 2.0 (Khronos, ISO/IEC 12113:2022), `MSFT_lod` and `KHR_materials_emissive_strength` in its registry.

mod geometry;
mod json;

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use kiln_asset::{AlphaMode, Filter, Level, LodSet, MapRole, Material, MaterialSet, Raster, Sampler, TextureRef, Wrap};
use serde::Serialize;

use crate::PackError;
use crate::unpack::unpack;

/// Which levels go out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportLevels {
    /// One; 0 is the finest.
    One(usize),
    /// All, bound together by `MSFT_lod`.
    All,
}

/// What an export had to repair or leave out.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ExportReport {
    /// Normals that had no length worth the name and became +Z.
    pub replaced_normals: usize,
    /// Tangents that became some direction across the normal.
    pub replaced_tangents: usize,
    /// Colours and factors clamped into `[0, 1]`.
    pub clamped: usize,
    /// Submeshes of a level without a face: no primitive.
    pub empty_submeshes: usize,
    /// What was left out, in words.
    pub notes: Vec<String>,
}

/// [`export_glb`] of a container's bytes.
///
/// # Errors
/// Bytes that are no sound container, or no such level.
pub fn export_container_glb(bytes: &[u8], which: ExportLevels) -> Result<(Vec<u8>, ExportReport), PackError> {
    let (levels, materials, rasters) = unpack(bytes)?;
    let pictures: Vec<&Raster> = rasters.iter().collect();
    export_glb(&levels, &materials, &pictures, which)
}

/// A GLB of one or all levels; `images[i]` is the picture of the material set's image `i`.
///
/// # Errors
/// No such level, a reference out of range, or more than 4 GiB.
pub fn export_glb(
    levels: &LodSet,
    materials: &MaterialSet,
    images: &[&Raster],
    which: ExportLevels,
) -> Result<(Vec<u8>, ExportReport), PackError> {
    let count = levels.levels.len();
    let chosen = match which {
        ExportLevels::All if count > 0 => 0..count,
        ExportLevels::One(asked) if asked < count => asked..asked + 1,
        ExportLevels::One(asked) => return Err(PackError::NoSuchLevel { asked, count }),
        ExportLevels::All => return Err(PackError::NoSuchLevel { asked: 0, count }),
    };
    check_references(levels, materials, images)?;
    let mut writer = Writer::default();
    writer.root.scenes.push(json::Scene { nodes: vec![0] });
    for lod in chosen.clone() {
        let node = writer.level(lod, &levels.levels[lod], materials);
        writer.root.nodes.push(node);
    }
    if chosen.len() > 1 {
        let first = &mut writer.root.nodes[0];
        first.extensions = Some(json::NodeExtensions { lod: json::Lod { ids: (1..chosen.len() as u32).collect() } });
        first.extras = Some(json::NodeExtras { coverage: coverages(&levels.levels) });
        writer.root.extensions_used.push("MSFT_lod");
    }
    writer.materials(materials, images)?;
    writer.finish()
}

fn check_references(levels: &LodSet, materials: &MaterialSet, images: &[&Raster]) -> Result<(), PackError> {
    let below = |path: String, expected: usize, found: u32| {
        if (found as usize) < expected { Ok(()) } else { Err(PackError::Reference { path, expected, found }) }
    };
    for (lod, level) in levels.levels.iter().enumerate() {
        for (number, submesh) in level.mesh.submeshes.iter().enumerate() {
            if let Some(material) = submesh.material {
                let path = format!("levels[{lod}].submeshes[{number}].material");
                below(path, materials.materials.len(), material.0)?;
            }
        }
    }
    for (number, material) in materials.materials.iter().enumerate() {
        for role in MapRole::ALL {
            if let Some(used) = material.map(role) {
                let path = format!("materials[{number}].{}", role.name());
                below(path.clone(), materials.textures.len(), used.texture.0)?;
                below(format!("{path}.uv_set"), 2, used.uv_set)?;
            }
        }
    }
    for (number, texture) in materials.textures.iter().enumerate() {
        below(format!("textures[{number}].image"), images.len().min(materials.images.len()), texture.image.0)?;
    }
    Ok(())
}

/// For each level the least share of the screen's height at which it is still needed.
fn coverages(levels: &[Level]) -> Vec<f64> {
    const SCREEN_LINES: f64 = 1080.0;
    let diameter = levels.first().map_or(0.0, |level| level.mesh.diagonal() as f64);
    let mut least = 1.0f64;
    let mut out: Vec<f64> = Vec::new();
    for coarser in levels.iter().skip(1) {
        let error = coarser.error as f64;
        let coverage = if error > 0.0 { diameter / (error * SCREEN_LINES) } else { 1.0 };
        least = least.min(coverage);
        out.push(least);
    }
    out.push(0.0);
    out
}

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

#[derive(Default)]
struct Writer {
    root: json::Root,
    binary: Vec<u8>,
    report: ExportReport,
}

impl Writer {
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> u32 {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let (byte_offset, byte_length) = (self.binary.len(), bytes.len());
        self.binary.extend_from_slice(bytes);
        self.root.buffer_views.push(json::BufferView { buffer: 0, byte_offset, byte_length, target });
        self.root.buffer_views.len() as u32 - 1
    }

    fn materials(&mut self, materials: &MaterialSet, images: &[&Raster]) -> Result<(), PackError> {
        let mut factor_clamps = 0;
        for material in &materials.materials {
            let written = material_json(material, &mut factor_clamps);
            if written.extensions.is_some() && !self.root.extensions_used.contains(&"KHR_materials_emissive_strength") {
                self.root.extensions_used.push("KHR_materials_emissive_strength");
            }
            self.root.materials.push(written);
        }
        self.report.clamped += factor_clamps;
        for texture in &materials.textures {
            let sampler = sampler_json(&texture.sampler);
            let known = self.root.samplers.iter().position(|s| *s == sampler);
            let sampler = known.unwrap_or_else(|| {
                self.root.samplers.push(sampler);
                self.root.samplers.len() - 1
            });
            self.root.textures.push(json::Texture { sampler: sampler as u32, source: texture.image.0 });
        }
        if materials.textures.is_empty() {
            return Ok(());
        }
        for (number, (info, raster)) in materials.images.iter().zip(images).enumerate() {
            let png = encode_png(raster).map_err(|message| PackError::Image {
                image: number as u32,
                name: info.name.clone(),
                message,
            })?;
            let buffer_view = self.view(&png, None);
            self.root.images.push(json::Image { name: info.name.clone(), buffer_view, mime_type: "image/png" });
        }
        Ok(())
    }

    /// Header, JSON chunk, binary chunk.
    fn finish(mut self) -> Result<(Vec<u8>, ExportReport), PackError> {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        if !self.binary.is_empty() {
            self.root.buffers.push(json::Buffer { byte_length: self.binary.len() });
        }
        let mut text = serde_json::to_vec(&self.root).map_err(|e| PackError::Unsupported(e.to_string()))?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let chunks = if self.binary.is_empty() { 1 } else { 2 };
        let length = 12 + 8 * chunks + text.len() + self.binary.len();
        let length32 = u32::try_from(length).map_err(|_| {
            PackError::Unsupported(format!("a GLB of {length} bytes (at most 4 GiB); export one level"))
        })?;
        let mut out = Vec::with_capacity(length);
        out.extend(b"glTF");
        out.extend(2u32.to_le_bytes());
        out.extend(length32.to_le_bytes());
        for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &self.binary)].into_iter().take(chunks) {
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(kind);
            out.extend(chunk);
        }
        Ok((out, self.report))
    }
}

/// PNG bytes of a picture: RGB where alpha is 255 everywhere, else RGBA.
fn encode_png(raster: &Raster) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    let encoder = PngEncoder::new_with_quality(Cursor::new(&mut out), CompressionType::Default, FilterType::Adaptive);
    let (w, h) = (raster.width, raster.height);
    let written = if raster.texels.iter().all(|texel| texel[3] == 255) {
        let rgb: Vec<u8> = raster.texels.iter().flat_map(|t| [t[0], t[1], t[2]]).collect();
        encoder.write_image(&rgb, w, h, ExtendedColorType::Rgb8)
    } else {
        encoder.write_image(bytemuck::cast_slice(&raster.texels), w, h, ExtendedColorType::Rgba8)
    };
    written.map_err(|e| e.to_string())?;
    Ok(out)
}

fn material_json(material: &Material, clamps: &mut usize) -> json::Material {
    let mut unit = |value: f32| {
        let clamped = value.clamp(0.0, 1.0);
        *clamps += (clamped != value) as usize;
        clamped
    };
    let texture = |used: Option<TextureRef>| {
        used.map(|used| json::TextureUse { index: used.texture.0, tex_coord: used.uv_set, scale: None, strength: None })
    };
    // Emission above 1 goes into the strength, which scales it back.
    let strength = material.emissive_factor.iter().fold(1.0f32, |a, b| a.max(*b));
    let occlusion_strength = unit(material.occlusion_strength);
    json::Material {
        name: material.name.clone(),
        pbr_metallic_roughness: json::Pbr {
            base_color_factor: material.base_color_factor.map(&mut unit),
            base_color_texture: texture(material.base_color),
            metallic_factor: unit(material.metallic_factor),
            roughness_factor: unit(material.roughness_factor),
            metallic_roughness_texture: texture(material.metallic_roughness),
        },
        normal_texture: texture(material.normal).map(|t| json::TextureUse { scale: Some(material.normal_scale), ..t }),
        occlusion_texture: texture(material.occlusion)
            .map(|t| json::TextureUse { strength: Some(occlusion_strength), ..t }),
        emissive_texture: texture(material.emissive),
        emissive_factor: material.emissive_factor.map(|e| unit(e / strength)),
        alpha_mode: match material.alpha_mode {
            AlphaMode::Opaque => "OPAQUE",
            AlphaMode::Mask => "MASK",
            AlphaMode::Blend => "BLEND",
        },
        alpha_cutoff: (material.alpha_mode == AlphaMode::Mask).then_some(material.alpha_cutoff.max(0.0)),
        double_sided: material.double_sided,
        extensions: (strength > 1.0).then_some(json::MaterialExtensions {
            emissive_strength: json::EmissiveStrength { emissive_strength: strength },
        }),
    }
}

fn sampler_json(sampler: &Sampler) -> json::Sampler {
    let wrap = |wrap| match wrap {
        Wrap::Repeat => 10497,
        Wrap::MirroredRepeat => 33648,
        Wrap::ClampToEdge => 33071,
    };
    let linear = (sampler.min == Filter::Linear) as u32;
    json::Sampler {
        mag_filter: 9728 + (sampler.mag == Filter::Linear) as u32,
        min_filter: match sampler.mip {
            None => 9728 + linear,
            Some(Filter::Nearest) => 9984 + linear,
            Some(Filter::Linear) => 9986 + linear,
        },
        wrap_s: wrap(sampler.wrap_u),
        wrap_t: wrap(sampler.wrap_v),
    }
}
