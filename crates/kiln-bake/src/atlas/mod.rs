//! Atlas: a second UV layout for a low mesh, in which every texel belongs to one place of the surface.
//!
//! **In** a level (mesh, points, carried quadrics), size, number and padding of the sheets, a density factor for each submesh.
//! **Out** the same level with `atlas_uv`: triangles in the same order, points and quadrics untouched, positions and normals
//! untouched; vertices are split where charts split. All charts of a submesh lie on one square sheet of exactly the size that was
//! asked, none mirrored, none overlapping, at least `padding` empty texels between any two and `padding / 2` to the sheet's edge
//! ([`mips`] says what that is worth). Sheet `s` is `[s, s + 1] x [0, 1]`.
//!
//! ```text
//! sheet of each submesh <- the largest demand (area x factor^2) first, to the emptiest sheet
//! for each sheet:
//!     surface <- points at unit scale, once for each fan of faces; degenerate faces set aside; cuts along hard edges
//!     for each rung of the ladder:              uvunwrap, uvunwrap-strict, planar (or the one that was asked for)
//!         charts <- rung(surface)               one UV per corner in texels, one chart per face
//!         orient charts                         counter-clockwise in the picture (V points down in glTF)
//!         check(charts)                         unplaced, outside, mirrored, overlapping faces; padding
//!         take the first without a defect; fail with what each rung said
//! lay every sheet again at the density of the fullest one
//! mesh <- split wedges by (vertex, UV); check; return mesh, layout, report
//! ```
//!
//! Charts are grown over points, so a chart may cross the boundary of two submeshes that `merge` joined where both have one sheet
//! and one density: a seam less is a seam less. Wedges of the two submeshes stay apart as they were.
//!
//! **Density.** A submesh of factor `f` gets `f` times the texels per length that one of factor 1 gets, on whatever sheet it lies
//! (measured within 2 %). One sheet is filled as densely as it can be; of several, each is laid as densely as the fullest, and
//! where that cannot be done the report says so.
//!
//! `auto` never looks at a clock and never at what is installed: it steps down the ladder only when a check failed, so the
//! same input takes the same rung everywhere. `xatlas` is therefore used only where it was asked for. Whoever looks on
//! ([`Watch`]) may end a run, and then there is an error and no result.
//!
//! **Limits.** Charts too many for sheet and padding are an error that says so; a submesh is never spread over two sheets. Chart
//! shapes are as good as the unwrapper's; nothing straightens them for the eye.
//!
//! **Sources.** Charts by region growing, least-squares conformal maps (Lévy, Petitjean, Ray, Maillot, "Least squares
//! conformal maps for automatic texture atlas generation", SIGGRAPH 2002, DOI 10.1145/566570.566590) and as-rigid-as-possible
//! refinement (Liu, Zhang, Xu, Gotsman, Gortler, "A local/global approach to mesh parameterization", SGP 2008,
//! DOI 10.1111/j.1467-8659.2008.01290.x) are the crate `uvunwrap`'s. The stretch figure is that of Sander, Snyder, Gortler,
//! Hoppe, "Texture mapping progressive meshes", SIGGRAPH 2001, DOI 10.1145/383259.383307.

pub mod check;
mod error;
pub mod mips;
mod options;
mod orient;
mod planar;
mod report;
mod sheets;
mod surface;
#[cfg(test)]
mod tests;
mod uvunwrap;
mod watch;
pub(crate) mod wedges;
pub mod xatlas;

use glam::{Vec2, Vec3};
use kiln_asset::{FaceId, Level, Mesh, UvLayout};

pub use check::{AtlasDefect, Measure, check};
pub use error::{AtlasError, FailedAttempt, UnwrapError};
pub use options::{AtlasOptions, UnwrapperChoice};
pub use planar::Planar;
pub use report::{AtlasReport, SheetReport, SubmeshDensity};
pub use uvunwrap::Uvunwrap;
pub use watch::{Stop, Watch};

use check::UNSEEN;
use orient::signed_area;
use surface::Surface;

/// How much denser than the fullest sheet another may stay, unitless; laying it anew costs as much as the first time.
const EVEN: f64 = 1.01;

