//! The hit pass on a graphics device: `shaders/mirrored_vertex.wgsl`, fed with pairs that the CPU found.
//!
//! Owners come from the CPU rasteriser as a picture, so coverage is the twin's to the texel; pairs too, so candidates are the
//! same. What may differ is a winner where a corner snaps to another 1/256 texel or two distances agree to the last bits.

use bytemuck::{Pod, Zeroable};
use kiln_gpu::{Gpu, GpuError, wgpu};
use kiln_shaders::MIRRORED_VERTEX;
use rayon::prelude::*;

use super::candidates::{FALLBACK, Search};
use super::frame::{Frame, Sheet};

/// Pairs in one draw: 16 MiB, below every device's binding limit; smaller draws cost a submission each.
const PAIRS_A_DRAW: usize = 1 << 21;

/// Low faces whose pairs are gathered at once: bounds what waits between the gathering and the draw.
const FACES_A_BATCH: usize = 1 << 12;

/// `Pass` in the shader.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Pass {
    size: u32,
    cage: f32,
    pad: [u32; 2],
}

/// As [`super::mirrored_vertex::hits`], on `gpu`.
pub(crate) fn hits(gpu: &Gpu, sheet: &Sheet, search: &Search<'_>) -> Result<(Vec<u32>, u64), GpuError> {
    hits_in_draws_of(PAIRS_A_DRAW, gpu, sheet, search)
}

/// [`hits`] with at most `most` pairs in a draw.
pub(super) fn hits_in_draws_of(
    most: usize,
    gpu: &Gpu,
    sheet: &Sheet,
    search: &Search<'_>,
) -> Result<(Vec<u32>, u64), GpuError> {
    let pass = HitPass::new(gpu, sheet, search)?;
    let mut pairs: Vec<[u32; 2]> = Vec::new();
    let mut total = 0;
    for start in (0..sheet.faces.len()).step_by(FACES_A_BATCH) {
        let end = (start + FACES_A_BATCH).min(sheet.faces.len());
        let gathered: Vec<Vec<[u32; 2]>> = (start..end)
            .into_par_iter()
            .map_init(Default::default, |(faces, candidates), face| {
                search.gather(face, &sheet.faces[face], faces, candidates);
                let pair = |fallback| face as u32 | if fallback { FALLBACK } else { 0 };
                candidates.iter().map(|c| [pair(c.fallback), c.high]).collect()
            })
            .collect();
        for of_face in gathered {
            total += of_face.len() as u64;
            pairs.extend(of_face);
        }
        // Any cut will do: depth and ids stay between draws, and pairs stay in order.
        let whole = pairs.len() - pairs.len() % most;
        for draw in pairs[..whole].chunks(most) {
            pass.draw(draw)?;
        }
        pairs.drain(..whole);
    }
    pass.draw(&pairs)?;
    Ok((gpu.read_id_picture(&pass.ids)?, total))
}

struct HitPass<'a> {
    gpu: &'a Gpu,
    pipeline: wgpu::RenderPipeline,
    uniform: wgpu::Buffer,
    points: wgpu::Buffer,
    corners: wgpu::Buffer,
    frames: wgpu::Buffer,
    owners: wgpu::Texture,
    ids: wgpu::Texture,
    depth: wgpu::Texture,
}

impl<'a> HitPass<'a> {
    fn new(gpu: &'a Gpu, sheet: &Sheet, search: &Search<'_>) -> Result<HitPass<'a>, GpuError> {
        let high = search.high();
        let frames: Vec<Frame> = sheet.faces.iter().map(|f| f.frame.unwrap_or_default()).collect();
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let id_usage = drawn | wgpu::TextureUsages::COPY_SRC;
        let pass = HitPass {
            gpu,
            pipeline: gpu.check("the hit pass", || pipeline(gpu.device()))?,
            uniform: gpu.uniform("pass", &Pass { size: sheet.size, cage: search.cage, pad: [0; 2] })?,
            points: gpu.storage("high positions", &high.positions)?,
            corners: gpu.storage("high triangles", &high.triangles)?,
            frames: gpu.storage("low frames", &frames)?,
            owners: gpu.id_picture("owners", sheet.size, &sheet.owners)?,
            ids: gpu.picture("hit ids", sheet.size, wgpu::TextureFormat::R32Uint, id_usage)?,
            depth: gpu.picture("hit depth", sheet.size, wgpu::TextureFormat::Depth32Float, drawn)?,
        };
        pass.submit(None)?;
        Ok(pass)
    }

    /// Offers these pairs to the depth test, after all earlier ones.
    fn draw(&self, pairs: &[[u32; 2]]) -> Result<(), GpuError> {
        if pairs.is_empty() { Ok(()) } else { self.submit(Some(pairs)) }
    }

    /// One render pass: clears where `pairs` is `None`, else draws them over what is there.
    fn submit(&self, pairs: Option<&[[u32; 2]]>) -> Result<(), GpuError> {
        let device = self.gpu.device();
        let buffer = pairs.map(|pairs| self.gpu.storage("pairs", pairs)).transpose()?;
        self.gpu.check("the hit pass", || {
            let clear = pairs.is_none();
            let ids = self.ids.create_view(&Default::default());
            let depth = self.depth.create_view(&Default::default());
            let mut encoder = device.create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("hit pass"),
                    color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                        view: &ids,
                        depth_slice: None,
                        resolve_target: None,
                        ops: wgpu::Operations {
                            load: if clear {
                                wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT)
                            } else {
                                wgpu::LoadOp::Load
                            },
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
                if let (Some(pairs), Some(buffer)) = (pairs, &buffer) {
                    pass.set_pipeline(&self.pipeline);
                    pass.set_bind_group(0, &self.bindings(buffer), &[]);
                    pass.draw(0..pairs.len() as u32 * 3, 0..1);
                }
            }
            self.gpu.queue().submit([encoder.finish()]);
        })
    }

    fn bindings(&self, pairs: &wgpu::Buffer) -> wgpu::BindGroup {
        let owners = self.owners.create_view(&Default::default());
        let buffers = [&self.uniform, &self.points, &self.corners, &self.frames, pairs];
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
        // No culling: mirrored charts turn the winding, and pairs that face away were never made.
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
