//! Tree and leaf buffers, and the compact tree, on the GPU: vertex buffers, draw lists, and picking while drawing.
//!
//! ```text
//! Picks::tree_leaf(gpu, view) or Picks::compact(gpu, view, positions)     once: buffers and pipeline
//! picks.fill(threshold, range, floats, vertices)                         a vertex buffer's range, by a compute pass
//! DrawList::new(gpu, triangles, deaths, ranges)                          once
//! list.fill(threshold)                                                   index buffer and indirect arguments, order kept
//! picks.draw(...)                                                        no buffers at all: the vertex shader picks
//! ```
//! Positions are the CPU's bit for bit: they are copied, and what is compared are integers and the q of texels. Passes:
//! `shaders/tree_leaf_pick.wgsl`, `tree_compact_pick.wgsl`, `tree_draw_list.wgsl`, `tree_draw.wgsl`.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use kiln_format::layout::{CompactTreeView, TreeLeafView};
use kiln_gpu::{Gpu, GpuError, wgpu};
use kiln_shaders::{TREE_COMPACT_PICK, TREE_DRAW, TREE_DRAW_LIST, TREE_LEAF_PICK};

use crate::tree::{RLevel, Scale};

/// Invocations of a workgroup, and triangles of a block.
const LANES: u32 = 256;
/// Most workgroups in one direction that every device takes.
const GROUPS: u32 = 65_535;

/// `Pass` in `tree_leaf_pick.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct LeafPass {
    first: u32,
    count: u32,
    floats: u32,
    row: u32,
    fraction: f32,
    width: u32,
    rows: u32,
    pad: u32,
}

/// `Pass` in `tree_compact_pick.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct CompactPass {
    first: u32,
    count: u32,
    floats: u32,
    threshold: u32,
    nodes: u32,
    pad: [u32; 3],
}

/// `Pass` in `tree_draw_list.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct ListPass {
    triangles: u32,
    threshold: u32,
    blocks: u32,
    ranges: u32,
}

/// Floats of a vertex in a vertex buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Floats {
    /// x, y, z without gap.
    Three = 3,
    /// x, y, z, 1.
    Four = 4,
}

/// Workgroups in x and y for so many.
fn spread(groups: u32) -> [u32; 2] {
    [groups.min(GROUPS), groups.div_ceil(GROUPS)]
}

fn too_large(what: &str, needed: u64, unit: &'static str) -> GpuError {
    GpuError::TooLarge { what: what.into(), needed, limit: u64::from(u32::MAX), unit }
}

/// A buffer that passes write and draws read.
fn drawable(gpu: &Gpu, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer, GpuError> {
    let limits = gpu.device().limits();
    let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    if bytes > limit {
        return Err(GpuError::TooLarge { what: label.into(), needed: bytes, limit, unit: "bytes" });
    }
    let usage = usage | wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
    let size = bytes.max(16);
    gpu.check(label, || {
        gpu.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    })
}

/// A bind group of these buffers at these bindings.
fn bind(
    gpu: &Gpu,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    buffers: &[(u32, &wgpu::Buffer)],
) -> Result<wgpu::BindGroup, GpuError> {
    let entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
        .iter()
        .map(|(binding, buffer)| wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() })
        .collect();
    gpu.check(label, || {
        let label = Some(label);
        gpu.device().create_bind_group(&wgpu::BindGroupDescriptor { label, layout, entries: &entries })
    })
}

/// Which layout lies on the device.
enum Layout {
    TreeLeaf { width: u32, rows: u32 },
    Compact { nodes: u32 },
}

/// A tree on a device, ready to pick from.
pub struct Picks<'a> {
    gpu: &'a Gpu,
    fill: wgpu::ComputePipeline,
    layout: Layout,
    /// Bindings 1 on.
    buffers: Vec<wgpu::Buffer>,
    vertices: u32,
    row_starts: Vec<u32>,
    face_counts: Vec<u32>,
    source: &'static str,
}

