//! `kiln build`.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use kiln_engine::{ContentHash, Executor, Inconsistency, RemoteOptions, Verification};
use kiln_pipeline::plan::{PlanError, folder_of};

use super::args::BuildArgs;
use super::watch::{self, Once, Watched};
use super::{complain, data, diagnostics, farm, progress};
use crate::build::BuildError;
use crate::config::Config;
use crate::debug_images::StagePicture;
use crate::exit::Exit;
use crate::summary::{StageState, Summary, seconds};

/// How long a cancelled build may take to end by itself, and how long to finish a file.
pub(super) const PATIENCE: Duration = Duration::from_millis(700);

/// How long a cancelled build may take whose stages run elsewhere.
const FARM_PATIENCE: Duration = Duration::from_secs(30);

/// Builds every pipeline in turn; the gravest exit code wins.
pub(super) fn run(args: &BuildArgs) -> Exit {
    let mode = args.remote.remote_mode.map(Into::into);
    let settings = Config::load().and_then(|config| {
        let remote = config.remote(args.remote.remote.as_deref(), mode)?;
        Ok((remote, farm::executor(args, &config)?))
    });
    let (remote, executor) = match settings {
        Ok((remote, executor)) => (remote, executor),
        Err(error) => return complain(Exit::Usage, &error.to_string()),
    };
    // What runs on other machines is asked to end by its scheduler, which takes its time.
    let cancel = cancelled_by_signal(if executor.is_local() { PATIENCE } else { FARM_PATIENCE });
    let means = Means { remote, executor };
    if !args.watch {
        return all(args, &means, &cancel, None).exit;
    }
    let mut last = None;
    watch::run(&cancel, &mut || {
        let once = all(args, &means, &cancel, last);
        last = Some(once.exit);
        once
    })
}

/// What the configuration and the command line give a build beside the pipeline.
struct Means {
    remote: Option<RemoteOptions>,
    executor: Box<dyn Executor>,
}

/// A flag that Ctrl-C sets; after `patience` the process ends whatever runs.
pub(super) fn cancelled_by_signal(patience: Duration) -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    let on_signal = Arc::clone(&cancel);
    // A second Ctrl-C ends the process at once: killing kiln at any moment loses nothing.
    let handler = ctrlc::set_handler(move || {
        if on_signal.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("cancelling; what runs is asked to end");
        std::thread::spawn(move || end_soon(patience));
    });
    if let Err(error) = handler {
        eprintln!("warning: Ctrl-C will end the build at once: {error}");
    }
    cancel
}

/// Ends the process if the build does not end by itself: some stages take minutes and do not look up. Nothing of them is kept; files
/// that are just being written are finished first.
fn end_soon(patience: Duration) {
    std::thread::sleep(patience);
    kiln_engine::quiesce(PATIENCE);
    eprintln!("cancelled; what still ran was left");
    std::process::exit(Exit::Failed.code().into());
}

