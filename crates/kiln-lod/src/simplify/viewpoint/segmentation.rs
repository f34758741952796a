//! Segmentation: the areas of a picture that a viewer takes for one thing each.
//!
//! **Problem.** In: a picture. Out: a label a texel, equal within an area whose colours belong together. A smooth ramp is one area
//! however far apart its ends are; a step that is larger than what goes on inside both of its sides parts them.
//!
//! **Method.** Each texel is an area of its own; edges join them, the lightest first.
//! ```text
//! planes  <- red, green and blue codes, halved until no side is longer than asked, each smoothed by a Gaussian of sigma texels
//! edges   <- each texel with its eight neighbours; weight: the distance of both colours, codes
//! for each edge in ascending weight, equal ones in texel order:                  (counting sort)
//!     join the areas at its ends if weight <= min(inner(A) + k / |A|, inner(B) + k / |B|)
//!     inner: the heaviest edge that joined an area; |A|: its texels
//! for each edge again: join if one side has fewer than `min_size` texels
//! areas nowhere wider than `reach` allows fall apart; for each edge again: join unless both sides are wide
//! labels  <- 0, 1, ... in the order of the areas' first texels
//! ```
//! A picture whose sampler repeats goes on at its other side, so an area may run across it; one that is clamped or mirrored ends.
//! Weights are rounded to 1/64 code: far below any difference in a picture of 8 bits, and two bytes an edge, which a counting sort
//! puts in order in linear time. Areas are trees in flat arrays. A texel costs 24 bytes of working memory beside its planes.
//!
//! **Departures.** The paper segments the three channels one by one and intersects the areas; here, as in its authors' program, the
//! distance in RGB is taken once. The last step is ours: a
//! blurred border is a ramp steeper than what goes on beside it, so the paper's areas have rings of it around them, half of all areas in
//! painted textures. Larger pictures are halved first ([`SegmentationOptions::side`]), which the paper does not need.
//!
//! **Limits.** Painted lines thinner than `2 reach + 1` texels go with the rings. Grain does not vanish by `k` alone: an area of more than k / grain texels takes no texel in that differs by more than it does
//! inside; the Gaussian and `min_size` see to that. Distances of sRGB codes are not what eyes see: two dark blues are as far apart as two greens. `k` depends on the number
//! of texels in a thing, so on `side`.
//!
//! **Source.** P. Felzenszwalb, D. Huttenlocher, Efficient graph-based image segmentation, IJCV 59(2), 2004,
//! doi:10.1023/B:VISI.0000022288.19776.77, algorithm 1, equations 2 and 4.

use kiln_asset::{Raster, Wrap};
use rayon::prelude::*;

use crate::simplify::plane::Plane;

/// How a picture falls into areas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentationOptions {
    /// Of the Gaussian that smooths first, texels; 0 smooths nothing. More swallows grain and fine lines.
    pub sigma: f64,
    /// How strongly areas hold together while they are small, codes times texels; more makes fewer and larger ones.
    pub k: f64,
    /// Fewest texels of an area.
    pub min_size: u32,
    /// How many texels of its own an area has on all sides of one of them at least; areas that are thinner everywhere, rings along
    /// blurred borders above all, are shared out among their neighbours. 0 keeps them, as published.
    pub reach: u32,
    /// Longest side of a picture when it is segmented, texels; larger ones are halved first.
    pub side: u32,
}

impl Default for SegmentationOptions {
    fn default() -> Self {
        SegmentationOptions { sigma: 0.8, k: 300.0, min_size: 50, reach: 2, side: 512 }
    }
}

/// A picture in areas.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Segmentation {
    /// Texels across, after halving.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// `[height * width]`, top row first: each texel's area, in `[0, count)`; areas ascend by their first texel.
    pub labels: Vec<u32>,
    /// Number of areas.
    pub count: u32,
}

/// Units of a weight in a code.
const UNITS: f32 = 64.0;
/// In place of a weight: a texel at the picture's end has no such neighbour. No distance of colours comes near it.
const NO_EDGE: u16 = u16::MAX;
/// Neighbours of a texel that come after it; with those for which it comes after, all eight.
const STEPS: [[i64; 2]; 4] = [[1, 0], [-1, 1], [0, 1], [1, 1]];

