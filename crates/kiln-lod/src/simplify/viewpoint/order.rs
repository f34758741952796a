//! The loop: candidates in order of what views lose by them.
//!
//! ```text
//! record  <- for each point its legal targets, each with its deltas, its cost and the time
//! queue   <- each point by its cheapest target
//! while the queue has a point, and more faces than the floor are left:
//!     from, to <- the front
//!     no longer legal: drop that target, put `from` back
//!     a fragment under its star changed since its time: its deltas anew                         (price)
//!     its cost anew, from the deltas and the histograms of now; no longer the least: put `from` back
//!     collapse; draw the star anew; price all targets of the points whose faces changed
//! ```
//! So the cost at which a collapse is done is that of drawing everything again at that moment. A cost that fell unnoticed, since
//! something changed in front of or behind its star or in the totals, is found when it comes to the front, not before.
//! `update = "published"` prices figure 5.5's set instead, and does what the queue says without looking again.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::{Mutex, PoisonError};

use kiln_asset::Mesh;
use rayon::prelude::*;

use super::formula::Delta;
use super::gpu::Device;
use super::price::{Limit, Scratch, Star, price};
use super::scene::Scene;
use super::{Update, ViewCondition};
use crate::simplify::log::Log;
use crate::simplify::metric::Metric;
use crate::simplify::rules::{Moves, RULE_COUNT, Rule, moves};
use crate::simplify::sequence::{CollapseSequence, SequenceReport};
use crate::simplify::working::Working;
use crate::simplify::{Boundary, SimplifyOptions};
use crate::topology::{NONE, PointKind};

/// What a point moved by the model's whole size counts beside a pixel of a view, when views see no difference.
const TIE: f64 = 1.0 / 1024.0;
/// Faces at a point above which only its [`HUB_TARGETS`] geometrically cheapest legal targets are candidates, priced when they come to the
/// front: pricing all targets of a hub takes the square of its faces for each of its neighbours that goes.
const HUB: usize = 64;
const HUB_TARGETS: usize = 8;
/// So many of them are tested at most.
const HUB_TESTS: usize = 64;
/// Targets are given up once they cost so many times what the dearest collapse did. More spends time on candidates that change before it
/// is their turn; less looks at them again and again.
const AHEAD: f64 = 2.0;
/// Points that are priced at a time at the start: bounds the memory of their stars.
const BATCH: usize = 4096;

/// A candidate of a point.
#[derive(Clone, Copy, Debug)]
struct Target {
    to: u32,
    /// Where its deltas lie in the record.
    first: u32,
    end: u32,
    /// The time of its deltas; [`NONE`] if it has none.
    time: u32,
    /// What views lose, and the geometric tie-breaker.
    cost: f64,
    tie: f64,
}

/// The candidates of a point.
#[derive(Default)]
struct Record {
    targets: Vec<Target>,
    deltas: Vec<Delta>,
}

impl Record {
    /// The cheapest, then lowest target.
    fn best(&self) -> Option<usize> {
        let order = |a: &Target, b: &Target| a.cost.total_cmp(&b.cost).then(a.to.cmp(&b.to));
        (0..self.targets.len()).min_by(|a, b| order(&self.targets[*a], &self.targets[*b]))
    }

    /// Replaces the deltas of target `i`.
    fn replace(&mut self, i: usize, deltas: &[Delta], time: u32) {
        let Target { first, end, .. } = self.targets[i];
        self.deltas.splice(first as usize..end as usize, deltas.iter().copied());
        let (new_end, end) = (first + deltas.len() as u32, end);
        for target in &mut self.targets {
            if target.first >= end && target.end > first {
                target.first = target.first - end + new_end;
                target.end = target.end - end + new_end;
            }
        }
        let target = &mut self.targets[i];
        (target.first, target.end, target.time) = (first, new_end, time);
    }
}

