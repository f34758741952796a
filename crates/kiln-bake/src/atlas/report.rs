//! What an atlas came to, and what of it whoever asked should hear.

use kiln_asset::{Level, UvLayout};
use serde::{Deserialize, Serialize};

use super::error::list_attempts;
use super::mips::Fetch;
use super::{AtlasError, AtlasOptions, FailedAttempt, Sheet, check, list_defects, wedges};

/// What the atlas came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AtlasReport {
    /// The unwrapper whose layout was taken; of several sheets, the lowest rung that one of them took.
    pub unwrapper: String,
    /// Those that were tried in vain, sheet by sheet.
    pub failed: Vec<FailedAttempt>,
    /// Number of charts.
    pub charts: u32,
    /// Charts of less than one texel's area: whatever lies there gets one colour.
    pub tiny_charts: u32,
    /// Share of the sheets' area inside charts, `[0, 1]`.
    pub coverage: f64,
    /// Least empty space found between two charts, texels; `None`: there is one chart only.
    pub padding_measured: Option<u32>,
    /// Least empty space found between a chart and the sheet's edge, texels.
    pub edge_measured: u32,
    /// Texels a unit of length gets, `sqrt(texel area / surface area)` over all charts; texels per object unit.
    pub texels_per_unit: f64,
    /// Mean texture stretch (Sander et al. 2001, eq. 2, L2), unitless: 1 is an isometry up to the mean scale. Density factors
    /// count as stretch.
    pub stretch: f64,
    /// Mean over the area of longest by shortest extent of a surface circle in texels, unitless: 1 is conformal.
    pub anisotropy: f64,
    /// Faces without area: each got one UV, at a neighbour's corner where there is one.
    pub degenerate_faces: u32,
    /// Hard edges that were made chart borders.
    pub hard_edges: u32,
    /// Coarsest mip level of which every texel is clean at the padding that was asked ([`mips`](super::mips)).
    pub clean_mip: Option<u32>,
    /// Coarsest mip level at which every bilinear fetch is.
    pub clean_mip_bilinear: Option<u32>,
    /// Each sheet, where there are several.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sheets: Vec<SheetReport>,
    /// Sheets, from 0, that stayed denser than the fullest one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub uneven: Vec<u32>,
    /// Submeshes with a density factor other than 1.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub densities: Vec<SubmeshDensity>,
    /// Vertices before.
    pub vertices_before: u32,
    /// Vertices after splitting at chart borders.
    pub vertices_after: u32,
}

/// One sheet of several.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SheetReport {
    /// The unwrapper whose layout was taken.
    pub unwrapper: String,
    /// Those that were tried before it.
    pub failed: Vec<FailedAttempt>,
    /// Number of submeshes on it.
    pub submeshes: u32,
    /// Number of charts.
    pub charts: u32,
    /// Share of the sheet's area inside charts, `[0, 1]`.
    pub coverage: f64,
    /// Texels per object unit over all its charts.
    pub texels_per_unit: f64,
}

/// What a density factor came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SubmeshDensity {
    /// Name of the submesh.
    pub submesh: String,
    /// What was asked.
    pub factor: f32,
    /// Texels per object unit that it got; 0 if no face of it has an area.
    pub texels_per_unit: f64,
}

impl AtlasReport {
    /// What should be heard, in sentences: rungs that failed and why, and sheets of another density.
    pub fn warnings(&self) -> Vec<String> {
        let fell = |place: &str, unwrapper: &str, failed: &[FailedAttempt]| {
            let why = list_attempts(failed);
            (!failed.is_empty()).then(|| format!("{place}charts are by {unwrapper}, since others failed ({why})"))
        };
        let mut warnings: Vec<String> = match &self.sheets[..] {
            [] => fell("", &self.unwrapper, &self.failed).into_iter().collect(),
            sheets => {
                let of =
                    |(i, sheet): (usize, &SheetReport)| fell(&format!("sheet {i}: "), &sheet.unwrapper, &sheet.failed);
                sheets.iter().enumerate().filter_map(of).collect()
            }
        };
        let uneven = |sheet: &u32| {
            let got = self.sheets.get(*sheet as usize).map_or(0.0, |s| s.texels_per_unit);
            format!("sheet {sheet} could not be laid as coarsely as the others: it has {got:.1} texels per unit")
        };
        warnings.extend(self.uneven.iter().map(uneven));
        warnings
    }
}

