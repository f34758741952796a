//! The textures of a container: which pictures, averaged how, in which format.
//!
//! An image that is used as colour and as data is stored once for each use, because mips and format differ; one that holds
//! occlusion, roughness and metalness is stored once. Textures of materials come first, by image and use; then the extra
//! pictures in their set's order, each stored by itself even if a material uses the same image.

use std::borrow::Cow;
use std::collections::BTreeMap;

use bytemuck::cast_slice;
use kiln_asset::{AlphaMode, ExtraMap, ImageId, MapRole, MaterialSet, Precision};
use kiln_format::{Channel, Extra, Role, TextureContent, TextureFormat, record::MAX_TEXTURE_SIZE};

use crate::PackError;
use crate::bc;
use crate::mips::{self, Meaning};
use crate::pack::{Coding, Images, PackOptions, PackReport};
use crate::picture::{Picture, format_of};

/// How an image is averaged and encoded: the reason for which it may be stored more than once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Class {
    Colour,
    Data,
    Normal,
}

/// A texture to be stored.
pub(crate) struct Want {
    pub(crate) image: ImageId,
    /// Of an extra: `Data`.
    pub(crate) class: Class,
    pub(crate) channels: [Channel; 4],
    pub(crate) alpha_weighted: bool,
    /// What an extra holds, and its sheet.
    pub(crate) extra: Option<(ExtraMap, u32)>,
}

pub(crate) fn class(role: MapRole) -> Class {
    match role {
        MapRole::BaseColor | MapRole::Emissive => Class::Colour,
        MapRole::MetallicRoughness | MapRole::Occlusion => Class::Data,
        MapRole::Normal => Class::Normal,
    }
}

/// The container's word for a role.
fn format_role(role: MapRole) -> Role {
    match role {
        MapRole::BaseColor => Role::BaseColor,
        MapRole::MetallicRoughness => Role::MetallicRoughness,
        MapRole::Normal => Role::Normal,
        MapRole::Occlusion => Role::Occlusion,
        MapRole::Emissive => Role::Emissive,
    }
}

/// The container's word for an extra map.
pub(crate) fn format_extra(kind: ExtraMap) -> Extra {
    match kind {
        ExtraMap::Height => Extra::Height,
        ExtraMap::Position => Extra::Position,
        ExtraMap::ObjectNormal => Extra::ObjectNormal,
        ExtraMap::ObjectId => Extra::ObjectId,
        ExtraMap::MaterialId => Extra::MaterialId,
        ExtraMap::Curvature => Extra::Curvature,
        ExtraMap::AmbientOcclusion => Extra::AmbientOcclusion,
        ExtraMap::BentNormal => Extra::BentNormal,
        ExtraMap::Opacity => Extra::Opacity,
        ExtraMap::Coverage => Extra::Coverage,
    }
}

/// How the mips of an extra map are made; `floats`: it is stored in floats.
fn extra_meaning(kind: ExtraMap, floats: bool) -> Meaning {
    match kind {
        ExtraMap::ObjectNormal | ExtraMap::BentNormal if floats => Meaning::Vector,
        ExtraMap::ObjectNormal | ExtraMap::BentNormal => Meaning::Normal,
        ExtraMap::ObjectId | ExtraMap::MaterialId => Meaning::Number,
        _ => Meaning::Data,
    }
}

/// Every texture to be stored: of materials by image and class, then the extras.
///
/// # Errors
/// A reference out of range.
pub(crate) fn wanted(materials: &MaterialSet) -> Result<Vec<Want>, PackError> {
    let image_count = materials.images.len();
    let mut wanted: BTreeMap<(ImageId, Class), Want> = BTreeMap::new();
    for (m, material) in materials.materials.iter().enumerate() {
        for role in MapRole::ALL {
            let Some(used) = material.map(role) else { continue };
            let path = format!("materials[{m}].{}", role.name());
            let texture = materials.textures.get(used.texture.index()).ok_or_else(|| PackError::Reference {
                path: path.clone(),
                expected: materials.textures.len(),
                found: used.texture.0,
            })?;
            if texture.image.index() >= image_count {
                let found = texture.image.0;
                return Err(PackError::Reference { path: format!("{path}.image"), expected: image_count, found });
            }
            if used.uv_set > 1 {
                return Err(PackError::Reference { path: format!("{path}.uv_set"), expected: 2, found: used.uv_set });
            }
            let image = texture.image;
            let want = wanted.entry((image, class(role))).or_insert(Want {
                image,
                class: class(role),
                channels: [Channel::Unused; 4],
                alpha_weighted: false,
                extra: None,
            });
            want.alpha_weighted |= role == MapRole::BaseColor && material.alpha_mode != AlphaMode::Opaque;
            for (have, new) in want.channels.iter_mut().zip(format_role(role).channels()) {
                if *have == Channel::Unused {
                    *have = new;
                }
            }
        }
    }
    let mut out: Vec<Want> = wanted.into_values().collect();
    for (number, extra) in materials.extras.iter().enumerate() {
        if extra.image.index() >= image_count {
            let path = format!("extras[{number}].image");
            return Err(PackError::Reference { path, expected: image_count, found: extra.image.0 });
        }
        out.push(Want {
            image: extra.image,
            class: Class::Data,
            channels: format_extra(extra.kind).channels(),
            alpha_weighted: false,
            extra: Some((extra.kind, extra.sheet)),
        });
    }
    Ok(out)
}

