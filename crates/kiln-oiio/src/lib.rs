//! Pictures through the system's OpenImageIO.
//!
//! **Problem.** Some textures come as PSD, DPX, PNM, HDR or BMP, and some renderers want `.tx`: tiled, with mips. Both are
//! OpenImageIO's, a large C++ library that the default build must not need.
//!
//! **Method.** A shim of four calls (`shim.cpp`) over the library that the system has, behind the feature `oiio`. Pictures are read
//! from memory and known by their bytes. Without the feature [`version`] is `None`, and every call is [`OiioError::Absent`].
//!
//! **Limits.** Formats that OpenImageIO cannot tell by their bytes, or cannot read from memory, are unknown (SGI, RLA, JPEG 2000
//! with 2.4). The library runs in this process: what breaks it breaks the build, so [`size`] and [`read`] are for models that one
//! trusts. Values are those in the file; no colour space is changed. OpenImageIO leaves what tiles hold beyond the picture's edge
//! undefined, so two textures written of the same texels may differ there, and only there.
//!
//! Source: OpenImageIO 2.4 (Gritz et al., Academy Software Foundation), `ImageInput` and `ImageBufAlgo::make_texture`.

#[cfg(feature = "oiio")]
mod shim;

use std::path::Path;

/// Why OpenImageIO gave nothing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OiioError {
    /// It is not part of this build.
    #[error("this build is without OpenImageIO (feature `oiio`)")]
    Absent,
    /// It refused.
    #[error("OpenImageIO: {0}")]
    Refused(String),
}

/// Size of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Values a texel.
    pub channels: u32,
}

impl Size {
    /// Values of the picture.
    pub fn values(self) -> u64 {
        u64::from(self.width).saturating_mul(self.height.into()).saturating_mul(self.channels.into())
    }
}

