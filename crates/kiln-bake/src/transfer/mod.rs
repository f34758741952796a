//! The bake: what the high mesh looks like, written into the low mesh's sheets.
//!
//! Comes in: a high mesh with its materials and pictures, levels of a low mesh that share one atlas. Goes out: the levels with that
//! atlas as their only UVs, one material for each (sheet, alpha mode, sidedness) in use, and the maps. Positions, triangles and
//! normals of the levels do not change.
//!
//! ```text
//! each face of the finest level: a bundle of lines, linear in the place on the sheet                 (low)
//! each sheet, each bin of its texels, rows of bins in parallel:
//!     each sample is owned by the lowest face that covers its centre                                 (sheet)
//!     high triangles that lines of a face can reach, from one tree; where each line meets them;
//!     the outermost, or the nearest, stays                           (search; gpu; correspondence instead of both)
//!     for each sample with a winner: the place on it, in double precision                            (resolve)
//!     every map's value there: normals, textures averaged over the sample, heights, ids, ...         (maps, texture, evaluate)
//!     samples of a texel's chart, weighted by a tent                                                 (evaluate)
//! fill what is left (dilation); write materials (materials)
//! ```
//!
//! Departures from the thesis. It mirrors vertices with k > 0 through the plane, which folds a triangle that straddles it, so that its
//! depth is no distance; here every line meets the triangle itself, in front or behind. Its directions are the faces' normals
//! (`directions = "face"`); with smooth ones a projection of vertices is wrong between them, so the image of an edge is taken for
//! what it is, a conic. Normals are not mirrored, nothing is clipped at the plane, facing is asked in space. Culling by a tree and
//! many low triangles at once are what it leaves as future work. A graphics card only names winners; all values are computed on the
//! CPU from ids, so backends share them.
//!
//! Hit rules. `outermost` is what bakers do today: the first surface that faces the line's way from `front` inwards. It shows parts that
//! float within `front`, and an overhang that comes within it; hence a reach of 1.5 times the level's measured distance and no
//! more. `nearest` is the thesis's.
//!
//! Limits: lines of a concave corner cross; they are cut there (counted). Samples of one texel that lie in two charts count for the
//! heavier one. Coarser levels use the finest level's maps with the normals and tangents that simplification carried along. Tangents
//! are those of the meshes given, if they belong to the atlas (`atlas` gives them); where a mesh has none, MikkTSpace computes them.
//!
//! Sources: C. González, thesis 2010, sections 6.2 (correspondence), 6.3 (mirrored vertices), 7.1 (other values); J. Plücker's
//! coordinates as in N. Platis, T. Theoharis, Fast Ray-Tetrahedron Intersection Using Plücker Coordinates, JGT 8(4), 2003; M.
//! Mikkelsen, Simulation of Wrinkled Surfaces Revisited, MSc thesis, University of Copenhagen 2008 (tangent frames).

mod charts;
pub mod check;
mod correspondence;
mod evaluate;
mod gpu;
mod low;
mod maps;
mod materials;
mod options;
mod resolve;
mod search;
mod sheet;
mod texture;

use std::time::Duration;

use glam::Vec3;
use kiln_asset::{ExtraMap, Level, LodSet, MapRole, Material, MaterialId, Mesh};
use kiln_geom::raster::Rect;
use rayon::prelude::*;

use crate::dilation::Fill;
use crate::occlusion::Occluder;
use crate::tangents::{self, UvSource};
use correspondence::Layout;
use evaluate::{Evaluator, Kind, Planned, Row, Rows, Samples, Tent, What};
use gpu::{HitPass, Portions, Stripe};
use low::Low;
use maps::RoleSource;
use materials::{Groups, is_neutral, material_of};
use resolve::{Locator, Meeting, Needs};
use search::{Scratch, Search};
use sheet::Sheet;

pub use options::{
    Backend, BakeError, BakeInput, BakeOptions, BakeReport, Baked, Depth, Directions, HitRule, Images, Matching,
    Method, NormalSpace, OcclusionSource, Picture,
};

