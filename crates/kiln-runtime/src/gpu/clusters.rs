//! Which clusters to draw, decided on the GPU: `shaders/select_clusters.wgsl`.
//!
//! The records go to the device once; a selection is three small dispatches and no read-back: the list and the arguments of an indirect
//! draw stay there. The list is ascending, so the same view gives the same bytes. It is the one of [`crate::clusters::select`] but
//! where a group's error shows exactly as much as is allowed, to the last bits of single precision.

use bytemuck::{Pod, Zeroable};
use kiln_gpu::{Gpu, GpuError, wgpu};
use kiln_shaders::SELECT_CLUSTERS;

use crate::clusters::{ClusterView, Detail};

/// Invocations of a workgroup.
const SIZE: u32 = 256;
/// Bytes of [`DrawArguments`].
const ARGUMENT_BYTES: u64 = size_of::<DrawArguments>() as u64;

/// `Pass` in the shader.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Pass {
    eye: [f32; 3],
    scale: f32,
    /// By view: the near distance.
    allowed: f32,
    by_view: u32,
    clusters: u32,
    groups: u32,
}

/// What a selection leaves for indirect draws.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct DrawArguments {
    /// Workgroups of a mesh draw: workgroup (x, y) draws cluster `65535 * y + x` of the list, if there is one.
    pub mesh_workgroups: [u32; 3],
    /// Clusters in the list.
    pub clusters: u32,
    /// Vertices of an instance: the corners of the largest cluster. A draw whose vertex stage pulls corner `vertex_index` of cluster
    /// `list[instance_index]`, and puts those that the cluster lacks at one place.
    pub vertices: u32,
    /// Instances: one a cluster.
    pub instances: u32,
    /// 0.
    pub first_vertex: u32,
    /// 0.
    pub first_instance: u32,
}

/// A cluster DAG on a device.
pub struct ClusterSelector {
    select: wgpu::ComputePipeline,
    scan: wgpu::ComputePipeline,
    list: wgpu::ComputePipeline,
    clusters: wgpu::Buffer,
    groups: wgpu::Buffer,
    counts: [u32; 2],
    out: Output,
}

/// Buffers that passes write.
struct Output {
    flags: wgpu::Buffer,
    starts: wgpu::Buffer,
    list: wgpu::Buffer,
    arguments: wgpu::Buffer,
}

