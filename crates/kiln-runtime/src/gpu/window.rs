//! Sliding windows on a device: `shaders/window_pick.wgsl`, whose results are those of [`crate::window`], bit for bit.
//!
//! ```text
//! WindowPasses::new(gpu)                    once a device
//! WindowBuffers::new(gpu, window)           once a model: parents, starts, indices, ranges, and room for draw arguments
//! passes.draw_arguments(.., lod)            what to draw of each submesh, for indexed indirect draws
//! passes.pick_elements(.., lod, ..)         a vertex array of the LOD, for level 0's indices
//! passes.pick_indices(.., lod, ..)          an index buffer of the LOD, for level 0's vertices
//! ```
//! Passes are recorded into the caller's encoder; what comes after them in it sees what they wrote. `shaders/window_draw.wgsl`
//! needs none of it but the draw arguments: it picks in the vertex shader.

use kiln_gpu::{Gpu, GpuError, wgpu};
use kiln_shaders::WINDOW_PICK;

use crate::window::{Window, WindowLod};

/// Invocations of a workgroup, as in the shader.
const LANES: u32 = 64;
/// In the passes' numbers: `starts` is there.
const HAS_STARTS: u32 = 1 << 31;
/// Words of a submesh's draw arguments.
const DRAW_WORDS: u64 = 5;

/// The passes of a device.
#[derive(Debug)]
pub struct WindowPasses {
    elements: wgpu::ComputePipeline,
    arguments: wgpu::ComputePipeline,
    indices: wgpu::ComputePipeline,
}

/// A window on the device.
#[derive(Debug)]
pub struct WindowBuffers {
    parents: wgpu::Buffer,
    starts: wgpu::Buffer,
    indices: wgpu::Buffer,
    ranges: wgpu::Buffer,
    draws: wgpu::Buffer,
    vertices: u32,
    triangles: u32,
    submeshes: u32,
    has_starts: bool,
}

impl WindowBuffers {
    /// # Errors
    /// Larger than the device binds, or no memory.
    pub fn new(gpu: &Gpu, window: &Window<'_>) -> Result<WindowBuffers, GpuError> {
        let indices: Vec<u32> = window.indices().iter().collect();
        let range = |submesh: usize| {
            let range = &window.ranges()[submesh];
            // As many as there are, whole triangles.
            let left = (indices.len() as u64).saturating_sub(u64::from(range.first_index));
            let count = left.min(u64::from(range.index_count)) as u32;
            [range.first_index, count / 3 * 3]
        };
        let ranges: Vec<[u32; 2]> = (0..window.ranges().len()).map(range).collect();
        let starts = window.view().starts;
        // A section that is not checked may have fewer words than it should.
        let mut whole = starts.to_vec();
        whole.resize((window.vertex_count() as usize).div_ceil(32).max(1), 0);
        Ok(WindowBuffers {
            parents: gpu.storage("window parents", window.view().parents)?,
            starts: gpu.storage("window starts", if starts.is_empty() { &[] } else { &whole })?,
            ranges: gpu.storage("window ranges", &ranges)?,
            draws: draw_buffer(gpu, ranges.len() as u64)?,
            vertices: window.vertex_count(),
            triangles: (indices.len() / 3) as u32,
            submeshes: ranges.len() as u32,
            has_starts: !starts.is_empty(),
            indices: gpu.storage("window indices", &indices)?,
        })
    }

    /// Draw arguments, five words a submesh, for `draw_indexed_indirect`; written by [`WindowPasses::draw_arguments`].
    pub fn draws(&self) -> &wgpu::Buffer {
        &self.draws
    }

    /// `[vertex_count]`, u32: for `shaders/window_draw.wgsl`.
    pub fn parents(&self) -> &wgpu::Buffer {
        &self.parents
    }
}

