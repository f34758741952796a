//! Where two members of a forest meet, in the logarithm of its depth.
//!
//! Every member has a parent with a lower number, or is a root. Beside the parent it has a *jump*: an ancestor chosen so that
//! walking by jumps where they do not go too far, and by parents else, takes at most about three times the binary logarithm
//! of the depth (Myers, An applicative random-access stack, Information Processing Letters 17, 1983). No chain of parents,
//! however long a hostile file makes it, is walked step by step.

use crate::prelude::*;

pub(super) struct Forest {
    parents: Vec<u32>,
    jumps: Vec<u32>,
    depths: Vec<u32>,
}

impl Forest {
    /// No members, room for some.
    pub(super) fn with_capacity(count: usize) -> Forest {
        let room = || Vec::with_capacity(count);
        Forest { parents: room(), jumps: room(), depths: room() }
    }

    /// The next member, whose parent is one before it, or itself for a root.
    pub(super) fn push(&mut self, parent: u32) {
        let own = self.parents.len() as u32;
        debug_assert!(parent <= own, "a parent stands before its child");
        self.parents.push(parent);
        if parent == own {
            self.jumps.push(own);
            self.depths.push(0);
            return;
        }
        let p = parent as usize;
        let jump = self.jumps[p] as usize;
        // Two jumps of the same length in a row make one of twice that length and one.
        let even = self.depths[p] - self.depths[jump] == self.depths[jump] - self.depths[self.jumps[jump] as usize];
        self.jumps.push(if even { self.jumps[jump] } else { parent });
        self.depths.push(self.depths[p] + 1);
    }

    /// The last step that is taken before the ways of two members to their roots meet, if the greater number always goes on:
    /// the lower numbered of the two children through which they reach the place where they meet, or the one child where one
    /// member is above the other. `None` if they never meet. The members differ.
    pub(super) fn last_step(&self, a: u32, b: u32) -> Option<u32> {
        let (mut a, mut b) = (a as usize, b as usize);
        let depth = self.depths[a].min(self.depths[b]);
        // One step deeper than the other, to see the child by which it comes.
        let (deep, mut low, mut below) =
            if self.depths[a] > depth { (true, a, b) } else { (self.depths[b] > depth, b, a) };
        if deep {
            low = self.ancestor(low, depth + 1);
            let up = self.parents[low] as usize;
            if up == below {
                return Some(low as u32);
            }
            (a, b) = (up, below);
        }
        // Same depth, different members.
        below = b;
        let mut other = a;
        while self.parents[below] != self.parents[other] {
            if self.depths[below] == 0 {
                return None;
            }
            let far = self.jumps[below] != self.jumps[other];
            let next = if far { &self.jumps } else { &self.parents };
            (below, other) = (next[below] as usize, next[other] as usize);
        }
        Some(below.min(other) as u32)
    }

    fn ancestor(&self, mut member: usize, depth: u32) -> usize {
        while self.depths[member] > depth {
            let jump = self.jumps[member] as usize;
            member = if self.depths[jump] >= depth { jump } else { self.parents[member] as usize };
        }
        member
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the specification tells it: the greater number goes to its parent until they are equal.
    fn naive(parents: &[u32], mut a: u32, mut b: u32) -> Option<u32> {
        let mut last = None;
        while a != b {
            let greater = if a > b { &mut a } else { &mut b };
            if parents[*greater as usize] == *greater {
                return None;
            }
            last = Some(*greater);
            *greater = parents[*greater as usize];
        }
        last
    }

    proptest::proptest! {
        #[test]
        fn two_members_meet_where_the_naive_walk_says(
            parents in proptest::collection::vec(0u32..1000, 1..120),
            reach in 1u32..20,
        ) {
            // Small reaches make long chains, large ones bushy trees; every eighth is a root.
            let parent = |(i, p): (usize, &u32)| {
                let i = i as u32;
                if i == 0 || p % 8 == 0 { i } else { i - 1 - p / 8 % reach.min(i) }
            };
            let parents: Vec<u32> = parents.iter().enumerate().map(parent).collect();
            let mut forest = Forest::with_capacity(parents.len());
            parents.iter().for_each(|p| forest.push(*p));
            for a in 0..parents.len() as u32 {
                for b in 0..a {
                    proptest::prop_assert_eq!(forest.last_step(a, b), naive(&parents, a, b), "{} {}", a, b);
                    proptest::prop_assert_eq!(forest.last_step(b, a), naive(&parents, a, b), "{} {}", b, a);
                }
            }
        }
    }

    #[test]
    fn a_chain_of_a_million_is_no_work() {
        let mut forest = Forest::with_capacity(1_000_001);
        forest.push(0);
        (0..1_000_000).for_each(|p| forest.push(p));
        for a in (1..1_000_000).step_by(7) {
            assert_eq!(forest.last_step(a, 1_000_000), Some(a + 1));
        }
    }
}
