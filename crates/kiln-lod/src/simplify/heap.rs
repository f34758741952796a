//! A heap of points ordered by (cost, point), four children a node, in which a point's cost can be changed in place.

use crate::topology::NONE;

pub(super) struct Heap {
    items: Vec<(f64, u32)>,
    /// `[point_count]`: where each point stands in `items`.
    place: Vec<u32>,
}

fn less(a: (f64, u32), b: (f64, u32)) -> bool {
    match a.0.total_cmp(&b.0) {
        std::cmp::Ordering::Equal => a.1 < b.1,
        order => order.is_lt(),
    }
}

impl Heap {
    pub(super) fn new(points: usize) -> Heap {
        Heap { items: Vec::with_capacity(points), place: vec![NONE; points] }
    }

    /// Puts `point` in with `cost`, or changes its cost.
    pub(super) fn set(&mut self, point: u32, cost: f64) {
        let at = self.place[point as usize];
        if at == NONE {
            self.items.push((cost, point));
            self.up(self.items.len() - 1);
        } else {
            let at = at as usize;
            let old = self.items[at];
            self.items[at] = (cost, point);
            if less((cost, point), old) { self.up(at) } else { self.down(at) }
        }
    }

    pub(super) fn remove(&mut self, point: u32) {
        let at = self.place[point as usize];
        if at == NONE {
            return;
        }
        self.place[point as usize] = NONE;
        let at = at as usize;
        let Some(last) = self.items.pop() else { return };
        if at < self.items.len() {
            self.items[at] = last;
            self.place[last.1 as usize] = at as u32;
            self.up(at);
            self.down(self.place[last.1 as usize] as usize);
        }
    }

    /// The cost of `point`, if it is in.
    pub(super) fn cost(&self, point: u32) -> Option<f64> {
        let at = self.place[point as usize];
        if at == NONE { None } else { Some(self.items[at as usize].0) }
    }

    pub(super) fn first(&self) -> Option<(f64, u32)> {
        self.items.first().copied()
    }

    fn up(&mut self, mut at: usize) {
        let item = self.items[at];
        while at > 0 {
            let parent = (at - 1) / 4;
            if !less(item, self.items[parent]) {
                break;
            }
            self.items[at] = self.items[parent];
            self.place[self.items[at].1 as usize] = at as u32;
            at = parent;
        }
        self.items[at] = item;
        self.place[item.1 as usize] = at as u32;
    }

    fn down(&mut self, mut at: usize) {
        let item = self.items[at];
        loop {
            let start = 4 * at + 1;
            let mut least = None;
            for child in start..(start + 4).min(self.items.len()) {
                if less(self.items[child], least.map_or(item, |l: usize| self.items[l])) {
                    least = Some(child);
                }
            }
            let Some(child) = least else { break };
            self.items[at] = self.items[child];
            self.place[self.items[at].1 as usize] = at as u32;
            at = child;
        }
        self.items[at] = item;
        self.place[item.1 as usize] = at as u32;
    }
}