/// Bakes the high mesh onto the finest of the levels.
///
/// # Errors
/// See [`BakeError`]; nothing is made by halves.
pub fn bake(input: &BakeInput<'_>, options: &BakeOptions, backend: Backend<'_>) -> Result<Baked, BakeError> {
    let BakeInput { high, low, materials, images, .. } = *input;
    let meshes = dressed(low, options)?;
    let finest = meshes.first().ok_or(BakeError::NoLevels)?;
    let sheets = low.layout.map_or(1, |layout| layout.sheets.max(1));
    let reach = reach(high, low.levels[0].error, options);
    let used: Vec<Material> = finest.submeshes.iter().map(|s| material_of(materials, s.material)).collect();
    let (asked, neutral): (Vec<MapRole>, Vec<MapRole>) = MapRole::ALL
        .iter()
        .filter(|r| options.maps.contains(r))
        .partition(|r| !is_neutral(**r, &used) || What::Role(**r).looks_out(options));
    let groups = Groups::new(finest, materials);
    let mut planned = Vec::new();
    for role in &asked {
        let source = Some(RoleSource::new(*role, high, materials, images)?);
        planned.push(Planned { what: What::Role(*role), source });
    }
    for extra in ExtraMap::ALL.iter().filter(|e| options.extras.contains(e)) {
        let source = match extra {
            ExtraMap::Opacity => Some(RoleSource::new(MapRole::BaseColor, high, materials, images)?),
            _ => None,
        };
        planned.push(Planned { what: What::Extra(*extra), source });
    }
    let mut report = BakeReport {
        size: options.size,
        front: reach[0],
        back: reach[1],
        sheets,
        short_padding: short_padding(low, options),
        lost_maps: lost_maps(&asked, &used),
        neutral_maps: neutral,
        maps: asked.clone(),
        extras: ExtraMap::ALL.iter().copied().filter(|e| options.extras.contains(e)).collect(),
        ..BakeReport::default()
    };
    let mut pictures = Vec::new();
    for sheet in 0..sheets {
        let pass = Pass::new(input, finest, sheet, options, reach, backend)?;
        pictures.extend(pass.bake(&groups, &planned, &mut report)?);
    }
    let set = materials::new_set(finest, materials, &groups, &planned, &pictures, options);
    let drop_colors = options.maps.contains(&MapRole::BaseColor);
    let mut levels = Vec::with_capacity(meshes.len());
    for (level, mesh) in meshes.into_iter().enumerate() {
        let mesh = redress(mesh, &groups, drop_colors).map_err(|message| BakeError::Mesh { level, message })?;
        let Level { error, quadrics, .. } = &low.levels[level];
        levels.push(Level { mesh, error: *error, quadrics: quadrics.clone() });
    }
    let levels = LodSet { levels, layout: low.layout, source_triangles: low.source_triangles };
    Ok(Baked { levels, materials: set, pictures, report })
}

/// One sheet of the finest level, ready to be baked.
struct Pass<'a> {
    high: &'a Mesh,
    low: Low<'a>,
    sheet: Sheet,
    finder: Finder<'a>,
    /// `[face_count]`.
    charts: Vec<u32>,
    options: &'a BakeOptions,
    backend: String,
}

