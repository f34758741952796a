//! `kiln why`.

use std::path::{Path, PathBuf};

use super::args::WhyArgs;
use super::{build, complain, data};
use crate::build::{WhyOutcome, why};
use crate::exit::Exit;

/// Says why an output would be built again: exit 0 either way, since knowing is what was asked.
pub(super) fn run(args: &WhyArgs) -> Exit {
    let candidates = match &args.pipeline {
        Some(pipeline) => vec![pipeline.clone()],
        None => pipelines_near(&args.output),
    };
    let mut broken = Vec::new();
    for pipeline in &candidates {
        match why(&args.plan.build(pipeline), &args.output) {
            Ok(Some(outcome)) => return show(&outcome, pipeline, args.json),
            Ok(None) => {}
            Err(error) if args.pipeline.is_some() => return build::failed(&error),
            // A pipeline that was only guessed may be broken and still not be the one.
            Err(error) => broken.push(error),
        }
    }
    for error in &broken {
        build::failed(error);
    }
    let help = match (args.pipeline.is_some(), broken.len()) {
        (true, _) => "that pipeline does not build it".to_owned(),
        (false, 0) => format!("none of {} pipelines near it builds it; name one with --pipeline", candidates.len()),
        (false, _) => "what is broken above may be the one that builds it; else name one with --pipeline".to_owned(),
    };
    complain(Exit::Failed, &format!("no pipeline for {}: {help}", args.output.display()))
}

/// TOML files in the folders above the output that have a cache.
fn pipelines_near(output: &Path) -> Vec<PathBuf> {
    let full = std::path::absolute(output).unwrap_or_else(|_| output.to_path_buf());
    let mut found = Vec::new();
    for folder in full.ancestors().skip(1).filter(|folder| folder.join(".kiln").is_dir()) {
        let files = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut pipelines: Vec<PathBuf> = files.filter(|p| p.extension().is_some_and(|e| e == "toml")).collect();
        pipelines.sort();
        found.extend(pipelines);
    }
    found
}

fn show(outcome: &WhyOutcome, pipeline: &Path, json: bool) -> Exit {
    if json {
        return data(&serde_json::to_string_pretty(outcome).expect("invariant: an outcome is plain data"));
    }
    let mut text = if outcome.fresh {
        format!("{} is fresh: {} would run nothing\n", outcome.output, pipeline.display())
    } else {
        format!("{} would be built again by {}:\n", outcome.output, pipeline.display())
    };
    let width = outcome.stages.iter().map(|s| s.stage.chars().count()).max().unwrap_or(0);
    for stage in &outcome.stages {
        let said = stage.text.as_deref().unwrap_or(stage.verdict);
        text.push_str(&format!("  {:width$}  {said}\n", stage.stage));
    }
    data(&text)
}
