//! Decoded pictures.

use serde::{Deserialize, Serialize};

use crate::blob::{BlobError, BlobReader, BlobWriter};

/// An RGBA8 picture, top row first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Raster {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// `[height * width]`, row by row.
    pub texels: Vec<[u8; 4]>,
}

impl Raster {
    /// A picture of one colour.
    pub fn filled(width: u32, height: u32, texel: [u8; 4]) -> Raster {
        Raster { width, height, texels: vec![texel; width as usize * height as usize] }
    }

    /// The picture as bytes for the private cache ([`crate::ImageFormat::Raster`]).
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = self.head();
        blob.array(&self.texels);
        blob.finish()
    }

    /// BLAKE3 of those bytes.
    pub fn blob_hash(&self) -> [u8; 32] {
        self.head().hash_with(&self.texels)
    }

    fn head(&self) -> BlobWriter {
        let mut blob = BlobWriter::new(*b"RAST", 1);
        blob.array(&[self.width, self.height]);
        blob
    }

    /// The picture out of [`Raster::to_blob`] bytes.
    ///
    /// # Errors
    /// Wrong type, version or length.
    pub fn from_blob(bytes: &[u8]) -> Result<Raster, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"RAST", 1)?;
        let size: Vec<u32> = blob.array()?;
        let texels: Vec<[u8; 4]> = blob.array()?;
        blob.finish()?;
        match size[..] {
            [width, height] if width as u64 * height as u64 == texels.len() as u64 => {
                Ok(Raster { width, height, texels })
            }
            _ => Err(BlobError::Content("size and texels differ".into())),
        }
    }
}

/// How finely a [`DeepRaster`] is written where it leaves the cache.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// 16 bits a channel over `[0, 1]`.
    #[default]
    Unorm16,
    /// 16-bit floats.
    Half,
    /// 32-bit floats.
    Float,
}

/// A picture of four `f32` channels, top row first. In a material's slot: what a sampler gives, colours linear, normals as
/// `(n + 1) / 2`. As an extra map: for [`Precision::Unorm16`] values in `[0, 1]`, unit vectors as `(v + 1) / 2`; for floats
/// the values as they are, unit vectors in `[-1, 1]`, lengths in object units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeepRaster {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// How finely it is to be written.
    pub precision: Precision,
    /// `[height * width]`, row by row, all finite.
    pub texels: Vec<[f32; 4]>,
}

impl DeepRaster {
    /// A picture of one value.
    pub fn filled(width: u32, height: u32, precision: Precision, texel: [f32; 4]) -> DeepRaster {
        DeepRaster { width, height, precision, texels: vec![texel; width as usize * height as usize] }
    }

    /// The picture as bytes for the private cache ([`crate::ImageFormat::Deep`]).
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = self.head();
        blob.array(&self.texels);
        blob.finish()
    }

    /// BLAKE3 of those bytes.
    pub fn blob_hash(&self) -> [u8; 32] {
        self.head().hash_with(&self.texels)
    }

    fn head(&self) -> BlobWriter {
        let mut blob = BlobWriter::new(*b"DEEP", 1);
        blob.meta(&(self.width, self.height, self.precision));
        blob
    }

    /// The picture out of [`DeepRaster::to_blob`] bytes.
    ///
    /// # Errors
    /// Wrong type, version or length, a texel that is no finite number.
    pub fn from_blob(bytes: &[u8]) -> Result<DeepRaster, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"DEEP", 1)?;
        let (width, height, precision): (u32, u32, Precision) = blob.meta()?;
        let texels: Vec<[f32; 4]> = blob.array()?;
        blob.finish()?;
        if width as u64 * height as u64 != texels.len() as u64 {
            return Err(BlobError::Content("size and texels differ".into()));
        }
        if texels.iter().flatten().any(|c| !c.is_finite()) {
            return Err(BlobError::Content("a texel is no finite number".into()));
        }
        Ok(DeepRaster { width, height, precision, texels })
    }
}
