//! Materials and textures as an engine wants them: enums instead of numbers.

use kiln_format::{Channel, Extra, MaterialRecord, Role, SlotRecord, TextureFormat, TextureRecord, record::NONE};

/// How coverage is taken from base colour's alpha.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    Opaque,
    /// Below the cutoff: hole; else opaque.
    Mask {
        /// The cutoff.
        cutoff: f32,
    },
    /// Alpha blends.
    Blend,
}

/// What happens outside `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// The picture repeats.
    Repeat,
    /// Every other repetition is mirrored.
    MirroredRepeat,
    /// The edge texel goes on.
    ClampToEdge,
}

/// How a texture is read; `true` is linear, `false` nearest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampler {
    /// Wrap in u.
    pub wrap_u: Wrap,
    /// Wrap in v.
    pub wrap_v: Wrap,
    /// Magnification.
    pub mag_linear: bool,
    /// Minification inside one mip.
    pub min_linear: bool,
    /// Between mips; `None`: mip 0 only.
    pub mip_linear: Option<bool>,
}

/// A texture in use by a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureUse {
    /// Number of the texture.
    pub texture: usize,
    /// UV set: 0 or 1.
    pub uv_set: u32,
    /// How it is read.
    pub sampler: Sampler,
    /// Added to the UV after scale and rotation.
    pub uv_offset: [f32; 2],
    /// Factor on the UV.
    pub uv_scale: [f32; 2],
    /// Rotation of the UV, radians.
    pub uv_rotation: f32,
}

/// glTF 2.0's metallic-roughness core.
#[derive(Clone, Copy, Debug)]
pub struct Material<'a> {
    /// Name, may be empty or repeated.
    pub name: &'a str,
    /// Alpha mode.
    pub alpha_mode: AlphaMode,
    /// Back faces are drawn too.
    pub double_sided: bool,
    /// Linear RGBA factor.
    pub base_color_factor: [f32; 4],
    /// Linear RGB factor.
    pub emissive_factor: [f32; 3],
    /// Factor on metalness.
    pub metallic_factor: f32,
    /// Factor on roughness.
    pub roughness_factor: f32,
    /// Factor on x and y of the normal map.
    pub normal_scale: f32,
    /// Strength of the occlusion.
    pub occlusion_strength: f32,
    slots: &'a [SlotRecord; 5],
}

impl<'a> Material<'a> {
    pub(crate) fn new(record: &'a MaterialRecord, name: &'a str) -> Material<'a> {
        Material {
            name,
            alpha_mode: match record.alpha_mode {
                0 => AlphaMode::Opaque,
                1 => AlphaMode::Mask { cutoff: record.alpha_cutoff },
                _ => AlphaMode::Blend,
            },
            double_sided: record.flags & 1 == 1,
            base_color_factor: record.base_color_factor,
            emissive_factor: record.emissive_factor,
            metallic_factor: record.metallic_factor,
            roughness_factor: record.roughness_factor,
            normal_scale: record.normal_scale,
            occlusion_strength: record.occlusion_strength,
            slots: &record.slots,
        }
    }

    /// The texture in a role.
    pub fn texture(&self, role: Role) -> Option<TextureUse> {
        let slot = self.slots.get(role.number() as usize)?;
        let wrap = |number| match number {
            0 => Wrap::Repeat,
            1 => Wrap::MirroredRepeat,
            _ => Wrap::ClampToEdge,
        };
        (slot.texture != NONE).then_some(TextureUse {
            texture: slot.texture as usize,
            uv_set: slot.uv_set,
            sampler: Sampler {
                wrap_u: wrap(slot.wrap_u),
                wrap_v: wrap(slot.wrap_v),
                mag_linear: slot.mag == 1,
                min_linear: slot.min == 1,
                mip_linear: (slot.mip > 0).then_some(slot.mip == 2),
            },
            uv_offset: slot.uv_offset,
            uv_scale: slot.uv_scale,
            uv_rotation: slot.uv_rotation,
        })
    }
}

/// A texture; its mips are lent by [`crate::Lods::mip`].
#[derive(Clone, Copy, Debug)]
pub struct Texture<'a> {
    /// Name, may be empty or repeated.
    pub name: &'a str,
    /// Format of a texel.
    pub format: TextureFormat,
    /// What R, G, B, A mean. Where normal x and y mean something and normal z does not (BC5), `z = sqrt(max(0, 1 - x x - y y))`.
    pub channels: [Channel; 4],
    /// For a picture that no material uses: what it holds, and its sheet.
    pub extra: Option<(Extra, u32)>,
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Mips, at least one.
    pub mip_count: u32,
}

impl<'a> Texture<'a> {
    pub(crate) fn new(record: &TextureRecord, name: &'a str) -> Option<Texture<'a>> {
        let mut channels = [Channel::Unused; 4];
        for (channel, number) in channels.iter_mut().zip(record.channels) {
            *channel = Channel::from_number(number as u32)?;
        }
        Some(Texture {
            name,
            format: TextureFormat::from_number(record.format)?,
            channels,
            extra: Extra::from_roles(record.roles).map(|extra| (extra, record.sheet)),
            width: record.width,
            height: record.height,
            mip_count: record.mip_count,
        })
    }
}

/// One mip, lent.
#[derive(Clone, Copy, Debug)]
pub struct Mip<'a> {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Texels or blocks as the texture's format lays them ([`TextureFormat::mip_length`] bytes), top row first, rows without gap.
    pub texels: &'a [u8],
}
