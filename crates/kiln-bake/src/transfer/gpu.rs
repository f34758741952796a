//! The hit pass on a graphics device: `shaders/mirrored_vertex.wgsl`, fed with pairs that the CPU found.
//!
//! ```text
//! for each stripe of rows of bins, in pieces no wider than the device's pictures:
//!     each bin, in parallel: owners of its samples                          one picture of the piece, filter's border included
//!     some bins at a time, in parallel: candidates of each low face         (search: the twin's own)
//!         as soon as enough have come together: one draw of all of them
//!     read the winners' ids
//! ```
//!
//! Owners and candidates are the twin's, so coverage is too, but for samples whose line grazes a border of the high mesh or ends at
//! the reach. What may differ beside: a winner among hits whose distances agree to about 2^-22 of the reach.
//!
//! Samples that the filters of two bins share are owned and drawn once, by the bin that they lie in.

use std::ops::Range;
use std::time::{Duration, Instant};

use bytemuck::{Pod, Zeroable};
use glam::DVec3;
use kiln_geom::raster::Rect;
use kiln_gpu::{Gpu, GpuError, wgpu};
use kiln_shaders::MIRRORED_VERTEX;
use rayon::prelude::*;

use super::low::{Lines, Low};
use super::options::HitRule;
use super::search::{Candidate, Search};
use super::sheet::Sheet;

/// In a pair: the high face counts only where the low face's own submesh offers nothing.
const FALLBACK: u32 = 1 << 31;

/// In the pass's flags.
const NEAREST: u32 = 1;
const BACK_FACES: u32 = 2;

/// Bins whose candidates are gathered at once: bounds what waits between the gathering and the draw.
const BINS_A_BATCH: usize = 64;

/// How much is worked at in one go. What comes out does not depend on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Portions {
    /// Samples of a stripe: 16 MiB for each of owners, ids and depths.
    pub(crate) samples: u64,
    /// Greatest side of a piece, samples; at most 2^15, for pairs keep it in 16 bits.
    pub(crate) side: u32,
    /// Pairs of a draw: 16 MiB, below every device's binding limit; smaller draws cost a submission each.
    pub(crate) pairs: usize,
    /// Low faces in the bins of a draw: 16 MiB.
    pub(crate) lines: usize,
    /// Fragments of a draw, so that none takes the seconds after which systems reset a device.
    pub(crate) fragments: u64,
}

impl Default for Portions {
    fn default() -> Self {
        Portions { samples: 1 << 22, side: 1 << 14, pairs: 1 << 20, lines: 1 << 17, fragments: 1 << 28 }
    }
}

/// `Pass` in the shader.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PassRecord {
    size: [f32; 2],
    step: f32,
    flags: u32,
}

/// `Lines` in the shader.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct LinesRecord {
    base: [f32; 3],
    owner: u32,
    origin_0: [f32; 3],
    shift_x: i32,
    origin_1: [f32; 3],
    shift_y: i32,
    origin_2: [f32; 3],
    scale: f32,
    direction_0: [f32; 3],
    front_0: f32,
    direction_1: [f32; 3],
    front_1: f32,
    direction_2: [f32; 3],
    front_2: f32,
    back: f32,
    clip: [f32; 2],
    pad: f32,
}

impl LinesRecord {
    /// For a picture whose first sample is `first`.
    fn new(lines: &Lines, owner: u32, first: [u32; 2], samples: u32) -> LinesRecord {
        let scale = scale(lines.extent);
        // What would overflow is further than any mesh.
        let length = |v: f64| (v * scale).clamp(-1e30, 1e30) as f32;
        let point = |v: DVec3| v.to_array().map(length);
        let unit = |v: DVec3| v.as_vec3().to_array();
        let shift = |k: usize| (i64::from(first[k]) - i64::from(lines.pixel[k]) * i64::from(samples)) as i32;
        LinesRecord {
            base: unit(lines.base),
            owner,
            origin_0: point(lines.origin[0]),
            shift_x: shift(0),
            origin_1: point(lines.origin[1]),
            shift_y: shift(1),
            origin_2: point(lines.origin[2]),
            scale: scale as f32,
            direction_0: unit(lines.direction[0]),
            front_0: length(lines.front[0]),
            direction_1: unit(lines.direction[1]),
            front_1: length(lines.front[1]),
            direction_2: unit(lines.direction[2]),
            front_2: length(lines.front[2]),
            back: length(lines.back),
            clip: lines.clip.map(length),
            pad: 0.0,
        }
    }
}

