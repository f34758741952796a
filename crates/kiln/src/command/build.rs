//! `kiln build`.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use kiln_pipeline::plan::PlanError;

use super::args::BuildArgs;
use super::{complain, data, diagnostics, progress};
use crate::build::BuildError;
use crate::config::Config;
use crate::debug_images::StagePicture;
use crate::exit::Exit;
use crate::summary::{StageState, Summary, seconds};

/// Builds every pipeline in turn; the gravest exit code wins.
pub(super) fn run(args: &BuildArgs) -> Exit {
    let cancel = Arc::new(AtomicBool::new(false));
    let on_signal = Arc::clone(&cancel);
    // A second Ctrl-C ends the process at once: killing kiln at any moment loses nothing.
    let handler = ctrlc::set_handler(move || {
        if on_signal.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("cancelling; what runs is asked to end");
    });
    if let Err(error) = handler {
        eprintln!("warning: Ctrl-C will end the build at once: {error}");
    }
    let mode = args.remote_mode.map(Into::into);
    let remote = match Config::load().and_then(|config| config.remote(args.remote.as_deref(), mode)) {
        Ok(remote) => remote,
        Err(error) => return complain(Exit::Usage, &error.to_string()),
    };
    let mut worst = Exit::Done;
    let mut reports = Vec::new();
    for pipeline in &args.pipelines {
        let mut build = args.plan.build(pipeline);
        build.jobs = args.jobs;
        build.keep_going = args.keep_going;
        build.dry_run = args.dry_run;
        build.remote = remote.clone();
        build.debug_pictures = args.debug_images.is_some();
        build.cancel = Arc::clone(&cancel);
        let progress = progress::Progress::new(args.explain);
        let result = build.run(&progress);
        progress.finish();
        let exit = match result {
            Ok(outcome) => {
                diagnostics::show(&outcome.diagnostics, &outcome.sources);
                let mut exit = outcome.summary.exit(args.deny.is_some());
                if outcome.cancelled {
                    exit = Exit::Failed;
                }
                show(&outcome.summary, args.dry_run);
                if let Some(folder) = &args.debug_images {
                    exit = exit.max(write_pictures(folder, &outcome.pictures));
                }
                reports.push(outcome.summary);
                exit
            }
            Err(error) => failed(&error),
        };
        worst = worst.max(exit);
        if worst >= Exit::Failed && !args.keep_going {
            break;
        }
    }
    if args.json {
        let report = match reports.as_slice() {
            [one] => serde_json::to_string_pretty(one),
            all => serde_json::to_string_pretty(all),
        };
        worst = worst.max(data(&report.expect("invariant: a summary is plain data")));
    }
    worst
}

/// Writes debug pictures as PNG and says what each shows.
fn write_pictures(folder: &Path, pictures: &[StagePicture]) -> Exit {
    for one in pictures {
        let path = folder.join(one.file_name());
        let written = kiln_measure::encode_png(&one.picture.picture)
            .map_err(|e| e.to_string())
            .and_then(|png| fs::create_dir_all(folder).and_then(|()| fs::write(&path, png)).map_err(|e| e.to_string()));
        if let Err(message) = written {
            return complain(Exit::Failed, &format!("{}: {message}", path.display()));
        }
        eprintln!("{}: {}", path.display(), one.picture.caption);
    }
    Exit::Done
}

/// Prints why there was no build.
pub(super) fn failed(error: &BuildError) -> Exit {
    if let BuildError::Plan(plan) = error
        && let PlanError::Pipeline { diagnostics: list, sources } = plan
    {
        diagnostics::show(list, sources);
        return if plan.is_usage() { Exit::Usage } else { Exit::Failed };
    }
    let exit = if matches!(error, BuildError::Remote(_)) { Exit::Usage } else { Exit::Failed };
    complain(exit, &error.to_string())
}

fn show(summary: &Summary, dry_run: bool) {
    for error in &summary.errors {
        eprintln!("error: {error}");
    }
    for warning in &summary.warnings {
        eprintln!("warning: {warning}");
    }
    for short in &summary.short {
        eprintln!("short: {short}");
    }
    let stages: usize = summary.assets.iter().map(|asset| asset.stages.len()).sum();
    if summary.fresh {
        let assets = summary.assets.len();
        let what = if dry_run { "nothing would run" } else { "nothing to do" };
        eprintln!(
            "{}: {what}, {assets} assets and {stages} stages are fresh ({})",
            summary.pipeline,
            seconds(summary.seconds)
        );
        return;
    }
    eprint!("{}", summary.table());
    let count = |state| summary.assets.iter().flat_map(|a| &a.stages).filter(|s| s.state == state).count();
    let (ran, would) = (count(StageState::Ran), count(StageState::WouldRun) + count(StageState::Depends));
    let verb =
        if dry_run { format!("{would} of {stages} stages may run") } else { format!("{ran} of {stages} stages ran") };
    eprintln!("{}: {verb} ({})", summary.pipeline, seconds(summary.seconds));
}
