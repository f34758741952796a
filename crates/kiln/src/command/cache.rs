//! `kiln cache`: what lies in a cache, what may go, whether it is whole.

use std::path::Path;

use kiln_engine::{Cache, CacheStats, GcOptions, GcReport, VerifyReport};
use serde::Serialize;

use super::args::{CacheArgs, CacheCommand, CacheGcArgs};
use super::{complain, data};
use crate::config::{Config, parse_age, parse_size, signing_key};
use crate::exit::Exit;
use crate::summary;

pub(super) fn run(args: &CacheArgs) -> Exit {
    match &args.command {
        CacheCommand::Stats(place) => with_cache(place.cache.as_deref(), |cache| match cache.stats() {
            Ok(stats) if place.json => json(&stats),
            Ok(stats) => data(&stats_text(&stats)),
            Err(error) => complain(Exit::Failed, &error.to_string()),
        }),
        CacheCommand::Verify(place) => with_cache(place.cache.as_deref(), |cache| match cache.verify() {
            Ok(report) => verified(&report, place.json),
            Err(error) => complain(Exit::Failed, &error.to_string()),
        }),
        CacheCommand::Gc(gc) => with_cache(gc.place.cache.as_deref(), |cache| collect(cache, gc)),
        CacheCommand::Key { file } => key(file),
    }
}

fn with_cache(folder: Option<&Path>, work: impl FnOnce(&Cache) -> Exit) -> Exit {
    let folder = folder.unwrap_or(Path::new(".kiln"));
    let cache = Cache::open(folder);
    if !cache.exists() {
        let message =
            format!("there is no cache at {}; it lies beside the pipeline: name it with --cache", folder.display());
        return complain(Exit::Failed, &message);
    }
    work(&cache)
}

fn json<T: Serialize>(value: &T) -> Exit {
    data(&serde_json::to_string_pretty(value).expect("invariant: a report is plain data"))
}

/// Bytes as people read them; `0 B` too.
fn bytes(count: u64) -> String {
    match count {
        0 => "0 B".into(),
        1_000_000_000.. => format!("{:.2} GB", count as f64 / 1e9),
        _ => summary::bytes(count),
    }
}

fn stats_text(stats: &CacheStats) -> String {
    let mut text = format!("{:<14}{:>8}  {:>10}\n", "", "files", "bytes");
    let parts = [stats.records, stats.lists, stats.blobs, stats.states, stats.quarantine, stats.temporary];
    let names = ["records", "file lists", "blobs", "build states", "quarantine", "being written"];
    for (name, count) in names.iter().zip(parts) {
        text.push_str(&format!("{name:<14}{:>8}  {:>10}\n", count.files, bytes(count.bytes)));
    }
    let files: usize = parts.iter().map(|part| part.files).sum();
    text.push_str(&format!("{:<14}{files:>8}  {:>10}\n", "together", bytes(stats.bytes)));
    let builds = if stats.leases == 1 { "build is" } else { "builds are" };
    text.push_str(&format!("{} {builds} at work on it\n", stats.leases));
    if !stats.kinds.is_empty() {
        text.push_str("\nkind             runs     outputs      took\n");
    }
    for kind in &stats.kinds {
        let took = summary::seconds(kind.seconds);
        let (name, out) = (&kind.kind, bytes(kind.output_bytes));
        text.push_str(&format!("{name:<14}{:>7}  {out:>10}  {took:>8}\n", kind.records));
    }
    text
}

/// Exit 1 if something was damaged: a check found something.
fn verified(report: &VerifyReport, as_json: bool) -> Exit {
    let exit = if report.damaged.is_empty() { Exit::Done } else { Exit::Short };
    if as_json {
        return exit.max(json(report));
    }
    for damaged in &report.damaged {
        eprintln!("warning: {damaged}");
    }
    let mut text = format!(
        "whole: {} records, {} file lists, {} blobs ({})\n",
        report.records,
        report.lists,
        report.blobs,
        bytes(report.bytes)
    );
    text.push_str(&match report.damaged.len() {
        0 => "nothing is damaged\n".to_owned(),
        count => {
            format!("damaged: {count}, moved to the cache's quarantine; a build that needs them makes them again\n")
        }
    });
    if report.incomplete_records > 0 {
        let count = report.incomplete_records;
        text.push_str(&format!(
            "{count} of the records have outputs that are gone: those stages run again when somebody reads them\n"
        ));
    }
    exit.max(data(&text))
}

fn collect(cache: &Cache, args: &CacheGcArgs) -> Exit {
    let options = match options(args) {
        Ok(options) => options,
        Err(exit) => return exit,
    };
    let report = match cache.gc(&options) {
        Ok(report) => report,
        Err(error) => return complain(Exit::Failed, &error.to_string()),
    };
    for pin in &report.unknown_pins {
        eprintln!("warning: no build in this cache made {pin}; the pin holds nothing");
    }
    // A budget that was missed is exit 1, as it is for builds.
    let exit = if report.over_bytes > 0 { Exit::Short } else { Exit::Done };
    exit.max(if args.place.json { json(&report) } else { data(&collected(&report, args.dry_run)) })
}

/// The limits: typed, else the user's; without any it is not clear what may go.
fn options(args: &CacheGcArgs) -> Result<GcOptions, Exit> {
    let usage = |message: String| complain(Exit::Usage, &message);
    let typed = args.max_size.is_some() || args.max_age.is_some();
    let config = if typed { Config::default() } else { Config::load().map_err(|error| usage(error.to_string()))? };
    let size = args.max_size.as_ref().or(config.cache.max_size.as_ref());
    let age = args.max_age.as_ref().or(config.cache.max_age.as_ref());
    if size.is_none() && age.is_none() {
        return Err(usage("say what may stay: --max-size 20GB, --max-age 30d, or both".into()));
    }
    let mut pins = args.pins.clone();
    for path in &args.pin_lists {
        let text = std::fs::read_to_string(path);
        let text = text.map_err(|error| complain(Exit::Failed, &format!("cannot read {}: {error}", path.display())))?;
        pins.extend(
            text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')).map(str::to_owned),
        );
    }
    Ok(GcOptions {
        max_bytes: size.map(|text| parse_size(text)).transpose().map_err(usage)?,
        max_age: age.map(|text| parse_age(text)).transpose().map_err(usage)?,
        pins,
        dry_run: args.dry_run,
    })
}

fn collected(report: &GcReport, dry_run: bool) -> String {
    if report.busy {
        return "another collection is at work on this cache; nothing was done\n".into();
    }
    let verb = if dry_run { "would remove" } else { "removed" };
    let mut text = format!(
        "{verb} {} of {} files, {} of {}\n",
        report.removed_files,
        report.files,
        bytes(report.removed_bytes),
        bytes(report.bytes)
    );
    for (count, what) in [
        (report.in_use_bytes, "are spared because a build at work may use them"),
        (report.pinned_bytes, "are pinned"),
        (report.over_bytes, "are left above --max-size"),
    ] {
        if count > 0 {
            text.push_str(&format!("{} {what}\n", bytes(count)));
        }
    }
    text
}

/// Prints the public key of a secret one.
fn key(file: &Path) -> Exit {
    match signing_key(file) {
        #[cfg(feature = "remote")]
        Ok(key) => data(&key.public().to_string()),
        #[cfg(not(feature = "remote"))]
        Ok(_) => complain(Exit::Failed, "signed records need kiln's feature `remote`, which this build lacks"),
        Err(error) => complain(Exit::Failed, &error.to_string()),
    }
}