fn draw_buffer(gpu: &Gpu, submeshes: u64) -> Result<wgpu::Buffer, GpuError> {
    let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::INDIRECT | wgpu::BufferUsages::COPY_SRC;
    gpu.check("window draws", || {
        gpu.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some("window draws"),
            size: 4 * DRAW_WORDS * submeshes.max(1),
            usage,
            mapped_at_creation: false,
        })
    })
}

impl WindowPasses {
    /// # Errors
    /// The device refuses a pass.
    pub fn new(gpu: &Gpu) -> Result<WindowPasses, GpuError> {
        let pass = |entry| gpu.compute_pipeline(WINDOW_PICK.source, entry);
        Ok(WindowPasses {
            elements: pass("pick_elements")?,
            arguments: pass("draw_arguments")?,
            indices: pass("pick_indices")?,
        })
    }

    /// Writes into `picked` what each vertex picks of `source` at `lod`; both `[vertex_count]` elements of `words` words (positions
    /// have three), usable as storage.
    ///
    /// # Errors
    /// The device refuses the buffers.
    pub fn pick_elements(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        window: &WindowBuffers,
        lod: WindowLod,
        words: u32,
        [source, picked]: [&wgpu::Buffer; 2],
    ) -> Result<(), GpuError> {
        let numbers = self.numbers(gpu, window, lod, words)?;
        let buffers = [&numbers, &window.parents, source, picked];
        record(gpu, encoder, "window elements", &self.elements, &buffers, window.vertices)
    }

    /// Writes [`WindowBuffers::draws`] of `lod`.
    ///
    /// # Errors
    /// The device fails.
    pub fn draw_arguments(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        window: &WindowBuffers,
        lod: WindowLod,
    ) -> Result<(), GpuError> {
        let numbers = self.numbers(gpu, window, lod, window.triangles)?;
        let buffers = [&numbers, &window.parents, &window.indices, &window.ranges, &window.starts, &window.draws];
        record(gpu, encoder, "window draws", &self.arguments, &buffers, window.submeshes)
    }

    /// Writes into `picked` (`[3 x triangles]`, u32, usable as storage) the indices of the triangles that are drawn at `lod`, in the places
    /// that they have in level 0; after [`WindowPasses::draw_arguments`] of the same LOD. Other places stay.
    ///
    /// # Errors
    /// The device refuses the buffer.
    pub fn pick_indices(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        window: &WindowBuffers,
        lod: WindowLod,
        picked: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        if window.submeshes == 0 {
            return Ok(());
        }
        let numbers = self.numbers(gpu, window, lod, window.triangles)?;
        let buffers = [&numbers, &window.parents, &window.indices, &window.ranges, &window.draws, picked];
        record(gpu, encoder, "window indices", &self.indices, &buffers, window.triangles)
    }

    /// `Pass` in the shader.
    fn numbers(&self, gpu: &Gpu, window: &WindowBuffers, lod: WindowLod, words: u32) -> Result<wgpu::Buffer, GpuError> {
        let submeshes = window.submeshes | if window.has_starts { HAS_STARTS } else { 0 };
        gpu.uniform("window pass", &[lod.vertices(), window.vertices, words, submeshes])
    }
}

/// One pass of at least `invocations`.
fn record(
    gpu: &Gpu,
    encoder: &mut wgpu::CommandEncoder,
    label: &str,
    pipeline: &wgpu::ComputePipeline,
    buffers: &[&wgpu::Buffer],
    invocations: u32,
) -> Result<(), GpuError> {
    let bindings = gpu.bindings(label, pipeline, buffers)?;
    // In rows, where one would be longer than the device's longest.
    let groups = invocations.div_ceil(LANES);
    let longest = gpu.device().limits().max_compute_workgroups_per_dimension;
    let rows = groups.div_ceil(longest.max(1));
    if groups == 0 {
        return Ok(());
    }
    let mut pass =
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(label), timestamp_writes: None });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &bindings, &[]);
    pass.dispatch_workgroups(groups.div_ceil(rows), rows, 1);
    Ok(())
}

#[cfg(test)]
mod tests;
