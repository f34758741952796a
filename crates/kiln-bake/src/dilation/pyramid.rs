//! Pull-push over blocks.
//!
//! A block of 64 x 64 texels carries its own pyramid, which stays in the processor's cache and fills the block's gaps. Only a
//! block without any value needs others: then a second pyramid over the blocks' means fills it, and only the means of blocks
//! below that pyramid's smallest cells with a value are computed. Both together are one pyramid from texels to one cell.

use glam::Vec4;
use rayon::prelude::*;

use super::code::{Code, mean};

/// Texels along a block's side, a power of two.
const BLOCK: usize = 64;

/// Fills every texel of `texels` (`[height] x width`) that `filled` (`[height + 2] x (width + 2)`, with a rim) says has no value.
pub(super) fn fill<C: Code>(texels: &mut [C::Texel], filled: &[u8], width: usize, height: usize) {
    let mask = Mask { filled, width, height };
    let (across, down) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
    let counts: Vec<usize> =
        (0..across * down).into_par_iter().map(|block| mask.count(block % across, block / across)).collect();
    let needed = needed(&counts, across, down);

    let rows = texels.par_chunks_mut(BLOCK * width).enumerate();
    let means: Vec<Vec<Option<Vec4>>> = rows
        .map(|(y, rows)| {
            let mut scratch = Vec::new();
            (0..across)
                .map(|x| {
                    let count = counts[y * across + x];
                    let gaps = count < mask.size(x, y);
                    if count == 0 || !gaps && !needed[y * across + x] {
                        return None;
                    }
                    Some(match count == BLOCK * BLOCK {
                        true => whole::<C>(rows, width, x),
                        false => block::<C>(rows, &mask, [x, y], &mut scratch),
                    })
                })
                .collect()
        })
        .collect();
    if !counts.contains(&0) {
        return;
    }
    let means: Vec<Option<Vec4>> =
        means.into_iter().flatten().zip(&needed).map(|(mean, needed)| mean.filter(|_| *needed)).collect();
    let values = push_pull::<C>(means, across, down);
    texels.par_chunks_mut(BLOCK * width).enumerate().for_each(|(y, rows)| {
        for x in (0..across).filter(|x| counts[y * across + x] == 0) {
            let value = C::encode(values[y * across + x]);
            for row in rows.chunks_mut(width) {
                row[x * BLOCK..width.min((x + 1) * BLOCK)].fill(value);
            }
        }
    });
}

/// Which texels have a value.
struct Mask<'a> {
    filled: &'a [u8],
    width: usize,
    height: usize,
}

impl Mask<'_> {
    /// From column `x` on in row `y`, to the right rim.
    #[inline]
    fn row(&self, x: usize, y: usize) -> &[u8] {
        let start = (y + 1) * (self.width + 2) + 1;
        &self.filled[start + x..start + self.width]
    }

    /// Texels of a block.
    fn size(&self, x: usize, y: usize) -> usize {
        BLOCK.min(self.width - x * BLOCK) * BLOCK.min(self.height - y * BLOCK)
    }

    /// Texels of a block that have a value.
    fn count(&self, x: usize, y: usize) -> usize {
        let rows = y * BLOCK..self.height.min((y + 1) * BLOCK);
        rows.map(|row| self.row(x * BLOCK, row).iter().take(BLOCK).map(|f| *f as usize).sum::<usize>()).sum()
    }
}

/// The mean of a whole block without gaps: what its pyramid would have at its top.
fn whole<C: Code>(rows: &[C::Texel], width: usize, block: usize) -> Vec4 {
    let (left, right) = (block * BLOCK, (block + 1) * BLOCK);
    if C::COPIES {
        return C::decode(rows[left]);
    }
    // A sum a row, so that roundings stay small.
    let row_sum = |row: &[C::Texel]| row[left..right].iter().fold(Vec4::ZERO, |sum, texel| sum + C::decode(*texel));
    let sum = rows.chunks(width).fold(Vec4::ZERO, |sum, row| sum + row_sum(row));
    sum / (BLOCK * BLOCK) as f32
}

