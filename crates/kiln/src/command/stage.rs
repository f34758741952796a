//! `kiln stage`: the kinds of stages; `kiln stage run`: one stage of one asset.

use kiln_engine::RemoteOptions;

use super::args::StageRunArgs;
use super::{build, complain, data, progress, write_if_new};
use crate::config::Config;
use crate::exit::Exit;
use crate::stage::{self, StageOutcome, StageRun};
use crate::summary::{StageState, seconds};

/// Prints the reference of stage kinds and their keys.
pub(super) fn kinds(kind: Option<&str>) -> Exit {
    use kiln_pipeline::language::reference;
    match kind {
        None => data(&reference::reference()),
        Some(kind) => match reference::help(kind) {
            Some(text) => data(&text),
            None => complain(Exit::Usage, &format!("there is no stage kind `{kind}`; `kiln stage` lists them")),
        },
    }
}

/// Runs one stage. A budget missed is no failure here: it is in the stage's report, and the final build says so.
pub(super) fn run(args: &StageRunArgs) -> Exit {
    let remote = match remote(args) {
        Ok(remote) => remote,
        Err(exit) => return exit,
    };
    let mut build = args.plan.build(&args.pipeline);
    build.assets = args.asset.iter().cloned().collect();
    build.with.clone_from(&args.with);
    build.jobs = args.jobs;
    build.remote = remote;
    build.cancel = build::cancelled_by_signal(super::build::PATIENCE);
    if args.fragment.is_some() {
        build.cache.clone_from(&args.fragment);
    }
    let run = StageRun {
        build,
        stage: args.stage.clone(),
        only: args.only,
        fragment: args.fragment.is_some(),
        expect: args.expect.clone(),
    };
    let progress = progress::Progress::new(false);
    let result = run.run(&progress);
    progress.finish();
    match result {
        Ok(outcome) => {
            show(&outcome).and_then(|()| leave(args, &run, &outcome)).map_or_else(|exit| exit, |()| Exit::Done)
        }
        Err(error) => build::failed(&error),
    }
}

/// The remote, if one is named on the command line: a hermetic command has no other network.
fn remote(args: &StageRunArgs) -> Result<Option<RemoteOptions>, Exit> {
    let Some(url) = &args.remote else { return Ok(None) };
    let mode = args.remote_mode.map_or(kiln_engine::RemoteMode::Read, Into::into);
    let remote = Config::load().and_then(|config| config.remote(Some(url), Some(mode)));
    remote.map_err(|error| complain(Exit::Usage, &error.to_string()))
}

fn show(outcome: &StageOutcome) -> Result<(), Exit> {
    for warning in &outcome.warnings {
        eprintln!("warning: {warning}");
    }
    for error in &outcome.errors {
        eprintln!("error: {error}");
    }
    let label = &outcome.label;
    if !outcome.succeeded() {
        let what = if outcome.cancelled { "cancelled" } else { "failed" };
        return Err(complain(Exit::Failed, &format!("{label}: {what}")));
    }
    let before = match outcome.before {
        0 => String::new(),
        count => format!(", and {count} stages before it"),
    };
    match (outcome.state, &outcome.reason) {
        (StageState::Ran, Some(reason)) => {
            eprintln!("{label}: ran in {}: {reason}{before}", seconds(outcome.seconds.unwrap_or(0.0)));
        }
        _ => eprintln!("{label}: fresh{before}"),
    }
    Ok(())
}

/// Writes receipt and depfile, the receipt last: it says that all is there.
fn leave(args: &StageRunArgs, run: &StageRun, outcome: &StageOutcome) -> Result<(), Exit> {
    let Some(receipt) = &args.receipt else { return Ok(()) };
    if let Some(depfile) = &args.depfile {
        write_if_new(depfile, outcome.depfile(receipt, &stage::root(run)).as_bytes())?;
    }
    write_if_new(receipt, outcome.receipt().as_bytes())
}
