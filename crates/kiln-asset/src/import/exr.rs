//! OpenEXR pictures as textures of 8 bits.
//!
//! EXR holds light, glTF's colours are sRGB and its data linear, so one file means two pictures: where a material uses it as colour
//! its values are encoded as sRGB ([`ImageFormat::Exr`]), elsewhere they are taken as they are ([`ImageFormat::ExrLinear`]).
//! [`settle_uses`] decides, once all materials are read. Values are clamped to [0, 1]: brighter light is lost. Alpha is taken as
//! straight. The data window is the picture, whatever the display window; of a mip-mapped file the largest level.
//!
//! **Limits.** One part, at most four channels a texel of the texel limit all together, channels R, G, B, A or Y without
//! subsampling. Deep data is refused.

use std::io::Cursor;
use std::sync::Arc;

use exr::image::FlatSamples;
use exr::prelude::{ReadChannels, ReadLayers};

use super::ImageLimits;
use crate::Asset;
use crate::ids::{ImageId, TextureId};
use crate::material::{ImageFormat, MapRole, MaterialSet};
use crate::raster::Raster;

pub(super) const MAGIC: &[u8] = &[0x76, 0x2F, 0x31, 0x01];

/// Flags of the version word: several parts, deep data.
const UNREAD: u32 = 0x1800;

/// Width, height and number of channels, from the first part's header.
fn header(bytes: &[u8]) -> Option<(u32, u32, u32)> {
    let mut rest = bytes.strip_prefix(MAGIC)?;
    rest = rest.get(4..)?;
    let (mut size, mut channels) = (None, None);
    loop {
        let name = text(&mut rest)?;
        if name.is_empty() {
            break;
        }
        let kind = text(&mut rest)?;
        let length = u32::from_le_bytes(*rest.first_chunk()?) as usize;
        let value = rest.get(4..)?.get(..length)?;
        rest = &rest[4 + length..];
        match (name, kind) {
            (b"dataWindow", b"box2i") if length == 16 => {
                let corner =
                    |k: usize| Some(i64::from(i32::from_le_bytes(value.get(4 * k..4 * k + 4)?.try_into().ok()?)));
                let side = |from: i64, to: i64| u32::try_from(to - from + 1).ok();
                size = Some((side(corner(0)?, corner(2)?)?, side(corner(1)?, corner(3)?)?));
            }
            (b"channels", b"chlist") => channels = Some(count_channels(value)?),
            _ => {}
        }
    }
    let (width, height) = size?;
    Some((width, height, channels?))
}

/// Cuts a zero-terminated text off the front.
fn text<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    // The longest name that a file may have.
    let end = rest.iter().take(256).position(|byte| *byte == 0)?;
    let (text, after) = rest.split_at(end);
    *rest = &after[1..];
    Some(text)
}

fn count_channels(mut list: &[u8]) -> Option<u32> {
    let mut count = 0;
    while !text(&mut list)?.is_empty() {
        list = list.get(16..)?;
        count += 1;
    }
    Some(count)
}

/// Width and height in texels, from the header alone.
pub(super) fn size(bytes: &[u8]) -> Option<(u32, u32)> {
    header(bytes).map(|(width, height, _)| (width, height))
}

