use kiln_shaders::WINDOW_DRAW;

use super::*;
use crate::window::tests::{made, one_submesh, picked, sheet};

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

/// Picked positions, picked indices, draw arguments of a LOD.
type Passed = (Vec<[u32; 3]>, Vec<u32>, Vec<[u32; 5]>);

fn passed(gpu: &Gpu, passes: &WindowPasses, window: &Window<'_>, lod: WindowLod, source: &[[f32; 3]]) -> Passed {
    let buffers = WindowBuffers::new(gpu, window).unwrap();
    let source = gpu.storage("source", source).unwrap();
    let bytes = [12 * u64::from(window.vertex_count()), 4 * window.indices().len() as u64];
    let [elements, indices] = bytes.map(|bytes| gpu.output("picked", bytes).unwrap());
    let mut encoder = gpu.device().create_command_encoder(&Default::default());
    passes.draw_arguments(gpu, &mut encoder, &buffers, lod).unwrap();
    passes.pick_elements(gpu, &mut encoder, &buffers, lod, 3, [&source, &elements]).unwrap();
    passes.pick_indices(gpu, &mut encoder, &buffers, lod, &indices).unwrap();
    gpu.queue().submit([encoder.finish()]);
    let draws = 20 * window.ranges().len() as u64;
    (
        gpu.read(&elements, bytes[0]).unwrap(),
        gpu.read(&indices, bytes[1]).unwrap(),
        gpu.read(buffers.draws(), draws).unwrap(),
    )
}

#[test]
fn the_device_picks_what_the_cpu_picks() {
    let Some(gpu) = gpu() else { return };
    let passes = WindowPasses::new(&gpu).unwrap();
    // With and without points of several vertices.
    for (mesh, several) in [(sheet(13, 9, 4, 1), true), (one_submesh(11, 8, 5), false)] {
        let (.., held) = made(&mesh);
        let window = held.window();
        assert_eq!(!window.view().starts.is_empty(), several);
        for detail in (0..=window.collapses()).step_by(7).chain([window.collapses()]) {
            let lod = window.lod(detail);
            let (elements, indices, draws) = passed(&gpu, &passes, &window, lod, &held.positions);
            let picked = picked(&window, lod, &held.positions);
            assert_eq!(elements, picked.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>(), "LOD {detail}");
            let mut expected = vec![0; window.indices().len()];
            for (submesh, range) in window.ranges().iter().enumerate() {
                let count = 3 * window.triangles(lod, submesh);
                assert_eq!(draws[submesh], [count, 1, range.first_index, 0, 0], "LOD {detail}");
                let (from, to) = (range.first_index as usize, (range.first_index + count) as usize);
                window.pick_indices(lod, submesh, 0, &mut expected[from..to]);
            }
            assert_eq!(indices, expected, "LOD {detail}");
        }
    }
}

/// Depths of all pixels of a view from above, as bits; 0 where nothing is drawn.
struct Picture<'a> {
    gpu: &'a Gpu,
    pipeline: wgpu::RenderPipeline,
}

const SIZE: u32 = 96;

