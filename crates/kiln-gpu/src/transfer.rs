//! Bytes to the device and back.

use std::sync::mpsc;
use std::time::Duration;

use crate::{Gpu, GpuError};

/// Rows of a picture lie this far apart in a buffer, bytes (an API rule).
const ROW_ALIGNMENT: u64 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as u64;

/// How long the outcome of finished work may stay away before the device counts as lost.
const CALLBACK_LIMIT: Duration = Duration::from_secs(60);

impl Gpu {
    /// A read-only storage buffer with these values; an empty slice gives one zeroed value, since bindings may not be empty.
    ///
    /// # Errors
    /// Larger than the device binds, or no memory.
    pub fn storage<T: bytemuck::Pod>(&self, label: &str, values: &[T]) -> Result<wgpu::Buffer, GpuError> {
        let zero = [T::zeroed()];
        let bytes: &[u8] = bytemuck::cast_slice(if values.is_empty() { &zero } else { values });
        let limits = self.device().limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        self.filled(label, bytes, wgpu::BufferUsages::STORAGE, limit)
    }

    /// A uniform buffer with this value.
    ///
    /// # Errors
    /// Larger than the device binds, or no memory.
    pub fn uniform<T: bytemuck::Pod>(&self, label: &str, value: &T) -> Result<wgpu::Buffer, GpuError> {
        let limit = self.device().limits().max_uniform_buffer_binding_size;
        self.filled(label, bytemuck::bytes_of(value), wgpu::BufferUsages::UNIFORM, limit)
    }

    fn filled(
        &self,
        label: &str,
        bytes: &[u8],
        usage: wgpu::BufferUsages,
        limit: u64,
    ) -> Result<wgpu::Buffer, GpuError> {
        let needed = (bytes.len() as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        if needed > limit {
            return Err(GpuError::TooLarge { what: label.to_owned(), needed, limit, unit: "bytes" });
        }
        self.check(label, || {
            let buffer = self.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: needed,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            self.queue().write_buffer(&buffer, 0, bytes);
            buffer
        })
    }

    /// A picture of `size` (width, height) texels without content.
    ///
    /// # Errors
    /// Larger than the device draws to, or no memory.
    pub fn picture(
        &self,
        label: &str,
        [width, height]: [u32; 2],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> Result<wgpu::Texture, GpuError> {
        let limit = self.device().limits().max_texture_dimension_2d;
        if width.max(height) > limit {
            let (needed, limit) = (width.max(height) as u64, limit as u64);
            return Err(GpuError::TooLarge { what: label.to_owned(), needed, limit, unit: "texels a side" });
        }
        self.check(label, || {
            self.device().create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        })
    }

    /// An R32Uint picture of `size` (width, height) with these texels, to be read by shaders. `texels`: `[height x width]`, top row first.
    ///
    /// # Errors
    /// As for [`Gpu::picture`], or `texels` of another length.
    pub fn id_picture(&self, label: &str, size: [u32; 2], texels: &[u32]) -> Result<wgpu::Texture, GpuError> {
        let [width, height] = size;
        if texels.len() as u64 != width as u64 * height as u64 {
            let reason = format!("{} texels for a picture of {width} x {height}", texels.len());
            return Err(GpuError::Refused { what: label.to_owned(), reason });
        }
        let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
        let picture = self.picture(label, size, wgpu::TextureFormat::R32Uint, usage)?;
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(width * 4), rows_per_image: None };
        self.check(label, || {
            self.queue().write_texture(picture.as_image_copy(), bytemuck::cast_slice(texels), layout, picture.size());
        })?;
        Ok(picture)
    }

    /// The texels of an R32Uint picture (usage COPY_SRC), `[height x width]`, top row first, after all work submitted so far.
    ///
    /// # Errors
    /// Too large for one buffer, no memory, a lost device.
    pub fn read_id_picture(&self, picture: &wgpu::Texture) -> Result<Vec<u32>, GpuError> {
        let (width, height) = (picture.width() as u64, picture.height() as u64);
        let row = (width * 4).next_multiple_of(ROW_ALIGNMENT);
        let (needed, limit) = (row * height, self.device().limits().max_buffer_size);
        if needed > limit {
            return Err(GpuError::TooLarge { what: "readback".into(), needed, limit, unit: "bytes" });
        }
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row as u32), rows_per_image: None };
        let mapped = self.read_back(needed, |encoder, readback| {
            let into = wgpu::TexelCopyBufferInfo { buffer: readback, layout };
            encoder.copy_texture_to_buffer(picture.as_image_copy(), into, picture.size());
        })?;
        let mut texels = Vec::with_capacity((width * height) as usize);
        for line in mapped.chunks_exact(row as usize).take(height as usize) {
            texels.extend(line.as_chunks::<4>().0.iter().take(width as usize).map(|b| u32::from_le_bytes(*b)));
        }
        Ok(texels)
    }

    /// The `bytes` that `copy` writes to a buffer, after all work submitted so far.
    pub(crate) fn read_back(
        &self,
        bytes: u64,
        copy: impl FnOnce(&mut wgpu::CommandEncoder, &wgpu::Buffer),
    ) -> Result<wgpu::BufferView, GpuError> {
        let (done, outcome) = mpsc::channel();
        let readback = self.check("readback", || {
            let readback = self.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size: bytes,
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            });
            let mut encoder = self.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            copy(&mut encoder, &readback);
            self.queue().submit([encoder.finish()]);
            readback.map_async(wgpu::MapMode::Read, .., move |mapped| {
                // The receiver lives in this function; if it is gone, nobody waits.
                let _ = done.send(mapped);
            });
            readback
        })?;
        let lost = |reason: String| GpuError::Lost { reason };
        self.check("readback", || self.device().poll(wgpu::PollType::wait_indefinitely()))?
            .map_err(|e| lost(e.to_string()))?;
        // Another thread's poll may have taken our callback along and be about to call it: the outcome is on its way.
        match outcome.recv_timeout(CALLBACK_LIMIT) {
            Ok(Ok(())) => {}
            Ok(Err(e)) => return Err(lost(e.to_string())),
            Err(_) => return Err(lost("the readback never finished".into())),
        }
        readback.get_mapped_range(..).map_err(|e| lost(e.to_string()))
    }
}