/// A point whose candidates are priced.
#[derive(Default)]
struct Job {
    star: Star,
    ties: Vec<f64>,
    record: Record,
    /// Only these targets are priced anew; the record's others stand.
    partial: bool,
}

/// What was known at a collapse, and what drawing everything says.
#[cfg(test)]
pub(super) struct Witness {
    pub(super) pair: [u32; 2],
    pub(super) known: (f64, Vec<Delta>),
    pub(super) drawn: (f64, Vec<Delta>),
    /// Whether all pixel counts were those of drawing everything before the collapse.
    pub(super) counts: bool,
}

pub(super) struct Order<'a, M> {
    work: Working<'a>,
    metric: M,
    scene: Scene<'a>,
    condition: &'a ViewCondition<'a>,
    /// What prices batches until the first collapse, if not the CPU.
    device: Option<Device<'a>>,
    update: Update,
    last: bool,
    floor: f64,
    tie: f64,
    /// What the dearest collapse cost, by importance.
    dearest: f64,
    /// `[point_count]`.
    records: Vec<Record>,
    /// `[point_count]`: the key of each point in the queue; `u64::MAX` if it is not in it.
    keys: Vec<u64>,
    heap: BinaryHeap<Reverse<(u64, u32)>>,
    /// `[point_count]`: whether a target of the point was found illegal.
    blocked: Vec<bool>,
    /// `[point_count]`: when the point was put on the list last.
    listed: Vec<u32>,
    lists: u32,
    list: Vec<u32>,
    jobs: Vec<Job>,
    star: Star,
    scratch: Mutex<Vec<Scratch>>,
    /// Faces and vertices of the mesh.
    size: [u32; 2],
    faces_left: u32,
    log: Log,
    /// One for each collapse, if they are wanted.
    #[cfg(test)]
    pub(super) witnesses: Option<Vec<Witness>>,
}

/// A scratch from the store, or a new one.
fn borrowed(store: &Mutex<Vec<Scratch>>, scene: &Scene<'_>, face_count: u32) -> Scratch {
    let stored = store.lock().unwrap_or_else(PoisonError::into_inner).pop();
    stored.unwrap_or_else(|| Scratch::new(scene.screens, face_count as usize))
}

fn given_back(store: &Mutex<Vec<Scratch>>, scratch: Scratch) {
    store.lock().unwrap_or_else(PoisonError::into_inner).push(scratch);
}

/// What a limit by importance is before it for `from`.
fn limit_of(work: &Working<'_>, from: u32, limit: f64) -> f64 {
    let importance = f64::from(work.importance(from));
    if importance > 0.0 { limit / importance } else { f64::INFINITY }
}

