//! What runs now: bars on a terminal, plain lines elsewhere.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use kiln_engine::{ActionState, Event, Observer, TargetState};

use crate::summary::seconds;

/// Shows events as they come.
pub(super) struct Progress {
    bars: Option<MultiProgress>,
    explain: bool,
    running: Mutex<BTreeMap<usize, Running>>,
    elsewhere: Mutex<Elsewhere>,
}

/// What was last said of tasks on other machines.
#[derive(Default)]
struct Elsewhere {
    bar: Option<ProgressBar>,
    ended: Option<usize>,
}

struct Running {
    name: String,
    bar: Option<ProgressBar>,
}

impl Progress {
    pub(super) fn new(explain: bool) -> Progress {
        let bars = std::io::stderr().is_terminal().then(MultiProgress::new);
        Progress { bars, explain, running: Mutex::default(), elsewhere: Mutex::default() }
    }

    /// Takes the bars away.
    pub(super) fn finish(&self) {
        if let Some(bars) = &self.bars {
            // Nothing is lost if the terminal refuses: the summary follows.
            let _ = bars.clear();
        }
    }

    /// How far tasks on other machines are: a bar, or a line for each twentieth.
    fn elsewhere(&self, progress: &kiln_engine::Progress) {
        let mut shown = self.elsewhere.lock().unwrap_or_else(PoisonError::into_inner);
        let (ended, all) = (progress.done + progress.failed, progress.tasks);
        let failed = if progress.failed > 0 { format!(", {} failed", progress.failed) } else { String::new() };
        let note = if progress.note.is_empty() { String::new() } else { format!(" ({})", progress.note) };
        let text = format!("{ended} of {all} stages elsewhere are done{failed}{note}");
        match &self.bars {
            Some(bars) => {
                let bar = shown.bar.get_or_insert_with(|| bar(bars.add(ProgressBar::new(all as u64))));
                bar.set_position(ended as u64);
                bar.set_message(text);
            }
            None if shown
                .ended
                .is_none_or(|before| ended != before && (ended == all || ended >= before + all / 20)) =>
            {
                eprintln!("{text}");
                shown.ended = Some(ended);
            }
            None => {}
        }
    }

    fn line(&self, text: &str) {
        match &self.bars {
            Some(bars) => {
                let _ = bars.println(text);
            }
            None => eprintln!("{text}"),
        }
    }
}

/// How far one long work is: a bar on a terminal, nothing elsewhere.
pub(super) struct Bar(Option<ProgressBar>);

impl Bar {
    pub(super) fn new() -> Bar {
        Bar(std::io::stderr().is_terminal().then(|| bar(ProgressBar::new(1000))))
    }

    /// `share` in `[0, 1]` is done; `label` says what is being done.
    pub(super) fn at(&self, share: f64, label: &str) {
        if let Some(bar) = &self.0 {
            bar.set_position((share.clamp(0.0, 1.0) * 1000.0) as u64);
            bar.set_message(label.to_owned());
        }
    }

    /// Takes it away.
    pub(super) fn finish(self) {
        if let Some(bar) = self.0 {
            bar.finish_and_clear();
        }
    }
}

/// The look that all bars share.
fn bar(bar: ProgressBar) -> ProgressBar {
    if let Ok(style) = ProgressStyle::with_template("  {spinner} {bar:24} {elapsed:>4} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

impl Observer for Progress {
    fn event(&self, event: &Event<'_>) {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            Event::Started { action, label, reason, .. } => {
                if self.explain {
                    self.line(&format!("{label}: runs, {reason}"));
                }
                let bar = self.bars.as_ref().map(|bars| {
                    let bar = bar(bars.add(ProgressBar::new(1000)));
                    bar.set_message((*label).to_owned());
                    bar
                });
                running.insert(*action, Running { name: (*label).to_owned(), bar });
            }
            Event::Progress { action, fraction, label } => {
                if let Some(Running { name, bar: Some(bar) }) = running.get(action) {
                    bar.set_position((fraction.clamp(0.0, 1.0) * 1000.0) as u64);
                    bar.set_message(format!("{name}: {label}"));
                }
            }
            Event::Finished { action, state, .. } => {
                let Some(Running { name, bar }) = running.remove(action) else { return };
                if let Some(bar) = bar {
                    bar.finish_and_clear();
                }
                match state {
                    ActionState::Ran { seconds: took, .. } => self.line(&format!("{name}: {}", seconds(*took))),
                    ActionState::Failed(_) => self.line(&format!("{name}: failed")),
                    _ => {}
                }
            }
            Event::Elsewhere(progress) => self.elsewhere(progress),
            Event::TargetFinished { state: TargetState::Failed(error), .. } => self.line(&format!("error: {error}")),
            _ => {}
        }
    }
}
