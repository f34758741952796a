use super::*;

/// A device, software allowed; `None` (said on standard error) where there is none, unless skipping is forbidden.
fn gpu() -> Option<Gpu> {
    match Gpu::open(true) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var_os("KILN_REQUIRE_ALL").is_some_and(|v| v == "1");
            assert!(!required, "needs a Vulkan adapter: {error}");
            eprintln!("skipped: needs a Vulkan adapter ({error})");
            None
        }
    }
}

#[test]
fn a_software_adapter_is_taken_only_when_it_is_asked_for() {
    let Some(gpu) = gpu() else { return };
    match Gpu::open(false) {
        Ok(hardware) => assert!(!hardware.is_software()),
        Err(GpuError::OnlySoftware { name }) => {
            assert!(gpu.is_software());
            assert!(gpu.class().device.contains(&name));
        }
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn the_device_class_names_everything_results_depend_on() {
    let Some(gpu) = gpu() else { return };
    let class = gpu.class();
    assert!(!class.backend.is_empty() && !class.device.is_empty() && !class.driver.is_empty(), "{class}");
    assert_eq!(class, gpu.class());
}

#[test]
fn texels_come_back_as_they_went() {
    let Some(gpu) = gpu() else { return };
    // 37 texels a row: rows in the readback buffer have padding behind them.
    let texels: Vec<u32> = (0..37 * 21).map(|i: u32| i.wrapping_mul(2_654_435_761)).collect();
    let usage = wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC;
    let target = gpu.picture("target", [37, 21], wgpu::TextureFormat::R32Uint, usage).expect("picture");
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(37 * 4), rows_per_image: None };
    gpu.queue().write_texture(target.as_image_copy(), bytemuck::cast_slice(&texels), layout, target.size());
    assert_eq!(gpu.read_id_picture(&target).expect("readback"), texels);
}

#[test]
fn what_is_larger_than_a_limit_is_refused_with_both_numbers() {
    let Some(gpu) = gpu() else { return };
    let limit = gpu.device().limits().max_texture_dimension_2d;
    let usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
    match gpu.picture("sheet", [1, limit + 1], wgpu::TextureFormat::R32Uint, usage) {
        Err(GpuError::TooLarge { needed, limit: l, .. }) => assert_eq!((needed, l), (limit as u64 + 1, limit as u64)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_shader_that_does_not_parse_is_an_error_and_the_device_lives_on() {
    let Some(gpu) = gpu() else { return };
    let source = wgpu::ShaderSource::Wgsl("fn broken( {".into());
    let error = gpu
        .check("a broken shader", || {
            gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source })
        })
        .expect_err("no WGSL");
    assert!(matches!(error, GpuError::Refused { ref what, .. } if what == "a broken shader"), "{error}");
    assert!(gpu.storage("values", &[1u32, 2, 3]).is_ok());
}

#[test]
fn what_a_compute_pass_writes_comes_back() {
    let Some(gpu) = gpu() else { return };
    let source = "
        @group(0) @binding(0) var<storage, read> values: array<u32>;
        @group(0) @binding(1) var<storage, read_write> squares: array<u32>;
        @compute @workgroup_size(4) fn square(@builtin(global_invocation_id) id: vec3<u32>) {
            squares[id.x] = values[id.x] * values[id.x];
        }";
    let pipeline = gpu.compute_pipeline(source, "square").expect("pipeline");
    let values = gpu.storage("values", &[3u32, 5, 7, 65_535, 9, 0, 1, 2]).expect("values");
    let squares = gpu.output("squares", 32).expect("output");
    let bindings = gpu.bindings("square", &pipeline, &[&values, &squares]).expect("bindings");
    let mut encoder = gpu.device().create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(2, 1, 1);
    }
    gpu.queue().submit([encoder.finish()]);
    assert_eq!(gpu.read::<[u32; 2]>(&squares, 24).expect("squares"), [[9, 25], [49, 4_294_836_225], [81, 0]]);
    assert!(gpu.read::<u32>(&squares, 64).is_err(), "more than it holds");
    assert!(matches!(gpu.output("all", u64::MAX - 7), Err(GpuError::TooLarge { .. })));
}
