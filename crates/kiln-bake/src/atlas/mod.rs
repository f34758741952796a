//! Atlas: a second UV layout for a low mesh, in which every texel belongs to one place of the surface.
//!
//! **In** a level (mesh, points, carried quadrics), the size of the sheet and the padding, both in texels. **Out** the same
//! level with `atlas_uv`: triangles in the same order, points and quadrics untouched, positions and normals untouched;
//! vertices are split where charts split. All charts lie on one square sheet of exactly the size that was asked, none
//! mirrored, none overlapping, at least `padding` empty texels between any two and `padding / 2` to the sheet's edge.
//!
//! ```text
//! surface <- points at unit scale, once for each fan of faces; degenerate faces set aside; cuts along hard edges
//! for each rung of the ladder:                  uvunwrap, uvunwrap-strict, planar (or the one that was asked for)
//!     charts <- rung(surface)                   one UV per corner in texels, one chart per face
//!     orient charts                             counter-clockwise in the picture (V points down in glTF)
//!     mesh <- split wedges by (vertex, UV)
//!     measure <- check(mesh)                    unplaced, outside, mirrored, overlapping faces; padding
//!     if no defect: return mesh, layout, report
//! fail with what each rung said
//! ```
//!
//! Charts are grown over points, so a chart may cross the boundary of two submeshes that `merge` joined: they end on the
//! same sheet anyway, and a seam less is a seam less. Wedges of the two submeshes stay apart as they were.
//!
//! `auto` never looks at a clock and never at what is installed: it steps down the ladder only when a check failed, so the
//! same input takes the same rung everywhere. `xatlas` is therefore used only where it was asked for.
//!
//! **Limits.** One sheet: charts too many for size and padding are an error that says so. Chart shapes are as good as the
//! unwrapper's; nothing straightens them for the eye.
//!
//! **Sources.** Charts by region growing, least-squares conformal maps (Lévy, Petitjean, Ray, Maillot, "Least squares
//! conformal maps for automatic texture atlas generation", SIGGRAPH 2002, DOI 10.1145/566570.566590) and as-rigid-as-possible
//! refinement (Liu, Zhang, Xu, Gotsman, Gortler, "A local/global approach to mesh parameterization", SGP 2008,
//! DOI 10.1111/j.1467-8659.2008.01290.x) are the crate `uvunwrap`'s. The stretch figure is that of Sander, Snyder, Gortler,
//! Hoppe, "Texture mapping progressive meshes", SIGGRAPH 2001, DOI 10.1145/383259.383307.

pub mod check;
mod orient;
mod planar;
mod surface;
#[cfg(test)]
mod tests;
mod uvunwrap;
pub(crate) mod wedges;
pub mod xatlas;

use glam::{Vec2, Vec3};
use kiln_asset::{FaceId, Level, UvLayout};
use serde::{Deserialize, Serialize};

pub use check::{AtlasDefect, Measure, check};
pub use planar::Planar;
pub use uvunwrap::Uvunwrap;

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
}

/// What the atlas shall be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AtlasOptions {
    /// Width and height of the sheet, texels, 16 to 16384.
    pub size: u32,
    /// Least empty space between two charts, texels; half of it (rounded down) is kept to the sheet's edge. At most a quarter
    /// of `size`. 16 keeps charts apart down to the fourth mip level.
    pub padding: u32,
    /// Who makes the charts.
    pub unwrapper: UnwrapperChoice,
}

impl Default for AtlasOptions {
    fn default() -> Self {
        AtlasOptions { size: 2048, padding: 16, unwrapper: UnwrapperChoice::Auto }
    }
}

impl AtlasOptions {
    /// Smallest sheet, texels.
    pub const SIZE_MIN: u32 = 16;
    /// Largest sheet, texels: what every GPU that the bake knows can hold as one texture.
    pub const SIZE_MAX: u32 = 16384;

    fn validate(&self) -> Result<(), AtlasError> {
        let AtlasOptions { size, padding, .. } = *self;
        if !(Self::SIZE_MIN..=Self::SIZE_MAX).contains(&size) {
            return Err(AtlasError::Size { size });
        }
        if padding > size / 4 {
            return Err(AtlasError::Padding { padding, size });
        }
        Ok(())
    }
}

