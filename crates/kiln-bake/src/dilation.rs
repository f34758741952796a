//! What the texels get that the bake left empty.
//!
//! Comes in: a baked picture, which of its texels are covered, which lie inside a chart. Goes out: the same picture with
//! every texel set. Covered texels never change.
//!
//! ```text
//! valid = covered
//! repeat N times: every texel that is not valid and has valid neighbours among its 8 takes their mean; all at once
//! go on, only for texels inside a chart, until none has a valid neighbour        (missed hits inside charts)
//! the rest: straight up (128, 128, 255) for normals, the covered texels' mean for everything else
//! ```
//!
//! Departures: the paper's test "length below 1 = empty" fails for 8-bit and averaged normals, hence the coverage mask; the
//! mean of normals is normalised, that of sRGB colour is taken in linear light. The mean as background keeps coarse mip
//! levels from darkening towards the charts' borders.
//!
//! Limits: a band of N texels on each side of a gap narrower than 2N meets in the middle, so padding should be at least the
//! dilation; the caller compares the two.
//!
//! Source: C. González, thesis 2010, section 6.2 (border expansion).

use kiln_asset::Raster;
use kiln_geom::colour::{linear_to_srgb, srgb_to_linear, unorm8};

/// How a picture's texels are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TexelKind {
    /// RGB in sRGB, alpha linear.
    Srgb,
    /// Every channel linear.
    Linear,
    /// RGB is a unit vector as `(n + 1) / 2`.
    Normal,
}

/// How many texels came from where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DilationReport {
    /// Filled from neighbours.
    pub dilated: u64,
    /// Left for the background.
    pub background: u64,
}

/// Fills every texel of `raster` that is not covered.
///
/// `covered`: `[height * width]`, texels that hold baked values. `inside`: `[height * width]`, texels of charts, filled from
/// their neighbours however far away those are. `rounds`: width of the band around charts, texels.
///
/// # Panics
/// If `covered` or `inside` has another length than the picture.
pub fn dilate(raster: &mut Raster, covered: &[bool], inside: &[bool], rounds: u32, kind: TexelKind) -> DilationReport {
    assert!(covered.len() == raster.texels.len() && inside.len() == raster.texels.len(), "masks of another size");
    let background = background(raster, covered, kind);
    let grid = Grid { width: raster.width as usize, height: raster.height as usize };
    let mut valid = covered.to_vec();
    let mut queued = vec![false; valid.len()];
    let mut front: Vec<usize> = (0..valid.len()).filter(|t| !valid[*t] && grid.around(*t).any(|n| valid[n])).collect();
    let mut report = DilationReport::default();
    let mut round = 0;
    while !front.is_empty() {
        if round >= rounds {
            front.retain(|t| inside[*t]);
        }
        let filled: Vec<(usize, [u8; 4])> = front
            .iter()
            .map(|t| (*t, mean(grid.around(*t).filter(|n| valid[*n]).map(|n| raster.texels[n]), kind, background)))
            .collect();
        for (texel, value) in &filled {
            raster.texels[*texel] = *value;
            valid[*texel] = true;
        }
        report.dilated += filled.len() as u64;
        front.clear();
        for (texel, _) in &filled {
            for n in grid.around(*texel) {
                if !valid[n] && !queued[n] {
                    queued[n] = true;
                    front.push(n);
                }
            }
        }
        for texel in &front {
            queued[*texel] = false;
        }
        round += 1;
    }
    for (texel, valid) in raster.texels.iter_mut().zip(&valid) {
        if !valid {
            *texel = background;
            report.background += 1;
        }
    }
    report
}

#[derive(Clone, Copy)]
struct Grid {
    width: usize,
    height: usize,
}

impl Grid {
    /// The up to 8 neighbours of a texel, row by row.
    fn around(self, texel: usize) -> impl Iterator<Item = usize> {
        let (x, y) = (texel % self.width, texel / self.width);
        let rows = y.saturating_sub(1)..(y + 2).min(self.height);
        rows.flat_map(move |row| {
            let columns = x.saturating_sub(1)..(x + 2).min(self.width);
            columns.map(move |column| row * self.width + column)
        })
        .filter(move |n| *n != texel)
    }
}

fn decode(texel: [u8; 4], kind: TexelKind) -> [f64; 4] {
    let linear = |c: u8| c as f64 / 255.0;
    let alpha = linear(texel[3]);
    let [r, g, b] = [texel[0], texel[1], texel[2]].map(|c| match kind {
        TexelKind::Srgb => srgb_to_linear(c) as f64,
        TexelKind::Linear => linear(c),
        TexelKind::Normal => 2.0 * linear(c) - 1.0,
    });
    [r, g, b, alpha]
}