/// The surface as an unwrapper gets it: places, not wedges; only faces that can have a chart. A place is a point as one fan
/// of faces around it sees it, so that parts which only touch share none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnwrapInput {
    /// `[place_count]`, scaled to a bounding box of unit diagonal; no two are bitwise equal, so that unwrappers which weld by
    /// position cannot join what the mesh keeps apart.
    pub positions: Vec<Vec3>,
    /// `[face_count] x 3` indices into `positions`, winding as in the mesh.
    pub triangles: Vec<[u32; 3]>,
    /// `[face_count] x 3`: whether the edge from corner `k` to corner `k + 1` must be a chart's border (hard edges, and edges
    /// between groups).
    pub cuts: Vec<[bool; 3]>,
    /// `[face_count]`, below the number of `scales`: faces of different groups share no chart.
    pub groups: Vec<u32>,
    /// `[group_count]`, how many times the texels per length of factor 1 each group gets, unitless.
    pub scales: Vec<f32>,
    /// Texels per length of `positions` at factor 1; `None`: as many as fit.
    pub density: Option<f64>,
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

    /// The charts of `input`, a function of `input` alone: same bytes on any machine of a numeric class. `watch` is told how far
    /// it is, and asked between steps whether to end.
    ///
    /// # Errors
    /// No layout could be made, or `watch` said stop; the message says why.
    fn unwrap(&self, input: &UnwrapInput, watch: &Watch<'_>) -> Result<UnwrapOutput, UnwrapError>;
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
    unwrap_watched(level, options, unwrapper, &Watch::NOBODY)
}

/// [`unwrap`] with someone who looks on.
///
/// # Errors
/// Those of [`unwrap`], and [`AtlasError::Stopped`] where `watch` said so.
pub fn unwrap_watched(
    level: &Level,
    options: &AtlasOptions,
    unwrapper: &dyn Unwrapper,
    watch: &Watch<'_>,
) -> Result<(Level, UvLayout, AtlasReport), AtlasError> {
    let mesh = &level.mesh;
    options.validate(mesh.submeshes.len())?;
    let faces = surface::chartable(mesh);
    if faces.is_empty() {
        return Err(AtlasError::Empty { faces: mesh.face_count(), degenerate: mesh.face_count() });
    }
    let (sheet_of, count) = sheets::distribute(mesh, &faces, options);
    let ladder = ladder(options.unwrapper, unwrapper);
    let mut sheets = Vec::new();
    for sheet in 0..count {
        let here = |f: &FaceId| sheet_of[mesh.face_submesh[f.index()].index()] == sheet;
        let surface = Surface::of(mesh, options, faces.iter().copied().filter(here).collect());
        let share = |sheet: u32| 0.9 * sheet as f32 / count as f32;
        sheets.push(lay_sheet(mesh, surface, &ladder, &watch.part(share(sheet), share(sheet + 1)))?);
    }
    let uneven = make_even(mesh, &mut sheets, watch)?;
    let layout = UvLayout { size: options.size, padding: options.padding, chart_count: 0, sheets: count };
    report::finish(level, options, layout, sheets, &sheet_of, uneven)
}

/// A sheet with its charts.
struct Sheet<'a> {
    surface: Surface,
    charts: UnwrapOutput,
    measure: Measure,
    rung: &'a dyn Unwrapper,
    failed: Vec<FailedAttempt>,
}

/// The charts of the first rung whose result passes the checks.
fn lay_sheet<'a>(
    mesh: &Mesh,
    surface: Surface,
    ladder: &[&'a dyn Unwrapper],
    watch: &Watch<'_>,
) -> Result<Sheet<'a>, AtlasError> {
    let mut failed = Vec::new();
    for rung in ladder {
        match try_rung(mesh, &surface, *rung, watch)? {
            Ok((charts, measure)) => return Ok(Sheet { surface, charts, measure, rung: *rung, failed }),
            Err(attempt) => failed.push(attempt),
        }
    }
    Err(AtlasError::Failed { attempts: failed })
}