/// The surface as an unwrapper gets it: places, not wedges; only faces that can have a chart. A place is a point as one fan
/// of faces around it sees it, so that parts which only touch share none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnwrapInput {
    /// `[place_count]`, scaled to a bounding box of unit diagonal; no two are bitwise equal, so that unwrappers which weld by
    /// position cannot join what the mesh keeps apart.
    pub positions: Vec<Vec3>,
    /// `[face_count] x 3` indices into `positions`, winding as in the mesh.
    pub triangles: Vec<[u32; 3]>,
    /// `[face_count] x 3`: whether the edge from corner `k` to corner `k + 1` must be a chart's border (hard edges).
    pub cuts: Vec<[bool; 3]>,
    /// Width and height of the sheet, texels.
    pub size: u32,
    /// Least empty space between charts, texels.
    pub padding: u32,
}

/// Charts, placed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnwrapOutput {
    /// `[face_count] x 3`, texels on the sheet, inside `[0, size]`. V may point either way: charts are turned afterwards.
    pub corners: Vec<[Vec2; 3]>,
    /// `[face_count]`, the chart of each face; [`UnwrapOutput::UNPLACED`] where it has none.
    pub charts: Vec<u32>,
}

impl UnwrapOutput {
    /// Chart of a face that was left out.
    pub const UNPLACED: u32 = u32::MAX;
}

/// Cuts a surface into charts and packs them on one sheet.
pub trait Unwrapper {
    /// Its name, as reports and pipelines write it.
    fn name(&self) -> &str;

    /// The charts of `input`, a function of `input` alone: same bytes on any machine of a numeric class.
    ///
    /// # Errors
    /// No layout could be made; the message says why.
    fn unwrap(&self, input: &UnwrapInput) -> Result<UnwrapOutput, UnwrapError>;
}

/// Why an unwrapper made no layout.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnwrapError {
    /// The charts do not fit one sheet.
    #[error("{charts} charts do not fit one sheet of {size} texels with {padding} texels of padding")]
    DoesNotFit {
        /// Number of charts.
        charts: u32,
        /// Texels.
        size: u32,
        /// Texels.
        padding: u32,
    },
    /// The unwrapper refused the surface.
    #[error("{0}")]
    Refused(String),
    /// The worker program failed, ran out of time or memory, or sent bytes that are no reply. Never cached.
    #[error("{0}")]
    Worker(String),
}

/// Why a level got no atlas.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AtlasError {
    /// Invalid: the size is out of range.
    #[error("atlas size {size} is outside {} to {} texels", AtlasOptions::SIZE_MIN, AtlasOptions::SIZE_MAX)]
    Size {
        /// What was asked.
        size: u32,
    },
    /// Invalid: the padding leaves no room.
    #[error("atlas padding {padding} is more than a quarter of the size {size}; use at most {}", size / 4)]
    Padding {
        /// What was asked, texels.
        padding: u32,
        /// The sheet's size, texels.
        size: u32,
    },
    /// Invalid: there is nothing to unwrap.
    #[error("no face of the mesh has an area: there is nothing to unwrap ({faces} faces, {degenerate} degenerate)")]
    Empty {
        /// Faces of the mesh.
        faces: usize,
        /// Those without area.
        degenerate: usize,
    },
    /// No unwrapper on the ladder gave a layout that passes the checks.
    #[error("no valid atlas: {}{}", list_attempts(.attempts), advice(.attempts))]
    Failed {
        /// What each one said, in the order in which they were tried.
        attempts: Vec<FailedAttempt>,
    },
}

/// An unwrapper that was tried and set aside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedAttempt {
    /// Its name.
    pub unwrapper: String,
    /// Why its result was not taken.
    pub reason: String,
    /// Whether the charts were too many for the sheet.
    pub does_not_fit: bool,
}

fn list_attempts(attempts: &[FailedAttempt]) -> String {
    attempts.iter().map(|a| format!("{}: {}", a.unwrapper, a.reason)).collect::<Vec<_>>().join("; ")
}

fn advice(attempts: &[FailedAttempt]) -> &'static str {
    if attempts.iter().any(|a| a.does_not_fit) {
        "; give the atlas a larger size or a smaller padding"
    } else if attempts.iter().any(|a| a.unwrapper != "planar") && !attempts.iter().any(|a| a.unwrapper == "planar") {
        "; use unwrapper = \"auto\", which falls back to planar charts"
    } else {
        ""
    }
}

