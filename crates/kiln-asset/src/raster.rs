//! Decoded pictures.

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
        let mut blob = BlobWriter::new(*b"RAST", 1);
        blob.array(&[self.width, self.height]);
        blob.array(&self.texels);
        blob.finish()
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