impl<'a> Picks<'a> {
    /// Takes tree and leaf buffers to a device.
    ///
    /// # Errors
    /// Larger than the device binds, or it fails.
    pub fn tree_leaf(gpu: &'a Gpu, view: &TreeLeafView<'_>) -> Result<Picks<'a>, GpuError> {
        let header = &view.header;
        Ok(Picks {
            gpu,
            fill: gpu.compute_pipeline(TREE_LEAF_PICK.source, "fill")?,
            layout: Layout::TreeLeaf { width: header.width.max(1), rows: header.rows.max(1) },
            buffers: vec![gpu.storage("tree buffer", view.tree)?, gpu.storage("leaf buffer", view.leaf)?],
            vertices: view.leaf.len() as u32,
            row_starts: view.row_starts.to_vec(),
            face_counts: view.face_counts.to_vec(),
            source: TREE_LEAF_PICK.source,
        })
    }

    /// Takes a compact tree and level 0's positions, `[vertices]`, to a device.
    ///
    /// # Errors
    /// Larger than the device binds, or it fails.
    pub fn compact(gpu: &'a Gpu, view: &CompactTreeView<'_>, positions: &[[f32; 3]]) -> Result<Picks<'a>, GpuError> {
        Ok(Picks {
            gpu,
            fill: gpu.compute_pipeline(TREE_COMPACT_PICK.source, "fill")?,
            layout: Layout::Compact { nodes: view.nodes.len() as u32 },
            buffers: vec![
                gpu.storage("nodes", view.nodes)?,
                gpu.storage("terminals", view.terminals)?,
                gpu.storage("positions", positions)?,
            ],
            vertices: view.terminals.len().min(positions.len()) as u32,
            row_starts: view.row_starts.to_vec(),
            face_counts: view.face_counts.to_vec(),
            source: TREE_COMPACT_PICK.source,
        })
    }

    /// A vertex buffer for all vertices.
    ///
    /// # Errors
    /// Larger than the device binds, or no memory.
    pub fn vertex_buffer(&self, floats: Floats) -> Result<wgpu::Buffer, GpuError> {
        let bytes = u64::from(self.vertices) * 4 * floats as u64;
        drawable(self.gpu, "picked positions", bytes, wgpu::BufferUsages::VERTEX)
    }

    /// Fills the places of the vertices `range` in a buffer of [`Picks::vertex_buffer`].
    ///
    /// # Errors
    /// The device fails.
    pub fn fill(
        &self,
        threshold: u32,
        range: Range<u32>,
        floats: Floats,
        vertices: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let end = range.end.min(self.vertices);
        let count = end.saturating_sub(range.start);
        if count == 0 {
            return Ok(());
        }
        let pass = self.pass(threshold, range.start, count, floats)?;
        let mut buffers = self.bindings(&pass);
        buffers.push((4, vertices));
        let bindings = bind(self.gpu, "picks", &self.fill.get_bind_group_layout(0), &buffers)?;
        self.gpu.check("picks", || {
            let mut encoder = self.gpu.device().create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&self.fill);
                pass.set_bind_group(0, &bindings, &[]);
                let [x, y] = spread(count.div_ceil(LANES));
                pass.dispatch_workgroups(x, y, 1);
            }
            self.gpu.queue().submit([encoder.finish()]);
        })
    }

    /// A pipeline that draws triangles with the vertex shader picking, and writes the bits of depths to an R32Uint picture, nearest
    /// depth (`Depth32Float`) in front. An engine takes `draw` of the same text with a fragment shader of its own.
    ///
    /// # Errors
    /// The device refuses it.
    pub fn draw_pipeline(&self) -> Result<wgpu::RenderPipeline, GpuError> {
        let text = format!("{}\n{}", self.source, TREE_DRAW.source);
        self.gpu.check("picking draw", || {
            let device = self.gpu.device();
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(TREE_DRAW.name),
                source: wgpu::ShaderSource::Wgsl(text.into()),
            });
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(TREE_DRAW.name),
                layout: None,
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("draw"),
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
                    entry_point: Some("shade"),
                    compilation_options: Default::default(),
                    targets: &[Some(wgpu::TextureFormat::R32Uint.into())],
                }),
                multiview_mask: None,
                cache: None,
            })
        })
    }

    /// What a pipeline of [`Picks::draw_pipeline`] reads, for its group 0, at `threshold`. `clip_from_object`: columns.
    ///
    /// # Errors
    /// The device fails.
    pub fn draw_bindings(
        &self,
        pipeline: &wgpu::RenderPipeline,
        threshold: u32,
        clip_from_object: &[[f32; 4]; 4],
    ) -> Result<wgpu::BindGroup, GpuError> {
        let pass = self.pass(threshold, 0, self.vertices, Floats::Four)?;
        let matrix = self.gpu.uniform("clip from object", clip_from_object)?;
        let mut buffers = self.bindings(&pass);
        buffers.push((5, &matrix));
        bind(self.gpu, "picking draw", &pipeline.get_bind_group_layout(0), &buffers)
    }

    fn bindings<'b>(&'b self, pass: &'b wgpu::Buffer) -> Vec<(u32, &'b wgpu::Buffer)> {
        (0..).zip(std::iter::once(pass).chain(&self.buffers)).collect()
    }

    fn pass(&self, threshold: u32, first: u32, count: u32, floats: Floats) -> Result<wgpu::Buffer, GpuError> {
        let floats = floats as u32;
        match self.layout {
            Layout::TreeLeaf { width, rows } => {
                let scale = Scale { checkpoints: &[], row_starts: &self.row_starts, face_counts: &self.face_counts };
                let RLevel { row, fraction } = scale.r_of(threshold);
                self.gpu.uniform("pass", &LeafPass { first, count, floats, row, fraction, width, rows, pad: 0 })
            }
            Layout::Compact { nodes } => {
                self.gpu.uniform("pass", &CompactPass { first, count, floats, threshold, nodes, pad: [0; 3] })
            }
        }
    }
}

