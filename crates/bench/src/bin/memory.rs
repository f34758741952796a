//! Memory of simplification: peak bytes for each input triangle, stage by stage, in a process that does nothing else.
//!
//! `cargo run --release -p kiln-bench --bin memory -- MODEL... [--keep SHARE]...`
//!
//! Each model runs in a process of its own. "Added" is the peak of a step less what was resident before it: what the step
//! itself needs beside its input. Steps as in the pipeline: import, merge, collapse to exhaustion, levels with their errors.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use kiln_bench::memory::{now, peak, reset_peak};
use kiln_bench::rows::Page;
use kiln_bench::{model, name, timed};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{Budget, LevelsOptions, SimplifyOptions, collapse, levels};

fn main() -> ExitCode {
    let (mut shares, mut models, mut alone) = (Vec::new(), Vec::new(), false);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--keep" => shares.extend(args.next().and_then(|v| v.parse::<f64>().ok())),
            "--alone" => alone = true,
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: memory MODEL... [--keep SHARE]...");
        return ExitCode::from(64);
    }
    let mut page = Page::new(None);
    if alone {
        if shares.is_empty() {
            shares.extend([0.5, 0.1, 0.02]);
        }
        return match measure(&models[0], &shares, &mut page) {
            Ok(()) => ExitCode::SUCCESS,
            Err(message) => {
                eprintln!("{}: {message}", models[0].display());
                ExitCode::FAILURE
            }
        };
    }
    page.head(&["model", ":triangles", "step", ":seconds", ":peak MB", ":added MB", ":added bytes a triangle"]);
    let Ok(own) = std::env::current_exe() else { return ExitCode::FAILURE };
    for path in &models {
        let mut command = Command::new(&own);
        command.arg(path).arg("--alone");
        shares.iter().for_each(|share| {
            command.args(["--keep", &share.to_string()]);
        });
        if !command.status().is_ok_and(|status| status.success()) {
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn measure(path: &Path, shares: &[f64], page: &mut Page) -> Result<(), String> {
    let mut steps = Steps { page, model: name(path), triangles: 0 };
    let asset = steps.step("import", || model(path), |asset| asset.as_ref().map_or(0, |a| a.mesh.face_count()))?;
    let merged = steps.step("merge", || merge(&asset.mesh, &MergeOptions::default()).0, |mesh| mesh.face_count());
    let sequence =
        steps.step("collapse", || collapse(&merged, &[], None, &SimplifyOptions::default()), |_| merged.face_count());
    let budgets: Vec<Budget> = shares.iter().map(|share| Budget::Keep(*share)).collect();
    let run = || levels(&merged, &[], &sequence, &asset.mesh, &budgets, &LevelsOptions::default());
    steps.step("levels", run, |_| merged.face_count());
    Ok(())
}

struct Steps<'a> {
    page: &'a mut Page,
    model: String,
    triangles: usize,
}

impl Steps<'_> {
    fn step<T>(&mut self, step: &str, run: impl FnOnce() -> T, count: impl Fn(&T) -> usize) -> T {
        reset_peak();
        let before = now();
        let (result, seconds) = timed(run);
        let peak = peak();
        self.triangles = count(&result).max(1);
        let added = peak.saturating_sub(before);
        self.page.row(&[
            self.model.clone(),
            self.triangles.to_string(),
            step.into(),
            format!("{seconds:.2}"),
            format!("{}", peak >> 20),
            format!("{}", added >> 20),
            format!("{:.0}", added as f64 / self.triangles as f64),
        ]);
        result
    }
}