/// The picture of a texture.
///
/// # Errors
/// It cannot be had, or its size is out of range.
pub(crate) fn picture(want: &Want, materials: &MaterialSet, images: &Images<'_>) -> Result<Picture, PackError> {
    let name = &materials.images[want.image.index()].name;
    let fail = |message| PackError::Image { image: want.image.0, name: name.clone(), message };
    let picture = images(want.image).map_err(fail)?;
    let ((width, height), found) = (picture.size(), picture.texel_count());
    let size_ok = |size: u32| (1..=MAX_TEXTURE_SIZE).contains(&size);
    if !size_ok(width) || !size_ok(height) || width as u64 * height as u64 != found as u64 {
        return Err(fail(format!(
            "expected 1 to {MAX_TEXTURE_SIZE} texels a side, found {width} x {height} with {found} texels"
        )));
    }
    Ok(picture)
}

/// A texture as the container stores it.
pub(crate) fn content<'r>(
    want: &Want,
    picture: &'r Picture,
    materials: &MaterialSet,
    options: &PackOptions,
    report: &mut PackReport,
) -> TextureContent<'r> {
    let name = materials.images[want.image.index()].name.clone();
    let (width, height) = picture.size();
    let floats = matches!(picture, Picture::Deep(deep) if deep.precision != Precision::Unorm16);
    let meaning = match (want.extra, want.class) {
        (Some((kind, _)), _) => extra_meaning(kind, floats),
        (None, Class::Colour) => Meaning::Colour { alpha_weighted: want.alpha_weighted },
        (None, Class::Data) => Meaning::Data,
        (None, Class::Normal) => Meaning::Normal,
    };
    let mut channels = want.channels;
    let (format, mips) = match picture {
        Picture::Deep(deep) => {
            let mips = mips::deep_chain(deep, meaning, options.mips).into_iter().map(Cow::Owned).collect();
            (format_of(deep.precision), mips)
        }
        Picture::Plain(raster) => {
            let whole = || vec![Cow::Borrowed(cast_slice(&raster.texels))];
            let mips = if options.mips { mips::chain(raster, meaning) } else { whole() };
            let raw = if want.class == Class::Colour { TextureFormat::Rgba8Srgb } else { TextureFormat::Rgba8Unorm };
            let format = match options.textures {
                Coding::Bc if want.extra.is_none() => block_format(want.class, &name, &raster.texels, report),
                _ => raw,
            };
            if format == TextureFormat::Bc5Unorm {
                channels[2] = Channel::Unused;
            }
            let blocks = |(k, mip): (usize, Cow<'_, [u8]>)| {
                let texels: Vec<[u8; 4]> = mip.as_chunks::<4>().0.to_vec();
                Cow::Owned(bc::encode(format, &texels, (width >> k).max(1), (height >> k).max(1)))
            };
            if format.is_block() {
                (format, mips.into_iter().enumerate().map(blocks).collect())
            } else {
                (format, mips)
            }
        }
    };
    let extra = want.extra.map(|(kind, sheet)| (format_extra(kind), sheet));
    TextureContent { name, format, channels, extra, width, height, mips }
}

fn block_format(class: Class, name: &str, texels: &[[u8; 4]], report: &mut PackReport) -> TextureFormat {
    match class {
        Class::Colour => TextureFormat::Bc7Srgb,
        Class::Data => TextureFormat::Bc7Unorm,
        Class::Normal if bc::two_channels_suffice(texels) => TextureFormat::Bc5Unorm,
        Class::Normal => {
            report.notes.push(format!("{name:?} has normals that look inwards, so it is BC7 instead of BC5"));
            TextureFormat::Bc7Unorm
        }
    }
}