/// The areas of `picture`, which goes on beyond its edges by `wrap`, in u and in v. `alpha`: colours fade to black by alpha, where
/// that is what is seen.
pub fn segment(picture: &Raster, alpha: bool, wrap: [Wrap; 2], options: &SegmentationOptions) -> Segmentation {
    // One channel after the other: a large picture's plane is four times its bytes.
    let channel = |c: usize| {
        let mut weights = [0.0; 3];
        weights[c] = 1.0;
        Plane::of(picture, weights, alpha, options.side)
    };
    let planes = [channel(0), channel(1), channel(2)];
    if planes[0].values.is_empty() {
        return Segmentation { width: picture.width, height: picture.height, ..Segmentation::default() };
    }
    let grid = Grid { width: planes[0].width, height: planes[0].height, wrap };
    let weights = weights(&planes.map(|plane| plane.smoothed(options.sigma, wrap)), &grid);
    let order = ascending(&weights);

    let mut forest = Forest::new(grid.width * grid.height, options.k as f32 * UNITS);
    for edge in &order {
        let [a, b] = grid.ends(*edge).map(|texel| forest.root(texel));
        let weight = f32::from(weights[*edge as usize]);
        if a != b && weight <= forest.limit[a as usize].min(forest.limit[b as usize]) {
            forest.join(a, b, weight);
        }
    }
    for edge in &order {
        let [a, b] = grid.ends(*edge).map(|texel| forest.root(texel));
        if a != b && forest.size[a as usize].min(forest.size[b as usize]) < options.min_size {
            forest.join(a, b, 0.0);
        }
    }
    if options.reach > 0 {
        forest = without_thin(forest, &grid, &order, options.reach);
    }
    let (labels, count) = forest.labels();
    Segmentation { width: grid.width as u32, height: grid.height as u32, labels, count }
}

/// Areas that nowhere hold a square of `2 * reach + 1` texels fall apart, and each of their texels goes to the wide area that it reaches
/// along the lightest edges (a minimum spanning forest from the wide ones). Where no area is wide, all stay.
fn without_thin(mut forest: Forest, grid: &Grid, order: &[u32], reach: u32) -> Forest {
    let count = grid.width * grid.height;
    let area: Vec<u32> = (0..count as u32).map(|texel| forest.root(texel)).collect();
    // `[texel_count]`, at roots.
    let mut is_wide = vec![false; count];
    for (root, _) in area.iter().zip(inner(&area, grid, reach)).filter(|(_, is_inner)| *is_inner) {
        is_wide[*root as usize] = true;
    }
    if !is_wide.contains(&true) {
        return forest;
    }
    let mut out = Forest::new(count, forest.k);
    for (texel, root) in area.iter().enumerate().filter(|(_, root)| is_wide[**root as usize]) {
        out.parent[texel] = *root;
        out.size[*root as usize] = forest.size[*root as usize];
    }
    for edge in order {
        let [a, b] = grid.ends(*edge).map(|texel| out.root(texel));
        let wide = [a, b].map(|root| is_wide[root as usize]);
        if a != b && wide != [true; 2] {
            out.join(a, b, 0.0);
            let root = out.root(a);
            is_wide[root as usize] = wide.contains(&true);
        }
    }
    out
}

/// `[texel_count]`: whether all texels within `reach` in x and y are of the same area; beyond the picture's end all are.
fn inner(area: &[u32], grid: &Grid, reach: u32) -> Vec<bool> {
    let mut inner = vec![true; area.len()];
    let mut before = inner.clone();
    for _ in 0..reach.min(grid.width.max(grid.height) as u32) {
        inner.par_chunks_mut(grid.width).enumerate().for_each(|(y, row)| {
            for (x, inner) in row.iter_mut().enumerate() {
                let own = area[y * grid.width + x];
                let mut around = STEPS.iter().flat_map(|[i, j]| [[*i, *j], [-i, -j]]);
                *inner &=
                    around.all(|step| grid.beside(x, y, step).is_none_or(|there| area[there] == own && before[there]));
            }
        });
        before.copy_from_slice(&inner);
    }
    inner
}

/// The texels and who lies beside whom. An edge is 4 * texel + step.
struct Grid {
    width: usize,
    height: usize,
    wrap: [Wrap; 2],
}

impl Grid {
    /// The texel `step` from texel `(x, y)`, if the picture has one there.
    #[inline]
    fn beside(&self, x: usize, y: usize, step: [i64; 2]) -> Option<usize> {
        let along = |at: usize, step: i64, size: usize, wrap: Wrap| {
            let to = at as i64 + step;
            let inside = (0..size as i64).contains(&to);
            (inside || wrap == Wrap::Repeat).then(|| to.rem_euclid(size as i64) as usize)
        };
        let x = along(x, step[0], self.width, self.wrap[0])?;
        let y = along(y, step[1], self.height, self.wrap[1])?;
        Some(y * self.width + x)
    }

