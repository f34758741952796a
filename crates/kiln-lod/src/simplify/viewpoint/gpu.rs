//! Many candidates at once on a graphics device: `shaders/price.wgsl`, then `shaders/formula.wgsl`.
//!
//! The device has the screens and all fragments as they are before the first collapse, and prices the largest batches there are, those
//! with which a sequence starts. Pixel counts are integers and come back in the order in which [`super::price`] meets the regions, so
//! costs computed from them, and the sequence, are the CPU's bit for bit. Costs in single precision come along for whoever wants them.
//! What the device cannot do (a star of more than 64 faces, more than 128 regions in a view, no memory) the CPU does.

use bytemuck::{Pod, Zeroable};
use kiln_asset::Wrap;
use kiln_gpu::{Gpu, GpuError, wgpu};
use kiln_shaders::{FORMULA, PRICE};

use super::ViewCondition;
use super::formula::{Delta, Measure};
use super::price::{Scratch, Star, stride};
use super::regions::RegionMap;
use super::scene::Scene;
use super::screen::{Fragment, Screens};
use crate::topology::NONE;

/// Most faces of a star, and regions of a candidate in a view: what a workgroup has room for.
const FACES: usize = 64;
/// Candidates times views in one dispatch: bounds the device's time and the rows that come back.
const DISPATCH: usize = 1 << 18;
/// Rows kept free for a candidate in a view, in the mean.
const ROWS: usize = 8;
/// Rows of a candidate in a view that was skipped.
const SKIPPED: u32 = u32::MAX;
/// Words before the first row: their number and padding.
const ROWS_HEAD: usize = 4;
/// Most texels across a picture of regions, so that twice as many have a sign.
const SIDE_LIMIT: u32 = 1 << 30;

/// `Pass` in `price.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PricePass {
    views: u32,
    size: u32,
    row_limit: u32,
    meets: u32,
}

/// `Pass` in `formula.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct FormulaPass {
    views: u32,
    pixels: u32,
    coupled: u32,
    order: f32,
}

impl<'a> ViewCondition<'a> {
    /// The same with the first prices from a device; the sequence stays the same, bit for bit. If the device fails, the CPU takes over:
    /// [`ViewCondition::trouble`].
    #[must_use]
    pub fn on(mut self, gpu: &'a Gpu) -> ViewCondition<'a> {
        self.gpu = Some(gpu);
        self
    }

    /// Why the device of [`ViewCondition::on`] was given up, if it was.
    pub fn trouble(&self) -> Option<GpuError> {
        self.trouble.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone()
    }

    /// `result`, or nothing and a note of the trouble.
    pub(super) fn tried<T>(&self, result: Result<T, GpuError>) -> Option<T> {
        let note = |error| *self.trouble.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(error);
        result.map_err(note).ok()
    }
}

/// A scene on a device, as it was when it was taken there.
pub struct Device<'a> {
    gpu: &'a Gpu,
    price: wgpu::ComputePipeline,
    formula: wgpu::ComputePipeline,
    places: wgpu::Buffer,
    texels: wgpu::Buffer,
    maps: wgpu::Buffer,
    heads: wgpu::Buffer,
    fragments: wgpu::Buffer,
    counts: wgpu::Buffer,
    totals: wgpu::Buffer,
    formula_pass: wgpu::Buffer,
    views: usize,
    size: u32,
    /// A bit for each view: whether its rays meet.
    meets: Vec<u32>,
    /// `[face_count]`: map of each face; empty where every face is a region.
    submesh: Vec<u32>,
}

/// What a device says of the candidates of some stars.
pub(super) struct Priced {
    views: usize,
    /// `[stars]`: the first candidate of each, or [`NONE`] where the star was not taken.
    first: Vec<u32>,
    /// `[candidates * views]`: first row, number of rows.
    spans: Vec<[u32; 2]>,
    /// Region, pixels it wins, rank.
    rows: Vec<[u32; 3]>,
    /// `[candidates]`: nats; negative where a view was skipped.
    costs: Vec<f32>,
}