enum Finder<'a> {
    Lines(Search<'a>),
    Device(Search<'a>, HitPass<'a>),
    Layout(Layout<'a>),
}

/// What one thread keeps between bins.
#[derive(Default)]
struct Bench {
    owners: Vec<u32>,
    winners: Vec<u32>,
    scratch: Scratch,
    row: Row,
    /// `[maps][samples of the bin]`.
    values: Vec<Vec<[f32; 4]>>,
}

/// What a row of bins came to.
#[derive(Clone, Copy, Default)]
struct Counts {
    owned: u64,
    covered: u64,
    overlaps: u64,
    behind: u64,
    pairs: u64,
    double: u64,
    device: Duration,
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
    /// `finest`: of the levels, with `atlas_uv`.
    fn new(
        input: &BakeInput<'a>,
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
                let search = Search::new(high, finest, options);
                match backend {
                    Backend::Cpu => Finder::Lines(search),
                    Backend::Gpu(gpu) => {
                        let device = HitPass::new(gpu, &search, Portions::default())?;
                        Finder::Device(search, device)
                    }
                }
            }
            Method::Correspondence => {
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
        Ok(Pass { high, low, sheet, finder, charts: charts::charts(finest, uv), options, backend })
    }

    /// All maps of the sheet, in the order of `planned`; counts are added to `report`.
    fn bake(
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
            tree = kiln_geom::Bvh::new(&high.positions, &high.triangles);
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

    fn account(&self, counts: Counts, report: &mut BakeReport) {
        let odd = |count: fn(&low::Oddities) -> bool| {
            let faces = (0..self.low.mesh.face_count()).into_par_iter().filter(|f| self.low.holds(*f));
            faces.filter(|f| count(&self.low.oddities(*f))).count() as u64
        };
        report.backend.clone_from(&self.backend);
        report.owned += counts.owned;
        report.covered += counts.covered;
        report.missed += counts.owned - counts.covered;
        report.overlapping += counts.overlaps.div_ceil(u64::from(self.sheet.samples * self.sheet.samples));
        report.behind += counts.behind;
        report.pairs += counts.pairs;
        report.sliver_faces += odd(|o| o.sliver);
        report.flat_faces += odd(|o| o.flat);
        report.steep_faces += odd(|o| o.steep);
        report.crossing_faces += odd(|o| o.crossing);
    }

    /// Visits all rows of bins, each with its part of `bands`, in parallel; in stripes where a device finds the winners.
    fn each_row<T: Send>(
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
    fn hits(&self, x: u32, y: u32, stripe: Option<&Stripe>, bench: &mut Bench) -> Counts {
        let (faces, rect) = (self.sheet.faces(x, y), self.sheet.samples(x, y));
        if let Some(stripe) = stripe {
            stripe.copy(x, rect, &mut bench.owners, &mut bench.winners);
            return Counts::default();
        }
        let overlaps = self.sheet.own(&self.low, faces, rect, &mut bench.owners);
        let (pairs, double) = match &self.finder {
            Finder::Lines(search) | Finder::Device(search, _) => {
                let found = search.find(&self.low, faces, rect, &bench.owners, &mut bench.winners, &mut bench.scratch);
                (found, 0)
            }
            Finder::Layout(layout) => layout.find(rect, &bench.owners, &mut bench.winners),
        };
        Counts { overlaps, pairs, double, ..Counts::default() }
    }

    fn locator(&self) -> Locator<'_> {
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

/// Which high face each texel of a sheet shows: the hit pass alone, before anything is sampled; for measuring.
pub struct HitBuffer<'a> {
    pass: Pass<'a>,
    /// `[size * size]` low face + 1 that owns the texel's centre, 0 = none.
    pub low_faces: Vec<u32>,
    /// `[size * size]` high face + 1 that won, 0 = none within reach.
    pub high_faces: Vec<u32>,
    /// Everything known so far.
    pub report: BakeReport,
    /// What a device took of the time, its uploads and read-backs included, as far as the CPU waited for it.
    pub device: Duration,
}

/// The hit pass of the first sheet alone, one sample a texel. The finest level needs `atlas_uv`.
///
/// # Errors
/// Options out of range, missing attributes, a failing device.
pub fn find_hits<'a>(
    input: &BakeInput<'a>,
    options: &'a BakeOptions,
    backend: Backend<'a>,
) -> Result<HitBuffer<'a>, BakeError> {
    let finest = &input.low.levels.first().ok_or(BakeError::NoLevels)?.mesh;
    if options.samples != 1 {
        let (found, expected) = (options.samples.to_string(), "1 for the hit pass alone".into());
        return Err(BakeError::Option { name: "samples", found, expected });
    }
    let reach = reach(input.high, input.low.levels[0].error, options);
    let pass = Pass::new(input, finest, 0, options, reach, backend)?;
    let size = pass.sheet.size as usize;
    let (mut low_faces, mut high_faces) = (vec![0u32; size * size], vec![0u32; size * size]);
    let rows = pass.sheet.side as usize * size;
    let bands = low_faces.chunks_mut(rows).zip(high_faces.chunks_mut(rows)).collect();
    let counts = pass.each_row(bands, |y, (low, high), stripe, bench| {
        let mut counts = Counts::default();
        for x in 0..pass.sheet.across {
            let rect = pass.sheet.samples(x, y);
            counts = counts + pass.hits(x, y, stripe, bench);
            let width = (rect.x1 - rect.x0) as usize;
            for (row, from) in bench.owners.chunks_exact(width).zip(bench.winners.chunks_exact(width)).enumerate() {
                let start = row * size + rect.x0 as usize;
                low[start..start + width].copy_from_slice(from.0);
                high[start..start + width].copy_from_slice(from.1);
            }
        }
        counts
    })?;
    let count = |texels: &[u32]| texels.iter().filter(|t| **t != 0).count() as u64;
    let counts = Counts { owned: count(&low_faces), covered: count(&high_faces), ..counts };
    let mut report =
        BakeReport { size: options.size, front: reach[0], back: reach[1], sheets: 1, ..BakeReport::default() };
    pass.account(counts, &mut report);
    Ok(HitBuffer { pass, low_faces, high_faces, report, device: counts.device })
}

impl HitBuffer<'_> {
    /// `[size * size]` normals of the high mesh at the hits, object space, unit length, without its normal maps; zero where
    /// nothing is hit. For measuring: full precision.
    pub fn object_normals(&self) -> Vec<Vec3> {
        let Some(normals) = self.pass.high.normals.as_deref() else { return Vec::new() };
        self.each(Vec3::ZERO, |hit| {
            let corners = self.pass.high.triangles[hit.high].map(|v| normals[v as usize]);
            let turn = if hit.turned { -1.0 } else { 1.0 };
            turn * resolve::mix3(corners, hit.high_bary).normalize_or_zero()
        })
    }

    /// `[size * size]` hit points, object space; `None` where nothing is hit.
    pub fn positions(&self) -> Vec<Option<Vec3>> {
        self.each(None, |hit| {
            let corners = self.pass.high.face_positions(kiln_asset::FaceId(hit.high as u32));
            Some(resolve::mix3(corners, hit.high_bary))
        })
    }

    fn each<T: Clone + Send + Sync>(&self, nothing: T, visit: impl Fn(&resolve::HitPoint) -> T + Sync) -> Vec<T> {
        let size = self.pass.sheet.size as usize;
        let mut out = vec![nothing; size * size];
        out.par_chunks_mut(size).enumerate().for_each_init(
            || self.pass.locator(),
            |locator, (y, row)| {
                for (x, slot) in row.iter_mut().enumerate() {
                    let (low, high) = (self.low_faces[y * size + x], self.high_faces[y * size + x]);
                    if high == 0 {
                        continue;
                    }
                    let sample = [x as u32, y as u32];
                    if let Some(hit) = locator.at(sample, low as usize - 1, high as usize - 1, Needs::default()) {
                        *slot = visit(&hit);
                    }
                }
            },
        );
        out
    }
}

