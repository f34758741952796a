//! One device: adapter choice, buffers, readback; says clearly when there is none.
//!
//! ```text
//! Gpu::open(allow_software)   the best adapter, by kind then by enumeration order; a device with all the limits it has
//! gpu.storage(..), gpu.target(..)   buffers and pictures, refused with both numbers where they are larger than a limit
//! gpu.compute_pipeline(..), gpu.output(..), gpu.read(..)   compute passes and what they wrote
//! gpu.check(|| work)          runs work and turns whatever the driver complains about into an error
//! gpu.read_picture(..)        texels back, after the work is done
//! ```
//!
//! Nothing here panics: no driver, a lost device, too little memory and a rejected shader are all a [`GpuError`], and whoever
//! calls decides whether the CPU twin takes over.
//!
//! On Linux only Vulkan is asked: OpenGL fallbacks render to fewer formats and hide that Vulkan is missing.

mod compute;
mod transfer;

use std::sync::{Arc, Mutex, PoisonError};

pub use wgpu;

/// Why there is no device, or why it failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// No adapter at all.
    #[error("no graphics adapter found ({reason}); install a driver, or set backend = \"cpu\"")]
    NoAdapter {
        /// What the system said.
        reason: String,
    },
    /// Only software adapters, and those were not asked for.
    #[error("the only graphics adapter is software ({name}); set backend = \"gpu\" to use it, or backend = \"cpu\"")]
    OnlySoftware {
        /// The adapter that was passed over.
        name: String,
    },
    /// The adapter gives no device.
    #[error("adapter {name} opens no device: {reason}")]
    NoDevice {
        /// The adapter.
        name: String,
        /// What the driver said.
        reason: String,
    },
    /// Something is larger than the device takes.
    #[error("{what} needs {needed} {unit}, the device takes {limit}; set backend = \"cpu\"")]
    TooLarge {
        /// What is too large.
        what: String,
        /// What it needs.
        needed: u64,
        /// What the device takes.
        limit: u64,
        /// Unit of both numbers.
        unit: &'static str,
    },
    /// The driver complained about work given to it.
    #[error("the graphics driver refused {what}: {reason}")]
    Refused {
        /// What was being done.
        what: String,
        /// What the driver said.
        reason: String,
    },
    /// The device is gone.
    #[error("the graphics device was lost: {reason}; set backend = \"cpu\"")]
    Lost {
        /// What the driver said.
        reason: String,
    },
}

/// What GPU results depend on beside the shader: part of a GPU stage's fingerprint.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceClass {
    /// Graphics interface: `vulkan`, `metal`, `dx12`.
    pub backend: String,
    /// PCI vendor id, or the interface's own.
    pub vendor: u32,
    /// Device by name and id.
    pub device: String,
    /// Driver by name and version.
    pub driver: String,
}

impl std::fmt::Display for DeviceClass {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {:04x} {} ({})", self.backend, self.vendor, self.device, self.driver)
    }
}

/// An open device.
#[derive(Debug)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    /// The first complaint that no scope caught, and the reason of a loss.
    trouble: Arc<Mutex<Option<GpuError>>>,
}

fn backends() -> wgpu::Backends {
    if cfg!(target_os = "linux") { wgpu::Backends::VULKAN } else { wgpu::Backends::PRIMARY }
}

/// Lower is better; equal kinds keep the system's order.
fn rank(kind: wgpu::DeviceType) -> u32 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

impl Gpu {
    /// The best adapter's device. Software adapters only with `allow_software`: a CPU twin is faster than a graphics card
    /// played by the CPU.
    ///
    /// # Errors
    /// No adapter, only software, or no device from it.
    pub fn open(allow_software: bool) -> Result<Gpu, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = backends();
        let instance = wgpu::Instance::new(descriptor);
        let mut adapters = pollster::block_on(instance.enumerate_adapters(backends()));
        adapters.sort_by_key(|a| rank(a.get_info().device_type));
        let Some(adapter) = adapters.first() else {
            return Err(GpuError::NoAdapter { reason: format!("{:?} lists none", backends()) });
        };
        let info = adapter.get_info();
        if info.device_type == wgpu::DeviceType::Cpu && !allow_software {
            return Err(GpuError::OnlySoftware { name: info.name });
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("kiln"),
            required_features: wgpu::Features::empty(),
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| GpuError::NoDevice { name: info.name.clone(), reason: e.to_string() })?;
        let trouble = Arc::new(Mutex::new(None));
        let note = |slot: &Arc<Mutex<Option<GpuError>>>, error: GpuError| {
            slot.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        };
        let slot = Arc::clone(&trouble);
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            note(&slot, GpuError::Refused { what: "work".into(), reason: e.to_string() });
        }));
        let slot = Arc::clone(&trouble);
        device.set_device_lost_callback(move |why, reason| {
            if why != wgpu::DeviceLostReason::Destroyed {
                note(&slot, GpuError::Lost { reason });
            }
        });
        Ok(Gpu { device, queue, info, trouble })
    }

    /// What its results depend on.
    pub fn class(&self) -> DeviceClass {
        DeviceClass {
            backend: self.info.backend.to_str().to_owned(),
            vendor: self.info.vendor,
            device: format!("{} [{:04x}]", self.info.name, self.info.device),
            driver: format!("{} {}", self.info.driver, self.info.driver_info).trim().to_owned(),
        }
    }

    /// Whether the adapter is played by the CPU.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// The device, for pipelines and bind groups.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// The queue, for submissions.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Runs `work` and returns what it returns, unless the driver complained about it. `what` names it in the error.
    ///
    /// # Errors
    /// A rejected shader, pipeline or buffer; too little memory; a lost device.
    pub fn check<T>(&self, what: &str, work: impl FnOnce() -> T) -> Result<T, GpuError> {
        let filters = [wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation];
        let scopes = filters.map(|filter| self.device.push_error_scope(filter));
        let result = work();
        let mut refused = None;
        // Scopes form a stack: the last one in is the first one out.
        for scope in scopes.into_iter().rev() {
            if let Some(error) = pollster::block_on(scope.pop()) {
                refused = Some(GpuError::Refused { what: what.to_owned(), reason: error.to_string() });
            }
        }
        match refused.or_else(|| self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone()) {
            Some(error) => Err(error),
            None => Ok(result),
        }
    }
}

#[cfg(test)]
mod tests;