fn encode(value: [f64; 4], kind: TexelKind, fallback: [u8; 4]) -> [u8; 4] {
    let [r, g, b, alpha] = value;
    let alpha = unorm8(alpha as f32);
    let [r, g, b] = match kind {
        TexelKind::Srgb => [r, g, b].map(|c| linear_to_srgb(c as f32)),
        TexelKind::Linear => [r, g, b].map(|c| unorm8(c as f32)),
        TexelKind::Normal => {
            let length = (r * r + g * g + b * b).sqrt();
            if length < 1e-6 {
                return fallback;
            }
            [r, g, b].map(|c| unorm8((c / length * 0.5 + 0.5) as f32))
        }
    };
    [r, g, b, alpha]
}

fn mean(texels: impl Iterator<Item = [u8; 4]>, kind: TexelKind, fallback: [u8; 4]) -> [u8; 4] {
    let mut sum = [0.0; 4];
    let mut count = 0.0;
    for texel in texels {
        let value = decode(texel, kind);
        for (s, v) in sum.iter_mut().zip(value) {
            *s += v;
        }
        count += 1.0;
    }
    if count == 0.0 { fallback } else { encode(sum.map(|s| s / count), kind, fallback) }
}

/// What is left gets this: up for normals, the covered texels' mean for the rest, opaque black if nothing is covered.
fn background(raster: &Raster, covered: &[bool], kind: TexelKind) -> [u8; 4] {
    match kind {
        TexelKind::Normal => [128, 128, 255, 255],
        _ => {
            let texels = raster.texels.iter().zip(covered).filter(|(_, c)| **c).map(|(t, _)| *t);
            mean(texels, kind, [0, 0, 0, 255])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(size: u32, at: usize, texel: [u8; 4]) -> (Raster, Vec<bool>) {
        let mut raster = Raster::filled(size, size, [9, 9, 9, 9]);
        raster.texels[at] = texel;
        let covered = (0..raster.texels.len()).map(|t| t == at).collect();
        (raster, covered)
    }

    #[test]
    fn a_single_texel_grows_by_one_ring_a_round() {
        let red = [200, 10, 20, 255];
        for rounds in 0..4 {
            let (mut raster, covered) = point(9, 40, red);
            let report = dilate(&mut raster, &covered, &covered, rounds, TexelKind::Linear);
            let side = 2 * rounds as u64 + 1;
            assert_eq!(report.dilated, side * side - 1);
            assert_eq!(report.background, 81 - side * side);
            // One colour in, the same colour everywhere: as the mean and as the background.
            assert!(raster.texels.iter().all(|t| *t == red));
        }
    }

    #[test]
    fn covered_texels_never_change() {
        let mut raster = Raster::filled(8, 1, [0; 4]);
        for x in 0..8 {
            raster.texels[x] = [x as u8 * 30, 255 - x as u8, 7, x as u8];
        }
        let before = raster.clone();
        let covered: Vec<bool> = (0..8).map(|x| x % 3 == 0).collect();
        dilate(&mut raster, &covered, &[false; 8], 2, TexelKind::Srgb);
        for (x, covered) in covered.iter().enumerate() {
            assert_eq!(raster.texels[x] == before.texels[x], *covered, "texel {x}");
        }
    }

    #[test]
    fn a_hole_inside_a_chart_is_filled_however_deep_it_is() {
        let mut raster = Raster::filled(21, 21, [50, 60, 70, 255]);
        let covered: Vec<bool> = (0..441).map(|t| [0, 20].contains(&(t % 21)) || [0, 20].contains(&(t / 21))).collect();
        for (texel, covered) in raster.texels.iter_mut().zip(&covered) {
            if !covered {
                *texel = [0; 4];
            }
        }
        let report = dilate(&mut raster, &covered, &[true; 441], 1, TexelKind::Linear);
        assert_eq!(report, DilationReport { dilated: 19 * 19, background: 0 });
        assert!(raster.texels.iter().all(|t| *t == [50, 60, 70, 255]));
    }

    #[test]
    fn colour_is_averaged_in_linear_light_and_normals_are_normalised() {
        let mut raster = Raster::filled(3, 1, [0; 4]);
        raster.texels[0] = [0, 0, 0, 255];
        raster.texels[2] = [255, 255, 255, 255];
        dilate(&mut raster, &[true, false, true], &[false; 3], 1, TexelKind::Srgb);
        assert_eq!(raster.texels[1], [188, 188, 188, 255], "half the light, not half the code");

        let mut raster = Raster::filled(3, 1, [0; 4]);
        raster.texels[0] = [255, 128, 128, 255];
        raster.texels[2] = [128, 128, 255, 255];
        dilate(&mut raster, &[true, false, true], &[false; 3], 1, TexelKind::Normal);
        let n = decode(raster.texels[1], TexelKind::Normal);
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        assert!((length - 1.0).abs() < 0.01 && (n[0] - n[2]).abs() < 0.01, "{n:?}");
    }

    #[test]
    fn an_uncovered_normal_map_points_straight_up() {
        let mut raster = Raster::filled(4, 4, [0; 4]);
        dilate(&mut raster, &[false; 16], &[false; 16], 3, TexelKind::Normal);
        assert!(raster.texels.iter().all(|t| *t == [128, 128, 255, 255]));
    }
}
