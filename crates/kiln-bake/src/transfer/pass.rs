//! One sheet's pass over the surface: owners, winners and values of a bin, rows of bins in parallel.

use std::sync::{Arc, OnceLock};
use std::time::Duration;

use kiln_asset::{ExtraMap, MapRole, Mesh};
use kiln_geom::Bvh;
use kiln_geom::raster::Rect;
use rayon::prelude::*;

use super::charts;
use super::correspondence::Layout;
use super::evaluate::{self, Evaluator, Kind, Planned, Row, Rows, Samples, Tent, What};
use super::gpu::{HitPass, Portions, Stripe};
use super::low::{self, Low};
use super::materials::Groups;
use super::options::{Backend, BakeError, BakeInput, BakeOptions, BakeReport, Method, NormalSpace, Picture};
use super::resolve::{Locator, Meeting, Needs};
use super::search::{Scratch, Search};
use super::sheet::Sheet;
use crate::dilation::Fill;
use crate::occlusion::Occluder;

/// The tree over the high mesh: built once, when somebody first asks for it, for all sheets.
#[derive(Clone)]
pub(super) struct Tree<'a> {
    high: &'a Mesh,
    built: Arc<OnceLock<Arc<Bvh>>>,
}

impl<'a> Tree<'a> {
    pub(super) fn of(high: &'a Mesh) -> Tree<'a> {
        Tree { high, built: Arc::default() }
    }

    fn get(&self) -> Arc<Bvh> {
        Arc::clone(self.built.get_or_init(|| Arc::new(Bvh::new(&self.high.positions, &self.high.triangles))))
    }
}

/// One sheet of the finest level, ready to be baked.
pub(super) struct Pass<'a> {
    tree: Tree<'a>,
    pub(super) high: &'a Mesh,
    pub(super) low: Low<'a>,
    pub(super) sheet: Sheet,
    pub(super) finder: Finder<'a>,
    /// `[face_count]`.
    charts: Vec<u32>,
    options: &'a BakeOptions,
    backend: String,
}

