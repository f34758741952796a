//! A build through a remote that does not take its word: a sample of what came is recomputed, and what rests on a lie is built again.

use kiln_engine::{BuildOptions, BuildReport, Engine, EngineError, Inconsistency, Observer, Plan, RemoteReport};

/// A build, what the remote did for it, and what is wrong with the remote's records, in words.
pub(crate) struct Built {
    pub(crate) report: BuildReport,
    pub(crate) remote: Option<RemoteReport>,
    pub(crate) lies: Vec<String>,
}

/// Builds; with `check` until no record of the sample lies. Every further build knows the truth of at least one more action.
pub(crate) fn build(
    engine: &mut Engine,
    plan: &Plan,
    options: &BuildOptions,
    observer: &dyn Observer,
    check: bool,
) -> Result<Built, EngineError> {
    let mut built =
        Built { report: engine.build(plan, options, observer)?, remote: engine.remote_report(), lies: Vec::new() };
    for _ in 0..plan.actions.len() {
        if !check || built.report.cancelled || options.dry_run {
            break;
        }
        let found = engine.check_claims(plan, &built.report, options)?;
        if let Some(remote) = &mut built.remote {
            remote.checked += found.checked;
            remote.refuted += found.lies.len();
        }
        built.lies.extend(found.lies.iter().map(lie));
        built.lies.extend(found.inconsistent.iter().map(fickle));
        let unchecked =
            |(label, why): &(String, String)| format!("{label}: the remote's record cannot be checked: {why}");
        built.lies.extend(found.failed.iter().map(unchecked));
        if found.lies.is_empty() {
            break;
        }
        let before = std::mem::replace(&mut built.report, engine.build(plan, options, observer)?);
        built.report.warnings.splice(0..0, before.warnings);
        built.report.seconds += before.seconds;
        if let (Some(all), Some(more)) = (&mut built.remote, engine.remote_report()) {
            all.add(&more);
        }
    }
    Ok(built)
}

fn lie(found: &Inconsistency) -> String {
    let Inconsistency { label, output, first, other, .. } = found;
    let short = |hash: &Option<kiln_engine::ContentHash>| hash.map_or_else(|| "none".into(), |hash| hash.short());
    format!(
        "{label}: the remote's record says that output `{output}` is {}, running the stage gives {}; what was made here stands in its \
         place. Whoever wrote it lied, or the stage depends on more than its fingerprint covers",
        short(other),
        short(first)
    )
}

fn fickle(found: &Inconsistency) -> String {
    let Inconsistency { label, output, .. } = found;
    format!(
        "{label}: output `{output}` is another each time the stage runs: no record of it can be checked; report this stage"
    )
}