/// The maps, 8 words each, then the ids of their pictures.
fn maps_of(screens: &Screens<'_>) -> Result<Vec<u32>, GpuError> {
    let Some(regions) = screens.regions else { return Ok(Vec::new()) };
    let mut words = vec![0; 8 * regions.maps.len()];
    for (m, map) in regions.maps.iter().enumerate() {
        let record = match map {
            RegionMap::Whole(region) => [*region, 0, 0, 0, 0, 0, 0, 0],
            RegionMap::Picture { width, height, wrap, ids, .. } => {
                let (needed, limit) = (u64::from(*width.max(height)), u64::from(SIDE_LIMIT));
                if needed >= limit || words.len() + ids.len() > u32::MAX as usize {
                    return Err(GpuError::TooLarge {
                        what: "a picture of regions".into(),
                        needed,
                        limit,
                        unit: "texels a side",
                    });
                }
                let mode = |wrap: &Wrap| match wrap {
                    Wrap::Repeat => 0,
                    Wrap::ClampToEdge => 1,
                    Wrap::MirroredRepeat => 2,
                };
                let first = words.len() as u32;
                words.extend_from_slice(ids);
                [NONE, first, *width, *height, mode(&wrap[0]), mode(&wrap[1]), 0, 0]
            }
        };
        words[8 * m..8 * m + 8].copy_from_slice(&record);
    }
    Ok(words)
}

