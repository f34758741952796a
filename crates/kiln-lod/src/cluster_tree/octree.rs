//! The octree: tight cells, found from the root down, children in the order of their octants.
//!
//! Sites are partitioned in place, so a cell is a run of them. Children of large cells are grown on all threads and joined in
//! order: the same cells on any thread count.

use kiln_asset::Mesh;
use rayon::prelude::*;

use super::MAX_ROWS;
use super::place::Cuboid;

/// Sites below which a cell's children are grown by one thread.
const MANY: usize = 1 << 14;

/// A point and its place, object units.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Site {
    place: [f32; 3],
    point: u32,
}

/// An internal node as it is found; parents stand before their children.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub(super) parent: Option<u32>,
    /// i_level.
    pub(super) row: u32,
    /// Mean of its points, object units.
    pub(super) mean: [f32; 3],
    /// Its run of sites.
    first: u32,
    count: u32,
    /// Lowest point.
    lowest: u32,
    /// Longest edge, object units.
    edge: f64,
    lo: [f32; 3],
    hi: [f32; 3],
}

impl Cell {
    /// The tight cuboid of `sites`, with their mean; row, parent and first site are not known yet.
    fn around(sites: &[Site]) -> Cell {
        let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        let (mut sum, mut lowest) = ([0.0f64; 3], u32::MAX);
        for site in sites {
            for k in 0..3 {
                lo[k] = lo[k].min(site.place[k]);
                hi[k] = hi[k].max(site.place[k]);
                sum[k] += f64::from(site.place[k]);
            }
            lowest = lowest.min(site.point);
        }
        let extent = |k: usize| f64::from(hi[k]) - f64::from(lo[k]);
        let mean = |k: usize| ((sum[k] / sites.len() as f64) as f32).clamp(lo[k], hi[k]);
        Cell {
            parent: None,
            row: 0,
            mean: [0, 1, 2].map(mean),
            first: 0,
            count: sites.len() as u32,
            lowest,
            edge: extent(0).max(extent(1)).max(extent(2)),
            lo,
            hi,
        }
    }

    pub(super) fn cuboid(&self) -> Cuboid {
        Cuboid { lo: self.lo, hi: self.hi }
    }
}

/// The greatest q with `whole >= 2^q edge`, exactly; both above 0, in the range of differences of 32-bit floats (so normal in 64).
pub(super) fn i_level(whole: f64, edge: f64) -> u32 {
    const MANTISSA: u64 = (1 << 52) - 1;
    let (a, b) = (whole.to_bits(), edge.to_bits());
    let q = (a >> 52) as i64 - (b >> 52) as i64 - i64::from(a & MANTISSA < b & MANTISSA);
    q.max(0) as u32
}

/// `[point_count]`: where each point lies, by its first vertex.
pub(super) fn sites(mesh: &Mesh) -> Vec<Site> {
    let mut sites = vec![Site::default(); mesh.point_count()];
    for (vertex, point) in mesh.points.iter().enumerate().rev() {
        sites[point.index()] = Site { place: mesh.positions[vertex].to_array(), point: point.0 };
    }
    sites
}

/// All internal nodes, and the sites in the order of their cells.
pub(super) fn grow(mut sites: Vec<Site>) -> (Vec<Cell>, Vec<Site>) {
    let mut cells = Vec::new();
    if !sites.is_empty() {
        let mut spare = sites.clone();
        let root = Cell::around(&sites);
        let growth = Growth { whole: root.edge };
        cells.push(root);
        growth.children(&mut sites, &mut spare, 0, &mut cells);
    }
    (cells, sites)
}

struct Growth {
    /// Longest edge of the root, object units.
    whole: f64,
}

