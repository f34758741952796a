//! The collapse loop: half-edge collapses of a part in order of cost until no legal one is left.
//!
//! **Exact order at a low price.** Each collapse is the cheapest legal one of all, ties by lower ids, and yet few costs are
//! computed. Where the costs of a metric only rise (forms only grow), a cost computed earlier is a lower bound of today's.
//! The queue holds one such bound a point, with the target that it came from; only the point at the front is priced again:
//! ```text
//! while the queue has a point p:
//!     the cost of its best target is still the bound, and legal: collapse p onto it; next p
//!     for each target of p that the table of kinds allows, cheapest first:
//!         dearer than the next point in the queue: put p back with that cost; next p
//!         legal: collapse p onto it; next p
//!     no target is legal: p waits until a face of its star changes
//! ```
//! After a collapse of `from` onto `to`, bounds can be too high only where a new target or a newly legal one may be cheaper: at
//! `to`, which is priced anew, and at the neighbours of `from`, which get `to` as a target (and are priced anew if their
//! bound rests on a target that was illegal). A metric whose costs may fall has all neighbours of `to` priced anew.

use glam::DVec3;
use rayon::prelude::*;

use super::heap::{Heap, entry, rank};
use super::log::Log;
use super::metric::Metric;
use super::rules::{Moves, RULE_COUNT, Rule, moves};
use super::sequence::SequenceReport;
use super::working::Working;
use crate::topology::NONE;

/// Whether and how a point stands in the queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum State {
    /// It was collapsed, or may never move.
    Out,
    /// In the queue; its rank is a lower bound over all its targets, and was its best target's cost.
    Queued,
    /// In the queue; its rank passes over cheaper targets that were illegal.
    Raised,
    /// None of its targets is legal; not in the queue.
    Blocked,
}

/// A target of a point: rank of the cost, the point.
type Target = (u32, u32);

pub(super) struct Collapser<'a, M> {
    pub(super) work: Working<'a>,
    pub(super) metric: M,
    heap: Heap,
    /// `[point_count]`: the target that a point's rank came from.
    best: Vec<u32>,
    /// Targets of the point at hand.
    targets: Vec<Target>,
    /// Where the point that stays goes, of the last test.
    place: Option<DVec3>,
    pub(super) faces_left: u32,
    /// Rank of the dearest collapse so far.
    pub(super) dearest: u32,
    pub(super) log: Log,
}