/// A power of two that brings `extent` near 1, as far as 32-bit floats go.
fn scale(extent: f64) -> f64 {
    const BIAS: u64 = 1023;
    let exponent = ((extent.to_bits() >> 52) & 0x7ff).clamp(BIAS - 100, BIAS + 100);
    f64::from_bits((2 * BIAS - exponent) << 52)
}

/// Index of the lines (| [`FALLBACK`]), high face, first and last + 1 column, likewise row.
type Pair = [u32; 4];

/// The winners of some rows of bins.
pub(crate) struct Stripe {
    /// From left to right.
    pieces: Vec<Piece>,
    /// Bins across a piece.
    bins: u32,
    /// Samples that a second low face covers too.
    pub(crate) overlaps: u64,
    /// Pairs that were drawn.
    pub(crate) pairs: u64,
    /// Spent on the device's side: bytes there, draws, bytes back.
    pub(crate) device: Duration,
}

struct Piece {
    rect: Rect,
    /// `[rows x columns]` low face + 1, 0 = none.
    owners: Vec<u32>,
    /// `[rows x columns]` high face + 1, 0 = none.
    winners: Vec<u32>,
}

impl Stripe {
    /// Owners and winners of a bin in column `x`: `[rows x columns]` of its samples in `rect`.
    pub(crate) fn copy(&self, x: u32, rect: Rect, owners: &mut Vec<u32>, winners: &mut Vec<u32>) {
        owners.clear();
        winners.clear();
        let piece = &self.pieces[(x / self.bins) as usize];
        let whole = piece.rect;
        for y in rect.y0..rect.y1 {
            let row = (y - whole.y0) as usize * (whole.x1 - whole.x0) as usize;
            let run = row + (rect.x0 - whole.x0) as usize..row + (rect.x1 - whole.x0) as usize;
            owners.extend_from_slice(&piece.owners[run.clone()]);
            winners.extend_from_slice(&piece.winners[run]);
        }
    }
}

/// A device with the high mesh on it.
pub(crate) struct HitPass<'a> {
    gpu: &'a Gpu,
    portions: Portions,
    pipeline: wgpu::RenderPipeline,
    points: wgpu::Buffer,
    corners: wgpu::Buffer,
    flags: u32,
}