impl ClusterSelector {
    /// Takes the records to a device.
    ///
    /// # Errors
    /// More clusters than one dispatch takes, or what the driver says.
    pub fn new(gpu: &Gpu, view: &ClusterView<'_>) -> Result<ClusterSelector, GpuError> {
        let counts = [view.clusters.len() as u32, view.groups.len() as u32];
        let workgroups = counts[0].div_ceil(SIZE).max(1);
        let limit = gpu.device().limits().max_compute_workgroups_per_dimension;
        if workgroups > limit {
            let (needed, limit) = (view.clusters.len() as u64, u64::from(limit) * u64::from(SIZE));
            return Err(GpuError::TooLarge { what: "a cluster DAG".into(), needed, limit, unit: "clusters" });
        }
        let pipeline = |entry: &str| gpu.compute_pipeline(SELECT_CLUSTERS.source, entry);
        let words = u64::from(counts[0].max(1)) * 4;
        let arguments = gpu.check("draw arguments", || {
            let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::INDIRECT | wgpu::BufferUsages::COPY_SRC;
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("draw arguments"),
                size: ARGUMENT_BYTES,
                usage,
                mapped_at_creation: false,
            })
        })?;
        Ok(ClusterSelector {
            select: pipeline("select_clusters")?,
            scan: pipeline("scan_clusters")?,
            list: pipeline("list_clusters")?,
            clusters: gpu.storage("clusters", view.clusters)?,
            groups: gpu.storage("groups", view.groups)?,
            counts,
            out: Output {
                flags: gpu.output("flags", words)?,
                starts: gpu.output("starts", u64::from(workgroups) * 4)?,
                list: gpu.output("list", words)?,
                arguments,
            },
        })
    }

    /// Selects; [`ClusterSelector::list`] and [`ClusterSelector::arguments`] hold the outcome for work that is submitted later.
    ///
    /// # Errors
    /// What the driver says.
    pub fn select(&self, gpu: &Gpu, detail: Detail) -> Result<(), GpuError> {
        let (eye, scale, allowed, by_view) = match detail {
            Detail::Error(allowed) => ([0.0; 3], 0.0, allowed, 0),
            // Products with an infinite number are no numbers on some devices.
            Detail::View { eye, scale, near } => (eye, scale.min(1e18), near, 1),
        };
        let [clusters, groups] = self.counts;
        let pass = gpu.uniform("cluster pass", &Pass { eye, scale, allowed, by_view, clusters, groups })?;
        let Output { flags, starts, list, arguments } = &self.out;
        let passes = [
            (
                &self.select,
                gpu.bindings("select", &self.select, &[&pass, &self.clusters, &self.groups, flags, starts])?,
            ),
            (&self.scan, gpu.bindings("scan", &self.scan, &[starts, arguments])?),
            (&self.list, gpu.bindings("list", &self.list, &[flags, starts, list])?),
        ];
        let workgroups = clusters.div_ceil(SIZE).max(1);
        gpu.check("cluster selection", || {
            let mut encoder = gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            for ((pipeline, bindings), count) in passes.iter().zip([workgroups, 1, workgroups]) {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, bindings, &[]);
                pass.dispatch_workgroups(count, 1, 1);
            }
            gpu.queue().submit([encoder.finish()]);
        })
    }

    /// `[clusters]` u32: numbers of the drawn clusters, ascending, [`DrawArguments::clusters`] of them.
    pub fn list(&self) -> &wgpu::Buffer {
        &self.out.list
    }

    /// [`DrawArguments`]: at byte 0 those of an indirect mesh draw, at byte 16 those of an indirect draw.
    pub fn arguments(&self) -> &wgpu::Buffer {
        &self.out.arguments
    }

    /// What the last selection left, read back: for tests and tools.
    ///
    /// # Errors
    /// What the driver says.
    pub fn read(&self, gpu: &Gpu) -> Result<(Vec<u32>, DrawArguments), GpuError> {
        let arguments = gpu.read::<DrawArguments>(&self.out.arguments, ARGUMENT_BYTES)?;
        let arguments = arguments.first().copied().unwrap_or_default();
        let count = arguments.clusters.min(self.counts[0]);
        Ok((gpu.read(&self.out.list, 4 * u64::from(count))?, arguments))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clusters::tests::{dag, mesh, view, views};
    use crate::clusters::{GroupRecord, selected};

    /// Whether the decision for a group hangs on the last bits.
    fn is_close(group: &GroupRecord, detail: &Detail) -> bool {
        let Detail::View { eye, scale, near } = detail else { return false };
        let [x, y, z, radius] = group.sphere.map(f64::from);
        let square: f64 = [x, y, z].iter().zip(eye).map(|(c, e)| (c - f64::from(*e)).powi(2)).sum();
        let shows = f64::from(*scale) * f64::from(group.error);
        let reach = shows + radius;
        (shows - f64::from(*near)).abs() <= 1e-6 * shows || (square - reach * reach).abs() <= 1e-5 * reach * reach
    }

    #[test]
    fn the_device_selects_what_the_twin_selects() {
        let gpu = match Gpu::open(true) {
            Ok(gpu) => gpu,
            Err(error) => return eprintln!("no device, so nothing is compared: {error}"),
        };
        // More workgroups than one, so that places hang together.
        let dag = dag(&mesh(300, 180));
        let view = view(&dag);
        assert!(view.clusters.len() > 2 * SIZE as usize);
        let selector = ClusterSelector::new(&gpu, &view).expect("a selector");
        let errors = [0.0, 1e-4, 1e-3, 1e-2, f32::MAX].map(Detail::Error);
        for detail in errors.into_iter().chain(views(40)) {
            selector.select(&gpu, detail).expect("a selection");
            let (list, arguments) = selector.read(&gpu).expect("a list");
            let twin: Vec<u32> = selected(&view, detail).collect();
            assert!(list.is_sorted());
            assert_eq!((arguments.clusters, arguments.instances), (list.len() as u32, list.len() as u32));
            assert_eq!(arguments.mesh_workgroups, [list.len() as u32, 1, 1]);
            let close = |c: u32| {
                let cluster = &view.clusters[c as usize];
                let groups = [cluster.group, cluster.made_by];
                groups.iter().filter_map(|g| view.groups.get(*g as usize)).any(|group| is_close(group, &detail))
            };
            let differ = (0..view.clusters.len() as u32)
                .filter(|c| list.binary_search(c).is_ok() != twin.binary_search(c).is_ok());
            assert_eq!(differ.filter(|c| !close(*c)).count(), 0, "{detail:?}");
        }
    }
}
