//! `merge`: submeshes into one mesh with shared points at their boundaries.

use kiln_asset::Mesh;
use kiln_engine::{Action, Source};
use kiln_lod::merge::{MergeOptions, MergeReport, Repair, Survey, merge, survey};
use serde::Serialize;

use super::{StageError, json, params};
use crate::foreign;
use crate::language::StageSettings;
use crate::language::options::{self, MergeRepair};

/// Raised whenever the same input and parameters give other bytes.
pub(crate) const VERSION: u32 = 2;

/// Output: `mesh`.
pub(crate) fn action(id: String, label: String, options: &options::MergeOptions, mesh: Source) -> Action {
    let settings = options.clone();
    let mut action = Action::new(id, "merge", VERSION, move |context| {
        let mesh = Mesh::from_blob(&context.input("mesh")?).map_err(StageError::Blob)?;
        let (merged, report) = merge(&mesh, &resolved(&settings, &mesh));
        Ok(kiln_engine::Outputs::new().with("mesh", merged.to_blob()).report(json(&Report::of(&report, &merged))))
    })
    .input("mesh", mesh);
    action.label = label;
    action.params = params(&StageSettings::Merge(options.clone()), &[]);
    action.foreign = vec![foreign::GLAM.into()];
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    action
}

fn resolved(options: &options::MergeOptions, mesh: &Mesh) -> MergeOptions {
    let asked = |repair| options.repair.0.contains(&repair);
    MergeOptions {
        weld: options.weld.resolve(f64::from(mesh.diagonal())),
        duplicate_faces: asked(MergeRepair::DuplicateFaces),
        zero_normals: asked(MergeRepair::ZeroNormals),
        winding: asked(MergeRepair::Winding),
    }
}

/// The stage's report: counts, and what the build's summary shows as soft trouble.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Triangles that are left.
    pub triangles: u32,
    /// Edges with exactly one face within their own submesh, before joining.
    pub border_edges: u32,
    /// Of them, how many now lie on a boundary.
    pub joined_edges: u32,
    /// How many points fewer than before for the joining.
    pub joined_points: u32,
    /// What was repaired.
    pub repairs: Vec<Repaired>,
    /// What should have been and could not.
    pub warnings: Vec<String>,
}

/// A repair in words.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Repaired {
    /// Kind, count and first place.
    #[serde(flatten)]
    pub repair: Repair,
    /// What was done.
    pub sentence: &'static str,
}

impl Report {
    fn of(report: &MergeReport, merged: &Mesh) -> Report {
        let repairs = report.repairs.iter();
        let unorientable = report.unorientable.len();
        let warnings = report.unorientable.first().map(|first| {
            format!("patches that cannot be wound consistently: left as they are ({unorientable} times, first {first})")
        });
        Report {
            triangles: merged.face_count() as u32,
            border_edges: report.border_edges,
            joined_edges: report.joined_edges,
            joined_points: report.joined_points,
            repairs: repairs.map(|r| Repaired { repair: r.clone(), sentence: r.kind.sentence() }).collect(),
            warnings: warnings.into_iter().collect(),
        }
    }
}

/// What a merge stage with default options would do to `mesh`, and what the merged mesh is like.
pub fn preview(mesh: &Mesh) -> (Report, Survey) {
    let (merged, report) = merge(mesh, &resolved(&options::MergeOptions::default(), mesh));
    (Report::of(&report, &merged), survey(&merged))
}
