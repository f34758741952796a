//! Why an output would be built again, or that it would not.

use std::path::{Path, PathBuf};

use kiln_engine::Verdict;
use kiln_pipeline::plan::folder_of;
use serde::Serialize;

use super::part::stage_of;
use super::{Build, BuildError};

/// Why an output would be built again.
#[derive(Debug, Serialize)]
pub struct WhyOutcome {
    /// The output, relative to the pipeline's folder.
    pub output: String,
    /// Whether a build would do nothing for it.
    pub fresh: bool,
    /// Each stage's verdict in order: id, and `fresh`, a reason, or what it depends on.
    pub stages: Vec<WhyStage>,
}

/// One stage's verdict.
#[derive(Debug, Serialize)]
pub struct WhyStage {
    /// The stage's id, or `output` for the file itself.
    pub stage: String,
    /// `fresh`, `stale`, `depends` or `fails`.
    pub verdict: &'static str,
    /// The first field that differs, with old and new value, in words.
    pub text: Option<String>,
    /// The same for programs.
    pub reason: Option<kiln_engine::StaleReason>,
}

/// Why `output` would be built again by `build.pipeline`; `None` if that pipeline does not build it. Runs nothing.
///
/// # Errors
/// As for [`Build::run`].
pub fn why(build: &Build, output: &Path) -> Result<Option<WhyOutcome>, BuildError> {
    let planned = build.plan(None)?;
    let root = folder_of(&build.pipeline);
    let wanted = absolute(output);
    let Some(asset) = planned.assets.iter().find(|asset| absolute(&root.join(&asset.output)) == wanted) else {
        return Ok(None);
    };
    let (mut engine, _) = build.engine();
    let answer = engine.why(&planned.plan, asset.target)?;
    let verdict = |stage: String, verdict: &Verdict| match verdict {
        Verdict::Fresh => WhyStage { stage, verdict: "fresh", text: None, reason: None },
        Verdict::Stale(reason) => {
            WhyStage { stage, verdict: "stale", text: Some(reason.to_string()), reason: Some(reason.clone()) }
        }
        Verdict::DependsOn { on } => {
            let text = format!("depends on {}", stage_of(asset, *on));
            WhyStage { stage, verdict: "depends", text: Some(text), reason: None }
        }
        Verdict::Fails { message } => {
            WhyStage { stage, verdict: "fails", text: Some(format!("would fail: {message}")), reason: None }
        }
    };
    let mut stages: Vec<WhyStage> = Vec::new();
    for (index, what) in &answer.actions {
        stages.push(verdict(stage_of(asset, *index).to_owned(), what));
    }
    stages.push(verdict("output".into(), &answer.target));
    let fresh = stages.iter().all(|s| s.verdict == "fresh");
    Ok(Some(WhyOutcome { output: asset.output.clone(), fresh, stages }))
}

/// The path without `.` and `..`, from the root; its folder's links resolved where it exists.
fn absolute(path: &Path) -> PathBuf {
    let full = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let (folder, name) = (full.parent().map(Path::to_path_buf).unwrap_or_default(), full.file_name());
    match (folder.canonicalize(), name) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => full,
    }
}