impl<'a, M: Metric + Sync> Order<'a, M> {
    pub(super) fn new(
        mesh: &Mesh,
        work: Working<'a>,
        metric: M,
        options: &SimplifyOptions,
        condition: &'a ViewCondition<'a>,
    ) -> Order<'a, M> {
        let points = work.points.len();
        let scene = Scene::new(&condition.screens, &condition.formula, &work);
        Order {
            tie: TIE / scene.screens.pixels() as f64,
            dearest: f64::INFINITY,
            device: condition.gpu.and_then(|gpu| condition.tried(Device::new(gpu, &scene))),
            condition,
            scene,
            work,
            metric,
            update: condition.options.update,
            last: options.boundary == Boundary::Last,
            floor: options.floor,
            records: (0..points).map(|_| Record::default()).collect(),
            keys: vec![u64::MAX; points],
            heap: BinaryHeap::new(),
            blocked: vec![false; points],
            listed: vec![0; points],
            lists: 0,
            list: Vec::new(),
            jobs: Vec::new(),
            star: Star::default(),
            scratch: Mutex::new(Vec::new()),
            size: [mesh.face_count() as u32, mesh.vertex_count() as u32],
            faces_left: mesh.face_count() as u32,
            log: Log::default(),
            #[cfg(test)]
            witnesses: None,
        }
    }

    /// Collapses until nothing legal is left or the floor is reached.
    pub(super) fn run(&mut self) -> CollapseSequence {
        let floor = (self.floor * f64::from(self.faces_left)) as u32;
        let points = self.work.points.len();
        for start in (0..points).step_by(BATCH) {
            self.list.clear();
            self.list.extend(start as u32..(start + BATCH).min(points) as u32);
            self.price_list();
        }
        self.device = None;
        self.dearest = if self.update == Update::Exact { 0.0 } else { f64::INFINITY };
        while self.faces_left > floor
            && let Some(Reverse((key, from))) = self.heap.pop()
        {
            if self.keys[from as usize] == key {
                self.keys[from as usize] = u64::MAX;
                self.advance(from);
            }
        }
        let blocked = self.tally();
        let mut log = Log::default();
        log.append(&self.log, &self.work.names);
        let mut out = log.finish(self.size[0], self.size[1], false);
        out.report = SequenceReport {
            collapses: out.collapses.len() as u32,
            faces_left: self.faces_left,
            at_floor: self.faces_left <= floor,
            blocked,
        };
        out
    }

    /// A cost of `from` by its importance.
    fn weighed(&self, from: u32, cost: f64) -> f64 {
        f64::from(self.work.importance(from)) * cost
    }

    /// What geometry says of a collapse, far less than a pixel, and what a texture border adds.
    fn tie(&self, from: u32, to: u32) -> f64 {
        let cost = self.metric.cost(&self.work, from, to, NONE) * self.metric.quadric_unit();
        let cost = if cost.is_nan() { 1.0 } else { cost.clamp(0.0, 1.0) };
        self.tie * f64::from(cost).sqrt() + self.metric.surcharge(&self.work, from, to)
    }

    /// Puts `from` into the queue by its cheapest target, if it has one.
    fn enqueue(&mut self, from: u32) {
        let record = &self.records[from as usize];
        self.keys[from as usize] = match record.best() {
            None => u64::MAX,
            Some(best) => {
                // The sign bit of a cost is free: with it set, a key lies behind all others.
                let last = self.last && self.work.points[from as usize].kind == PointKind::Boundary;
                let cost = self.weighed(from, record.targets[best].cost);
                let key = cost.to_bits() | u64::from(last) << 63;
                self.heap.push(Reverse((key, from)));
                key
            }
        };
    }

    /// Does the cheapest collapse of `from` if it is the cheapest of all; puts `from` back, if not.
    fn advance(&mut self, from: u32) {
        let Some(best) = self.records[from as usize].best() else { return };
        let Target { to, cost, .. } = self.records[from as usize].targets[best];
        if self.work.points[to as usize].count == 0 || self.work.test(from, to, None).is_some() {
            self.records[from as usize].targets.remove(best);
            self.blocked[from as usize] = true;
            self.enqueue(from);
            return;
        }
        self.star.read(&self.work, from);
        self.star.add(&self.work, to);
        if self.update == Update::Exact || self.records[from as usize].targets[best].time == NONE {
            let now = self.look_again(from, best);
            if now != cost {
                self.enqueue(from);
                let first = self.heap.peek().map_or((u64::MAX, NONE), |first| first.0);
                if self.records[from as usize].best() != Some(best) || first != (self.keys[from as usize], from) {
                    return;
                }
                self.keys[from as usize] = u64::MAX;
            }
            self.dearest = self.dearest.max(self.weighed(from, now));
        }
        self.collapse(from, to);
    }

    /// Brings the deltas and the cost of a target up to date; the cost. [`Order::star`] holds it.
    fn look_again(&mut self, from: u32, best: usize) -> f64 {
        let limit = limit_of(&self.work, from, self.limit());
        let Order { scene, scratch, star, records, .. } = self;
        let record = &mut records[from as usize];
        let mut memory = borrowed(scratch, scene, self.size[0]);
        let time = record.targets[best].time;
        if time == NONE || star.changed(scene.screens, &scene.layers, time) {
            let limit = Limit { formula: scene.formula, histogram: &scene.histogram, cost: limit };
            let limited = scene.formula.adds_up().then_some(&limit);
            price(scene.screens, &scene.layers, star, limited, &mut memory);
            if memory.partial[0].1 {
                let target = &mut record.targets[best];
                (target.time, target.cost) = (NONE, memory.partial[0].0 + target.tie);
                let cost = target.cost;
                given_back(scratch, memory);
                return cost;
            }
            record.replace(best, &memory.deltas[0], scene.now);
        }
        let Target { first, end, .. } = record.targets[best];
        let deltas = &record.deltas[first as usize..end as usize];
        let seen = scene.formula.cost(&scene.histogram, deltas, &mut memory.cost);
        given_back(scratch, memory);
        let tie = self.tie(from, self.records[from as usize].targets[best].to);
        let target = &mut self.records[from as usize].targets[best];
        (target.tie, target.cost) = (tie, seen + tie);
        target.cost
    }

    /// Beyond what cost, by importance, a target is given up.
    fn limit(&self) -> f64 {
        // The last one must be known.
        let front = self.heap.peek().map_or(f64::INFINITY, |Reverse((key, _))| f64::from_bits(key & !(1 << 63)));
        AHEAD * self.dearest.max(front)
    }

    /// Takes `from` to `to`, which were tested last and are in [`Order::star`].
    fn collapse(&mut self, from: u32, to: u32) {
        #[cfg(test)]
        self.bear_witness(from, to);
        self.scene.collapse(&self.star);
        let error = self.metric.merge(&mut self.work, from, to, None) as f32;
        // One part: the log has its order.
        self.log.begin(from, to, error, 0);
        self.log.pairs.extend_from_slice(&self.work.map);
        self.work.collapse(from, to);
        self.log.faces.extend_from_slice(&self.work.vanished);
        self.faces_left -= self.work.vanished.len() as u32;
        self.records[from as usize] = Record::default();
        self.lists += 1;
        self.list.clear();
        self.list.push(to);
        self.list.extend_from_slice(&self.work.ring);
        for p in &self.list {
            self.listed[*p as usize] = self.lists;
            self.metric.star_changed(&self.work, *p);
        }
        self.list_unblocked();
        self.price_list();
        if self.update == Update::Published {
            self.price_published(to);
        }
    }

    /// Adds to the list the points behind it that may go onto one of it now, and could not before.
    fn list_unblocked(&mut self) {
        for i in 0..self.list.len() {
            let to = self.list[i];
            for c in 0..self.work.corners(to).len() {
                for from in self.work.others(self.work.corners(to)[c]) {
                    if !self.blocked[from as usize] || self.listed[from as usize] == self.lists {
                        continue;
                    }
                    let known = self.records[from as usize].targets.iter().any(|target| target.to == to);
                    let allowed = match moves(self.work.points[from as usize].kind) {
                        Moves::Never => false,
                        Moves::AlongLine => self.work.points[from as usize].line.contains(&to),
                        Moves::Anywhere => true,
                    };
                    if !known && allowed && self.work.test(from, to, None).is_none() {
                        self.listed[from as usize] = self.lists;
                        self.list.push(from);
                    }
                }
            }
        }
    }

    /// Prices the candidates of all points on the list.
    fn price_list(&mut self) {
        let mut jobs = std::mem::take(&mut self.jobs);
        let mut count = 0;
        let list = std::mem::take(&mut self.list);
        for p in &list {
            if count == jobs.len() {
                jobs.push(Job::default());
            }
            if self.read_job(*p, &mut jobs[count]) {
                count += 1;
            }
        }
        self.finish_jobs(&mut jobs[..count]);
        (self.jobs, self.list) = (jobs, list);
        self.jobs.truncate(BATCH);
    }

    /// Prices the candidates on the edges at the neighbours of `kept` from their other ends: with what [`Order::price_list`] did,
    /// figure 5.5's set.
    fn price_published(&mut self, kept: u32) {
        self.lists += 1;
        let ring: Vec<u32> = self.work.corners(kept).iter().flat_map(|corner| self.work.others(*corner)).collect();
        for p in ring.iter().chain([&kept]) {
            self.listed[*p as usize] = self.lists;
        }
        let mut jobs: Vec<Job> = Vec::new();
        // The neighbours themselves, those of them that were not priced yet.
        self.list.clear();
        for p in &ring {
            if !self.list.contains(p) && !self.work.ring.contains(p) {
                self.list.push(*p);
            }
        }
        self.price_list();
        let mut seen: Vec<u32> = Vec::new();
        for p in &ring {
            seen.extend(self.work.corners(*p).iter().flat_map(|corner| self.work.others(*corner)));
        }
        seen.sort_unstable();
        seen.dedup();
        for from in seen {
            if self.listed[from as usize] == self.lists {
                continue;
            }
            let mut job = Job { partial: true, ..Job::default() };
            job.star.read(&self.work, from);
            let targets: Vec<u32> = self.records[from as usize].targets.iter().map(|target| target.to).collect();
            for to in targets.into_iter().filter(|to| self.listed[*to as usize] == self.lists && *to != kept) {
                if self.work.test(from, to, None).is_none() {
                    job.star.add(&self.work, to);
                    job.ties.push(self.tie(from, to));
                }
            }
            if !job.star.to.is_empty() {
                job.record = std::mem::take(&mut self.records[from as usize]);
                jobs.push(job);
            }
        }
        self.finish_jobs(&mut jobs);
    }

    /// Reads the star of `p` with its legal targets into `job`; false if there is nothing to price.
    fn read_job(&mut self, p: u32, job: &mut Job) -> bool {
        self.blocked[p as usize] = false;
        job.star.read(&self.work, p);
        job.ties.clear();
        job.partial = false;
        let point = self.work.points[p as usize];
        let hub = job.star.faces.len() > HUB;
        let before = std::mem::take(&mut self.records[p as usize]);
        if point.count > 0 {
            match moves(point.kind) {
                Moves::Never => {}
                Moves::AlongLine => point.line.iter().filter(|to| **to != NONE).for_each(|to| self.offer(p, *to, job)),
                Moves::Anywhere if hub => self.offer_hub(p, job),
                Moves::Anywhere => (0..job.star.faces.len()).for_each(|i| self.offer(p, job.star.around[i].0[0], job)),
            }
        }
        if job.star.to.is_empty() || hub {
            let cost = before.targets.iter().map(|target| target.cost).fold(f64::INFINITY, f64::min);
            let cost = if cost.is_finite() { cost } else { 0.0 };
            let target = |(to, tie): (&u32, &f64)| Target { to: *to, first: 0, end: 0, time: NONE, cost, tie: *tie };
            let targets = job.star.to.iter().zip(&job.ties).map(target).collect();
            self.records[p as usize] = Record { targets, deltas: Vec::new() };
            self.enqueue(p);
            return false;
        }
        job.record = before;
        true
    }

    /// Adds a target to a job if it is legal.
    fn offer(&mut self, from: u32, to: u32, job: &mut Job) {
        if self.work.test(from, to, None).is_some() {
            self.blocked[from as usize] = true;
            return;
        }
        job.star.add(&self.work, to);
        job.ties.push(self.tie(from, to));
    }

    /// Adds the targets of a hub.
    fn offer_hub(&mut self, from: u32, job: &mut Job) {
        let mut targets: Vec<(f64, u32)> =
            job.star.around.iter().map(|([to, _], _)| (self.tie(from, *to), *to)).collect();
        targets.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, to) in targets.iter().take(HUB_TESTS) {
            if job.star.to.len() < HUB_TARGETS {
                self.offer(from, *to, job);
            }
        }
    }

    /// Prices jobs in parallel and puts their points into the queue, in order.
    fn finish_jobs(&mut self, jobs: &mut [Job]) {
        let priced = (self.device.as_ref())
            .and_then(|device| self.condition.tried(device.price(jobs.iter().map(|job| &job.star))));
        let Order { work, scene, scratch, update, .. } = &*self;
        let (faces, exact, all) = (self.size[0], *update == Update::Exact, self.limit());
        jobs.par_iter_mut().enumerate().for_each(|(j, job)| {
            let mut memory = borrowed(scratch, scene, faces);
            if !priced.as_ref().is_some_and(|priced| priced.fill(j, job.star.to.len(), &mut memory)) {
                let cost = limit_of(work, job.star.from, all);
                let limit = Limit { formula: scene.formula, histogram: &scene.histogram, cost };
                let limited = (exact && scene.formula.adds_up()).then_some(&limit);
                price(scene.screens, &scene.layers, &job.star, limited, &mut memory);
            }
            let Job { star, ties, record, partial } = job;
            if !*partial {
                record.targets.clear();
                record.deltas.clear();
            }
            for (i, (to, tie)) in star.to.iter().zip(ties).enumerate() {
                let deltas = &memory.deltas[i];
                if memory.partial[i].1 {
                    let cost = memory.partial[i].0 + *tie;
                    record.targets.push(Target { to: *to, first: 0, end: 0, time: NONE, cost, tie: *tie });
                    continue;
                }
                let cost = scene.formula.cost(&scene.histogram, deltas, &mut memory.cost) + *tie;
                if *partial && let Some(target) = record.targets.iter_mut().find(|target| target.to == *to) {
                    (target.cost, target.tie) = (cost, *tie);
                    continue;
                }
                let first = record.deltas.len() as u32;
                if exact {
                    record.deltas.extend_from_slice(deltas);
                }
                let end = record.deltas.len() as u32;
                record.targets.push(Target { to: *to, first, end, time: scene.now, cost, tie: *tie });
            }
            given_back(scratch, memory);
        });
        for job in jobs {
            self.records[job.star.from as usize] = std::mem::take(&mut job.record);
            self.enqueue(job.star.from);
        }
    }

    #[cfg(test)]
    fn bear_witness(&mut self, from: u32, to: u32) {
        let Order { work, scene, star, records, witnesses: Some(witnesses), .. } = self else { return };
        let record = &records[from as usize];
        let target = record.targets.iter().find(|target| target.to == to).expect("a target of its record");
        let mut deltas = record.deltas[target.first as usize..target.end as usize].to_vec();
        deltas.sort_unstable();
        let counts = super::twin::counts(scene.screens, || super::scene::faces(work));
        witnesses.push(Witness {
            pair: [from, to],
            known: (target.cost - target.tie, deltas),
            drawn: super::study::drawn(work, scene, star),
            counts: counts == scene.histogram.counts,
        });
    }

    /// For each rule, how many of the points that are left it keeps: each by the rule that forbids its geometrically cheapest target.
    fn tally(&mut self) -> [u32; RULE_COUNT] {
        let mut blocked = [0; RULE_COUNT];
        for p in 0..self.work.points.len() as u32 {
            let point = self.work.points[p as usize];
            if point.count == 0 {
                continue;
            }
            let mut targets: Vec<u32> = match moves(point.kind) {
                Moves::Never => Vec::new(),
                Moves::AlongLine => point.line.iter().copied().filter(|to| *to != NONE).collect(),
                Moves::Anywhere => self.work.corners(p).iter().map(|corner| self.work.others(*corner)[0]).collect(),
            };
            targets.sort_by(|a, b| self.tie(p, *a).total_cmp(&self.tie(p, *b)).then(a.cmp(b)));
            let rule = match targets.first() {
                None => Some(Rule::Kind),
                Some(to) => self.work.test(p, *to, None),
            };
            if let Some(rule) = rule {
                blocked[rule as usize] += 1;
            }
        }
        blocked
    }
}
