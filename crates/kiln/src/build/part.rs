//! What a build came to for one asset, and what the next build is told of it.

use std::sync::{Mutex, PoisonError};

use kiln_engine::{ActionError, ActionState, BuildReport, ContentHash, Event, Group, Memory, Observer, TargetState};
use kiln_pipeline::plan::{Planned, PlannedAsset};
use kiln_pipeline::stages::StageError;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::memory;
use crate::summary::{AssetSummary, StageState, StageSummary};

/// What is at hand of an asset about which nothing changed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Brief {
    pub(super) stages: usize,
    /// Classes of device that its stages depend on.
    pub(super) device: String,
    pub(super) warnings: Vec<String>,
    pub(super) short: Vec<String>,
}

impl Brief {
    pub(super) fn parse(text: &str) -> Brief {
        serde_json::from_str(text).unwrap_or_default()
    }
}

/// What a build came to for one asset.
pub(super) struct Part {
    pub(super) asset: AssetSummary,
    pub(super) brief: Brief,
    /// Warnings of this build alone.
    pub(super) passing: Vec<String>,
    pub(super) errors: Vec<String>,
}

/// The classes of device that an asset's stages depend on.
pub(super) fn device_of(planned: &Planned, asset: &PlannedAsset) -> String {
    let classes = asset.actions.iter().filter_map(|(action, _)| planned.plan.actions[*action].device_class.clone());
    classes.collect::<Vec<_>>().join("; ")
}

/// What the next build has to know to find out what there is to do.
pub(super) fn memory(key: ContentHash, planned: &Planned, parts: &[Part]) -> Memory {
    let json = "invariant: summaries are plain data";
    let group = |(asset, part): (&PlannedAsset, &Part)| {
        let brief = Brief { device: device_of(planned, asset), ..part.brief.clone() };
        Group {
            name: asset.input.clone(),
            actions: asset.actions.iter().map(|(action, _)| *action).collect(),
            targets: vec![asset.target],
            brief: serde_json::to_string(&brief).expect(json),
            note: serde_json::to_vec(&as_fresh(&part.asset)).expect(json),
        }
    };
    let groups = planned.assets.iter().zip(parts).map(group).collect();
    Memory { key, files: planned.files.clone(), folders: planned.folders.clone(), groups }
}

/// Notes the process' peak memory while each action runs.
pub(super) struct Peaks<'a> {
    inner: &'a dyn Observer,
    peaks: Mutex<Vec<Option<u64>>>,
}

impl<'a> Peaks<'a> {
    pub(super) fn new(inner: &'a dyn Observer, actions: usize) -> Peaks<'a> {
        Peaks { inner, peaks: Mutex::new(vec![None; actions]) }
    }

    /// Bytes, by action; `None` for those that did not run.
    pub(super) fn into_peaks(self) -> Vec<Option<u64>> {
        self.peaks.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for Peaks<'_> {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Started { .. } => memory::reset_peak(),
            Event::Finished { action, state: ActionState::Ran { .. }, .. } => {
                let mut peaks = self.peaks.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some(slot) = peaks.get_mut(*action) {
                    *slot = memory::peak();
                }
            }
            _ => {}
        }
        self.inner.event(event);
    }
}

/// What the next build says of an asset if nothing changes.
fn as_fresh(asset: &AssetSummary) -> AssetSummary {
    let mut asset = asset.clone();
    asset.state = "unchanged".into();
    for stage in &mut asset.stages {
        stage.state = StageState::Fresh;
        stage.reason = None;
        stage.peak_bytes = None;
    }
    asset
}

/// The stage that an action of the plan belongs to.
pub(super) fn stage_of(asset: &PlannedAsset, action: usize) -> &str {
    asset.actions.iter().find(|(index, _)| *index == action).map_or("another asset's stage", |(_, name)| name)
}