pub(super) enum Finder<'a> {
    Lines(Search<'a>),
    Device(Search<'a>, HitPass<'a>),
    Layout(Layout<'a>),
}

/// What one thread keeps between bins.
#[derive(Default)]
pub(super) struct Bench {
    pub(super) owners: Vec<u32>,
    pub(super) winners: Vec<u32>,
    scratch: Scratch,
    row: Row,
    /// `[maps][samples of the bin]`.
    values: Vec<Vec<[f32; 4]>>,
}

/// What a row of bins came to.
#[derive(Clone, Copy, Default)]
pub(super) struct Counts {
    pub(super) owned: u64,
    pub(super) covered: u64,
    pub(super) overlaps: u64,
    pub(super) behind: u64,
    pub(super) pairs: u64,
    pub(super) double: u64,
    pub(super) device: Duration,
}

impl std::ops::Add for Counts {
    type Output = Counts;

    fn add(self, other: Counts) -> Counts {
        Counts {
            owned: self.owned + other.owned,
            covered: self.covered + other.covered,
            overlaps: self.overlaps + other.overlaps,
            behind: self.behind + other.behind,
            pairs: self.pairs + other.pairs,
            double: self.double + other.double,
            device: self.device + other.device,
        }
    }
}

impl<'a> Pass<'a> {
    /// `tree`: over the high mesh. `finest`: of the levels, with `atlas_uv`.
    pub(super) fn new(
        input: &BakeInput<'a>,
        tree: &Tree<'a>,
        finest: &'a Mesh,
        sheet: u32,
        options: &'a BakeOptions,
        reach: [f32; 2],
        backend: Backend<'a>,
    ) -> Result<Pass<'a>, BakeError> {
        evaluate::check_options(options, reach)?;
        let high = input.high;
        let uv = finest.atlas_uv.as_deref().ok_or(BakeError::NoAtlas { level: 0 })?;
        if finest.normals.is_none() {
            return Err(BakeError::NoNormals { mesh: "low" });
        }
        if high.normals.is_none() {
            return Err(BakeError::NoNormals { mesh: "high" });
        }
        let mut low = Low::new(finest, uv, sheet, options, reach);
        if let Some(cage) = input.cage {
            low = low.with_cage(cage);
        }
        let finder = match options.method {
            Method::MirroredVertex => {
                let search = Search::new(high, tree.get(), finest, options);
                match backend {
                    Backend::Cpu => Finder::Lines(search),
                    Backend::Gpu(gpu) => {
                        let device = HitPass::new(gpu, &search, Portions::default())?;
                        Finder::Device(search, device)
                    }
                }
            }
            Method::Correspondence => {
                // A repeated layout has several places for one texel.
                let outside = |uv: &glam::Vec2| !(uv.cmpge(glam::Vec2::ZERO) & uv.cmple(glam::Vec2::ONE)).all();
                let count = uv.iter().filter(|uv| outside(uv)).count();
                if input.low.layout.is_none() && count > 0 {
                    return Err(BakeError::Layouts(format!(
                        "{count} vertices of the low mesh lie outside of the layout's square; a repeated layout says nothing"
                    )));
                }
                // The atlas if both carry it, else the model's own layout.
                let carried = high.atlas_uv.as_deref().filter(|_| input.low.levels[0].mesh.atlas_uv.is_some());
                let uv = carried.or(high.uv0.as_deref());
                let uv = uv.ok_or_else(|| BakeError::Layouts("the high mesh has no texture coordinates".into()))?;
                Finder::Layout(Layout::new(high, uv, options.size * options.samples))
            }
        };
        let backend = match backend {
            Backend::Cpu => "cpu".to_owned(),
            Backend::Gpu(gpu) => gpu.class().to_string(),
        };
        let sheet = Sheet::new(&low);
        let tree = tree.clone();
        Ok(Pass { tree, high, low, sheet, finder, charts: charts::charts(finest, uv), options, backend })
    }

    /// All maps of the sheet, in the order of `planned`; counts are added to `report`.
    pub(super) fn bake(
        &self,
        groups: &Groups,
        planned: &[Planned<'_>],
        report: &mut BakeReport,
    ) -> Result<Vec<Picture>, BakeError> {
        let finest = self.low.mesh;
        let tangent_space =
            planned.iter().any(|m| m.what == What::Role(MapRole::Normal)) && self.options.space == NormalSpace::Tangent;
        if tangent_space && finest.tangents.is_none() {
            return Err(BakeError::StaleTangents { level: 0 });
        }
        let curvature = match planned.iter().any(|m| m.what == What::Extra(ExtraMap::Curvature)) {
            true => crate::curvature::mean_curvature(&self.high.positions, &self.high.triangles),
            false => Vec::new(),
        };
        let tree;
        let occluder = if planned.iter().any(|m| m.what.looks_out(self.options)) {
            let (high, reach) = (self.high, self.options.ray_length.unwrap_or(self.high.diagonal()));
            tree = self.tree.get();
            // Every sample asks at least one.
            let rays = self.options.rays.max(self.options.samples * self.options.samples);
            Some(Occluder::new(&tree, &high.positions, &high.triangles, rays, reach))
        } else {
            None
        };
        let evaluator = Evaluator {
            high: self.high,
            low: finest,
            high_normals: self.high.normals.as_deref().unwrap_or_default(),
            low_normals: finest.normals.as_deref().unwrap_or_default(),
            low_tangents: finest.tangents.as_deref().unwrap_or_default(),
            groups,
            maps: planned,
            curvature: &curvature,
            occluder,
            options: self.options,
        };
        let size = self.sheet.size;
        let texels = size as usize * size as usize;
        let mut pictures: Vec<Picture> = planned.iter().map(|m| m.what.picture(size, self.options.depth)).collect();
        let (mut charts, mut covered) = (vec![0u32; texels], vec![false; texels]);
        let rows = self.sheet.side as usize * size as usize;
        let mut bands = evaluate::bands(&mut pictures, rows);
        bands.resize_with(charts.len().div_ceil(rows), Vec::new);
        let bands = bands.into_iter().zip(charts.chunks_mut(rows)).zip(covered.chunks_mut(rows)).collect();
        let counts = self.each_row(bands, |y, ((mut maps, charts), covered), stripe, bench| {
            self.band(y, &evaluator, stripe, bench, Texels { maps: &mut maps, charts, covered })
        })?;
        self.account(counts, report);
        if let Finder::Layout(_) = self.finder {
            if counts.covered == 0 {
                return Err(BakeError::Layouts("the two meshes share no place of the layout".into()));
            }
            if counts.double > 0 {
                let samples = counts.double;
                return Err(BakeError::Layouts(format!(
                    "{samples} samples are covered by more than one face of the high mesh; a layout with overlaps says nothing there"
                )));
            }
        }
        let fill = Fill::plan(size, size, &covered, &charts, self.options.dilation);
        report.dilated += fill.report().dilated;
        for (picture, map) in pictures.iter_mut().zip(planned) {
            if map.what == What::Extra(ExtraMap::Coverage) {
                continue;
            }
            let kind = map.what.filling(self.options.depth);
            match picture {
                Picture::Plain(raster) => fill.apply(raster, kind),
                Picture::Deep(raster) => fill.apply(raster, kind),
            }
        }
        Ok(pictures)
    }

    pub(super) fn account(&self, counts: Counts, report: &mut BakeReport) {
        let faces = (0..self.low.mesh.face_count()).into_par_iter().filter(|face| self.low.holds(*face));
        let odd = faces.map(|face| {
            let low::Oddities { sliver, flat, steep, crossing } = self.low.oddities(face);
            [sliver, flat, steep, crossing].map(u64::from)
        });
        let [slivers, flat, steep, crossing] = odd.reduce(|| [0; 4], |a, b| std::array::from_fn(|k| a[k] + b[k]));
        report.backend.clone_from(&self.backend);
        report.owned += counts.owned;
        report.covered += counts.covered;
        report.missed += counts.owned - counts.covered;
        report.overlapping += counts.overlaps.div_ceil(u64::from(self.sheet.samples * self.sheet.samples));
        report.behind += counts.behind;
        report.pairs += counts.pairs;
        report.sliver_faces += slivers;
        report.flat_faces += flat;
        report.steep_faces += steep;
        report.crossing_faces += crossing;
    }

    /// Visits all rows of bins, each with its part of `bands`, in parallel; in stripes where a device finds the winners.
    pub(super) fn each_row<T: Send>(
        &self,
        bands: Vec<T>,
        visit: impl Fn(u32, T, Option<&Stripe>, &mut Bench) -> Counts + Sync,
    ) -> Result<Counts, BakeError> {
        let (sheet, mut counts) = (&self.sheet, Counts::default());
        let rows = match &self.finder {
            Finder::Device(_, device) => device.rows(sheet),
            Finder::Lines(_) | Finder::Layout(_) => sheet.across,
        };
        let mut bands = bands.into_iter();
        for first in (0..sheet.across).step_by(rows as usize) {
            let mut stripe = None;
            if let Finder::Device(search, device) = &self.finder {
                let found = device.stripe(&self.low, sheet, search, first..(first + rows).min(sheet.across))?;
                let Stripe { overlaps, pairs, device, .. } = found;
                counts = counts + Counts { overlaps, pairs, device, ..Counts::default() };
                stripe = Some(found);
            }
            let here: Vec<T> = bands.by_ref().take(rows as usize).collect();
            let visited = here
                .into_par_iter()
                .enumerate()
                .map_init(Bench::default, |bench, (row, band)| visit(first + row as u32, band, stripe.as_ref(), bench));
            counts = counts + visited.reduce(Counts::default, |a, b| a + b);
        }
        Ok(counts)
    }

    /// Owners and winners of one bin, in `bench`. `stripe`: what a device found.
    pub(super) fn hits(&self, x: u32, y: u32, stripe: Option<&Stripe>, bench: &mut Bench) -> Counts {
        let (faces, rect) = (self.sheet.faces(x, y), self.sheet.samples(x, y));
        if let Some(stripe) = stripe {
            stripe.copy(x, rect, &mut bench.owners, &mut bench.winners);
            return Counts::default();
        }
        let overlaps = self.sheet.own(&self.low, [x, y], rect, &mut bench.owners);
        let (pairs, double) = match &self.finder {
            Finder::Lines(search) | Finder::Device(search, _) => {
                let found = search.find(&self.low, faces, rect, &bench.owners, &mut bench.winners, &mut bench.scratch);
                (found, 0)
            }
            Finder::Layout(layout) => layout.find(rect, &bench.owners, &mut bench.winners),
        };
        Counts { overlaps, pairs, double, ..Counts::default() }
    }

    pub(super) fn locator(&self) -> Locator<'_> {
        let meeting = match &self.finder {
            Finder::Lines(_) | Finder::Device(..) => Meeting::Line,
            Finder::Layout(layout) => Meeting::Layout(layout.uv),
        };
        Locator::new(&self.low, self.high, meeting)
    }

    /// Whether a map holds normals against the low mesh's shading normal: behind it where their z is negative.
    fn is_tangent_normal(&self, what: What) -> bool {
        what == What::Role(MapRole::Normal) && self.options.space == NormalSpace::Tangent
    }

    /// A row of bins, written to `into`.
    fn band(
        &self,
        y: u32,
        evaluator: &Evaluator<'_>,
        stripe: Option<&Stripe>,
        bench: &mut Bench,
        mut into: Texels<'_, '_>,
    ) -> Counts {
        let mut counts = Counts::default();
        let mut locator = self.locator();
        for x in 0..self.sheet.across {
            if self.sheet.faces(x, y).is_empty() {
                continue;
            }
            counts = counts + self.hits(x, y, stripe, bench);
            let bin = [x, y];
            counts = counts
                + match self.sheet.samples {
                    1 => self.texels(bin, evaluator, &mut locator, bench, &mut into),
                    _ => self.filtered(bin, evaluator, &mut locator, bench, &mut into),
                };
        }
        counts
    }

    /// The hits of one row of a bin's samples.
    fn row(&self, rect: Rect, row: usize, evaluator: &Evaluator<'_>, locator: &mut Locator<'_>, bench: &mut Bench) {
        let width = (rect.x1 - rect.x0) as usize;
        let needs = evaluator.needs();
        let hits = &mut bench.row.hits;
        hits.clear();
        let row_of = row * width..(row + 1) * width;
        // The search knows where it met what it found; what else there is to know takes the line once more.
        let quick = matches!(self.finder, Finder::Lines(_)) && needs == Needs::default() && !self.options.back_faces;
        let faces = bench.owners[row_of.clone()].iter().zip(&mut bench.winners[row_of]);
        for (column, (owner, winner)) in faces.enumerate().filter(|(_, (_, winner))| **winner != 0) {
            let sample = [rect.x0 + column as u32, rect.y0 + row as u32];
            let (low, high) = (*owner as usize - 1, *winner as usize - 1);
            let hit = match quick {
                true => locator.met(sample, low, high, bench.scratch.met[row * width + column]),
                false => locator.at(sample, low, high, needs),
            };
            match hit {
                Some(hit) => hits.push((column as u32, hit)),
                None => *winner = 0,
            }
        }
        if let Some(occluder) = &evaluator.occluder {
            evaluator.look_out(occluder, [rect.x0, rect.y0 + row as u32], &mut bench.row);
        }
    }

    /// A bin of one sample a texel: nothing to be filtered.
    fn texels(
        &self,
        [x, y]: [u32; 2],
        evaluator: &Evaluator<'_>,
        locator: &mut Locator<'_>,
        bench: &mut Bench,
        into: &mut Texels<'_, '_>,
    ) -> Counts {
        let mut counts = Counts::default();
        let rect = self.sheet.samples(x, y);
        let width = (rect.x1 - rect.x0) as usize;
        for row in 0..(rect.y1 - rect.y0) as usize {
            let start = row * self.sheet.size as usize + rect.x0 as usize;
            self.row(rect, row, evaluator, locator, bench);
            let owners = &bench.owners[row * width..(row + 1) * width];
            for (chart, owner) in into.charts[start..start + width].iter_mut().zip(owners).filter(|(_, o)| **o != 0) {
                *chart = self.charts[*owner as usize - 1] + 1;
                counts.owned += 1;
            }
            counts.covered += bench.row.hits.len() as u64;
            for (column, _) in &bench.row.hits {
                into.covered[start + *column as usize] = true;
            }
            for (map, rows) in evaluator.maps.iter().zip(into.maps.iter_mut()) {
                let (kind, halved) = (map.what.kind(), map.what.halved(self.options.depth));
                let normal = self.is_tangent_normal(map.what);
                evaluator.each(map, &bench.row, |column, value| {
                    counts.behind += u64::from(normal && value[2] < 0.0);
                    rows.write(start + column, value, kind, halved);
                });
            }
        }
        counts
    }

    /// A bin of several samples a texel.
    fn filtered(
        &self,
        [x, y]: [u32; 2],
        evaluator: &Evaluator<'_>,
        locator: &mut Locator<'_>,
        bench: &mut Bench,
        into: &mut Texels<'_, '_>,
    ) -> Counts {
        let mut counts = Counts::default();
        let rect = self.sheet.samples(x, y);
        let width = (rect.x1 - rect.x0) as usize;
        let kinds: Vec<Kind> = evaluator.maps.iter().map(|m| m.what.kind()).collect();
        let mut values = std::mem::take(&mut bench.values);
        values.resize_with(kinds.len(), Vec::new);
        values.iter_mut().for_each(|v| v.resize(bench.owners.len(), [0.0; 4]));
        for row in 0..(rect.y1 - rect.y0) as usize {
            self.row(rect, row, evaluator, locator, bench);
            for (map, values) in evaluator.maps.iter().zip(&mut values) {
                evaluator.each(map, &bench.row, |column, value| values[row * width + column] = value);
            }
        }
        let tent = Tent::new(self.sheet.samples);
        let mut out = vec![[0.0; 4]; kinds.len()];
        let samples =
            Samples { rect, owners: &bench.owners, winners: &bench.winners, values: &values, charts: &self.charts };
        let texels = self.sheet.texels(x, y);
        for ty in texels.y0..texels.y1 {
            for tx in texels.x0..texels.x1 {
                let texel = samples.texel(&tent, [tx, ty], &kinds, &mut out);
                if texel.chart == 0 {
                    continue;
                }
                let at = (ty - texels.y0) as usize * self.sheet.size as usize + tx as usize;
                into.charts[at] = texel.chart;
                counts.owned += 1;
                let [hit, all] = texel.weight;
                if hit == 0.0 {
                    continue;
                }
                into.covered[at] = true;
                counts.covered += 1;
                let share = hit / all;
                for ((map, rows), value) in evaluator.maps.iter().zip(into.maps.iter_mut()).zip(&out) {
                    let coverage = map.what == What::Extra(ExtraMap::Coverage);
                    let value = if coverage { [share, share, share, 1.0] } else { *value };
                    counts.behind += u64::from(self.is_tangent_normal(map.what) && value[2] < 0.0);
                    rows.write(at, value, map.what.kind(), map.what.halved(self.options.depth));
                }
            }
        }
        bench.values = values;
        counts
    }
}

/// Where a row of bins is written.
struct Texels<'a, 'm> {
    maps: &'a mut [Rows<'m>],
    charts: &'a mut [u32],
    covered: &'a mut [bool],
}
