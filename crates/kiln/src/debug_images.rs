//! Debug pictures of a build: textures with their borders and the edges that cross them, textures with their regions, and what the
//! views of a metric see.
//!
//! They are computed from the inputs of the stages as the cache holds them, after the build, whether a stage ran or was fresh: no
//! fingerprint, record or output knows of them.

use std::sync::Arc;

use kiln_engine::{BuildReport, Engine, Source};
use kiln_pipeline::plan::Planned;
use kiln_pipeline::stages::DebugPicture;

/// One picture of one stage of one asset.
#[derive(Clone, Debug)]
pub struct StagePicture {
    /// The asset's container, relative to the pipeline's folder.
    pub output: String,
    /// The stage's id.
    pub stage: String,
    /// The picture.
    pub picture: DebugPicture,
}

impl StagePicture {
    /// A file name of its own: container, stage, number, texture and map.
    pub fn file_name(&self) -> String {
        let output: String = self.output.strip_suffix(".kiln").unwrap_or(&self.output).replace(['/', '\\', ':'], "_");
        format!("{}.{}.{}.png", output.trim_start_matches(['.', '_']), self.stage, self.picture.name)
    }
}

/// The pictures of all stages that can be shown, and in words what could not be had.
pub(crate) fn debug_pictures(
    engine: &Engine,
    planned: &Planned,
    report: &BuildReport,
) -> (Vec<StagePicture>, Vec<String>) {
    let output = |action: usize, name: &str| -> Option<Arc<[u8]>> {
        engine.blob(&report.actions.get(action)?.record.as_ref()?.output(name)?.hash)
    };
    let (mut pictures, mut missing) = (Vec::new(), Vec::new());
    for asset in &planned.assets {
        for view in &asset.debug_views {
            let source = |name: &str| {
                let inputs = &planned.plan.actions[view.action].inputs;
                inputs.iter().find(|input| input.name == name).map(|input| &input.source)
            };
            let input = |name: &str| match source(name)? {
                Source::Output { action, output: of } => output(*action, of),
                _ => None,
            };
            let images = match source("images") {
                Some(Source::Outputs { action, prefix }) => {
                    (0..).map_while(|index| output(*action, &format!("{prefix}{index}"))).collect()
                }
                _ => Vec::new(),
            };
            let place = format!("{}, stage {}", asset.input, view.stage);
            let materials = if view.reads_materials() { input("materials") } else { Some(Arc::from([].as_slice())) };
            let (Some(mesh), Some(materials)) = (input("in"), materials) else {
                missing.push(format!("{place}: no debug pictures, the cache has not what they are made from"));
                continue;
            };
            match view.pictures(&mesh, &materials, &images) {
                Ok(drawn) => pictures.extend(drawn.into_iter().map(|picture| StagePicture {
                    output: asset.output.clone(),
                    stage: view.stage.clone(),
                    picture,
                })),
                Err(error) => missing.push(format!("{place}: no debug pictures: {error}")),
            }
        }
    }
    (pictures, missing)
}
