//! Compute passes: pipelines, buffers that shaders write, and what they wrote.

use crate::{Gpu, GpuError};

impl Gpu {
    /// A pipeline of the compute entry point `entry` of a WGSL text; bindings as the shader names them.
    ///
    /// # Errors
    /// The shader or the pipeline is refused.
    pub fn compute_pipeline(&self, source: &str, entry: &str) -> Result<wgpu::ComputePipeline, GpuError> {
        self.check(entry, || {
            let module = self.device().create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(entry),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            });
            self.device().create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: None,
                module: &module,
                entry_point: Some(entry),
                compilation_options: Default::default(),
                cache: None,
            })
        })
    }

    /// Bind group 0 of a pipeline: these buffers from binding 0 on.
    ///
    /// # Errors
    /// They are not what the shader asks for.
    pub fn bindings(
        &self,
        label: &str,
        pipeline: &wgpu::ComputePipeline,
        buffers: &[&wgpu::Buffer],
    ) -> Result<wgpu::BindGroup, GpuError> {
        let entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        self.check(label, || {
            self.device().create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(label),
                layout: &pipeline.get_bind_group_layout(0),
                entries: &entries,
            })
        })
    }

    /// A zeroed buffer of `bytes` (made a multiple of 4) that shaders write and [`Gpu::read`] reads.
    ///
    /// # Errors
    /// Larger than the device binds, or no memory.
    pub fn output(&self, label: &str, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        let limits = self.device().limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let needed = bytes.max(4).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        if needed > limit {
            return Err(GpuError::TooLarge { what: label.to_owned(), needed, limit, unit: "bytes" });
        }
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        self.check(label, || {
            self.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: needed,
                usage,
                mapped_at_creation: false,
            })
        })
    }

    /// The first `bytes` (a multiple of 4) of a buffer from [`Gpu::output`], after all work submitted so far.
    ///
    /// # Errors
    /// No memory, a lost device, or more than the buffer holds.
    pub fn read<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, bytes: u64) -> Result<Vec<T>, GpuError> {
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let mapped =
            self.read_back(bytes, |encoder, readback| encoder.copy_buffer_to_buffer(buffer, 0, readback, 0, bytes))?;
        let mut values = vec![T::zeroed(); bytes as usize / size_of::<T>()];
        let whole = values.len() * size_of::<T>();
        bytemuck::cast_slice_mut(&mut values).copy_from_slice(&mapped[..whole]);
        Ok(values)
    }
}
