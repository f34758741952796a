//! The built-in unwrapper: an adapter over the crate `uvunwrap` (pure Rust, bit-identical on any thread count and any CPU).

use glam::Vec2;
use uvunwrap::{Density, Error, MeshInput, Options, Packing, generate};

use super::surface::Groups;
use super::{UnwrapError, UnwrapInput, UnwrapOutput, Unwrapper};

/// Parts that do not hang together above which charts are packed in rows instead of by shape. Packing by shape tries every
/// place for every chart: for 8,000 leaves minutes instead of a second, for a machine of 2,672 charts 28 s instead of 8 s, and
/// 23.1 % of the sheet instead of 22.8 %; for a helmet of 82 parts 9 s instead of 3 s, but 43 % instead of 38 %.
const FAST_PARTS: u32 = 100;

/// `uvunwrap` with its two limits on charts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uvunwrap {
    name: &'static str,
    /// Largest angle between a face's normal and its chart's mean, degrees. Wider: fewer seams, more stretch.
    max_chart_angle: f32,
    /// Largest ratio of a face's share of texels and its share of surface, either way, unitless.
    max_area_distortion: f32,
}

impl Uvunwrap {
    /// The crate's own limits: 70 degrees, factor 4.
    pub const STANDARD: Uvunwrap = Uvunwrap { name: "uvunwrap", max_chart_angle: 70.0, max_area_distortion: 4.0 };
    /// Flatter charts for surfaces on which the standard ones fail: 40 degrees, factor 2.
    pub const STRICT: Uvunwrap = Uvunwrap { name: "uvunwrap-strict", max_chart_angle: 40.0, max_area_distortion: 2.0 };
}

impl Default for Uvunwrap {
    fn default() -> Self {
        Uvunwrap::STANDARD
    }
}

impl Unwrapper for Uvunwrap {
    fn name(&self) -> &str {
        self.name
    }

    fn unwrap(&self, input: &UnwrapInput) -> Result<UnwrapOutput, UnwrapError> {
        let positions: Vec<[f32; 3]> = input.positions.iter().map(|p| p.to_array()).collect();
        let mesh = MeshInput { seams: Some(&input.cuts), ..MeshInput::new(&positions, input.triangles.as_flattened()) };
        let packing = if parts(input) > FAST_PARTS { Packing::Fast } else { Packing::Shape };
        let options = Options {
            packing,
            max_chart_angle: self.max_chart_angle,
            max_area_distortion: self.max_area_distortion,
            density: Density::Auto { page_size: input.size },
            // The crate keeps this much around each chart, so twice as much between two and once to the edge.
            padding: input.padding.div_ceil(2),
            ..Options::default()
        };
        let does_not_fit = |charts| UnwrapError::DoesNotFit { charts, size: input.size, padding: input.padding };
        let atlas = generate(&[mesh], &options).map_err(|error| match error {
            Error::AtlasTooLarge { .. } | Error::ChartTooLarge { .. } => does_not_fit(0),
            error => UnwrapError::Refused(error.to_string()),
        })?;
        if atlas.page_count > 1 {
            return Err(does_not_fit(atlas.chart_count));
        }
        let [mesh] = &atlas.meshes[..] else {
            return Err(UnwrapError::Refused(format!("{} meshes came out of one", atlas.meshes.len())));
        };
        let texels = Vec2::new(atlas.width as f32, atlas.height as f32);
        let faces = mesh.indices.chunks_exact(3);
        let vertex = |v: u32| &mesh.vertices[v as usize];
        Ok(UnwrapOutput {
            corners: faces
                .clone()
                .map(|t| [t[0], t[1], t[2]].map(|v| Vec2::from_array(vertex(v).uv) * texels))
                .collect(),
            charts: faces.map(|t| vertex(t[0]).chart.unwrap_or(UnwrapOutput::UNPLACED)).collect(),
        })
    }
}

/// Number of parts of the surface that share no point.
fn parts(input: &UnwrapInput) -> u32 {
    let mut points = Groups::new(input.positions.len());
    for [a, b, c] in &input.triangles {
        points.join(*a as usize, *b as usize);
        points.join(*b as usize, *c as usize);
    }
    points.numbers().1
}
