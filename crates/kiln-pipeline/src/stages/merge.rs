//! `merge`: submeshes into one mesh with shared points at their boundaries.

use kiln_asset::Mesh;
use kiln_engine::{Action, Source};
use kiln_lod::merge::{MergeOptions, merge};

use super::{StageError, json, params};
use crate::foreign;
use crate::language::StageSettings;
use crate::language::options;

/// Raised whenever the same input and parameters give other bytes.
pub(crate) const VERSION: u32 = 1;

/// Output: `mesh`.
pub(crate) fn action(id: String, label: String, options: &options::MergeOptions, mesh: Source) -> Action {
    let weld = options.weld;
    let mut action = Action::new(id, "merge", VERSION, move |context| {
        let mesh = Mesh::from_blob(&context.input("mesh")?).map_err(StageError::Blob)?;
        let options = MergeOptions { weld: weld.resolve(f64::from(mesh.diagonal())) };
        let (merged, report) = merge(&mesh, &options);
        Ok(kiln_engine::Outputs::new().with("mesh", merged.to_blob()).report(json(&report)))
    })
    .input("mesh", mesh);
    action.label = label;
    action.params = params(&StageSettings::Merge(options.clone()), &[]);
    action.foreign = vec![foreign::GLAM.into()];
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    action
}