impl<'a> Picture<'a> {
    fn new(gpu: &'a Gpu) -> Picture<'a> {
        let fragment =
            "@fragment fn depth(@builtin(position) p: vec4<f32>) -> @location(0) u32 { return bitcast<u32>(p.z); }";
        let pipeline = gpu
            .check("the draw", || {
                let module = |source: &'static str| {
                    let source = wgpu::ShaderSource::Wgsl(source.into());
                    gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source })
                };
                gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                    label: None,
                    layout: None,
                    vertex: wgpu::VertexState {
                        module: &module(WINDOW_DRAW.source),
                        entry_point: Some("place"),
                        compilation_options: Default::default(),
                        buffers: &[],
                    },
                    primitive: Default::default(),
                    depth_stencil: None,
                    multisample: Default::default(),
                    fragment: Some(wgpu::FragmentState {
                        module: &module(fragment),
                        entry_point: Some("depth"),
                        compilation_options: Default::default(),
                        targets: &[Some(wgpu::TextureFormat::R32Uint.into())],
                    }),
                    multiview_mask: None,
                    cache: None,
                })
            })
            .unwrap();
        Picture { gpu, pipeline }
    }

    /// `draws`: arguments of as many indexed draws as there are submeshes.
    fn draw(
        &self,
        window: &Window<'_>,
        [alive, coarse]: [u32; 2],
        factor: f32,
        positions: &[[f32; 3]],
        draws: &wgpu::Buffer,
    ) -> Vec<u32> {
        let gpu = self.gpu;
        // 13 x 9 columns and rows fill the picture; heights are depths.
        let mut view = [0.0_f32; 20];
        (view[0], view[5], view[10], view[12], view[13], view[15]) = (2.0 / 13.0, 2.0 / 9.0, 0.5, -1.0, -1.0, 1.0);
        (view[16], view[17], view[18]) = (f32::from_bits(alive), f32::from_bits(coarse), factor);
        let view = gpu.uniform("view", &view.map(f32::to_bits)).unwrap();
        let parents = gpu.storage("parents", window.view().parents).unwrap();
        let positions = gpu.storage("positions", positions).unwrap();
        let indices: Vec<u32> = window.indices().iter().collect();
        let buffer = gpu.device().create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 4 * indices.len() as u64,
            usage: wgpu::BufferUsages::INDEX | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        gpu.queue().write_buffer(&buffer, 0, &indices.iter().flat_map(|i| i.to_le_bytes()).collect::<Vec<u8>>());
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let target = gpu.picture("depths", [SIZE; 2], wgpu::TextureFormat::R32Uint, usage).unwrap();
        let target_view = target.create_view(&Default::default());
        let entries: Vec<wgpu::BindGroupEntry<'_>> = [&view, &parents, &positions]
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let layout = self.pipeline.get_bind_group_layout(0);
        let bindings = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &layout,
            entries: &entries,
        });
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: None,
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &target_view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.set_index_buffer(buffer.slice(..), wgpu::IndexFormat::Uint32);
            for submesh in 0..window.ranges().len() as u64 {
                pass.draw_indexed_indirect(draws, 20 * submesh);
            }
        }
        gpu.queue().submit([encoder.finish()]);
        gpu.read_id_picture(&target).unwrap()
    }
}

#[test]
fn the_vertex_shader_draws_the_same_picture_as_picked_vertices() {
    let Some(gpu) = gpu() else { return };
    let (.., held) = made(&sheet(13, 9, 4, 1));
    let window = held.window();
    let (passes, picture) = (WindowPasses::new(&gpu).unwrap(), Picture::new(&gpu));
    let buffers = WindowBuffers::new(&gpu, &window).unwrap();
    let whole = window.vertex_count();
    let mut seen = Vec::new();
    for detail in [0, 9, window.collapses() / 2, window.collapses()] {
        let (lod, coarse) = (window.lod(detail), window.lod(detail + 12));
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        passes.draw_arguments(&gpu, &mut encoder, &buffers, lod).unwrap();
        gpu.queue().submit([encoder.finish()]);
        let draw = |alive: [u32; 2], factor: f32, positions: &[[f32; 3]]| {
            picture.draw(&window, alive, factor, positions, buffers.draws())
        };
        let fine = picked(&window, lod, &held.positions);
        // The device's pick of the originals, and none of what the CPU picked.
        let drawn = draw([lod.vertices(); 2], 0.0, &held.positions);
        assert!(drawn == draw([whole; 2], 0.0, &fine), "LOD {detail}");
        assert!(drawn.iter().filter(|d| **d != 0).count() > 1000, "LOD {detail} is empty");
        assert!(!seen.contains(&drawn), "LOD {detail} is another");
        // Both ends of a morph; past the seam of the last one, where nothing is left to go.
        let alive = [lod.vertices(), coarse.vertices()];
        assert!(draw(alive, 0.0, &held.positions) == drawn);
        let far = picked(&window, coarse, &held.positions);
        assert!(draw(alive, 1.0, &held.positions) == draw([whole; 2], 0.0, &far), "LOD {detail}'s morph");
        seen.push(drawn);
    }
}