/// The charts of one rung and their measure, or why they are not taken.
fn try_rung(
    mesh: &Mesh,
    surface: &Surface,
    rung: &dyn Unwrapper,
    watch: &Watch<'_>,
) -> Result<Result<(UnwrapOutput, Measure), FailedAttempt>, AtlasError> {
    let give_up = |reason: String, does_not_fit| FailedAttempt { unwrapper: rung.name().into(), reason, does_not_fit };
    let stopped = |stop| AtlasError::Stopped { stop, unwrapper: rung.name().into() };
    let charts = match rung.unwrap(&surface.input, &watch.part(0.0, 0.9)) {
        Ok(charts) => charts,
        Err(UnwrapError::Stopped(stop)) => return Err(stopped(stop)),
        Err(error) => {
            return Ok(Err(give_up(error.to_string(), matches!(error, UnwrapError::DoesNotFit { .. }))));
        }
    };
    watch.go_on().map_err(stopped)?;
    watch.progress(0.9, "checking charts");
    let charts = match orient::orient(charts, &surface.input) {
        Ok(charts) => charts,
        Err(defect) => return Ok(Err(give_up(defect.to_string(), false))),
    };
    Ok(match check_charts(mesh, surface, &charts) {
        Ok(measure) => Ok((charts, measure)),
        Err(defects) => Err(give_up(list_defects(&defects), false)),
    })
}

/// Measures the charts of one sheet as if there were no other.
fn check_charts(mesh: &Mesh, surface: &Surface, charts: &UnwrapOutput) -> Result<Measure, Vec<AtlasDefect>> {
    let UnwrapInput { size, padding, .. } = surface.input;
    let mut sheets = vec![UNSEEN; mesh.face_count()];
    surface.faces.iter().for_each(|f| sheets[f.index()] = 0);
    let laid = wedges::split(mesh, &[(surface, charts)], &vec![0; mesh.submeshes.len()], size);
    check::check_on(&laid, &UvLayout { size, padding, chart_count: 0, sheets: 1 }, &sheets)
}

/// Lays every sheet that is denser than the fullest one again, as densely as that. The sheets, from 0, of which that could not be
/// done: they stay as they are.
fn make_even(mesh: &Mesh, sheets: &mut [Sheet<'_>], watch: &Watch<'_>) -> Result<Vec<u32>, AtlasError> {
    let densities: Vec<f64> = sheets.iter().map(|sheet| density(&sheet.surface, &sheet.charts)).collect();
    let least = densities.iter().copied().fold(f64::INFINITY, f64::min);
    let mut uneven = Vec::new();
    for (number, (sheet, density)) in sheets.iter_mut().zip(densities).enumerate() {
        if density <= least * EVEN {
            continue;
        }
        sheet.surface.input.density = Some(least);
        match try_rung(mesh, &sheet.surface, sheet.rung, &watch.part(0.9, 0.95))? {
            Ok((charts, measure)) => (sheet.charts, sheet.measure) = (charts, measure),
            Err(_) => uneven.push(number as u32),
        }
    }
    Ok(uneven)
}

/// Texels per length of the surface at factor 1.
fn density(surface: &Surface, charts: &UnwrapOutput) -> f64 {
    let UnwrapInput { positions, triangles, groups, scales, .. } = &surface.input;
    let (mut texels, mut area) = (0.0, 0.0);
    for ((triangle, corners), group) in triangles.iter().zip(&charts.corners).zip(groups) {
        let [a, b, c] = triangle.map(|p| positions[p as usize].as_dvec3());
        let scale = f64::from(scales[*group as usize]);
        texels += signed_area(corners.map(|uv| uv.as_dvec2())).abs();
        area += 0.5 * (b - a).cross(c - a).length() * scale * scale;
    }
    (texels / area).sqrt()
}

fn list_defects(defects: &[AtlasDefect]) -> String {
    defects.iter().map(AtlasDefect::to_string).collect::<Vec<_>>().join(", ")
}

/// Who is tried, in order: `first`, then what the choice allows.
fn ladder(choice: UnwrapperChoice, first: &dyn Unwrapper) -> Vec<&dyn Unwrapper> {
    match choice {
        UnwrapperChoice::Auto => vec![first, &Uvunwrap::STRICT, &Planar],
        UnwrapperChoice::Uvunwrap => vec![first, &Uvunwrap::STRICT],
        UnwrapperChoice::Xatlas | UnwrapperChoice::Planar => vec![first],
    }
}

/// Names a face in a message.
fn face_list(faces: &[FaceId]) -> String {
    let shown: Vec<_> = faces.iter().take(3).map(|f| f.to_string()).collect();
    let more = if faces.len() > 3 { format!(" and {} more", faces.len() - 3) } else { String::new() };
    format!("{}{more}", shown.join(", "))
}
