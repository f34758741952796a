//! Stages on other machines: what is stale becomes tasks, an executor runs them as `kiln stage run`, the ordinary build finds
//! their records. See `kiln_engine`'s `executor`.

use std::ffi::OsString;
use std::path::PathBuf;

use kiln_engine::{
    BuildOptions, Class, Engine, Event, Executor, ExecutorError, IoError, NoObserver, Observer, RemoteMode, Work,
    settle, tasks,
};
use kiln_pipeline::plan::Planned;
use kiln_pipeline::stages::Backend;

use crate::build::{Build, BuildError};
use crate::stage::stage_name;

/// Digits of a digest on a command line.
pub(crate) const DIGITS: usize = 16;

/// Runs what is stale elsewhere; what failed there fails in `planned` with its log.
pub(crate) fn execute(
    build: &Build,
    executor: &dyn Executor,
    engine: &mut Engine,
    planned: &mut Planned,
    observer: &dyn Observer,
) -> Result<(), BuildError> {
    let dry = BuildOptions { dry_run: true, ..build.options() };
    let report = engine.build(&planned.plan, &dry, &NoObserver)?;
    let mut tasks = tasks(&planned.plan, &report);
    if tasks.is_empty() {
        return Ok(());
    }
    let mut asset_of = vec![None; planned.plan.actions.len()];
    for asset in &planned.assets {
        for (action, _) in &asset.actions {
            asset_of[*action] = Some(asset.input.as_str());
        }
    }
    for task in &mut tasks {
        let action = &planned.plan.actions[task.action];
        let asset = asset_of[task.action].unwrap_or_default();
        let expect = action.declares().hex()[..DIGITS].to_owned();
        task.arguments =
            ["--asset", asset, "--stage", stage_name(action), "--expect", &expect].map(OsString::from).to_vec();
    }
    let folder = std::env::current_dir().map_err(system("find", "the current folder"))?;
    let program = std::env::current_exe().map_err(system("find", "kiln itself"))?;
    let cache = folder.join(build.cache_folder());
    // `auto` may mean something else on another machine.
    let gpu = planned.plan.actions.iter().any(|action| action.device_class.is_some());
    let backend = if gpu { Backend::Gpu } else { Backend::Cpu };
    let mut command = vec![program.into_os_string(), "stage".into(), "run".into()];
    command.extend(common(&Build { backend, cache: Some(cache.clone()), ..build.clone() }));
    command.push("--only".into());
    let progress = |progress: &kiln_engine::Progress| observer.event(&Event::Elsewhere(progress));
    let work = Work {
        command: &command,
        folder: &folder,
        cache: &cache,
        tasks: &tasks,
        cancel: &build.cancel,
        progress: &progress,
    };
    let executed = engine.during(|| executor.execute(&work))??;
    settle(&mut planned.plan, &tasks, &executed);
    Ok(())
}

fn system(doing: &'static str, what: &'static str) -> impl FnOnce(std::io::Error) -> ExecutorError {
    move |source| IoError { doing, path: PathBuf::from(what), source }.into()
}

/// What `kiln stage run` and `kiln build` are told of a build, whatever the asset.
pub(crate) fn common(build: &Build) -> Vec<OsString> {
    let mut arguments = vec![build.pipeline.clone().into_os_string()];
    let mut push = |flag: &str, value: OsString| arguments.extend([OsString::from(flag), value]);
    for set in &build.sets {
        push("--set", set.into());
    }
    match build.backend {
        Backend::Auto => {}
        Backend::Gpu => push("--backend", "gpu".into()),
        Backend::Cpu => push("--backend", "cpu".into()),
    }
    if let Some(cache) = &build.cache {
        push("--cache", cache.into());
    }
    for folder in &build.with {
        push("--with", folder.into());
    }
    // The rest of its settings each node finds in the user's configuration.
    if let Some(remote) = &build.remote {
        push("--remote", remote.url.clone().into());
        push("--remote-mode", if remote.mode == RemoteMode::Write { "write" } else { "read" }.into());
    }
    arguments
}

/// The class's name, for graphs.
pub(crate) fn class(action: &kiln_engine::Action) -> Class {
    if action.device_class.is_some() { Class::Gpu } else { Class::Cpu }
}