/// The level with all sheets side by side, checked as a whole, and what it came to. `sheet_of`: `[submesh_count]`.
pub(super) fn finish(
    level: &Level,
    options: &AtlasOptions,
    mut layout: UvLayout,
    sheets: Vec<Sheet<'_>>,
    sheet_of: &[u32],
    uneven: Vec<u32>,
) -> Result<(Level, UvLayout, AtlasReport), AtlasError> {
    let old = &level.mesh;
    let laid: Vec<_> = sheets.iter().map(|sheet| (&sheet.surface, &sheet.charts)).collect();
    let mesh = wedges::split(old, &laid, sheet_of, layout.size);
    let rungs = || sheets.iter().map(|sheet| sheet.rung.name().to_owned());
    let measure = match &sheets[..] {
        [one] => one.measure.clone(),
        _ => check(&mesh, &layout).map_err(|defects| AtlasError::Failed {
            attempts: vec![FailedAttempt {
                unwrapper: rungs().collect::<Vec<_>>().join(", "),
                reason: list_defects(&defects),
                does_not_fit: false,
            }],
        })?,
    };
    layout.chart_count = measure.charts;
    let failed: Vec<FailedAttempt> = sheets.iter().flat_map(|sheet| sheet.failed.clone()).collect();
    let lowest = sheets.iter().max_by_key(|sheet| sheet.failed.len()).map(|sheet| sheet.rung.name().to_owned());
    let charted: usize = sheets.iter().map(|sheet| sheet.surface.faces.len()).sum();
    let sheet_report = |(number, sheet): (usize, &Sheet<'_>)| SheetReport {
        unwrapper: sheet.rung.name().into(),
        failed: sheet.failed.clone(),
        submeshes: sheet_of.iter().filter(|s| **s as usize == number).count() as u32,
        charts: sheet.measure.charts,
        coverage: sheet.measure.coverage,
        texels_per_unit: sheet.measure.texels_per_unit,
    };
    let density = |(i, factor): (usize, &f32)| SubmeshDensity {
        submesh: old.submeshes[i].name.clone(),
        factor: *factor,
        texels_per_unit: measure.of_submesh[i],
    };
    let report = AtlasReport {
        unwrapper: lowest.unwrap_or_default(),
        failed,
        charts: measure.charts,
        tiny_charts: measure.tiny_charts,
        coverage: measure.coverage,
        padding_measured: measure.padding,
        edge_measured: measure.edge,
        texels_per_unit: measure.texels_per_unit,
        stretch: measure.stretch,
        anisotropy: measure.anisotropy,
        degenerate_faces: (old.face_count() - charted) as u32,
        hard_edges: sheets.iter().map(|sheet| sheet.surface.hard_edges).sum(),
        clean_mip: Fetch::Texel.coarsest_clean(layout.padding),
        clean_mip_bilinear: Fetch::Bilinear.coarsest_clean(layout.padding),
        sheets: if sheets.len() > 1 { sheets.iter().enumerate().map(sheet_report).collect() } else { Vec::new() },
        uneven,
        densities: options.densities.iter().enumerate().filter(|(_, f)| **f != 1.0).map(density).collect(),
        vertices_before: old.vertex_count() as u32,
        vertices_after: mesh.vertex_count() as u32,
    };
    Ok((Level { mesh, error: level.error, quadrics: level.quadrics.clone() }, layout, report))
}