/// The picture in 8 bits, whose size the caller has checked; `srgb`: RGB is encoded as colours are.
pub(super) fn decode(bytes: &[u8], srgb: bool, limits: &ImageLimits) -> Result<Raster, String> {
    let (width, height, channels) = header(bytes).ok_or("its header is broken or cut off")?;
    let flags = bytes.get(4..8).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    if flags & UNREAD != 0 {
        return Err("EXR of several parts or with deep data is not read".into());
    }
    let samples = u64::from(width) * u64::from(height) * u64::from(channels);
    if samples > limits.max_texels.saturating_mul(4) {
        let most = limits.max_texels.saturating_mul(4);
        return Err(format!("{channels} channels of {width} x {height} texels, the limit is {most} values"));
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|e| format!("cannot be decoded: {e}"))?;
    let layer = image.layer_data;
    if (layer.size.0, layer.size.1) != (width as usize, height as usize) {
        return Err(format!("header says {width} x {height}, the data {} x {}", layer.size.0, layer.size.1));
    }
    let list = &layer.channel_data.list;
    let named = |name: &str| list.iter().find(|c| c.name == *name);
    let planes = match ["R", "G", "B", "A"].map(named) {
        [Some(r), Some(g), Some(b), a] => [Some(r), Some(g), Some(b), a],
        _ => {
            let grey = named("Y").or(named("R")).ok_or("it has neither channels R, G and B nor Y")?;
            [Some(grey), Some(grey), Some(grey), named("A")]
        }
    };
    let count = width as usize * height as usize;
    let mut raster = Raster::filled(width, height, [255; 4]);
    for (k, channel) in planes.into_iter().enumerate() {
        let Some(channel) = channel else { continue };
        if channel.sampling.0 != 1 || channel.sampling.1 != 1 || channel.sample_data.len() != count {
            return Err("its channels are subsampled, which is not read".into());
        }
        let encode = |value: f32| if srgb && k < 3 { to_srgb(value) } else { to_byte(value) };
        let texels = raster.texels.iter_mut();
        match &channel.sample_data {
            FlatSamples::F16(values) => texels.zip(values).for_each(|(t, v)| t[k] = encode(v.to_f32())),
            FlatSamples::F32(values) => texels.zip(values).for_each(|(t, v)| t[k] = encode(*v)),
            FlatSamples::U32(_) => return Err("its channels are whole numbers, which are no light".into()),
        }
    }
    Ok(raster)
}

/// Nearest byte; clamped, NaN gives 0.
fn to_byte(value: f32) -> u8 {
    (value * 255.0 + 0.5) as u8
}

/// Nearest byte on the curve of sRGB (IEC 61966-2-1); clamped, NaN gives 0.
fn to_srgb(light: f32) -> u8 {
    let code = if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * libm::powf(light, 1.0 / 2.4) - 0.055 };
    to_byte(code)
}

/// Gives each EXR image the meaning that its uses ask for; one that is used as colour and as data becomes two images of the same
/// bytes, and its textures as many as needed.
pub(super) fn settle_uses(asset: &mut Asset) {
    let set = &mut asset.materials;
    let mut used = vec![[false; 2]; set.images.len()];
    for_each_use(set, |set, texture, linear| {
        used[set.textures[texture.index()].image.index()][linear as usize] = true;
        texture
    });
    let mut twins = vec![None; set.images.len()];
    for image in 0..set.images.len() {
        match (set.images[image].format, used[image]) {
            (ImageFormat::Exr, [false, true]) => set.images[image].format = ImageFormat::ExrLinear,
            (ImageFormat::Exr, [true, true]) => {
                let mut twin = set.images[image].clone();
                twin.format = ImageFormat::ExrLinear;
                twins[image] = Some(ImageId(set.images.len() as u32));
                set.images.push(twin);
                asset.images.push(Arc::clone(&asset.images[image]));
            }
            _ => {}
        }
    }
    let mut twin_textures = vec![None; set.textures.len()];
    for_each_use(set, |set, texture, linear| {
        let of = set.textures[texture.index()].clone();
        let Some(twin) = twins[of.image.index()].filter(|_| linear) else { return texture };
        *twin_textures[texture.index()].get_or_insert_with(|| {
            let mut new = of;
            new.image = twin;
            set.textures.push(new);
            TextureId(set.textures.len() as u32 - 1)
        })
    });
}

/// Replaces the texture of each slot in use; `change` learns whether the slot's values are linear.
fn for_each_use(set: &mut MaterialSet, mut change: impl FnMut(&mut MaterialSet, TextureId, bool) -> TextureId) {
    for material in 0..set.materials.len() {
        for role in MapRole::ALL {
            let Some(mut used) = set.materials[material].map(role) else { continue };
            used.texture = change(set, used.texture, !role.is_srgb());
            *set.materials[material].map_mut(role) = Some(used);
        }
    }
}