/// What the atlas came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AtlasReport {
    /// The unwrapper whose layout was taken.
    pub unwrapper: String,
    /// Those that were tried before it.
    pub failed: Vec<FailedAttempt>,
    /// Number of charts.
    pub charts: u32,
    /// Charts of less than one texel's area: whatever lies there gets one colour.
    pub tiny_charts: u32,
    /// Share of the sheet's area inside charts, `[0, 1]`.
    pub coverage: f64,
    /// Least empty space found between two charts, texels; `None`: there is one chart only.
    pub padding_measured: Option<u32>,
    /// Least empty space found between a chart and the sheet's edge, texels.
    pub edge_measured: u32,
    /// Texels a unit of length gets, `sqrt(texel area / surface area)` over all charts; texels per object unit.
    pub texels_per_unit: f64,
    /// Mean texture stretch (Sander et al. 2001, eq. 2, L2), unitless: 1 is an isometry up to the mean scale.
    pub stretch: f64,
    /// Mean over the area of longest by shortest extent of a surface circle in texels, unitless: 1 is conformal.
    pub anisotropy: f64,
    /// Faces without area: each got one UV, at a neighbour's corner where there is one.
    pub degenerate_faces: u32,
    /// Hard edges that were made chart borders.
    pub hard_edges: u32,
    /// Vertices before.
    pub vertices_before: u32,
    /// Vertices after splitting at chart borders.
    pub vertices_after: u32,
}

/// `level` with an atlas: see the module page for what changes and what is promised. `unwrapper` is the first to be tried;
/// [`AtlasOptions::unwrapper`] says who follows when its result fails a check.
///
/// # Errors
/// Options out of range, no face with an area, or no layout that passes the checks.
pub fn unwrap(
    level: &Level,
    options: &AtlasOptions,
    unwrapper: &dyn Unwrapper,
) -> Result<(Level, UvLayout, AtlasReport), AtlasError> {
    options.validate()?;
    let surface = surface::Surface::of(&level.mesh, options);
    if surface.faces.is_empty() {
        return Err(AtlasError::Empty { faces: level.mesh.face_count(), degenerate: level.mesh.face_count() });
    }
    let mut failed = Vec::new();
    for rung in ladder(options.unwrapper, unwrapper) {
        let mut give_up = |reason: String, does_not_fit| {
            failed.push(FailedAttempt { unwrapper: rung.name().into(), reason, does_not_fit });
        };
        let charts = match rung.unwrap(&surface.input) {
            Ok(charts) => charts,
            Err(error) => {
                give_up(error.to_string(), matches!(error, UnwrapError::DoesNotFit { .. }));
                continue;
            }
        };
        let charts = match orient::orient(charts, &surface.input) {
            Ok(charts) => charts,
            Err(defect) => {
                give_up(defect.to_string(), false);
                continue;
            }
        };
        let mesh = wedges::split(&level.mesh, &surface, &charts, options.size);
        let mut layout = UvLayout { size: options.size, padding: options.padding, chart_count: 0, sheets: 1 };
        let measure = match check::check(&mesh, &layout) {
            Ok(measure) => measure,
            Err(defects) => {
                give_up(defects.iter().map(AtlasDefect::to_string).collect::<Vec<_>>().join(", "), false);
                continue;
            }
        };
        layout.chart_count = measure.charts;
        let report = AtlasReport {
            unwrapper: rung.name().into(),
            failed,
            charts: measure.charts,
            tiny_charts: measure.tiny_charts,
            coverage: measure.coverage,
            padding_measured: measure.padding,
            edge_measured: measure.edge,
            texels_per_unit: measure.texels_per_unit,
            stretch: measure.stretch,
            anisotropy: measure.anisotropy,
            degenerate_faces: (level.mesh.face_count() - surface.faces.len()) as u32,
            hard_edges: surface.hard_edges,
            vertices_before: level.mesh.vertex_count() as u32,
            vertices_after: mesh.vertex_count() as u32,
        };
        return Ok((Level { mesh, error: level.error, quadrics: level.quadrics.clone() }, layout, report));
    }
    Err(AtlasError::Failed { attempts: failed })
}

/// Who is tried, in order: `first`, then what the choice allows.
fn ladder(choice: UnwrapperChoice, first: &dyn Unwrapper) -> Vec<&dyn Unwrapper> {
    match choice {
        UnwrapperChoice::Auto => vec![first, &Uvunwrap::STRICT, &Planar],
        UnwrapperChoice::Uvunwrap => vec![first, &Uvunwrap::STRICT],
        UnwrapperChoice::Xatlas => vec![first],
    }
}

/// Names a face in a message.
fn face_list(faces: &[FaceId]) -> String {
    let shown: Vec<_> = faces.iter().take(3).map(|f| f.to_string()).collect();
    let more = if faces.len() > 3 { format!(" and {} more", faces.len() - 3) } else { String::new() };
    format!("{}{more}", shown.join(", "))
}