/// Builds every pipeline once; `last`: how the build before it ended, while watching.
fn all(args: &BuildArgs, means: &Means, cancel: &Arc<AtomicBool>, last: Option<Exit>) -> Once {
    let mut worst = Exit::Done;
    let mut reports = Vec::new();
    let mut depfile = String::new();
    let mut watched = Watched::default();
    let mut all_known = true;
    // A remote that is asked for by name is what is to be verified; one of the configuration is not.
    let checks_remote = args.verify && args.remote.remote.is_some() && means.remote.is_some();
    for pipeline in &args.pipelines {
        let mut build = args.plan.build(pipeline);
        build.jobs = args.jobs;
        build.keep_going = args.keep_going;
        build.dry_run = args.dry_run;
        build.remote = means.remote.clone();
        build.check_claims = checks_remote;
        build.assets.clone_from(&args.part.assets);
        build.with.clone_from(&args.part.with);
        build.debug_pictures = args.debug_images.is_some();
        build.brief = !args.json;
        build.dependencies = args.depfile.is_some() || args.watch;
        build.cancel = Arc::clone(cancel);
        let progress = progress::Progress::new(args.explain);
        if args.verify && !checks_remote {
            let result = build.verify(&progress);
            progress.finish();
            worst = worst.max(result.map_or_else(|error| failed(&error), |found| show_verified(pipeline, &found)));
            continue;
        }
        let result = build.run_on(&*means.executor, &progress);
        progress.finish();
        let exit = match result {
            Ok(outcome) => {
                diagnostics::show(&outcome.diagnostics, &outcome.sources);
                let mut exit = outcome.summary.exit(args.deny.is_some());
                if outcome.cancelled {
                    exit = Exit::Failed;
                }
                // What is fresh still needs no word; what is fresh again does.
                let still = last.is_some_and(|last| last < Exit::Failed);
                if !(still && outcome.summary.fresh) {
                    show(&outcome.summary, args.dry_run);
                    if checks_remote {
                        show_checked(&outcome.summary);
                    }
                }
                if let Some(dependencies) = &outcome.dependencies {
                    if args.depfile.is_some() {
                        depfile.push_str(&crate::depfile(dependencies, &folder_of(pipeline)));
                    }
                    if args.watch {
                        watched.add(dependencies, &folder_of(pipeline));
                    }
                } else {
                    all_known = false;
                }
                if let Some(folder) = &args.debug_images {
                    exit = exit.max(write_pictures(folder, &outcome.pictures));
                }
                reports.push(outcome.summary);
                exit
            }
            Err(error) => {
                all_known = false;
                failed(&error)
            }
        };
        worst = worst.max(exit);
        if worst >= Exit::Failed && !args.keep_going {
            all_known = false;
            break;
        }
    }
    if let Some(path) = &args.depfile
        && !depfile.is_empty()
        && let Err(exit) = super::write_if_new(path, depfile.as_bytes())
    {
        worst = worst.max(exit);
    }
    if args.json && (!args.verify || checks_remote) {
        let report = match reports.as_slice() {
            [one] => serde_json::to_string_pretty(one),
            all => serde_json::to_string_pretty(all),
        };
        worst = worst.max(data(&report.expect("invariant: a summary is plain data")));
    }
    for pipeline in args.pipelines.iter().filter(|_| args.watch) {
        watched.add_pipeline(pipeline, &folder_of(pipeline));
    }
    Once { exit: worst, watched: (all_known || last.is_none()).then_some(watched) }
}

/// Says whether every stage gave the same bytes.
fn show_verified(pipeline: &Path, found: &Verification) -> Exit {
    for (label, error) in &found.failed {
        eprintln!("error: {label}: {error}");
    }
    for Inconsistency { label, output, first, other, cached } in &found.inconsistent {
        let shown = |hash: &Option<ContentHash>| hash.map_or_else(|| "none".into(), |hash| hash.short());
        let (first, other) = (shown(first), shown(other));
        let whence = if *cached { "the cache has" } else { "the second run gave" };
        eprintln!("error: {label}: output `{output}` is {first}, {whence} {other}, for the same inputs");
        if *cached {
            eprintln!("  either the stage depends on more than its fingerprint covers, or its version was not raised");
        }
    }
    let sound = found.failed.is_empty() && found.inconsistent.is_empty() && !found.cancelled;
    let (compared, guilty) = (found.compared, found.inconsistent.len());
    eprintln!("{}: {compared} stages ran twice, {guilty} of them gave other bytes", pipeline.display());
    if sound { Exit::Done } else { Exit::Failed }
}

/// Says how much of what the remote gave was recomputed.
fn show_checked(summary: &Summary) {
    let remote = summary.remote.clone().unwrap_or_default();
    let (hits, checked, refuted) = (remote.hits, remote.checked, remote.refuted);
    eprintln!(
        "{}: {checked} of {hits} records of the remote were recomputed, {refuted} of them lied",
        summary.pipeline
    );
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
    let usage = matches!(error, BuildError::Remote(_) | BuildError::NoAsset { .. } | BuildError::NoStage { .. });
    let exit = if usage { Exit::Usage } else { Exit::Failed };
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
    let listed: usize = summary.assets.iter().map(|asset| asset.stages.len()).sum();
    let stages = listed + summary.untouched.stages;
    if summary.fresh {
        let assets = summary.assets.len() + summary.untouched.assets;
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