/// Values of a texture's texels, one texel behind the other, top row first.
#[derive(Clone, Copy, Debug)]
pub enum Texels<'a> {
    /// 8 bits.
    Bytes(&'a [u8]),
    /// 16 bits.
    Words(&'a [u16]),
    /// 16-bit floats, by their bits.
    Halves(&'a [u16]),
    /// 32-bit floats.
    Floats(&'a [f32]),
}

/// The library's version, `2.4.7`; `None` without the feature.
pub fn version() -> Option<String> {
    #[cfg(feature = "oiio")]
    return Some(shim::version());
    #[cfg(not(feature = "oiio"))]
    None
}

/// Size of the first picture in the bytes of a file, from its header.
///
/// # Errors
/// No library, or bytes that are no picture for it.
#[cfg_attr(not(feature = "oiio"), expect(unused_variables, reason = "no library to ask"))]
pub fn size(bytes: &[u8]) -> Result<Size, OiioError> {
    #[cfg(feature = "oiio")]
    return shim::size(bytes);
    #[cfg(not(feature = "oiio"))]
    Err(OiioError::Absent)
}

/// The first picture in the bytes of a file: `[height * width * channels]`, whole numbers scaled to [0, 1]. `size`: what [`size`]
/// said, which the caller has held against its limits.
///
/// # Errors
/// No library, or damaged bytes.
#[cfg_attr(not(feature = "oiio"), expect(unused_variables, reason = "no library to ask"))]
pub fn read(bytes: &[u8], size: Size) -> Result<Vec<f32>, OiioError> {
    #[cfg(feature = "oiio")]
    return shim::read(bytes, size);
    #[cfg(not(feature = "oiio"))]
    Err(OiioError::Absent)
}

/// Writes a tiled (64 x 64) and mip-mapped file: EXR for floats, else TIFF, whatever `path` ends in.
///
/// # Errors
/// No library, texels that do not fit `size`, or a file that cannot be written.
#[cfg_attr(not(feature = "oiio"), expect(unused_variables, reason = "no library to ask"))]
pub fn make_texture(path: &Path, size: Size, texels: Texels<'_>) -> Result<(), OiioError> {
    #[cfg(feature = "oiio")]
    return shim::make_texture(path, size, texels);
    #[cfg(not(feature = "oiio"))]
    Err(OiioError::Absent)
}

/// One level of a file with all its values, and the width of its tiles (0: none).
#[derive(Clone, Debug, PartialEq)]
pub struct FileLevel {
    /// Its size.
    pub size: Size,
    /// Width of its tiles, 0 for lines.
    pub tile: u32,
    /// `[height * width * channels]`.
    pub values: Vec<f32>,
}

/// A level of a picture file, read by OpenImageIO: how tests see what was written.
///
/// # Errors
/// No library, no such file or level, or more than `most` values.
#[cfg_attr(not(feature = "oiio"), expect(unused_variables, reason = "no library to ask"))]
pub fn read_level(path: &Path, level: u32, most: usize) -> Result<FileLevel, OiioError> {
    #[cfg(feature = "oiio")]
    return shim::read_level(path, level, most);
    #[cfg(not(feature = "oiio"))]
    Err(OiioError::Absent)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(not(feature = "oiio"))]
    #[test]
    fn without_the_feature_there_is_none_and_it_says_so() {
        assert_eq!(version(), None);
        assert_eq!(size(b"8BPS"), Err(OiioError::Absent));
        let size = Size { width: 1, height: 1, channels: 1 };
        assert!(make_texture(Path::new("none.tx"), size, Texels::Bytes(&[1])).is_err());
    }

    #[cfg(feature = "oiio")]
    mod with {
        use super::*;

        /// A Photoshop file of 3 x 2 texels, 8 bits, RGB in planes, nothing else.
        fn psd() -> Vec<u8> {
            let mut out = b"8BPS\0\x01\0\0\0\0\0\0\0\x03\0\0\0\x02\0\0\0\x03\0\x08\0\x03".to_vec();
            out.extend([0; 12]);
            out.extend([0, 0]);
            out.extend((0..18).map(|i| i * 10));
            out
        }

        #[test]
        fn a_psd_is_read_from_memory_and_known_by_its_bytes() {
            assert!(version().expect("the feature").starts_with("2.") || version() > Some("3".into()));
            let size = size(&psd()).expect("a PSD");
            assert_eq!(size, Size { width: 3, height: 2, channels: 3 });
            let values = read(&psd(), size).expect("reads");
            let bytes: Vec<u8> = values.iter().map(|v| (v * 255.0).round() as u8).collect();
            // Planes of six values: the second texel is 10, 70, 130.
            assert_eq!(bytes[3..6], [10, 70, 130]);
        }

        #[test]
        fn damage_is_an_error_and_no_end_of_the_process() {
            assert!(size(b"").is_err());
            assert!(size(b"no picture").is_err());
            let whole = psd();
            for end in 0..whole.len() {
                if let Ok(size) = size(&whole[..end]) {
                    assert_eq!(size.values(), 18);
                    let _ = read(&whole[..end], size);
                }
            }
            let wrong = Size { width: 4, height: 2, channels: 3 };
            assert!(read(&whole, wrong).is_err());
        }

        #[test]
        fn a_texture_has_tiles_and_mips_and_its_values() {
            let folder = tempfile::tempdir().expect("a folder");
            let size = Size { width: 100, height: 70, channels: 3 };
            let bytes: Vec<u8> = (0..21_000).map(|i| (i % 251) as u8).collect();
            let words: Vec<u16> = (0..21_000).map(|i| (i * 3) as u16).collect();
            let floats: Vec<f32> = (0..21_000).map(|i| i as f32 * 0.5 - 100.0).collect();
            let cases: [(&str, Texels<'_>, Vec<f32>); 3] = [
                ("a.tx", Texels::Bytes(&bytes), bytes.iter().map(|v| f32::from(*v) / 255.0).collect()),
                ("b.tx", Texels::Words(&words), words.iter().map(|v| f32::from(*v) / 65_535.0).collect()),
                ("c.exr", Texels::Floats(&floats), floats.clone()),
            ];
            for (name, texels, expected) in cases {
                let path = folder.path().join(name);
                make_texture(&path, size, texels).expect("writes");
                let level = read_level(&path, 0, 21_000).expect("reads");
                assert_eq!((level.size, level.tile), (size, 64), "{name}");
                let near = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-6 * b.abs().max(1.0);
                assert!(level.values.iter().zip(&expected).all(near), "{name}");
                let half = read_level(&path, 1, 21_000).expect("has mips").size;
                assert_eq!((half.width, half.height), (50, 35), "{name}");
            }
            assert!(make_texture(&folder.path().join("d.tx"), size, Texels::Bytes(&bytes[1..])).is_err());
            assert!(make_texture(&folder.path().join("no/folder.tx"), size, Texels::Bytes(&bytes)).is_err());
        }
    }
}
