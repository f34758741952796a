//! Levels of detail: what simplification gives, atlas lays out, bake dresses and pack writes.

use serde::{Deserialize, Serialize};

use crate::blob::{BlobError, BlobReader, BlobWriter};
use crate::mesh::Mesh;

/// Coefficients of one symmetric 4x4 error form: `xx xy xz yy yz zz x y z 1`, then its weight (area, square object units).
/// The error of a place is `sqrt(q(p) / weight)`, a length.
pub type QuadricCoefficients = [f64; 11];

/// One level of detail.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Level {
    /// Its triangles; submeshes keep name, order and material of the source, even where no face is left.
    pub mesh: Mesh,
    /// Measured distance to the SOURCE asset's surface, object units: the larger one-sided maximum over sample points; never
    /// smaller than that of a finer level.
    pub error: f32,
    /// `[point_count]` or empty: error forms gathered so far, from which a later simplify stage goes on.
    pub quadrics: Vec<QuadricCoefficients>,
}

/// A UV layout made by `atlas` (the mesh's `atlas_uv`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct UvLayout {
    /// Width and height of the sheet for which it was packed, texels.
    pub size: u32,
    /// Least empty space between charts, texels at `size`.
    pub padding: u32,
    /// Number of charts.
    pub chart_count: u32,
    /// Number of sheets, at least 1. Sheet `s` is the square `[s, s + 1] x [0, 1]` of the layout's UVs (as UDIM tiles lie side by
    /// side); all faces of a submesh lie on one sheet, and no chart touches its sheet's edge where there are several.
    pub sheets: u32,
}

impl UvLayout {
    /// The sheet on which a face with these UVs lies, from 0; out of range for UVs outside of the layout.
    pub fn sheet_of(corners: [glam::Vec2; 3]) -> u32 {
        ((corners[0].x + corners[1].x + corners[2].x) / 3.0).floor().max(0.0) as u32
    }
}

/// Levels that share one UV layout, finest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LodSet {
    /// Finest first; never empty after a simplify stage.
    pub levels: Vec<Level>,
    /// The atlas that `atlas_uv` (before `bake`) or `uv0` (after it) lies in; `None`: the source's own UVs.
    pub layout: Option<UvLayout>,
    /// Triangles of the SOURCE asset; shares are of it.
    pub source_triangles: u32,
}

impl LodSet {
    /// The set as bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = BlobWriter::new(*b"LODS", 2);
        blob.meta(&(self.source_triangles, self.layout, self.levels.iter().map(|l| l.error).collect::<Vec<_>>()));
        for level in &self.levels {
            level.mesh.write(&mut blob);
            blob.array(&level.quadrics);
        }
        blob.finish()
    }

    /// The set out of [`LodSet::to_blob`] bytes.
    ///
    /// # Errors
    /// Wrong type, version, length or content.
    pub fn from_blob(bytes: &[u8]) -> Result<LodSet, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"LODS", 2)?;
        let (source_triangles, layout, errors): (u32, Option<UvLayout>, Vec<f32>) = blob.meta()?;
        let mut levels = Vec::new();
        for error in errors {
            let mesh = Mesh::read(&mut blob)?;
            let quadrics: Vec<QuadricCoefficients> = blob.array()?;
            if !quadrics.is_empty() && quadrics.len() != mesh.point_count() {
                return Err(BlobError::Content("quadrics and points differ in number".into()));
            }
            levels.push(Level { mesh, error, quadrics });
        }
        blob.finish()?;
        Ok(LodSet { levels, layout, source_triangles })
    }
}
