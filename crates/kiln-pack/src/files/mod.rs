//! Textures of a container as files that other tools open.
//!
//! **Problem.** Every texture goes out as one file named after it, with the values that a reader of the container sees.
//!
//! **Method.**
//! ```text
//! plan:   a name for each texture that every file system takes and no other texture has; a format that holds its values
//! encode: PNG   mip 0; 8 bits as they are, 16 bits as they are; blocks decoded
//!         EXR   mip 0, or all in tiles of 64 x 64; halves and floats as they are, 16 bits as floats, 8 bits as halves;
//!               sRGB becomes linear, as the format wants it
//!         KTX2  all mips, bytes as they lie in the container
//! ```
//! PNG and EXR have one channel where only R means something, else R, G, B, and A where it means something; z of two-channel normals
//! is put in. PNG of a deep colour holds linear light, for which PNG has no common mark: EXR suits it better, and is the default for
//! floats.
//!
//! **Limits.** No metadata but what the formats ask for. A texture without a full chain of mips leaves as one level.
//!
//! Sources: PNG (ISO/IEC 15948:2004), OpenEXR file layout (Academy Software Foundation), KTX 2.0 and Data Format Specification
//! 1.3 (Khronos, 2020).

mod exr;
mod ktx2;
mod png;

use std::collections::BTreeSet;
use std::sync::Arc;

use kiln_asset::Precision;
use kiln_format::{Channel, Container, TextureFormat};

use crate::PackError;
use crate::picture::Picture;
use crate::unpack::{mip_picture, texels_of};

/// A file format of textures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFormat {
    /// PNG of 8 or 16 bits.
    Png,
    /// OpenEXR of halves or floats.
    Exr,
    /// KTX 2.0.
    Ktx2,
}

impl FileFormat {
    /// Extension without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            FileFormat::Png => "png",
            FileFormat::Exr => "exr",
            FileFormat::Ktx2 => "ktx2",
        }
    }
}

/// A texture on its way into a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextureFile {
    /// Its number in the container.
    pub texture: usize,
    /// Name without folder or extension: letters, digits, `.`, `-` and `_`; no other texture's in any case of letters.
    pub stem: String,
    /// What it will be.
    pub format: FileFormat,
    /// Normal maps of materials are written with y down in the picture, as some engines read them. Not for KTX2, whose bytes are the
    /// container's.
    pub normals_down: bool,
}

impl TextureFile {
    /// `stem.extension`.
    pub fn file_name(&self) -> String {
        format!("{}.{}", self.stem, self.format.extension())
    }
}

/// One file for each texture. `format`: of all; without it PNG, and EXR for textures of floats.
///
/// # Errors
/// PNG is asked for and some texture is of floats: all of them are named.
pub fn texture_files(container: &Container<'_>, format: Option<FileFormat>) -> Result<Vec<TextureFile>, PackError> {
    let mut taken = BTreeSet::new();
    let (mut files, mut unfit) = (Vec::new(), Vec::new());
    for (texture, record) in container.textures().iter().enumerate() {
        let floats = matches!(
            TextureFormat::from_number(record.format),
            Some(TextureFormat::Rgba16Float | TextureFormat::Rgba32Float)
        );
        let name = container.string(record.name);
        if floats && format == Some(FileFormat::Png) {
            unfit.push(format!("{name:?}"));
        }
        let natural = if floats { FileFormat::Exr } else { FileFormat::Png };
        files.push(TextureFile {
            texture,
            stem: stem(name, &mut taken),
            format: format.unwrap_or(natural),
            normals_down: false,
        });
    }
    if unfit.is_empty() {
        return Ok(files);
    }
    let message = format!("PNG cannot hold floats, which these textures are: {}; take exr or ktx2", unfit.join(", "));
    Err(PackError::Unsupported(message))
}

/// A name that any file system takes, unlike all `taken` ones.
fn stem(name: &str, taken: &mut BTreeSet<String>) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let mut stem: String = name.chars().take(100).map(plain).collect();
    let first = stem.split('.').next().unwrap_or("").to_ascii_lowercase();
    let device = ["con", "prn", "aux", "nul"].contains(&first.as_str())
        || (first.len() == 4 && (first.starts_with("com") || first.starts_with("lpt")));
    if stem.is_empty() {
        stem = "texture".into();
    } else if stem.starts_with('.') || device {
        stem.insert(0, '_');
    }
    let mut unique = stem.clone();
    let mut number = 2;
    while !taken.insert(unique.to_ascii_lowercase()) {
        unique = format!("{stem}-{number}");
        number += 1;
    }
    unique
}