    /// The texels at both ends of an edge that exists.
    #[inline]
    fn ends(&self, edge: u32) -> [u32; 2] {
        let texel = edge as usize / 4;
        let other = self.beside(texel % self.width, texel / self.width, STEPS[edge as usize % 4]);
        [texel as u32, other.map_or(texel as u32, |other| other as u32)]
    }
}

/// `[4 * texel_count]`: the distance of the colours at each edge's ends, 1/64 code, or [`NO_EDGE`].
fn weights(planes: &[Plane; 3], grid: &Grid) -> Vec<u16> {
    let mut weights = vec![NO_EDGE; 4 * grid.width * grid.height];
    weights.par_chunks_mut(4 * grid.width).enumerate().for_each(|(y, row)| {
        for (x, edges) in row.chunks_exact_mut(4).enumerate() {
            let here = y * grid.width + x;
            for (weight, step) in edges.iter_mut().zip(STEPS) {
                let Some(there) = grid.beside(x, y, step).filter(|there| *there != here) else { continue };
                let [r, g, b] = [0, 1, 2].map(|c: usize| planes[c].values[here] - planes[c].values[there]);
                // At most 256 * sqrt(3) codes.
                *weight = ((r * r + g * g + b * b).sqrt() * UNITS + 0.5) as u16;
            }
        }
    });
    weights
}

/// The edges in ascending weight, equal ones ascending.
fn ascending(weights: &[u16]) -> Vec<u32> {
    let heaviest = weights.iter().filter(|w| **w != NO_EDGE).max().map_or(0, |w| *w as usize);
    let mut next = vec![0u32; heaviest + 2];
    for weight in weights.iter().filter(|w| **w != NO_EDGE) {
        next[*weight as usize + 1] += 1;
    }
    for w in 0..=heaviest {
        next[w + 1] += next[w];
    }
    let mut order = vec![0u32; next[heaviest + 1] as usize];
    for (edge, weight) in weights.iter().enumerate().filter(|(_, w)| **w != NO_EDGE) {
        let place = &mut next[*weight as usize];
        order[*place as usize] = edge as u32;
        *place += 1;
    }
    order
}

/// The areas so far: trees of texels.
struct Forest {
    /// `[texel_count]`; a root is its own.
    parent: Vec<u32>,
    /// `[texel_count]`, at roots: texels of the area.
    size: Vec<u32>,
    /// `[texel_count]`, at roots: the heaviest edge that may join the area to another, 1/64 code.
    limit: Vec<f32>,
    /// 1/64 code times texels.
    k: f32,
}

impl Forest {
    fn new(count: usize, k: f32) -> Forest {
        Forest { parent: (0..count as u32).collect(), size: vec![1; count], limit: vec![k; count], k }
    }

    #[inline]
    fn root(&mut self, mut texel: u32) -> u32 {
        while self.parent[texel as usize] != texel {
            let above = self.parent[self.parent[texel as usize] as usize];
            self.parent[texel as usize] = above;
            texel = above;
        }
        texel
    }

    /// Joins the areas of two roots by an edge; the larger one's root stays, of equal ones the lower.
    fn join(&mut self, a: u32, b: u32, weight: f32) {
        let key = |root: u32| (std::cmp::Reverse(self.size[root as usize]), root);
        let [stays, goes] = if key(a) < key(b) { [a, b] } else { [b, a] };
        self.parent[goes as usize] = stays;
        self.size[stays as usize] += self.size[goes as usize];
        // Edges ascend: this is the heaviest in the area.
        self.limit[stays as usize] = weight + self.k / self.size[stays as usize] as f32;
    }