/// Fills a block's gaps; its mean before. `rows`: the block's rows of the picture, whole.
fn block<C: Code>(
    rows: &mut [C::Texel],
    mask: &Mask<'_>,
    [bx, by]: [usize; 2],
    levels: &mut Vec<Vec<Option<Vec4>>>,
) -> Vec4 {
    const HALF: usize = BLOCK / 2;
    let (width, left) = (mask.width, bx * BLOCK);
    let (across, down) = (BLOCK.min(width - left), rows.len() / width);
    levels.resize_with(BLOCK.ilog2() as usize, Vec::new);
    levels[0].clear();
    levels[0].resize(HALF * HALF, None);
    for y in (0..down).step_by(2) {
        let other = (y + 1).min(down - 1);
        let masks = [y, other].map(|y| mask.row(left, by * BLOCK + y));
        for x in (0..across).step_by(2) {
            let at = |dx: usize, row: usize| C::decode(rows[row * width + left + x + dx]);
            let second = x + 1 < across;
            let own = [
                masks[0][x] != 0,
                second && masks[0][x + 1] != 0,
                other > y && masks[1][x] != 0,
                second && other > y && masks[1][x + 1] != 0,
            ];
            levels[0][y / 2 * HALF + x / 2] = match own {
                [true, true, true, true] if !C::COPIES => {
                    Some(0.25 * ((at(0, y) + at(1, y)) + (at(0, other) + at(1, other))))
                }
                [false, false, false, false] => None,
                _ => {
                    let four = [(0, y), (1, y), (0, other), (1, other)];
                    Some(mean::<C>(four.iter().zip(own).filter(|(_, own)| *own).map(|((dx, row), _)| at(*dx, *row))))
                }
            };
        }
    }
    for level in 1..levels.len() {
        let (below, above) = levels.split_at_mut(level);
        pull::<C>(&below[level - 1], [HALF >> (level - 1); 2], &mut above[0]);
    }
    let whole = levels[levels.len() - 1][0].unwrap_or(C::NOTHING);
    for level in (1..levels.len()).rev() {
        let (below, above) = levels.split_at_mut(level);
        push(&above[0], HALF >> level, &mut below[level - 1], HALF >> (level - 1));
    }
    for y in 0..down {
        let own = mask.row(left, by * BLOCK + y);
        for x in (0..across).filter(|x| own[*x] == 0) {
            let value = levels[0][y / 2 * HALF + x / 2].unwrap_or(C::NOTHING);
            rows[y * width + left + x] = C::encode(value);
        }
    }
    whole
}

/// The next coarser level: the mean of each 2 x 2 that have a value. `[across, down]`: the finer level's size.
fn pull<C: Code>(fine: &[Option<Vec4>], [across, down]: [usize; 2], coarse: &mut Vec<Option<Vec4>>) {
    coarse.clear();
    for y in 0..down.div_ceil(2) {
        for x in 0..across.div_ceil(2) {
            let at = |dx: usize, dy: usize| {
                let (x, y) = (2 * x + dx, 2 * y + dy);
                if x < across && y < down { fine[y * across + x] } else { None }
            };
            let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
            let any = four.iter().any(Option::is_some);
            coarse.push(any.then(|| mean::<C>(four.into_iter().flatten())));
        }
    }
}

/// Cells without a value take that of the cell above. `wide`, `across`: cells in a row of each level.
fn push(coarse: &[Option<Vec4>], wide: usize, fine: &mut [Option<Vec4>], across: usize) {
    for (y, row) in fine.chunks_mut(across).enumerate() {
        for (x, cell) in row.iter_mut().enumerate() {
            if cell.is_none() {
                *cell = coarse[y / 2 * wide + x / 2];
            }
        }
    }
}

/// A pyramid over blocks: every block's value, its own or that of the smallest cell around it that has one.
fn push_pull<C: Code>(means: Vec<Option<Vec4>>, across: usize, down: usize) -> Vec<Vec4> {
    let (mut levels, mut sizes) = (vec![means], vec![[across, down]]);
    while let Some(size) = sizes.last().copied()
        && size != [1, 1]
    {
        let mut coarse = Vec::new();
        pull::<C>(&levels[levels.len() - 1], size, &mut coarse);
        levels.push(coarse);
        sizes.push(size.map(|side| side.div_ceil(2)));
    }
    for level in (1..levels.len()).rev() {
        let (below, above) = levels.split_at_mut(level);
        push(&above[0], sizes[level][0], &mut below[level - 1], sizes[level - 1][0]);
    }
    levels[0].iter().map(|value| value.unwrap_or(C::NOTHING)).collect()
}

/// Which blocks' means some empty block may ask for: those below the smallest cells around it that have any value.
fn needed(counts: &[usize], across: usize, down: usize) -> Vec<bool> {
    if !counts.contains(&0) {
        return vec![false; counts.len()];
    }
    let (mut levels, mut sizes) = (vec![counts.iter().map(|c| *c > 0).collect::<Vec<bool>>()], vec![[across, down]]);
    while let Some([across, down]) = sizes.last().copied()
        && [across, down] != [1, 1]
    {
        let fine = &levels[levels.len() - 1];
        let wide = across.div_ceil(2);
        let mut coarse = vec![false; wide * down.div_ceil(2)];
        for (k, any) in fine.iter().enumerate() {
            coarse[k / across / 2 * wide + k % across / 2] |= any;
        }
        levels.push(coarse);
        sizes.push([wide, down.div_ceil(2)]);
    }
    // A cell with a value that has an empty child is asked for, and so is all below it.
    let mut asked = vec![false];
    for level in (0..levels.len() - 1).rev() {
        let ([across, down], wide) = (sizes[level], sizes[level + 1][0]);
        let above = |k: usize| k / across / 2 * wide + k % across / 2;
        for k in 0..across * down {
            if !levels[level][k] && levels[level + 1][above(k)] {
                asked[above(k)] = true;
            }
        }
        asked = (0..across * down).map(|k| asked[above(k)]).collect();
    }
    asked
}
