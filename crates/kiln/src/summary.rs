//! What a build did, for people (a table) and for programs (JSON).

use std::fmt::Write as _;
use std::path::Path;

use kiln_engine::RemoteReport;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::exit::Exit;

/// How a stage ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StageState {
    /// Its result was known.
    Fresh,
    /// It ran.
    Ran,
    /// Dry run: it would run.
    WouldRun,
    /// Dry run: it depends on what a stage before it gives.
    Depends,
    /// It failed.
    Failed,
    /// A stage before it failed, or the build stopped.
    Skipped,
}

/// One stage of one asset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageSummary {
    /// The stage's id; a simplify stage has a second row `ID, collapse`.
    pub stage: String,
    /// How it ended.
    pub state: StageState,
    /// Why it ran or would run, or why it failed.
    pub reason: Option<String>,
    /// Seconds it took when it last ran.
    pub seconds: Option<f64>,
    /// The process' peak memory while it ran, bytes; other stages that ran beside it included.
    pub peak_bytes: Option<u64>,
    /// Bytes of its outputs in the cache.
    pub bytes: u64,
    /// The stage's own report.
    pub report: Value,
}

/// One model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AssetSummary {
    /// The model, relative to the pipeline's folder.
    pub input: String,
    /// The container, relative to the pipeline's folder.
    pub output: String,
    /// `unchanged`, `written`, `would-write`, `depends`, `failed`, `skipped`.
    pub state: String,
    /// Length of the container, bytes; 0 if unknown.
    pub bytes: u64,
    /// In order.
    pub stages: Vec<StageSummary>,
    /// Dry run: the pipeline as it holds for this model, every default filled, as TOML.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolved: Option<String>,
}

/// Assets that are counted and not listed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Untouched {
    /// How many.
    pub assets: usize,
    /// Their stages.
    pub stages: usize,
}

/// One pipeline's build.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The pipeline file as it was given.
    pub pipeline: String,
    /// In order of input.
    pub assets: Vec<AssetSummary>,
    /// Assets that are not listed since nothing about them changed; none unless [`Build::brief`](crate::Build::brief) asked for it.
    #[serde(default)]
    pub untouched: Untouched,
    /// Soft trouble: repairs, replacements, budgets missed.
    pub warnings: Vec<String>,
    /// Budgets that were not met, in words.
    pub short: Vec<String>,
    /// What failed, in words, each defect its own entry.
    pub errors: Vec<String>,
    /// What the remote cache did, if one was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remote: Option<RemoteReport>,
    /// Whether nothing ran and nothing was written.
    pub fresh: bool,
    /// Wall time, seconds.
    pub seconds: f64,
}

impl Summary {
    /// Of a build of `pipeline` that did nothing yet.
    pub(crate) fn of(pipeline: &Path) -> Summary {
        Summary {
            pipeline: pipeline.display().to_string(),
            assets: Vec::new(),
            untouched: Untouched::default(),
            warnings: Vec::new(),
            short: Vec::new(),
            errors: Vec::new(),
            remote: None,
            fresh: false,
            seconds: 0.0,
        }
    }

    /// The exit code that it deserves. `deny_warnings`: soft trouble counts as a budget missed.
    pub fn exit(&self, deny_warnings: bool) -> Exit {
        if !self.errors.is_empty() {
            Exit::Failed
        } else if !self.short.is_empty() || deny_warnings && !self.warnings.is_empty() {
            Exit::Short
        } else {
            Exit::Done
        }
    }

    /// The table: a row for each stage, and what the asset came to.
    pub fn table(&self) -> String {
        let mut rows = vec![["stage", "time", "triangles", "error", "bytes", "peak", "state"].map(String::from)];
        for asset in &self.assets {
            for stage in &asset.stages {
                rows.push([
                    format!("{} / {}", asset.input.rsplit('/').next().unwrap_or_default(), stage.stage),
                    stage.seconds.map(seconds).unwrap_or_default(),
                    triangles(&stage.report),
                    errors(&stage.report),
                    bytes(stage.bytes),
                    stage.peak_bytes.map(bytes).unwrap_or_default(),
                    match (stage.state, &stage.reason) {
                        (StageState::Fresh, _) => "fresh".into(),
                        (StageState::Ran, Some(reason)) => format!("ran: {reason}"),
                        (StageState::Ran, None) => "ran".into(),
                        (StageState::WouldRun, reason) => {
                            format!("would run: {}", reason.as_deref().unwrap_or_default())
                        }
                        (StageState::Depends, reason) => {
                            format!("depends on {}", reason.as_deref().unwrap_or_default())
                        }
                        (StageState::Failed, _) => "FAILED".into(),
                        (StageState::Skipped, _) => "skipped".into(),
                    },
                ]);
            }
        }
        let mut widths = [0; 7];
        for row in &rows {
            for (width, cell) in widths.iter_mut().zip(row) {
                *width = (*width).max(cell.chars().count());
            }
        }
        let mut out = String::new();
        for row in &rows {
            let mut line = String::new();
            for (column, (cell, width)) in row.iter().zip(widths).enumerate() {
                // Numbers end where their column ends, names begin where it begins.
                let _ = match column {
                    0 | 6 => write!(line, "{cell:<width$}  "),
                    _ => write!(line, "{cell:>width$}  "),
                };
            }
            let _ = writeln!(out, "  {}", line.trim_end());
        }
        for asset in &self.assets {
            let state = match asset.state.as_str() {
                "would-write" => "would be written",
                "depends" => "may be written",
                state => state,
            };
            let _ = write!(out, "  {} {state}", asset.output);
            let _ = if asset.bytes > 0 { writeln!(out, " ({})", bytes(asset.bytes)) } else { writeln!(out) };
        }
        if let Some(remote) = &self.remote {
            let (hits, sent) = (remote.hits, remote.sent);
            let (down, up) = (bytes(remote.bytes_received), bytes(remote.bytes_sent));
            let _ = write!(
                out,
                "  remote cache: {hits} stages taken ({})",
                if down.is_empty() { "0 B" } else { down.as_str() }
            );
            let _ = if sent > 0 { writeln!(out, ", {sent} sent ({up})") } else { writeln!(out) };
        }
        out
    }
}

/// Seconds as people read them.
pub fn seconds(seconds: f64) -> String {
    if seconds < 1.0 { format!("{:.0} ms", seconds * 1e3) } else { format!("{seconds:.2} s") }
}

/// Bytes as people read them.
pub fn bytes(count: u64) -> String {
    match count {
        0 => String::new(),
        1..10_000 => format!("{count} B"),
        10_000..10_000_000 => format!("{:.0} kB", count as f64 / 1e3),
        _ => format!("{:.1} MB", count as f64 / 1e6),
    }
}

fn levels(report: &Value) -> impl Iterator<Item = &Value> {
    report["levels"].as_array().into_iter().flatten()
}

/// The triangles of a stage's result, finest level first.
fn triangles(report: &Value) -> String {
    let of_levels: Vec<String> =
        levels(report).filter_map(|l| l["triangles"].as_u64()).map(|n| n.to_string()).collect();
    if of_levels.is_empty() {
        return report["triangles"].as_u64().map(|n| n.to_string()).unwrap_or_default();
    }
    of_levels.join(" ")
}

/// The measured errors of a stage's levels, metres.
fn errors(report: &Value) -> String {
    let list: Vec<String> = levels(report).filter_map(|l| l["error"].as_f64()).map(|e| format!("{e:.2e}")).collect();
    list.join(" ")
}
