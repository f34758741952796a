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
    let (least, greatest) = indices.iter().fold((*first, *first), |(least, greatest), i| {
        (if *i < least { *i } else { least }, if *i > greatest { *i } else { greatest })
    });
    (least.into(), (greatest.into() - least.into()) as u64 + 1)
}

/// Whether `stated` is the smallest box over the vertices in use, told without a gather: it is if it is the box of all
/// vertices of the span (from vertex `first` on), and each of its six faces is touched by one that an index names. `false`
/// says nothing: an unused vertex may lie further out.
pub(crate) fn is_box_of_used<I: Index>(stated: Box3, vertices: &[[f32; 3]], indices: &[I], first: u32) -> bool {
    // Ranges with few indices over a wide span would make this slower than looking at the indices' vertices.
    if vertices.len() > indices.len() || box_of(vertices) != stated {
        return false;
    }
    let mut wanted = [None; 6];
    for (face, wanted) in wanted.iter_mut().enumerate() {
        let (axis, value) = (face % 3, if face < 3 { stated.0[face] } else { stated.1[face - 3] });
        *wanted = touching(vertices, axis, value).and_then(|place| I::try_from(first + place as u32).ok());
    }
    let [Some(a), Some(b), Some(c), Some(d), Some(e), Some(f)] = wanted else { return false };
    let mut found = [false; 6];
    for chunk in indices.chunks(4096) {
        for i in chunk {
            let same = [*i == a, *i == b, *i == c, *i == d, *i == e, *i == f];
            found = core::array::from_fn(|k| found[k] | same[k]);
        }
        if found == [true; 6] {
            return true;
        }
    }
    false
}

/// The first vertex with this value on an axis.
fn touching(vertices: &[[f32; 3]], axis: usize, value: f32) -> Option<usize> {
    for (number, chunk) in vertices.chunks(256).enumerate() {
        if chunk.iter().fold(false, |any, v| any | (v[axis] == value)) {
            return chunk.iter().position(|v| v[axis] == value).map(|i| number * 256 + i);
        }
    }
    None
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
            proptest::prop_assert!(!is_box_of_used(wrong, vertices, &indices, least));
            if is_box_of_used(box_of(vertices), vertices, &indices, least) {
                proptest::prop_assert_eq!(box_of(vertices), right);
            }
        }
    }
}