impl<'a> HitPass<'a> {
    /// # Errors
    /// The device refuses the shader, or the high mesh is larger than it binds.
    pub(crate) fn new(gpu: &'a Gpu, search: &Search<'_>, portions: Portions) -> Result<HitPass<'a>, GpuError> {
        let nearest = if search.hit == HitRule::Nearest { NEAREST } else { 0 };
        let side = portions.side.min(gpu.device().limits().max_texture_dimension_2d);
        Ok(HitPass {
            gpu,
            portions: Portions { side, ..portions },
            pipeline: gpu.check("the hit pass", || pipeline(gpu.device()))?,
            points: gpu.storage("high positions", &search.high.positions)?,
            corners: gpu.storage("high triangles", &search.high.triangles)?,
            flags: nearest | if search.back_faces { BACK_FACES } else { 0 },
        })
    }

    /// Bins that fit into a piece, side by side with the filter's border around them.
    fn bins_a_side(&self, sheet: &Sheet) -> u32 {
        (self.portions.side.saturating_sub(sheet.samples) / (sheet.side * sheet.samples)).max(1)
    }

    /// Rows of bins in a stripe of the sheet.
    pub(crate) fn rows(&self, sheet: &Sheet) -> u32 {
        let whole = u64::from(sheet.size * sheet.samples) * u64::from(sheet.side * sheet.samples);
        (self.portions.samples / whole).clamp(1, u64::from(self.bins_a_side(sheet))) as u32
    }

    /// Winners of these rows of bins.
    ///
    /// # Errors
    /// The device fails.
    pub(crate) fn stripe(
        &self,
        low: &Low<'_>,
        sheet: &Sheet,
        search: &Search<'_>,
        rows: Range<u32>,
    ) -> Result<Stripe, GpuError> {
        let bins = self.bins_a_side(sheet);
        let mut stripe = Stripe { pieces: Vec::new(), bins, overlaps: 0, pairs: 0, device: Duration::ZERO };
        for first in (0..sheet.across).step_by(bins as usize) {
            let columns = first..(first + bins).min(sheet.across);
            let piece = self.piece(low, sheet, search, [columns, rows.clone()], &mut stripe)?;
            stripe.pieces.push(piece);
        }
        Ok(stripe)
    }

    fn piece(
        &self,
        low: &Low<'_>,
        sheet: &Sheet,
        search: &Search<'_>,
        [columns, rows]: [Range<u32>; 2],
        stripe: &mut Stripe,
    ) -> Result<Piece, GpuError> {
        let cells = Cells { sheet, columns, rows };
        let rect = cells.whole();
        let (owners, overlaps) = cells.own(low);
        stripe.overlaps += overlaps;
        let full: Vec<[u32; 2]> = cells.each().filter(|[x, y]| !sheet.faces(*x, *y).is_empty()).collect();
        let mut canvas = Canvas { pass: self, rect, samples: low.samples, drawn: None, batch: Batch::default() };
        for bins in full.chunks(BINS_A_BATCH) {
            let gather = |(found, candidates): &mut (Vec<u32>, Vec<Candidate>), [x, y]: &[u32; 2]| {
                let mut gathered = Gathered::default();
                for face in sheet.faces(*x, *y).iter().map(|f| *f as usize) {
                    let Some(lines) = low.lines(face) else { continue };
                    search.gather(low, face, &lines, cells.samples(*x, *y), found, candidates);
                    gathered.add(face, &lines, candidates, rect, low.samples);
                }
                gathered
            };
            let gathered: Vec<Gathered> = bins.par_iter().map_init(Default::default, gather).collect();
            let started = Instant::now();
            for of_bin in &gathered {
                stripe.pairs += of_bin.pairs.len() as u64;
                canvas.add(of_bin, &owners)?;
            }
            stripe.device += started.elapsed();
        }
        let started = Instant::now();
        let winners = canvas.finish(&owners)?;
        stripe.device += started.elapsed();
        Ok(Piece { rect, owners, winners })
    }
}

/// The bins of a piece.
struct Cells<'a> {
    sheet: &'a Sheet,
    columns: Range<u32>,
    rows: Range<u32>,
}

impl Cells<'_> {
    fn each(&self) -> impl Iterator<Item = [u32; 2]> {
        self.rows.clone().flat_map(|y| self.columns.clone().map(move |x| [x, y]))
    }

    /// All samples, the filter's border included.
    fn whole(&self) -> Rect {
        let first = self.sheet.samples(self.columns.start, self.rows.start);
        let last = self.sheet.samples(self.columns.end - 1, self.rows.end - 1);
        Rect { x0: first.x0, y0: first.y0, x1: last.x1, y1: last.y1 }
    }

    /// The samples that a bin draws: its own, and the border where the piece ends. Each sample of the piece belongs to one bin.
    fn samples(&self, x: u32, y: u32) -> Rect {
        let (outer, texels, n) = (self.sheet.samples(x, y), self.sheet.texels(x, y), self.sheet.samples);
        Rect {
            x0: if x == self.columns.start { outer.x0 } else { texels.x0 * n },
            y0: if y == self.rows.start { outer.y0 } else { texels.y0 * n },
            x1: if x + 1 == self.columns.end { outer.x1 } else { texels.x1 * n },
            y1: if y + 1 == self.rows.end { outer.y1 } else { texels.y1 * n },
        }
    }

    /// `[rows x columns]` of all samples: low face + 1, 0 = none; and how many a second face covers too.
    fn own(&self, low: &Low<'_>) -> (Vec<u32>, u64) {
        let whole = self.whole();
        let width = (whole.x1 - whole.x0) as usize;
        let mut owners = vec![0; width * (whole.y1 - whole.y0) as usize];
        let bins: Vec<[u32; 2]> = self.each().filter(|[x, y]| !self.sheet.faces(*x, *y).is_empty()).collect();
        let own = |[x, y]: [u32; 2]| {
            let (rect, mut owners) = (self.samples(x, y), Vec::new());
            let overlaps = self.sheet.own(low, [x, y], rect, &mut owners);
            (rect, owners, overlaps)
        };
        let mut overlaps = 0;
        for bins in bins.chunks(BINS_A_BATCH) {
            let owned: Vec<(Rect, Vec<u32>, u64)> = bins.par_iter().map(|bin| own(*bin)).collect();
            for (rect, from, twice) in owned {
                overlaps += twice;
                for (row, from) in from.chunks_exact((rect.x1 - rect.x0) as usize).enumerate() {
                    let start = ((rect.y0 - whole.y0) as usize + row) * width + (rect.x0 - whole.x0) as usize;
                    owners[start..start + from.len()].copy_from_slice(from);
                }
            }
        }
        (owners, overlaps)
    }
}