/// The bytes of a texture's file. `mips`: EXR gets all of them, in tiles (KTX2 has them anyway, PNG cannot).
///
/// # Errors
/// A texture whose mips are not at hand, or more than the format can hold.
pub fn texture_file(container: &Container<'_>, file: &TextureFile, mips: bool) -> Result<Vec<u8>, PackError> {
    let number = file.texture;
    let Some(record) = container.textures().get(number) else {
        return Err(PackError::Unsupported(format!("there is no texture {number}")));
    };
    let name = || container.string(record.name).to_string();
    let fail = |message: String| PackError::Image { image: number as u32, name: name(), message };
    let (format, channels) = texels_of(record).ok_or_else(|| fail("its format is not registered".into()))?;
    let planes = planes(channels, format);
    let turned = channels.iter().position(|channel| *channel == Channel::NormalY).filter(|_| file.normals_down);
    match file.format {
        FileFormat::Ktx2 => ktx2::encode(container, number, format).map_err(fail),
        FileFormat::Png => {
            let mut picture = mip_picture(container, number, 0)?;
            match (&mut picture, turned) {
                (_, None) => {}
                (Picture::Plain(raster), Some(c)) => {
                    Arc::make_mut(raster).texels.iter_mut().for_each(|texel| texel[c] = 255 - texel[c]);
                }
                (Picture::Deep(raster), Some(c)) => turn(&mut Arc::make_mut(raster).texels, c),
            }
            png::encode(&picture, planes).map_err(fail)
        }
        FileFormat::Exr => {
            let mut levels = texture_levels(container, number, mips)?;
            if let Some(c) = turned {
                levels.iter_mut().for_each(|level| turn(&mut level.texels, c));
            }
            exr::encode(&levels, planes, mips).map_err(fail)
        }
    }
}

/// The other sign of a vector's component that is held as `(v + 1) / 2`.
fn turn(texels: &mut [[f32; 4]], channel: usize) {
    texels.iter_mut().for_each(|texel| texel[channel] = 1.0 - texel[channel]);
}

/// One level of a texture in linear floats.
#[derive(Clone, Debug, PartialEq)]
pub struct FloatLevel {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// 32-bit floats, else 16-bit ones hold the values.
    pub full: bool,
    /// `[height * width]`, top row first.
    pub texels: Vec<[f32; 4]>,
}

/// How many of a texture's four channels leave: those that mean something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Planes {
    /// R alone.
    One,
    /// R, G, B.
    Three,
    /// R, G, B, A.
    Four,
}

impl Planes {
    /// Their number.
    pub fn count(self) -> usize {
        match self {
            Planes::One => 1,
            Planes::Three => 3,
            Planes::Four => 4,
        }
    }
}

fn planes(channels: [Channel; 4], format: TextureFormat) -> Planes {
    let used = channels.map(|channel| channel != Channel::Unused);
    match used {
        [.., true] => Planes::Four,
        [_, false, false, false] if format != TextureFormat::Bc5Unorm => Planes::One,
        _ => Planes::Three,
    }
}

/// Mip 0 of a texture as deep as it is, blocks decoded, and which of its channels mean something.
///
/// # Errors
/// There is no such texture, or its mip is not at hand.
pub fn texture_picture(container: &Container<'_>, texture: usize) -> Result<(Picture, Planes), PackError> {
    let record = container.textures().get(texture).and_then(texels_of);
    let (format, channels) =
        record.ok_or_else(|| PackError::Unsupported(format!("there is no readable texture {texture}")))?;
    Ok((mip_picture(container, texture, 0)?, planes(channels, format)))
}

/// Mip 0 of a texture, or all its mips, as linear floats.
///
/// # Errors
/// Mips that are not at hand.
pub fn texture_levels(container: &Container<'_>, texture: usize, all: bool) -> Result<Vec<FloatLevel>, PackError> {
    let record = container.textures().get(texture).and_then(texels_of);
    let srgb = record.is_some_and(|(format, _)| format.is_srgb());
    let count = if all { container.mips(texture).len() } else { 1 };
    let level = |mip| {
        let picture = mip_picture(container, texture, mip)?;
        let (width, height) = picture.size();
        Ok(match picture {
            Picture::Deep(deep) => {
                let full = deep.precision != Precision::Half;
                FloatLevel { width, height, full, texels: deep.texels.clone() }
            }
            Picture::Plain(raster) => {
                let light = |c: u8| if srgb { kiln_geom::colour::srgb_to_linear(c) } else { f32::from(c) / 255.0 };
                let texel = |t: &[u8; 4]| [light(t[0]), light(t[1]), light(t[2]), f32::from(t[3]) / 255.0];
                FloatLevel { width, height, full: false, texels: raster.texels.iter().map(texel).collect() }
            }
        })
    };
    (0..count).map(level).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_plain_and_unlike_each_other() {
        let mut taken = BTreeSet::new();
        let mut of = |name: &str| stem(name, &mut taken);
        assert_eq!(of("wood"), "wood");
        assert_eq!(of("Wood"), "Wood-2");
        assert_eq!(of("wood"), "wood-3");
        assert_eq!(of("wood-3"), "wood-3-2");
        assert_eq!(of("../../etc/passwd"), "_.._.._etc_passwd");
        assert_eq!(of("a\\b:c\u{e9}\n"), "a_b_c__");
        assert_eq!(of(""), "texture");
        assert_eq!(of(".."), "_..");
        assert_eq!(of("NUL.x"), "_NUL.x");
        assert_eq!(of(&"x".repeat(5000)).len(), 100);
    }
}
