//! Why it would run, without running: the verdicts of `why` and of a dry run.

use std::collections::{BTreeMap, BTreeSet};

use super::{Session, lock};
use crate::error::ActionError;
use crate::plan::Source;
use crate::reason::StaleReason;
use crate::report::{ActionState, TargetError, TargetState, Verdict, Why};

type ActionVerdicts = BTreeMap<usize, Result<Verdict, ActionError>>;
type TargetVerdicts = BTreeMap<usize, Result<Verdict, TargetError>>;

impl Session<'_> {
    /// The verdict of every action and target, into their slots.
    pub(super) fn judge_all(&self) {
        let actions = (0..self.plan.actions.len()).collect();
        let (verdicts, targets) = self.judge(&actions, (0..self.plan.targets.len()).collect());
        for (action, verdict) in verdicts {
            let state = match verdict {
                Ok(Verdict::Fresh) => ActionState::Fresh,
                Ok(Verdict::Stale(reason)) => ActionState::WouldRun { reason },
                Ok(Verdict::DependsOn { on }) => ActionState::DependsOn { on },
                Ok(Verdict::Fails { message }) => ActionState::Failed(ActionError::failed(message)),
                Err(error) => ActionState::Failed(error),
            };
            self.finish(action, state);
        }
        for (target, verdict) in targets {
            lock(&self.targets[target]).state = Some(match verdict {
                Ok(Verdict::Fresh) => TargetState::Unchanged,
                Ok(Verdict::Stale(reason)) => TargetState::WouldWrite { reason },
                Ok(Verdict::DependsOn { on }) => TargetState::DependsOn { on },
                Ok(Verdict::Fails { message }) => TargetState::Failed(ActionError::failed(message).into()),
                Err(error) => TargetState::Failed(error),
            });
        }
    }

    /// The verdicts that concern one target.
    pub(crate) fn why(&self, target: usize) -> Why {
        let mut needed = BTreeSet::new();
        let mut open = vec![self.plan.targets[target].action];
        while let Some(action) = open.pop() {
            if needed.insert(action) {
                open.extend(self.upstream(action));
            }
        }
        let (verdicts, targets) = self.judge(&needed, BTreeSet::from([target]));
        let told = |action: usize, error: ActionError| match self.missing_file(action) {
            Some(reason) => Verdict::Stale(reason),
            None => Verdict::Fails { message: error.to_string() },
        };
        let actions = verdicts
            .into_iter()
            .map(|(action, verdict)| (action, verdict.unwrap_or_else(|error| told(action, error))))
            .collect();
        let target = targets.into_values().next().map_or(Verdict::Fresh, |verdict| {
            verdict.unwrap_or_else(|error| Verdict::Fails { message: error.to_string() })
        });
        Why { actions, target }
    }

    /// Forward: what is stale by its inputs. Then backward: what is fresh, but has lost an output that would be read.
    fn judge(&self, actions: &BTreeSet<usize>, targets: BTreeSet<usize>) -> (ActionVerdicts, TargetVerdicts) {
        let mut verdicts = ActionVerdicts::new();
        for &action in actions {
            let fresh = |before: &usize| matches!(verdicts.get(before), Some(Ok(Verdict::Fresh)));
            let verdict = match self.upstream(action).into_iter().find(|before| !fresh(before)) {
                Some(on) => Ok(Verdict::DependsOn { on }),
                None => self.judge_inputs(action),
            };
            verdicts.insert(action, verdict);
        }
        let mut target_verdicts = TargetVerdicts::new();
        for target in targets {
            let on = self.plan.targets[target].action;
            let verdict = match verdicts.get(&on) {
                Some(Ok(Verdict::Fresh)) => self.judge_target(target),
                _ => Ok(Verdict::DependsOn { on }),
            };
            if matches!(verdict, Ok(Verdict::Stale(_))) {
                self.judge_blobs(on, &self.plan.targets[target].output, true, &mut verdicts);
            }
            target_verdicts.insert(target, verdict);
        }
        for &action in actions.iter().rev() {
            if matches!(verdicts.get(&action), Some(Ok(Verdict::Fresh))) {
                continue;
            }
            for input in &self.plan.actions[action].inputs {
                match &input.source {
                    Source::Output { action, output } => self.judge_blobs(*action, output, true, &mut verdicts),
                    Source::Outputs { action, prefix } => self.judge_blobs(*action, prefix, false, &mut verdicts),
                    _ => {}
                }
            }
        }
        (verdicts, target_verdicts)
    }

    fn judge_inputs(&self, action: usize) -> Result<Verdict, ActionError> {
        let resolved = self.resolve(action, &|before| self.record(before))?;
        Ok(match resolved.hit {
            Some(record) => {
                self.done(action, resolved.manifest, record);
                Verdict::Fresh
            }
            None => Verdict::Stale(resolved.reason),
        })
    }

    fn judge_target(&self, target: usize) -> Result<Verdict, TargetError> {
        let Some(output) = self.wanted_output(target)? else { return Ok(Verdict::Fresh) };
        Ok(self.target_reason(target, &output)?.map_or(Verdict::Fresh, Verdict::Stale))
    }

    /// Makes a fresh action stale if its output `name` (or one that begins so, unless `whole`) is lost.
    fn judge_blobs(&self, action: usize, name: &str, whole: bool, verdicts: &mut ActionVerdicts) {
        if !matches!(verdicts.get(&action), Some(Ok(Verdict::Fresh))) {
            return;
        }
        let Some(record) = self.record(action) else { return };
        let read = |output: &str| if whole { output == name } else { output.starts_with(name) };
        let lost = |hash, length| !self.store.has_blob(hash, length);
        let outputs = record.outputs.iter().filter(|output| read(&output.name));
        if let Some(output) = outputs.into_iter().find(|output| lost(&output.hash, output.length)) {
            let reason = StaleReason::BlobLost { what: output.name.clone() };
            verdicts.insert(action, Ok(Verdict::Stale(reason)));
        }
    }
}
