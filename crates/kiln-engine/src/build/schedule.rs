//! The order: the lowest ready index first, so that one asset is finished before the next fills the memory.

use std::collections::BTreeSet;
use std::sync::{Condvar, Mutex, PoisonError};

use super::{Session, lock};
use crate::report::ActionState;

/// An action or a target; a target stands right behind its action.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Node {
    Action { action: usize },
    Target { action: usize, target: usize },
}

impl Node {
    fn key(self) -> (usize, usize) {
        match self {
            Node::Action { action } => (action, 0),
            Node::Target { action, target } => (action, 1 + target),
        }
    }
}

struct Board {
    ready: BTreeSet<((usize, usize), Node)>,
    /// `[action_count]`: actions that must be done before.
    waits: Vec<usize>,
    at_work: usize,
    stop: bool,
}

impl Session<'_> {
    /// Does all actions and targets on the options' number of threads.
    pub(super) fn schedule(&self) {
        let count = self.plan.actions.len();
        let mut readers: Vec<Vec<Node>> = vec![Vec::new(); count];
        let mut board = Board { ready: BTreeSet::new(), waits: vec![0; count], at_work: 0, stop: false };
        for action in 0..count {
            let upstream = self.upstream(action);
            board.waits[action] = upstream.len();
            for before in &upstream {
                readers[*before].push(Node::Action { action });
            }
            if upstream.is_empty() {
                let node = Node::Action { action };
                board.ready.insert((node.key(), node));
            }
        }
        for (target, wanted) in self.plan.targets.iter().enumerate() {
            readers[wanted.action].push(Node::Target { action: wanted.action, target });
        }
        let jobs = self.options.jobs.clamp(1, (count + self.plan.targets.len()).max(1));
        let board = Mutex::new(board);
        let changed = Condvar::new();
        std::thread::scope(|scope| {
            for _ in 1..jobs {
                scope.spawn(|| self.work(&board, &changed, &readers));
            }
            self.work(&board, &changed, &readers);
        });
    }

    /// Actions that `action` reads, each once, ascending.
    pub(super) fn upstream(&self, action: usize) -> BTreeSet<usize> {
        self.plan.actions[action].upstream()
    }

    /// One thread: takes what is ready until nothing can become ready.
    fn work(&self, board: &Mutex<Board>, changed: &Condvar, readers: &[Vec<Node>]) {
        loop {
            let mut now = lock(board);
            let node = loop {
                if now.stop {
                    return;
                }
                if let Some((_, node)) = now.ready.pop_first() {
                    break node;
                }
                if now.at_work == 0 {
                    return;
                }
                now = changed.wait(now).unwrap_or_else(PoisonError::into_inner);
            };
            now.at_work += 1;
            drop(now);
            let failed = self.step(node);
            let mut now = lock(board);
            now.at_work -= 1;
            now.stop |= (failed && !self.options.keep_going) || self.is_cancelled();
            if let Node::Action { action } = node {
                for &reader in &readers[action] {
                    let ready = match reader {
                        Node::Action { action } => {
                            now.waits[action] -= 1;
                            now.waits[action] == 0
                        }
                        Node::Target { .. } => true,
                    };
                    if ready {
                        now.ready.insert((reader.key(), reader));
                    }
                }
            }
            drop(now);
            changed.notify_all();
        }
    }

    /// Does one node; `true` if it failed.
    fn step(&self, node: Node) -> bool {
        match node {
            Node::Action { action } => {
                let upstream = self.upstream(action);
                match upstream.iter().copied().find(|&before| self.record(before).is_none()) {
                    Some(before) => {
                        let because = self.first_failed(before);
                        self.finish(action, ActionState::Skipped { because: Some(because) });
                    }
                    None => self.perform(action),
                }
                for before in self.plan.actions[action].inputs.iter().filter_map(|input| input.source.upstream()) {
                    self.release(before);
                }
                matches!(lock(&self.slots[action]).state, Some(ActionState::Failed(_)))
            }
            Node::Target { action, target } => {
                self.deliver(target);
                self.release(action);
                matches!(lock(&self.targets[target]).state, Some(crate::report::TargetState::Failed(_)))
            }
        }
    }

    /// The action whose failure made `action` give nothing.
    fn first_failed(&self, action: usize) -> usize {
        match lock(&self.slots[action]).state {
            Some(ActionState::Skipped { because: Some(because) }) => because,
            _ => action,
        }
    }
}