/// Triangles on a device, of which the living ones become an index buffer.
pub struct DrawList<'a> {
    gpu: &'a Gpu,
    count: wgpu::ComputePipeline,
    scan: wgpu::ComputePipeline,
    scatter: wgpu::ComputePipeline,
    arguments_pass: wgpu::ComputePipeline,
    triangles: wgpu::Buffer,
    deaths: wgpu::Buffer,
    ranges: wgpu::Buffer,
    sums: wgpu::Buffer,
    indices: wgpu::Buffer,
    arguments: wgpu::Buffer,
    triangle_count: u32,
    range_count: u32,
}

impl<'a> DrawList<'a> {
    /// Takes triangles, their deaths ([`crate::tree::Compact::deaths`]) and draw ranges (first triangle, triangles) to a device.
    ///
    /// # Errors
    /// Larger than the device binds, or it fails.
    pub fn new(
        gpu: &'a Gpu,
        triangles: &[[u32; 3]],
        deaths: &[u32],
        ranges: &[[u32; 2]],
    ) -> Result<DrawList<'a>, GpuError> {
        let count = triangles.len().min(deaths.len());
        let triangle_count = u32::try_from(count).ok().filter(|count| count.checked_mul(3).is_some());
        let triangle_count = triangle_count.ok_or_else(|| too_large("draw list", count as u64, "triangles"))?;
        let (source, blocks) = (TREE_DRAW_LIST.source, triangle_count.div_ceil(LANES));
        let index_bytes = 12 * u64::from(triangle_count);
        Ok(DrawList {
            gpu,
            count: gpu.compute_pipeline(source, "count")?,
            scan: gpu.compute_pipeline(source, "scan")?,
            scatter: gpu.compute_pipeline(source, "scatter")?,
            arguments_pass: gpu.compute_pipeline(source, "arguments")?,
            triangles: gpu.storage("triangles", triangles)?,
            deaths: gpu.storage("deaths", deaths)?,
            ranges: gpu.storage("draw ranges", ranges)?,
            sums: gpu.output("blocks", 4 * (u64::from(blocks) + 1))?,
            indices: drawable(gpu, "living triangles", index_bytes, wgpu::BufferUsages::INDEX)?,
            arguments: drawable(gpu, "arguments", 20 * ranges.len() as u64, wgpu::BufferUsages::INDIRECT)?,
            triangle_count,
            range_count: ranges.len() as u32,
        })
    }

    /// Indices (u32) of the living triangles of the last [`DrawList::fill`], in order.
    pub fn indices(&self) -> &wgpu::Buffer {
        &self.indices
    }

    /// For each draw range the arguments of its indexed indirect draw, 20 bytes.
    pub fn arguments(&self) -> &wgpu::Buffer {
        &self.arguments
    }

    /// Fills index buffer and arguments.
    ///
    /// # Errors
    /// The device fails.
    pub fn fill(&self, threshold: u32) -> Result<(), GpuError> {
        let blocks = self.triangle_count.div_ceil(LANES);
        let pass = ListPass { triangles: self.triangle_count, threshold, blocks, ranges: self.range_count };
        let pass = self.gpu.uniform("pass", &pass)?;
        let bind = |pipeline: &wgpu::ComputePipeline, buffers: &[(u32, &wgpu::Buffer)]| {
            bind(self.gpu, "draw list", &pipeline.get_bind_group_layout(0), buffers)
        };
        let (deaths, sums) = ((1, &self.deaths), (2, &self.sums));
        let count = bind(&self.count, &[(0, &pass), deaths, sums])?;
        let scan = bind(&self.scan, &[(0, &pass), sums])?;
        let scatter = bind(&self.scatter, &[(0, &pass), deaths, sums, (3, &self.triangles), (4, &self.indices)])?;
        let arguments =
            bind(&self.arguments_pass, &[(0, &pass), deaths, sums, (5, &self.ranges), (6, &self.arguments)])?;
        let steps = [
            (&self.count, count, spread(blocks)),
            (&self.scan, scan, [1, 1]),
            (&self.scatter, scatter, spread(blocks)),
            (&self.arguments_pass, arguments, [self.range_count.div_ceil(64), 1]),
        ];
        self.gpu.check("draw list", || {
            let mut encoder = self.gpu.device().create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                for (pipeline, bindings, [x, y]) in &steps {
                    pass.set_pipeline(pipeline);
                    pass.set_bind_group(0, bindings, &[]);
                    pass.dispatch_workgroups(*x, *y, 1);
                }
            }
            self.gpu.queue().submit([encoder.finish()]);
        })
    }
}

#[cfg(test)]
#[path = "tree_tests.rs"]
mod tests;