impl<'a, M: Metric + Sync> Collapser<'a, M> {
    /// All points of `work` are priced; `faces_left` of that part, or of more.
    pub(super) fn new(work: Working<'a>, metric: M, faces_left: u32) -> Collapser<'a, M> {
        let mut collapser = Collapser {
            best: vec![NONE; work.points.len()],
            work,
            metric,
            heap: Heap::new(),
            targets: Vec::new(),
            place: None,
            faces_left,
            dearest: 0,
            log: Log::default(),
        };
        collapser.log.reserve(collapser.work.points.len(), collapser.work.faces.len());
        collapser.price_all();
        collapser
    }

    /// Collapses until at most `floor` faces are left, or nothing legal of at most that rank.
    pub(super) fn run(&mut self, floor: u32, limit: u32) {
        while self.faces_left > floor && self.heap.first() <= entry(limit, NONE) {
            let Some(front) = self.heap.pop() else { break };
            let (rank, from) = ((front >> 32) as u32, front as u32);
            let point = &self.work.points[from as usize];
            if point.rank == rank && matches!(point.state, State::Queued | State::Raised) {
                self.advance(from, rank);
            }
        }
    }

    /// What ended it.
    pub(super) fn report(&mut self, collapses: usize, floor: u32) -> SequenceReport {
        SequenceReport {
            collapses: collapses as u32,
            faces_left: self.faces_left,
            at_floor: self.faces_left <= floor,
            blocked: self.tally(),
        }
    }

    /// The order of [`Collapser::run`] the plain way: at every step all legal collapses are priced anew.
    #[cfg(test)]
    pub(super) fn naive_order(mut self) -> Vec<[u32; 2]> {
        loop {
            let mut best: Option<(u64, u32)> = None;
            for from in 0..self.work.points.len() as u32 {
                self.price(from);
                find_targets(&self.work, &self.metric, from, &mut self.targets);
                for (rank, to) in self.targets.clone() {
                    let offered = (entry(rank, from), to);
                    if best.is_none_or(|b| offered < b) && self.test(from, to).is_none() {
                        best = Some(offered);
                    }
                }
            }
            let Some((front, to)) = best else { break };
            self.test(front as u32, to);
            self.collapse(front as u32, to, (front >> 32) as u32);
        }
        self.order()
    }

    /// Points that went and where to, by the ids of the part.
    #[cfg(test)]
    pub(super) fn order(&self) -> Vec<[u32; 2]> {
        self.log.collapses.iter().map(|c| [c.from, c.to]).collect()
    }

    fn price_all(&mut self) {
        let points = (0..self.work.points.len() as u32).into_par_iter().with_min_len(1024);
        let found: Vec<Option<Target>> = points.map(|p| cheapest(&self.work, &self.metric, p)).collect();
        let mut entries = Vec::with_capacity(found.len());
        for (p, target) in found.into_iter().enumerate() {
            if let Some((rank, to)) = target {
                let point = &mut self.work.points[p];
                (point.rank, point.state, self.best[p]) = (rank, State::Queued, to);
                entries.push(entry(rank, p as u32));
            } else if moves(self.work.points[p].kind) != Moves::Never && self.work.points[p].count > 0 {
                self.work.points[p].state = State::Blocked;
            }
        }
        self.heap = Heap::of(entries);
    }

    /// Does the cheapest legal collapse of `from`, the front of the queue, if it is the cheapest of all; puts `from` back, if not.
    fn advance(&mut self, from: u32, rank: u32) {
        if self.work.points[from as usize].state == State::Queued {
            let to = self.best[from as usize];
            // Two points that are left lose no edge between them.
            if self.work.points[to as usize].count > 0
                && self.rank_of(from, to) == rank
                && self.test(from, to).is_none()
            {
                self.collapse(from, to, rank);
                return;
            }
        }
        find_targets(&self.work, &self.metric, from, &mut self.targets);
        self.targets.sort_unstable();
        for i in 0..self.targets.len() {
            let (cost, to) = self.targets[i];
            if cost > rank && entry(cost, from) > self.heap.first() {
                self.enqueue(from, cost, to, if i == 0 { State::Queued } else { State::Raised });
                return;
            }
            if self.test(from, to).is_none() {
                self.collapse(from, to, cost);
                return;
            }
        }
        self.work.points[from as usize].state = State::Blocked;
    }

    /// The rule that forbids taking `from` to `to`; leaves what [`Collapser::collapse`] needs.
    fn test(&mut self, from: u32, to: u32) -> Option<Rule> {
        self.place = if M::PLACES { self.metric.place(&self.work, from, to) } else { None };
        self.work.test(from, to, self.place)
    }

    #[inline]
    fn rank_of(&self, from: u32, to: u32) -> u32 {
        self.work.ranked(from, self.metric.cost(&self.work, from, to, NONE))
    }

    #[inline]
    fn enqueue(&mut self, p: u32, rank: u32, to: u32, state: State) {
        let point = &mut self.work.points[p as usize];
        point.rank = rank;
        point.state = state;
        self.best[p as usize] = to;
        self.heap.push(entry(rank, p));
    }

    /// Puts `p` into the queue with the cost of its cheapest target, legal or not.
    fn price(&mut self, p: u32) {
        if M::FALLS {
            self.metric.star_changed(&self.work, p);
        }
        match cheapest(&self.work, &self.metric, p) {
            Some((rank, to)) => self.enqueue(p, rank, to, State::Queued),
            None => {
                // It may get a target yet, unless it never moves or is gone.
                let point = &mut self.work.points[p as usize];
                let done = point.count == 0 || moves(point.kind) == Moves::Never;
                point.state = if done { State::Out } else { State::Blocked };
            }
        }
    }

    /// Takes `from` to `to`, which were tested last, at a cost of that rank.
    fn collapse(&mut self, from: u32, to: u32, rank: u32) {
        let error = self.metric.merge(&mut self.work, from, to, self.place) as f32;
        let [goes, stays] = [from, to].map(|p| &self.work.points[p as usize]);
        let since = rank.max(goes.since).max(stays.since);
        self.dearest = self.dearest.max(rank);
        self.log.begin(from, to, error, since);
        self.log.pairs.extend_from_slice(&self.work.map);
        self.work.collapse(from, to);
        if M::PLACES {
            let position = &mut self.work.points[to as usize].position;
            *position = self.place.map_or(*position, |place| place.as_vec3());
            self.log.places.push(position.to_array());
            self.metric.star_changed(&self.work, to);
            for i in 0..self.work.corners(to).len() {
                let [a, b] = self.work.others(self.work.corners(to)[i]);
                // In a closed fan every neighbour comes first once; in an open one the last comes second only.
                self.change(a, since);
                if self.work.points[b as usize].line != [NONE; 2] {
                    self.change(b, since);
                }
            }
        }
        self.log.faces.extend_from_slice(&self.work.vanished);
        self.faces_left -= self.work.vanished.len() as u32;
        self.work.points[from as usize].state = State::Out;
        self.work.points[to as usize].since = since;
        for i in 0..self.work.ring.len() {
            let point = &mut self.work.points[self.work.ring[i] as usize];
            point.since = point.since.max(since);
        }

        self.price(to);
        if M::FALLS {
            self.price_ring(to);
        } else {
            for i in 0..self.work.ring.len() {
                self.offer(self.work.ring[i], to);
            }
        }
    }

    fn change(&mut self, p: u32, since: u32) {
        self.metric.star_changed(&self.work, p);
        let point = &mut self.work.points[p as usize];
        point.since = point.since.max(since);
    }

    /// Prices all neighbours of `to` anew.
    fn price_ring(&mut self, to: u32) {
        let mut ring = std::mem::take(&mut self.work.ring);
        ring.clear();
        ring.extend(self.work.corners(to).iter().flat_map(|corner| self.work.others(*corner)));
        ring.sort_unstable();
        ring.dedup();
        for p in &ring {
            if self.work.points[*p as usize].state != State::Out {
                self.price(*p);
            }
        }
        self.work.ring = ring;
    }

    /// Brings the bound of `p`, whose star has changed and which has `to` as a neighbour now, down to where it may lie.
    #[inline]
    fn offer(&mut self, p: u32, to: u32) {
        let point = &self.work.points[p as usize];
        match (point.state, moves(point.kind)) {
            (State::Out, _) | (_, Moves::Never) => {}
            (State::Raised | State::Blocked, _) => self.price(p),
            (State::Queued, Moves::AlongLine) if !point.line.contains(&to) => {}
            (State::Queued, _) if !self.metric.offers(&self.work, p, to) => {}
            (State::Queued, _) => {
                let offered = self.rank_of(p, to);
                let point = &self.work.points[p as usize];
                if offered < point.rank {
                    self.enqueue(p, offered, to, State::Queued);
                } else if offered == point.rank && to < self.best[p as usize] {
                    self.best[p as usize] = to;
                }
            }
        }
    }

    /// For each rule, how many of the points that are left it keeps: each by the rule that forbids its cheapest target.
    fn tally(&mut self) -> [u32; RULE_COUNT] {
        let mut blocked = [0; RULE_COUNT];
        for p in 0..self.work.points.len() as u32 {
            if self.work.points[p as usize].count == 0 {
                continue;
            }
            let rule = match cheapest(&self.work, &self.metric, p) {
                None => Some(Rule::Kind),
                Some((_, to)) => self.test(p, to),
            };
            if let Some(rule) = rule {
                blocked[rule as usize] += 1;
            }
        }
        blocked
    }
}

/// The targets that the table of kinds allows `p`, in no order.
fn find_targets<M: Metric>(work: &Working<'_>, metric: &M, p: u32, targets: &mut Vec<Target>) {
    targets.clear();
    each_target(work, metric, p, |target| targets.push(target));
}

/// The cheapest of them, legal or not.
fn cheapest<M: Metric>(work: &Working<'_>, metric: &M, p: u32) -> Option<Target> {
    let mut least = (u32::MAX, NONE);
    each_target(work, metric, p, |target| least = least.min(target));
    (least.1 != NONE).then_some(least)
}

#[inline]
fn each_target<M: Metric>(work: &Working<'_>, metric: &M, p: u32, mut out: impl FnMut(Target)) {
    let point = &work.points[p as usize];
    if point.count == 0 {
        return;
    }
    match moves(point.kind) {
        Moves::Never => {}
        Moves::AlongLine => {
            for to in point.line {
                if to != NONE && !work.points[to as usize].held {
                    out((work.ranked(p, metric.cost(work, p, to, NONE)), to));
                }
            }
        }
        Moves::Anywhere => {
            // In a closed fan every neighbour follows `p` in exactly one face.
            metric.costs(work, p, |cost, to| {
                if !work.points[to as usize].held {
                    out((rank(work.weighed(p, cost)), to));
                }
            });
        }
    }
}