fn reach(high: &Mesh, error: f32, options: &BakeOptions) -> [f32; 2] {
    // A mesh without extent has nothing to hit, but a reach must be positive.
    let own = (BakeOptions::REACH * error).max(BakeOptions::REACH_SHARE * high.diagonal()).max(f32::MIN_POSITIVE);
    [options.front.unwrap_or(own), options.back.unwrap_or(own)]
}

/// Maps that materials in use have and nobody asked for.
fn lost_maps(asked: &[MapRole], used: &[Material]) -> Vec<MapRole> {
    let lost = |r: &MapRole| !asked.contains(r) && used.iter().any(|m| m.map(*r).is_some());
    MapRole::ALL.iter().copied().filter(lost).collect()
}

/// The layout's padding at the maps' size, texels, where it is less than the dilation.
fn short_padding(low: &LodSet, options: &BakeOptions) -> Option<u32> {
    let layout = low.layout?;
    let padding = (layout.padding as u64 * options.size as u64 / layout.size.max(1) as u64) as u32;
    (padding < options.dilation).then_some(padding)
}

/// The levels' meshes with the layout to bake into as `atlas_uv`, and tangents that belong to it where the bake needs any.
fn dressed(low: &LodSet, options: &BakeOptions) -> Result<Vec<Mesh>, BakeError> {
    let needs_tangents = options.maps.contains(&MapRole::Normal) && options.space == NormalSpace::Tangent;
    let mut meshes = Vec::with_capacity(low.levels.len());
    for (level, Level { mesh, .. }) in low.levels.iter().enumerate() {
        let mut mesh = mesh.clone();
        if mesh.atlas_uv.is_none() && options.method == Method::Correspondence && mesh.uv0.is_some() {
            let mut raw = mesh.into_raw();
            raw.atlas_uv = raw.uv0.take();
            mesh = Mesh::new(raw).map_err(|e| BakeError::Mesh { level, message: e.to_string() })?;
        }
        if mesh.atlas_uv.is_none() {
            return Err(BakeError::NoAtlas { level });
        }
        if mesh.normals.is_none() {
            return Err(BakeError::NoNormals { mesh: "low" });
        }
        meshes.push(match &mesh.tangents {
            _ if !needs_tangents => mesh,
            None => tangents::mikktspace(&mesh, UvSource::AtlasUv).map_err(|e| BakeError::Tangents(e.to_string()))?,
            Some(_) if check::tangents_follow_atlas(&mesh) => mesh,
            Some(_) => return Err(BakeError::StaleTangents { level }),
        });
    }
    Ok(meshes)
}

/// A level after the bake: the atlas is its only UV set, submeshes refer to the new materials.
fn redress(mesh: Mesh, groups: &Groups, drop_colors: bool) -> Result<Mesh, String> {
    let mut raw = mesh.into_raw();
    raw.uv0 = raw.atlas_uv.take();
    raw.uv1 = None;
    if let Some(uv) = &mut raw.uv0 {
        // Sheets lay side by side; from here on each is a texture of its own.
        let mut shift = vec![0.0; uv.len()];
        for (triangle, submesh) in raw.triangles.iter().zip(&raw.face_submesh) {
            let sheet = groups.materials[groups.of_submesh[submesh.index()]].sheet;
            triangle.iter().for_each(|v| shift[*v as usize] = sheet as f32);
        }
        uv.iter_mut().zip(shift).for_each(|(uv, shift)| uv.x -= shift);
    }
    if drop_colors {
        raw.colors = None;
    }
    let has_tangents = raw.tangents.is_some();
    for (submesh, group) in raw.submeshes.iter_mut().zip(&groups.of_submesh) {
        submesh.material = Some(MaterialId(*group as u32));
        submesh.attributes.uv0 = true;
        submesh.attributes.uv1 = false;
        submesh.attributes.tangents = has_tangents;
        submesh.attributes.normals = true;
        submesh.attributes.colors &= !drop_colors;
    }
    Mesh::new(raw).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests;