/// What a build came to for `asset`.
pub(super) fn part(asset: &PlannedAsset, report: &BuildReport, peaks: &[Option<u64>]) -> Part {
    let (mut brief, mut passing, mut errors) = (Brief::default(), Vec::new(), Vec::new());
    let mut stages = Vec::new();
    for (index, stage) in &asset.actions {
        let action = &report.actions[*index];
        let place = format!("{}, stage {stage}", asset.input);
        let (state, reason) = match &action.state {
            ActionState::Fresh => (StageState::Fresh, None),
            ActionState::Ran { reason, .. } => (StageState::Ran, Some(reason.to_string())),
            ActionState::WouldRun { reason } => (StageState::WouldRun, Some(reason.to_string())),
            ActionState::DependsOn { on } => (StageState::Depends, Some(stage_of(asset, *on).to_owned())),
            ActionState::Failed(error) => {
                errors.extend(defects(error).into_iter().map(|d| format!("{place}: {d}")));
                (StageState::Failed, Some(error.to_string()))
            }
            ActionState::Skipped { .. } => (StageState::Skipped, None),
        };
        let record = action.record.as_ref();
        let stage_report: Value = record.and_then(|r| serde_json::from_slice(&r.report).ok()).unwrap_or(Value::Null);
        passing.extend(action.warnings.iter().map(|w| format!("{place}: {w}")));
        soft_trouble(&place, &stage_report, &mut brief);
        stages.push(StageSummary {
            stage: stage.clone(),
            state,
            reason,
            seconds: record.map(|r| r.seconds),
            peak_bytes: peaks.get(*index).copied().flatten(),
            bytes: record.map_or(0, |r| r.outputs.iter().map(|o| o.length).sum()),
            report: stage_report,
        });
    }
    brief.stages = stages.len();
    let target = &report.targets[asset.target];
    let state = match &target.state {
        TargetState::Unchanged => "unchanged",
        TargetState::Written { .. } => "written",
        TargetState::WouldWrite { .. } => "would-write",
        TargetState::DependsOn { .. } => "depends",
        TargetState::Failed(error) => {
            errors.push(format!("{}: {error}", asset.output));
            "failed"
        }
        TargetState::Skipped => "skipped",
    };
    let asset = AssetSummary {
        input: asset.input.clone(),
        output: asset.output.clone(),
        state: state.into(),
        bytes: target.length.unwrap_or(0),
        stages,
        resolved: None,
    };
    Part { asset, brief, passing, errors }
}

/// Each defect of a failed stage.
pub(crate) fn defects(error: &ActionError) -> Vec<String> {
    if let ActionError::Failed(inner) = error
        && let Some(StageError::Import(import)) = inner.downcast_ref::<StageError>()
    {
        let family = import.to_string();
        let family = family.split(':').next().unwrap_or_default();
        return import.defects().iter().map(|d| format!("{family}: {d}")).collect();
    }
    vec![error.to_string()]
}

/// What reports say of budgets missed (`levels[].short`), of what was asked in vain (`short`), and of things repaired, replaced or left
/// out (`repairs`, `warnings`).
fn soft_trouble(place: &str, report: &Value, brief: &mut Brief) {
    for (number, level) in report["levels"].as_array().into_iter().flatten().enumerate() {
        if let Some(short) = level["short"].as_str() {
            brief.short.push(format!("{place}, level {number}: {short}"));
        }
    }
    for vain in report["short"].as_array().into_iter().flatten() {
        brief.short.extend(vain.as_str().map(|text| format!("{place}: {text}")));
    }
    for repair in report["repairs"].as_array().into_iter().flatten() {
        let what = repair["sentence"].as_str().or(repair["kind"].as_str()).unwrap_or("repaired");
        let first = repair["first"].as_str().unwrap_or_default();
        brief.warnings.push(format!("{place}: {what} ({} times, first {first})", repair["count"]));
    }
    for warning in report["warnings"].as_array().into_iter().flatten() {
        if let Some(text) = warning.as_str() {
            brief.warnings.push(format!("{place}: {text}"));
        }
    }
}