impl<'a> Device<'a> {
    /// Takes a scene to a device.
    pub(super) fn new(gpu: &'a Gpu, scene: &Scene<'_>) -> Result<Device<'a>, GpuError> {
        let screens = scene.screens;
        let limit = gpu.device().limits().max_storage_buffer_binding_size / 12;
        let (mut heads, mut fragments) = (Vec::with_capacity(screens.pixels() * screens.views + 1), Vec::new());
        for layers in &scene.layers {
            for (pixel, front) in layers.front.iter().enumerate() {
                heads.push(fragments.len() as u32);
                let seen = (*front != Fragment::BACKGROUND).then_some(front);
                fragments
                    .extend(seen.into_iter().chain(layers.behind(pixel)).map(|f| [f.depth as u32, f.face, f.region]));
            }
            let needed = fragments.len() as u64;
            if needed > limit {
                return Err(GpuError::TooLarge { what: "fragments".into(), needed, limit, unit: "fragments" });
            }
        }
        heads.push(fragments.len() as u32);
        let mut meets = vec![0; screens.views.div_ceil(32)];
        for (view, _) in screens.meets.iter().enumerate().filter(|(_, meets)| **meets) {
            meets[view / 32] |= 1 << (view % 32);
        }
        let formula = scene.formula;
        let pass = FormulaPass {
            views: screens.views as u32,
            pixels: screens.pixels() as u32,
            coupled: u32::from(formula.measure == Measure::MutualInformation),
            order: formula.order as f32,
        };
        Ok(Device {
            gpu,
            price: gpu.compute_pipeline(PRICE.source, PRICE.name)?,
            formula: gpu.compute_pipeline(FORMULA.source, FORMULA.name)?,
            places: gpu.storage("places", &screens.places)?,
            texels: gpu.storage("texels", &screens.texels)?,
            maps: gpu.storage("maps", &maps_of(screens)?)?,
            heads: gpu.storage("heads", &heads)?,
            fragments: gpu.storage("fragments", &fragments)?,
            counts: gpu.storage("counts", &scene.histogram.counts)?,
            totals: gpu.storage("totals", &scene.histogram.totals)?,
            formula_pass: gpu.uniform("formula pass", &pass)?,
            views: screens.views,
            size: screens.size,
            meets,
            submesh: screens.submesh.clone(),
        })
    }

    /// Prices all targets of `stars`, in the scene that was taken to the device.
    pub(super) fn price<'s>(&self, stars: impl Iterator<Item = &'s Star>) -> Result<Priced, GpuError> {
        let mut out =
            Priced { views: self.views, first: Vec::new(), spans: Vec::new(), rows: Vec::new(), costs: Vec::new() };
        let mut batch = Batch::default();
        let mut sent = 0;
        for star in stars {
            if star.faces.len() > FACES || star.faces.is_empty() {
                out.first.push(NONE);
                continue;
            }
            if (batch.records.len() + star.to.len()) * self.views > DISPATCH && !batch.records.is_empty() {
                self.dispatch(&batch, &mut out)?;
                batch.clear();
            }
            out.first.push(sent);
            sent += star.to.len() as u32;
            batch.add(star, &self.submesh);
        }
        self.dispatch(&batch, &mut out)?;
        Ok(out)
    }

    /// One dispatch of each pass.
    fn dispatch(&self, batch: &Batch, out: &mut Priced) -> Result<(), GpuError> {
        let (gpu, candidates) = (self.gpu, batch.records.len());
        if candidates == 0 {
            return Ok(());
        }
        let row_limit = candidates * self.views * ROWS;
        let (words, meets) = batch.words(&self.meets);
        let pass = PricePass { views: self.views as u32, size: self.size, row_limit: row_limit as u32, meets };
        let pass = gpu.uniform("price pass", &pass)?;
        let words = gpu.storage("batch", &words)?;
        let spans = gpu.output("spans", (candidates * self.views * 8) as u64)?;
        let rows = gpu.output("rows", (4 * (ROWS_HEAD + 3 * row_limit)) as u64)?;
        let costs = gpu.output("costs", 4 * candidates as u64)?;
        let fixed = [&self.places, &self.texels, &self.maps, &self.heads, &self.fragments];
        let [places, texels, maps, heads, fragments] = fixed;
        let price = [&pass, places, texels, maps, heads, fragments, &words, &spans, &rows];
        let price = gpu.bindings("price", &self.price, &price)?;
        let formula = [&self.formula_pass, &self.counts, &self.totals, &spans, &rows, &costs];
        let formula = gpu.bindings("formula", &self.formula, &formula)?;
        gpu.check("prices", || {
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&self.price);
                pass.set_bind_group(0, &price, &[]);
                pass.dispatch_workgroups(self.views as u32, candidates as u32, 1);
                pass.set_pipeline(&self.formula);
                pass.set_bind_group(0, &formula, &[]);
                pass.dispatch_workgroups(candidates as u32, 1, 1);
            }
            gpu.queue().submit([encoder.finish()]);
        })?;
        let before = out.rows.len() as u32;
        let count = gpu.read::<u32>(&rows, 4)?[0].min(row_limit as u32) as usize;
        let read = gpu.read::<u32>(&rows, 4 * (ROWS_HEAD + 3 * count) as u64)?;
        out.rows.extend_from_slice(read[ROWS_HEAD..].as_chunks::<3>().0);
        let spans = gpu.read::<[u32; 2]>(&spans, (candidates * self.views * 8) as u64)?;
        out.spans.extend(spans.iter().map(|[first, rows]| [first + before, *rows]));
        out.costs.extend(gpu.read::<f32>(&costs, 4 * candidates as u64)?);
        Ok(())
    }

    /// Prices a batch.
    ///
    /// # Errors
    /// The device fails.
    pub fn price_batch(&self, stars: &super::study::Stars) -> Result<Vec<DevicePrice>, GpuError> {
        let priced = self.price(stars.0.iter())?;
        let price = |(star, target): (usize, usize)| {
            let mut deltas = Vec::new();
            let whole = priced.deltas(star, target, &mut deltas);
            DevicePrice { cost: priced.cost(star, target), deltas: whole.then_some(deltas) }
        };
        let candidates = stars.0.iter().enumerate().flat_map(|(s, star)| (0..star.to.len()).map(move |t| (s, t)));
        Ok(candidates.map(price).collect())
    }
}