/// The candidates of one bin.
#[derive(Default)]
struct Gathered {
    /// One for each low face that has any, with the end of its pairs.
    lines: Vec<(LinesRecord, usize)>,
    /// Their index is not set yet.
    pairs: Vec<Pair>,
}

impl Gathered {
    fn add(&mut self, face: usize, lines: &Lines, candidates: &[Candidate], whole: Rect, samples: u32) {
        if candidates.is_empty() {
            return;
        }
        let pair = |c: &Candidate| {
            let Rect { x0, y0, x1, y1 } = c.samples;
            let ends = |from: u32, to: u32, first: u32| (from - first) | (to - first) << 16;
            let fallback = if c.fallback { FALLBACK } else { 0 };
            [fallback, c.high, ends(x0, x1, whole.x0), ends(y0, y1, whole.y0)]
        };
        self.pairs.extend(candidates.iter().map(pair));
        let record = LinesRecord::new(lines, face as u32 + 1, [whole.x0, whole.y0], samples);
        self.lines.push((record, self.pairs.len()));
    }
}

/// What the next draw will draw.
#[derive(Default)]
struct Batch {
    lines: Vec<LinesRecord>,
    pairs: Vec<Pair>,
    fragments: u64,
}

/// The pictures of a piece, as far as they are drawn.
struct Canvas<'a> {
    pass: &'a HitPass<'a>,
    rect: Rect,
    samples: u32,
    drawn: Option<Pictures>,
    batch: Batch,
}

struct Pictures {
    uniform: wgpu::Buffer,
    owners: wgpu::Texture,
    ids: wgpu::Texture,
    depth: wgpu::Texture,
    clear: bool,
}

