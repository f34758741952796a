//! Checks over millions of numbers, written so that the compiler makes vector instructions of them: no early exit inside a
//! chunk, no gather, comparisons instead of `min` and `max`, which would ask about NaN.

/// A box, least and greatest corner.
pub(crate) type Box3 = ([f32; 3], [f32; 3]);

/// An index as a level stores it.
pub(crate) trait Index: Copy + Ord + Into<u32> + TryFrom<u32> {}
impl Index for u16 {}
impl Index for u32 {}

/// Place of the first NaN or infinity: all eight bits of the exponent set.
pub(crate) fn first_not_finite(values: &[f32]) -> Option<usize> {
    const EXPONENT: u32 = 0x7F80_0000;
    for (number, chunk) in values.chunks(1024).enumerate() {
        // One more in a full exponent carries into the highest bit.
        let carry = chunk.iter().fold(0, |carry, v| carry | ((v.to_bits() & EXPONENT) + 0x0080_0000));
        if carry >> 31 != 0 {
            return chunk.iter().position(|v| !v.is_finite()).map(|i| number * 1024 + i);
        }
    }
    None
}

/// The smallest box over positions; zeros for none. A zero may have either sign.
pub(crate) fn box_of(positions: &[[f32; 3]]) -> Box3 {
    let Some(first) = positions.first() else { return ([0.0; 3], [0.0; 3]) };
    let (fours, rest) = positions.as_chunks::<4>();
    let (mut lo, mut hi) = ([*first; 4], [*first; 4]);
    for four in fours {
        for (k, p) in four.iter().enumerate() {
            for axis in 0..3 {
                lo[k][axis] = if p[axis] < lo[k][axis] { p[axis] } else { lo[k][axis] };
                hi[k][axis] = if p[axis] > hi[k][axis] { p[axis] } else { hi[k][axis] };
            }
        }
    }
    rest.iter().chain(&lo).chain(&hi).fold((*first, *first), |(lo, hi), p| {
        (core::array::from_fn(|k| lo[k].min(p[k])), core::array::from_fn(|k| hi[k].max(p[k])))
    })
}

/// Least index, and greatest minus least plus one; zeros for none.
pub(crate) fn span<I: Index>(indices: &[I]) -> (u32, u64) {
    let Some(first) = indices.first() else { return (0, 0) };
    let (least, greatest) = indices.iter().fold((*first, *first), |(lo, hi), i| (lo.min(*i), hi.max(*i)));
    (least.into(), (greatest.into() - least.into()) as u64 + 1)
}

/// Whether a draw range's stated vertices (`first` and `vertices`, which are those of its span) and box are right, told without a
/// gather: no index is outside, the first and the last vertex of the span are named, and the box is that of all its
/// vertices with each face touched by a named one. `false` says nothing: an unused vertex may lie further out.
pub(crate) fn is_range<I: Index>(stated: Box3, first: u32, vertices: &[[f32; 3]], indices: &[I]) -> bool {
    // Ranges with few indices over a wide span would make this slower than looking at the indices' vertices.
    if vertices.len() > indices.len() || vertices.is_empty() || box_of(vertices) != stated {
        return false;
    }
    let last = vertices.len() as u32 - 1;
    let Some([a, b, c, d, e, f]) = touching(vertices, stated) else { return false };
    let wanted = [0, last, a, b, c, d, e, f].map(|place| I::try_from(first + place).ok());
    let [Some(p), Some(q), Some(r), Some(s), Some(t), Some(u), Some(v), Some(w)] = wanted else { return false };
    let (mut outside, mut found) = (0, [false; 8]);
    for chunk in indices.chunks(4096) {
        // Counts are below 2^31: a difference that is negative has the highest bit.
        outside |= chunk.iter().fold(0, |outside, i| {
            let place = (*i).into().wrapping_sub(first);
            outside | place | last.wrapping_sub(place)
        });
        for (half, own) in [[p, q, r, s], [t, u, v, w]].into_iter().zip(found.as_chunks_mut::<4>().0) {
            if *own != [true; 4] {
                let named = chunk
                    .iter()
                    .fold([0u32; 4], |named, i| core::array::from_fn(|k| named[k] | (*i == half[k]) as u32));
                *own = core::array::from_fn(|k| own[k] | (named[k] != 0));
            }
        }
    }
    outside >> 31 == 0 && found == [true; 8]
}

/// For each face of the box the first vertex that touches it; the vertices lie inside.
fn touching(vertices: &[[f32; 3]], (lo, hi): Box3) -> Option<[u32; 6]> {
    let mut places = [None; 6];
    for (number, chunk) in vertices.chunks(256).enumerate() {
        let any = chunk.iter().fold([false; 6], |any, v| {
            core::array::from_fn(|k| any[k] | if k < 3 { v[k] == lo[k] } else { v[k - 3] == hi[k - 3] })
        });
        for face in 0..6 {
            if !any[face] || places[face].is_some() {
                continue;
            }
            let touches = |v: &[f32; 3]| if face < 3 { v[face] == lo[face] } else { v[face - 3] == hi[face - 3] };
            places[face] = chunk.iter().position(touches).map(|i| (number * 256 + i) as u32);
        }
        if places.iter().all(Option::is_some) {
            break;
        }
    }
    let [a, b, c, d, e, f] = places;
    Some([a?, b?, c?, d?, e?, f?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::payload;
    use crate::prelude::*;

    #[test]
    fn a_number_that_is_none_is_found_at_any_place() {
        for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for at in [0, 1, 1023, 1024, 3000] {
                let mut values = vec![f32::MAX; 3001];
                values[at] = bad;
                assert_eq!(first_not_finite(&values), Some(at));
            }
        }
        assert_eq!(first_not_finite(&[f32::MAX, f32::MIN, -0.0, f32::MIN_POSITIVE / 2.0]), None);
    }

    proptest::proptest! {
        #[test]
        fn boxes_and_spans_are_those_of_the_naive_walk(
            positions in proptest::collection::vec(proptest::array::uniform3(-3i8..3), 1..40),
            corners in proptest::collection::vec(0usize..10_000, 0..200),
        ) {
            let positions: Vec<[f32; 3]> = positions.iter().map(|p| p.map(f32::from)).collect();
            proptest::prop_assert_eq!(box_of(&positions), payload::box_of(positions.iter()));
            let indices: Vec<u16> = corners.iter().map(|c| (c % positions.len()) as u16).collect();
            let (least, count) = span(&indices);
            proptest::prop_assert_eq!(least as u16, indices.iter().min().copied().unwrap_or(0));
            let right = payload::box_of(indices.iter().map(|i| &positions[*i as usize]));
            let vertices = &positions[least as usize..least as usize + count as usize];
            let mut wrong = right;
            wrong.1[1] += 1.0;
            proptest::prop_assert!(!is_range(wrong, least, vertices, &indices));
            if is_range(box_of(vertices), least, vertices, &indices) {
                proptest::prop_assert_eq!(box_of(vertices), right);
            }
            // Any other span is refused.
            for (start, end) in [(0, positions.len()), (least as usize + 1, least as usize + count as usize)] {
                let other = positions.get(start..end).unwrap_or(&[]);
                if (start, other.len()) != (least as usize, count as usize) {
                    proptest::prop_assert!(!is_range(box_of(other), start as u32, other, &indices));
                }
            }
        }
    }
}