/// What a device says of a candidate.
#[derive(Clone, Debug, PartialEq)]
pub struct DevicePrice {
    /// What views lose, nats, in single precision; `None` where the CPU must say.
    pub cost: Option<f32>,
    /// The changes of pixel counts, in the CPU's order; `None` where the CPU must say.
    pub deltas: Option<Vec<Delta>>,
}

/// Candidates on their way to the device.
#[derive(Default)]
struct Batch {
    /// Offsets are into `words`.
    records: Vec<[u32; 8]>,
    words: Vec<u32>,
}

impl Batch {
    fn clear(&mut self) {
        self.records.clear();
        self.words.clear();
    }

    fn add(&mut self, star: &Star, submesh: &[u32]) {
        let (first, faces) = (self.words.len() as u32, star.faces.len() as u32);
        self.words.extend(star.faces.iter().flat_map(|face| [face.face, face.points[1], face.points[2]]));
        for target in 0..star.to.len() {
            let changed = self.words.len() as u32;
            for face in star.after(target) {
                let map = submesh.get(face.face as usize).copied().unwrap_or(NONE);
                self.words.push(face.face);
                self.words.extend_from_slice(&face.points);
                self.words.extend_from_slice(&face.wedges);
                self.words.push(map);
            }
            let count = (self.words.len() as u32 - changed) / 8;
            self.records.push([first, faces, star.faces[0].points[0], changed, count, 0, 0, 0]);
        }
    }

    /// What the device reads, and where the bits of `meets` lie in it.
    fn words(&self, meets: &[u32]) -> (Vec<u32>, u32) {
        let bits = (8 * self.records.len()) as u32;
        let start = bits + meets.len() as u32;
        let moved = |r: &[u32; 8]| [r[0] + start, r[1], r[2], r[3] + start, r[4], 0, 0, 0];
        let records = self.records.iter().flat_map(moved);
        (records.chain(meets.iter().copied()).chain(self.words.iter().copied()).collect(), bits)
    }
}

impl Priced {
    /// The changes by a target of a star, views and regions in the order of [`super::price::price`]; false if the CPU must say.
    pub(super) fn deltas(&self, star: usize, target: usize, out: &mut Vec<Delta>) -> bool {
        out.clear();
        if self.first[star] == NONE {
            return false;
        }
        let candidate = self.first[star] as usize + target;
        let spans = &self.spans[candidate * self.views..(candidate + 1) * self.views];
        if spans.iter().any(|[_, rows]| *rows == SKIPPED) {
            return false;
        }
        let stride = stride(self.views);
        let mut view = 0;
        let mut ranked: Vec<[u32; 3]> = Vec::new();
        for _ in 0..self.views {
            view = (view + stride) % self.views;
            let [first, rows] = spans[view];
            ranked.clear();
            ranked.extend_from_slice(&self.rows[first as usize..(first + rows) as usize]);
            ranked.sort_unstable_by_key(|row| row[2]);
            let delta =
                |[region, count, _]: &[u32; 3]| Delta { view: view as u32, region: *region, count: *count as i32 };
            out.extend(ranked.iter().map(delta));
        }
        true
    }

    /// What views lose, nats; `None` if the CPU must say.
    fn cost(&self, star: usize, target: usize) -> Option<f32> {
        let first = self.first[star];
        let cost = (first != NONE).then(|| self.costs[first as usize + target])?;
        (cost >= 0.0).then_some(cost)
    }

    /// [`super::price::price`] from what the device said; false if the CPU must say.
    pub(super) fn fill(&self, star: usize, targets: usize, scratch: &mut Scratch) -> bool {
        if scratch.deltas.len() < targets {
            scratch.deltas.resize_with(targets, Vec::new);
        }
        scratch.partial.clear();
        scratch.partial.resize(targets, (0.0, false));
        (0..targets).all(|target| self.deltas(star, target, &mut scratch.deltas[target]))
    }
}
