//! Work over independent items on up to two threads, the longest first; results stand in the items' order, whoever made them.

use crate::prelude::*;

/// Below that many bytes a second thread starts later than the first is done.
#[cfg(feature = "std")]
const WORTH: usize = 4 << 20;

/// How many threads validation and decoding of so many bytes take: two where the machine has them, so that a loader beside a game keeps
/// to itself.
pub(crate) fn threads(bytes: usize) -> usize {
    #[cfg(feature = "std")]
    if bytes >= WORTH {
        return std::thread::available_parallelism().map_or(1, |threads| threads.get().min(2));
    }
    let _ = bytes;
    1
}

/// `work(i)` for every item; `lengths[i]` says how long it takes, in any unit.
pub(crate) fn spread<T: Send>(threads: usize, lengths: &[u64], work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    #[cfg(feature = "std")]
    if threads > 1 && lengths.len() > 1 {
        return on_threads(threads.min(lengths.len()), lengths, work);
    }
    let _ = threads;
    (0..lengths.len()).map(work).collect()
}

#[cfg(feature = "std")]
fn on_threads<T: Send>(threads: usize, lengths: &[u64], work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    use std::sync::atomic::{AtomicUsize, Ordering};
    let mut order: Vec<usize> = (0..lengths.len()).collect();
    // The longest first, so that no thread is left with it at the end.
    order.sort_by_key(|i| (core::cmp::Reverse(lengths[*i]), *i));
    let next = AtomicUsize::new(0);
    let share = || {
        let mut made = Vec::new();
        while let Some(i) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
            made.push((*i, work(*i)));
        }
        made
    };
    let mut made = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(share)).collect();
        let mut made = share();
        for other in others {
            match other.join() {
                Ok(more) => made.extend(more),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        made
    });
    made.sort_unstable_by_key(|(i, _)| *i);
    made.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_stand_in_the_order_of_their_items_on_any_number_of_threads() {
        let lengths: Vec<u64> = (0..100).map(|i| i * 37 % 11).collect();
        let expected: Vec<usize> = (0..100).map(|i| i * i).collect();
        for threads in [1, 2, 5, 200] {
            assert_eq!(spread(threads, &lengths, |i| i * i), expected);
        }
        assert_eq!(spread(2, &[], |i| i), Vec::<usize>::new());
    }
}