    /// `[texel_count]` labels by first texel, and their number.
    fn labels(mut self) -> (Vec<u32>, u32) {
        let mut name = vec![u32::MAX; self.parent.len()];
        let mut count = 0;
        let labels = (0..self.parent.len() as u32)
            .map(|texel| {
                let name = &mut name[self.root(texel) as usize];
                if *name == u32::MAX {
                    *name = count;
                    count += 1;
                }
                *name
            })
            .collect();
        (labels, count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLAMP: [Wrap; 2] = [Wrap::ClampToEdge; 2];
    const REPEAT: [Wrap; 2] = [Wrap::Repeat; 2];
    const SHARP: SegmentationOptions = SegmentationOptions { sigma: 0.0, k: 300.0, min_size: 1, reach: 0, side: 4096 };

    fn picture(width: u32, height: u32, colour: impl Fn(u32, u32) -> [u8; 3]) -> Raster {
        let texel = |i: u32| {
            let [r, g, b] = colour(i % width, i / width);
            [r, g, b, 255]
        };
        Raster { width, height, texels: (0..width * height).map(texel).collect() }
    }

    fn noise(x: u32, y: u32, codes: u64) -> u8 {
        (kiln_geom::sample::hash(u64::from(y) << 20 | u64::from(x)) % codes) as u8
    }

    #[test]
    fn flat_blocks_are_one_area_each() {
        // Three by two blocks of 20 by 30 texels.
        let colour = |x: u32, y: u32| [(x / 20 * 80) as u8, (y / 30 * 120) as u8, 40];
        // Smoothed, the borders are ramps whose texels are areas too, but small ones.
        for (sigma, min_size) in [(0.0, 1), (0.8, 100)] {
            let options = SegmentationOptions { sigma, min_size, ..SHARP };
            let found = segment(&picture(60, 60, colour), false, CLAMP, &options);
            assert_eq!(found.count, 6, "sigma {sigma}");
            let at = |x: u32, y: u32| found.labels[(y * 60 + x) as usize];
            let reach = if sigma > 0.0 { 3 } else { 0 };
            for (x, y) in (0..60).flat_map(|y| (0..60).map(move |x| (x, y))) {
                let inside = |c: u32, side: u32| (reach..side - reach).contains(&(c % side));
                if inside(x, 20) && inside(y, 30) {
                    assert_eq!(at(x, y), at(x / 20 * 20 + 10, y / 30 * 30 + 15), "({x}, {y}), sigma {sigma}");
                }
            }
            let middles = [0, 1].map(|row| [0, 1, 2].map(|column| at(20 * column + 10, 30 * row + 15)));
            assert_eq!(middles[0], [0, 1, 2], "ascending by first texel");
            let mut bottom = middles[1];
            bottom.sort_unstable();
            assert_eq!(bottom, [3, 4, 5]);
        }
    }

    #[test]
    fn a_ramp_is_one_area_and_a_step_of_half_its_span_is_two() {
        let ramp = picture(256, 32, |x, _| [x as u8; 3]);
        assert_eq!(segment(&ramp, false, CLAMP, &SHARP).count, 1);
        let step = picture(256, 32, |x, _| [if x < 128 { 64 } else { 192 }; 3]);
        assert_eq!(segment(&step, false, CLAMP, &SHARP).count, 2);
    }

    #[test]
    fn noise_is_swallowed_by_k_and_the_gaussian_and_shows_without_them() {
        let noisy = picture(64, 64, |x, y| {
            let grey = noise(x, y, 12) + if x < 32 { 60 } else { 180 };
            [grey, grey, grey]
        });
        let with = |options: SegmentationOptions| segment(&noisy, false, CLAMP, &options);
        // Grain of 20 codes against a third of the 2,048 texels of a half.
        let smooth = SegmentationOptions { min_size: 200, ..SegmentationOptions::default() };
        for options in [SegmentationOptions { k: 20_000.0, ..SHARP }, smooth] {
            let found = with(options);
            assert_eq!(found.count, 2, "both halves, no grain");
            let off = (0..4096).filter(|i| found.labels[*i] != u32::from(i % 64 >= 32)).count();
            assert!(off <= if options.sigma > 0.0 { 128 } else { 0 }, "{off}");
        }
        assert!(with(SegmentationOptions { k: 1.0, ..SHARP }).count > 500);
    }

    #[test]
    fn no_area_is_smaller_than_asked_unless_the_picture_is() {
        let noisy = picture(64, 48, |x, y| [noise(x, y, 200), noise(y, x, 200), 0]);
        for min_size in [1, 20, 300] {
            let found = segment(&noisy, false, REPEAT, &SegmentationOptions { k: 5.0, min_size, ..SHARP });
            let mut sizes = vec![0; found.count as usize];
            found.labels.iter().for_each(|label| sizes[*label as usize] += 1);
            assert!(sizes.iter().all(|size| *size >= min_size), "{min_size}: {sizes:?}");
            assert!(found.count > 1 || min_size == 300);
        }
        let small = segment(&picture(3, 3, |x, _| [x as u8 * 80; 3]), false, CLAMP, &SHARP_BUT_LARGE);
        assert_eq!(small.count, 1);
    }

    const SHARP_BUT_LARGE: SegmentationOptions = SegmentationOptions { min_size: 50, ..SHARP };

    #[test]
    fn a_blurred_border_makes_no_area_of_its_own() {
        // A disc whose border is a ramp of four texels.
        let disc = picture(96, 96, |x, y| {
            let distance = (f64::from(x) - 48.0).hypot(f64::from(y) - 48.0);
            [(40.0 + 180.0 * ((distance - 24.0) / 4.0).clamp(0.0, 1.0)) as u8; 3]
        });
        let with = |reach| segment(&disc, false, CLAMP, &SegmentationOptions { k: 20.0, min_size: 9, reach, ..SHARP });
        assert!(with(0).count > 2, "{}", with(0).count);
        let found = with(2);
        assert_eq!(found.count, 2);
        for (texel, label) in found.labels.iter().enumerate() {
            let distance = (texel as f64 % 96.0 - 48.0).hypot((texel / 96) as f64 - 48.0);
            assert!((23.0..29.0).contains(&distance) || *label == u32::from(distance < 26.0), "{distance}");
        }
        // What is thin everywhere stays, and a reach beyond the picture takes a picture of one area for what it is.
        let stripes = picture(40, 40, |x, _| [if x / 2 % 2 == 0 { 0 } else { 200 }; 3]);
        let with = |picture, reach| segment(picture, false, CLAMP, &SegmentationOptions { reach, ..SHARP }).count;
        assert_eq!((with(&stripes, 0), with(&stripes, 2)), (20, 20));
        assert_eq!(with(&picture(5, 3, |_, _| [9; 3]), u32::MAX), 1);
    }

    #[test]
    fn an_area_runs_across_the_end_of_a_picture_that_repeats() {
        // A band in the middle: outside it one area on the torus, two on the plane.
        let band = |x: u32, _| if (20..40).contains(&x) { [200, 0, 0] } else { [0, 0, 90] };
        let count = |wrap: [Wrap; 2]| segment(&picture(60, 16, band), false, wrap, &SHARP).count;
        assert_eq!(count(CLAMP), 3);
        assert_eq!(count([Wrap::Repeat, Wrap::ClampToEdge]), 2);
        assert_eq!(count([Wrap::MirroredRepeat; 2]), 3, "a mirrored picture meets itself at its own edge");
        assert_eq!(count([Wrap::ClampToEdge, Wrap::Repeat]), 3, "rows repeat, columns do not");
        // The same in v, and across a corner.
        let turned = segment(&picture(16, 60, |x, y| band(y, x)), false, [Wrap::ClampToEdge, Wrap::Repeat], &SHARP);
        assert_eq!(turned.count, 2);
        let corners = picture(12, 12, |x, y| {
            let near = |c: u32| !(3..9).contains(&c);
            if near(x) && near(y) { [255, 255, 0] } else { [0, 60, 0] }
        });
        assert_eq!(segment(&corners, false, CLAMP, &SHARP).count, 5);
        assert_eq!(segment(&corners, false, REPEAT, &SHARP).count, 2);
    }

    #[test]
    fn areas_touch_by_their_corners() {
        let diagonal = picture(24, 24, |x, y| if x == y { [255; 3] } else { [0; 3] });
        let found = segment(&diagonal, false, CLAMP, &SegmentationOptions { k: 1.0, ..SHARP });
        assert_eq!(found.count, 2, "the line is one area, and so is what it cuts, by the corners between its texels");
    }

    #[test]
    fn the_least_pictures_have_areas_and_an_empty_one_has_none() {
        for wrap in [CLAMP, REPEAT, [Wrap::MirroredRepeat; 2]] {
            for [width, height, count] in [[1, 1, 1], [2, 1, 2], [1, 3, 3], [2, 2, 4]] {
                let all_apart = |x: u32, y: u32| [(x * 250) as u8, (y * 120) as u8, 0];
                let options = SegmentationOptions { k: 0.0, ..SHARP };
                assert_eq!(segment(&picture(width, height, all_apart), false, wrap, &options).count, count);
            }
        }
        assert_eq!(segment(&Raster::default(), false, REPEAT, &SHARP), Segmentation::default());
    }

    #[test]
    fn a_large_picture_is_halved_and_alpha_fades_colours() {
        let blocks = picture(512, 128, |x, _| if x < 256 { [30, 200, 10] } else { [220, 20, 90] });
        let found = segment(&blocks, false, CLAMP, &SegmentationOptions { side: 64, ..SHARP });
        assert_eq!((found.width, found.height, found.count), (64, 16, 2));
        let mut holes = Raster::filled(40, 40, [200, 200, 200, 255]);
        for y in 10..30 {
            holes.texels[y * 40 + 10..y * 40 + 30].fill([200, 200, 200, 0]);
        }
        assert_eq!(segment(&holes, false, CLAMP, &SHARP).count, 1);
        assert_eq!(segment(&holes, true, CLAMP, &SHARP).count, 2);
    }

    /// Algorithm 1 as it is printed: components relabelled one by one, their inner difference looked up among their edges.
    fn naive(picture: &Raster, wrap: [Wrap; 2], k: f64, min_size: usize) -> Vec<u32> {
        let (w, h) = (i64::from(picture.width), i64::from(picture.height));
        let mut edges = Vec::new();
        for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
            for (step, [dx, dy]) in STEPS.into_iter().enumerate() {
                let (mut nx, mut ny) = (x + dx, y + dy);
                if wrap[0] == Wrap::Repeat {
                    nx = (nx + w) % w;
                }
                if wrap[1] == Wrap::Repeat {
                    ny = (ny + h) % h;
                }
                if nx < 0 || ny < 0 || nx >= w || ny >= h || (nx, ny) == (x, y) {
                    continue;
                }
                let [a, b] = [(x, y), (nx, ny)].map(|(x, y)| (y * w + x) as usize);
                let square = |c: usize| (f64::from(picture.texels[a][c]) - f64::from(picture.texels[b][c])).powi(2);
                let weight = ((square(0) + square(1) + square(2)).sqrt() * 64.0).round();
                edges.push((weight as u64, a, step, b));
            }
        }
        edges.sort_unstable();
        let mut label: Vec<usize> = (0..picture.texels.len()).collect();
        let mut inner = vec![0u64; label.len()];
        let members = |label: &[usize], of: usize| label.iter().filter(|l| **l == of).count();
        for pass in 0..2 {
            for (weight, a, _, b) in &edges {
                let (la, lb) = (label[*a], label[*b]);
                if la == lb {
                    continue;
                }
                let sizes = [members(&label, la), members(&label, lb)];
                let bound = |of: usize, size: usize| inner[of] as f64 + k * 64.0 / size as f64;
                let joins = match pass {
                    0 => *weight as f64 <= bound(la, sizes[0]).min(bound(lb, sizes[1])),
                    _ => sizes[0].min(sizes[1]) < min_size,
                };
                if joins {
                    label.iter_mut().filter(|l| **l == lb).for_each(|l| *l = la);
                    inner[la] = inner[la].max(inner[lb]).max(*weight);
                }
            }
        }
        let mut names: Vec<usize> = Vec::new();
        let name = |l: &usize| {
            let known = names.iter().position(|n| n == l);
            known.unwrap_or_else(|| {
                names.push(*l);
                names.len() - 1
            }) as u32
        };
        label.iter().map(name).collect()
    }

    #[test]
    fn the_areas_are_those_of_the_algorithm_as_printed() {
        for seed in 0..60u32 {
            let hashed = |i: u32| kiln_geom::sample::hash(u64::from(seed) << 32 | u64::from(i));
            let (w, h) = (1 + hashed(1) as u32 % 14, 1 + hashed(2) as u32 % 14);
            let span = [4, 30, 255][hashed(3) as usize % 3];
            let wrap = [[CLAMP, REPEAT][hashed(4) as usize % 2][0], [CLAMP, REPEAT][hashed(5) as usize % 2][0]];
            let colour = |x: u32, y: u32| [0, 1, 2].map(|c| (hashed(1000 + (y / 3 * 64 + x / 3) * 3 + c) % span) as u8);
            let picture = picture(w, h, colour);
            // Powers of two, so that neither side rounds k / size at the very bound.
            let (k, min_size) = ([0.0, 8.0, 64.0, 512.0][hashed(6) as usize % 4], 1 + hashed(7) as u32 % 9);
            let found = segment(&picture, false, wrap, &SegmentationOptions { k, min_size, ..SHARP });
            assert_eq!(found.labels, naive(&picture, wrap, k, min_size as usize), "seed {seed}, {w} x {h}");
        }
    }
}
