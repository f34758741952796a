//! A queue of points by (cost, point): four children a node, one 64-bit word an entry, so that a node's children share a
//! cache line and one comparison orders both.

/// Least first. Holds entries that are out of date, too: whoever pops one asks the point whether it still stands by that cost.
pub(super) struct Heap(Vec<u64>);

/// A cost as 32 bits that are ordered as costs are; below 0 counts as 0. Equal ones are ordered by point.
#[inline]
pub(super) fn rank(cost: f32) -> u32 {
    cost.max(0.0).to_bits()
}

/// Where `point` stands in the order with a cost of that rank.
#[inline]
pub(super) fn entry(rank: u32, point: u32) -> u64 {
    u64::from(rank) << 32 | u64::from(point)
}

impl Heap {
    pub(super) fn new() -> Heap {
        Heap(Vec::new())
    }

    /// A queue of these entries.
    pub(super) fn of(entries: Vec<u64>) -> Heap {
        let mut heap = Heap(entries);
        for at in (0..heap.0.len().div_ceil(4)).rev() {
            let entry = heap.0[at];
            heap.sink(at, entry);
        }
        heap
    }

    /// The least entry; greater than all others if there is none.
    #[inline]
    pub(super) fn first(&self) -> u64 {
        self.0.first().copied().unwrap_or(u64::MAX)
    }

    #[inline]
    pub(super) fn push(&mut self, entry: u64) {
        let mut at = self.0.len();
        self.0.push(entry);
        while at > 0 {
            let parent = (at - 1) / 4;
            if self.0[parent] <= entry {
                break;
            }
            self.0[at] = self.0[parent];
            at = parent;
        }
        self.0[at] = entry;
    }

    /// Puts `entry` where it belongs at `at` or below, where it takes a free place.
    #[inline]
    fn sink(&mut self, mut at: usize, entry: u64) {
        let items = &mut self.0[..];
        loop {
            let start = 4 * at + 1;
            let (child, least) = if let Some(&[a, b, c, d]) = items.get(start..start + 4) {
                let low = if b < a { (start + 1, b) } else { (start, a) };
                let high = if d < c { (start + 3, d) } else { (start + 2, c) };
                if high.1 < low.1 { high } else { low }
            } else {
                let last = (start..).zip(items.get(start..).unwrap_or_default());
                match last.min_by_key(|(_, entry)| **entry) {
                    Some((child, least)) => (child, *least),
                    None => break,
                }
            };
            if least >= entry {
                break;
            }
            items[at] = least;
            at = child;
        }
        items[at] = entry;
    }

    pub(super) fn pop(&mut self) -> Option<u64> {
        let last = self.0.pop()?;
        let Some(first) = self.0.first().copied() else { return Some(last) };
        self.sink(0, last);
        Some(first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_come_out_by_cost_and_then_by_point() {
        let mut heap = Heap::new();
        let costs = [3.0, 0.5, 0.5, -1.0, 1e30, 0.0, 2.0, 0.5];
        for (point, cost) in costs.iter().enumerate() {
            heap.push(entry(rank(*cost), point as u32));
        }
        let at_once = Heap::of(costs.iter().zip(0..).map(|(cost, point)| entry(rank(*cost), point)).collect());
        for mut heap in [heap, at_once] {
            let order: Vec<u32> = std::iter::from_fn(|| heap.pop()).map(|entry| entry as u32).collect();
            assert_eq!(order, [3, 5, 1, 2, 7, 6, 0, 4]);
        }
    }
}