impl Growth {
    /// Grows what is below the last of `cells`, whose sites these are.
    fn children(&self, sites: &mut [Site], spare: &mut [Site], first: u32, cells: &mut Vec<Cell>) {
        let me = cells.len() as u32 - 1;
        let cell = cells[me as usize];
        if cell.edge <= 0.0 {
            return;
        }
        let ends = partition(&cell, sites, spare);
        let (mut rest, mut rest_spare, mut start) = (sites, spare, 0);
        let mut octants = Vec::new();
        for end in ends {
            let (sites, behind) = rest.split_at_mut(end - start);
            let (spare, spare_behind) = rest_spare.split_at_mut(end - start);
            if sites.len() > 1 {
                match cell.count as usize > MANY {
                    true => octants.push((sites, spare, first + start as u32)),
                    false => self.child(sites, spare, first + start as u32, (Some(me), cell.row), cells),
                }
            }
            (rest, rest_spare, start) = (behind, spare_behind, end);
        }
        let grown = octants.into_par_iter().map(|(sites, spare, first)| {
            let mut cells = Vec::new();
            self.child(sites, spare, first, (None, cell.row), &mut cells);
            cells
        });
        for mut below in grown.collect::<Vec<_>>() {
            let shift = cells.len() as u32;
            below.iter_mut().for_each(|cell| cell.parent = Some(cell.parent.map_or(me, |parent| parent + shift)));
            cells.append(&mut below);
        }
    }

    /// The cell of these sites, if it is one, and what is below it. `above`: the parent and its row.
    fn child(
        &self,
        sites: &mut [Site],
        spare: &mut [Site],
        first: u32,
        above: (Option<u32>, u32),
        cells: &mut Vec<Cell>,
    ) {
        let cell = Cell::around(sites);
        if cell.edge <= 0.0 {
            return;
        }
        let row = i_level(self.whole, cell.edge).max(above.1 + 1);
        if row < MAX_ROWS {
            cells.push(Cell { parent: above.0, row, first, ..cell });
            self.children(sites, spare, first, cells);
        }
    }
}

/// Sorts the sites of a cell by octant, keeping their order inside each; where each octant ends. The middle between two different
/// 32-bit floats is above the lower in 64 bits, so no octant gets all sites.
fn partition(cell: &Cell, sites: &mut [Site], spare: &mut [Site]) -> [usize; 8] {
    let middle = [0, 1, 2].map(|k| 0.5 * (f64::from(cell.lo[k]) + f64::from(cell.hi[k])));
    let octant = |site: &Site| {
        let above = |k: usize| usize::from(f64::from(site.place[k]) >= middle[k]) << k;
        above(0) | above(1) | above(2)
    };
    let mut ends = [0; 8];
    sites.iter().for_each(|site| ends[octant(site)] += 1);
    let (mut slots, mut sum) = ([0; 8], 0);
    for (slot, end) in slots.iter_mut().zip(&mut ends) {
        *slot = sum;
        sum += *end;
        *end = sum;
    }
    for site in sites.iter() {
        let slot = &mut slots[octant(site)];
        spare[*slot] = *site;
        *slot += 1;
    }
    sites.copy_from_slice(spare);
    ends
}

/// `[point_count]`: the deepest cell over each point.
pub(super) fn terminals(cells: &[Cell], sites: &[Site]) -> Vec<u32> {
    let mut terminals = vec![0; sites.len()];
    let (mut open, mut next) = (Vec::new(), 0);
    for (at, site) in sites.iter().enumerate() {
        let ended = |cell: &u32| {
            let cell = &cells[*cell as usize];
            cell.first as usize + cell.count as usize <= at
        };
        while open.last().is_some_and(ended) {
            open.pop();
        }
        while cells.get(next).is_some_and(|cell| cell.first as usize == at) {
            open.push(next as u32);
            next += 1;
        }
        terminals[site.point as usize] = *open.last().expect("invariant: the root holds all sites");
    }
    terminals
}

/// The cells by rank: by row, then by longest edge, longest first, then by lowest point.
pub(super) fn ranked(cells: &[Cell]) -> Vec<u32> {
    let mut keys: Vec<(u32, u64, u32, u32)> =
        cells.iter().zip(0..).map(|(cell, at)| (cell.row, !cell.edge.to_bits(), cell.lowest, at)).collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|key| key.3).collect()
}
