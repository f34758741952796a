//! What the atlas shall be, and which of it makes sense.

use serde::{Deserialize, Serialize};

use super::AtlasError;

/// Which unwrapper makes the charts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UnwrapperChoice {
    /// `uvunwrap`; where its result fails a check, stricter options; where that fails, planar charts.
    #[default]
    Auto,
    /// `uvunwrap` alone, with stricter options as its second try.
    Uvunwrap,
    /// The worker program `kiln-xatlas` alone.
    Xatlas,
    /// Planar charts alone: the coarsest and the fastest.
    Planar,
}

/// What the atlas shall be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AtlasOptions {
    /// Width and height of a sheet, texels, 16 to 16384.
    pub size: u32,
    /// Least empty space between two charts, texels; half of it (rounded down) is kept to the sheet's edge. At most a quarter
    /// of `size`. [`super::mips`] says down to which mip level charts stay apart.
    pub padding: u32,
    /// Who makes the charts.
    pub unwrapper: UnwrapperChoice,
    /// Most sheets over which the submeshes are spread, 1 to [`AtlasOptions::SHEETS_MAX`]; `sheets * size` at most
    /// [`AtlasOptions::SHEETS_TEXELS_MAX`].
    pub sheets: u32,
    /// `[submesh_count]`: how many times the texels per length of a submesh of factor 1 each gets, unitless, 1/16 to 16; empty
    /// where all are 1.
    pub densities: Vec<f32>,
}

impl Default for AtlasOptions {
    fn default() -> Self {
        AtlasOptions { size: 2048, padding: 16, unwrapper: UnwrapperChoice::Auto, sheets: 1, densities: Vec::new() }
    }
}

impl AtlasOptions {
    /// Smallest sheet, texels.
    pub const SIZE_MIN: u32 = 16;
    /// Largest sheet, texels: what every GPU that the bake knows can hold as one texture.
    pub const SIZE_MAX: u32 = 16384;
    /// Most sheets.
    pub const SHEETS_MAX: u32 = 64;
    /// Most texels over all sheets side by side: a 32-bit `u` on the last one is then exact to 1/512 texel, half of what a face
    /// must reach into a texel to touch it.
    pub const SHEETS_TEXELS_MAX: u32 = 1 << 16;
    /// Least factor of a submesh's density.
    pub const DENSITY_MIN: f32 = 1.0 / 16.0;
    /// Greatest factor of a submesh's density.
    pub const DENSITY_MAX: f32 = 16.0;

    pub(super) fn validate(&self, submeshes: usize) -> Result<(), AtlasError> {
        let AtlasOptions { size, padding, sheets, .. } = *self;
        if !(Self::SIZE_MIN..=Self::SIZE_MAX).contains(&size) {
            return Err(AtlasError::Size { size });
        }
        if padding > size / 4 {
            return Err(AtlasError::Padding { padding, size });
        }
        if sheets == 0 || sheets > Self::SHEETS_MAX || sheets > 1 && sheets * size > Self::SHEETS_TEXELS_MAX {
            return Err(AtlasError::Sheets { sheets, size });
        }
        if !self.densities.is_empty() && self.densities.len() != submeshes {
            return Err(AtlasError::Densities { found: self.densities.len(), submeshes });
        }
        let outside = |factor: &&f32| !(Self::DENSITY_MIN..=Self::DENSITY_MAX).contains(*factor);
        match self.densities.iter().find(outside) {
            Some(factor) => Err(AtlasError::Density { factor: *factor }),
            None => Ok(()),
        }
    }

    /// Most sheets of that size that may lie side by side.
    pub fn most_sheets(size: u32) -> u32 {
        (Self::SHEETS_TEXELS_MAX / size.max(1)).clamp(1, Self::SHEETS_MAX)
    }

    /// The density factor of a submesh.
    pub(super) fn density(&self, submesh: usize) -> f32 {
        self.densities.get(submesh).copied().unwrap_or(1.0)
    }
}