impl Canvas<'_> {
    /// Offers the pairs of a bin to the depth test, after all earlier ones; draws when enough have come together.
    fn add(&mut self, gathered: &Gathered, owners: &[u32]) -> Result<(), GpuError> {
        let most = self.pass.portions;
        let mut start = 0;
        for (record, end) in &gathered.lines {
            let mut fresh = true;
            for pair in &gathered.pairs[start..*end] {
                let span = |ends: u32| u64::from((ends >> 16) - (ends & 0xffff));
                let fragments = span(pair[2]) * span(pair[3]);
                let full = self.batch.pairs.len() >= most.pairs
                    || self.batch.fragments + fragments > most.fragments
                    || (fresh && self.batch.lines.len() >= most.lines);
                if full && !self.batch.pairs.is_empty() {
                    // Any cut will do: depths and ids stay between draws, and pairs stay in order.
                    self.draw(owners)?;
                    fresh = true;
                }
                if fresh {
                    self.batch.lines.push(*record);
                    fresh = false;
                }
                let [fallback, high, columns, rows] = *pair;
                self.batch.pairs.push([fallback | (self.batch.lines.len() as u32 - 1), high, columns, rows]);
                self.batch.fragments += fragments;
            }
            start = *end;
        }
        Ok(())
    }

    /// `[rows x columns]` high face + 1 of the winners, 0 = none.
    fn finish(mut self, owners: &[u32]) -> Result<Vec<u32>, GpuError> {
        self.draw(owners)?;
        match &self.drawn {
            Some(pictures) => self.pass.gpu.read_id_picture(&pictures.ids),
            None => Ok(vec![0; owners.len()]),
        }
    }

    /// Draws the batch over what is there.
    fn draw(&mut self, owners: &[u32]) -> Result<(), GpuError> {
        let batch = std::mem::take(&mut self.batch);
        if batch.pairs.is_empty() {
            return Ok(());
        }
        let gpu = self.pass.gpu;
        let mut pictures = match self.drawn.take() {
            Some(pictures) => pictures,
            None => self.pictures(owners)?,
        };
        let lines = gpu.storage("lines", &batch.lines)?;
        let pairs = gpu.storage("pairs", &batch.pairs)?;
        gpu.check("the hit pass", || self.pass.submit(&pictures, &lines, &pairs, batch.pairs.len() as u32))?;
        pictures.clear = false;
        self.drawn = Some(pictures);
        Ok(())
    }

    fn pictures(&self, owners: &[u32]) -> Result<Pictures, GpuError> {
        let (gpu, Rect { x0, y0, x1, y1 }) = (self.pass.gpu, self.rect);
        let size = [x1 - x0, y1 - y0];
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let record =
            PassRecord { size: size.map(|s| s as f32), step: 1.0 / self.samples as f32, flags: self.pass.flags };
        Ok(Pictures {
            uniform: gpu.uniform("pass", &record)?,
            owners: gpu.id_picture("owners", size, owners)?,
            ids: gpu.picture("hit ids", size, wgpu::TextureFormat::R32Uint, drawn | wgpu::TextureUsages::COPY_SRC)?,
            depth: gpu.picture("hit depth", size, wgpu::TextureFormat::Depth32Float, drawn)?,
            clear: true,
        })
    }
}

impl HitPass<'_> {
    /// One render pass with one draw.
    fn submit(&self, pictures: &Pictures, lines: &wgpu::Buffer, pairs: &wgpu::Buffer, count: u32) {
        let device = self.gpu.device();
        let ids = pictures.ids.create_view(&Default::default());
        let depth = pictures.depth.create_view(&Default::default());
        let clear = pictures.clear;
        let mut encoder = device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("hit pass"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &ids,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: if clear { wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT) } else { wgpu::LoadOp::Load },
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &depth,
                    depth_ops: Some(wgpu::Operations {
                        load: if clear { wgpu::LoadOp::Clear(1.0) } else { wgpu::LoadOp::Load },
                        store: wgpu::StoreOp::Store,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: None,
                occlusion_query_set: None,
                multiview_mask: None,
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bindings(pictures, lines, pairs), &[]);
            pass.draw(0..count * 6, 0..1);
        }
        self.gpu.queue().submit([encoder.finish()]);
    }

    fn bindings(&self, pictures: &Pictures, lines: &wgpu::Buffer, pairs: &wgpu::Buffer) -> wgpu::BindGroup {
        let owners = pictures.owners.create_view(&Default::default());
        let buffers = [&pictures.uniform, &self.points, &self.corners, lines, pairs];
        let mut entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        entries.push(wgpu::BindGroupEntry { binding: 5, resource: wgpu::BindingResource::TextureView(&owners) });
        self.gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("hit pass"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &entries,
        })
    }
}

fn pipeline(device: &wgpu::Device) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(MIRRORED_VERTEX.name),
        source: wgpu::ShaderSource::Wgsl(MIRRORED_VERTEX.source.into()),
    });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(MIRRORED_VERTEX.name),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: wgpu::TextureFormat::Depth32Float,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Less),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: Default::default(),
            targets: &[Some(wgpu::TextureFormat::R32Uint.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
