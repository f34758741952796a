//! The passes on a device against their CPU twins: no bit differs.

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use super::*;
use crate::tree::tests::{Built, bits, mesh, trouble};
use crate::tree::{Compact, TreeLeaf, draw_list};

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

/// A wavy sheet of two submeshes, with a far point, a doubled one and places that differ by a denormal.
fn sheet(n: u32) -> Built {
    let side = |x0: f32| {
        let at = move |i: u32, j: u32| {
            let (x, y) = (x0 + i as f32 / n as f32, j as f32 / n as f32);
            [x - 1.0, 1.6 * y - 0.8, 0.5 + 0.3 * (5.0 * x).sin() * (4.0 * y).cos()]
        };
        (0..=n).flat_map(move |j| (0..=n).map(move |i| at(i, j)))
    };
    let mut places: Vec<[f32; 3]> = side(0.0).collect();
    let half = places.len();
    places.extend(side(1.0));
    let quads = |first: u32| (0..n).flat_map(move |j| (0..n).map(move |i| first + j * (n + 1) + i));
    let faces = |a: u32| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]];
    let mut triangles: Vec<[u32; 3]> = quads(0).chain(quads(half as u32)).flat_map(faces).collect();
    let more = places.len() as u32;
    places.extend([[0.0, 0.0, 0.9], [0.0, 0.0, 0.9], [1e-42, 0.0, 0.9], [-0.0, 1e-3, 0.9]]);
    triangles.extend([[more, more + 1, more + 3], [more, more + 2, more + 3]]);
    Built::new(mesh(&places, &triangles, half))
}

fn thresholds(built: &Built) -> Vec<u32> {
    let n = built.tree.node_count();
    let mut list: Vec<u32> = (0..=20).map(|i| (u64::from(n) * i * i / 400) as u32).chain([1, 2, n - 1]).collect();
    list.extend(built.tree.row_starts());
    list
}

#[test]
fn both_layouts_fill_vertex_buffers_bit_for_bit() {
    let Some(gpu) = gpu() else { return };
    let built = sheet(30);
    let count = built.positions.len() as u32;
    let paper = Picks::tree_leaf(&gpu, &built.tree_leaf()).unwrap();
    let compact = Picks::compact(&gpu, &built.compact(), &built.positions).unwrap();
    for picks in [&paper, &compact] {
        let (three, four) = (picks.vertex_buffer(Floats::Three).unwrap(), picks.vertex_buffer(Floats::Four).unwrap());
        for t in thresholds(&built) {
            picks.fill(t, 0..count, Floats::Three, &three).unwrap();
            // In two ranges, the latter one too long.
            picks.fill(t, 700..count + 9, Floats::Four, &four).unwrap();
            picks.fill(t, 0..700, Floats::Four, &four).unwrap();
            let expected = bits(&built.naive(t));
            assert_eq!(gpu.read::<[u32; 3]>(&three, u64::from(count) * 12).unwrap(), expected, "threshold {t}");
            let read = gpu.read::<[u32; 4]>(&four, u64::from(count) * 16).unwrap();
            let with_one: Vec<[u32; 4]> = expected.iter().map(|[x, y, z]| [*x, *y, *z, 1f32.to_bits()]).collect();
            assert_eq!(read, with_one, "threshold {t}");
        }
    }
}

#[test]
fn meshes_of_trouble_are_picked_as_by_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let config = ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() };
    let run = TestRunner::new(config).run(&trouble(), |mesh| {
        let built = Built::new(mesh);
        let (count, n) = (built.positions.len() as u32, built.tree.node_count());
        let paper = Picks::tree_leaf(&gpu, &built.tree_leaf()).unwrap();
        let compact = Picks::compact(&gpu, &built.compact(), &built.positions).unwrap();
        for picks in [&paper, &compact] {
            let buffer = picks.vertex_buffer(Floats::Three).unwrap();
            for t in [0, 1, n / 3, n / 2, n] {
                picks.fill(t, 0..count, Floats::Three, &buffer).unwrap();
                let read = gpu.read::<[u32; 3]>(&buffer, u64::from(count) * 12).unwrap();
                prop_assert_eq!(read, bits(&built.naive(t)), "threshold {}", t);
            }
        }
        Ok(())
    });
    run.unwrap();
}

#[test]
fn a_range_leaves_other_vertices_alone() {
    let Some(gpu) = gpu() else { return };
    let built = sheet(6);
    let picks = Picks::compact(&gpu, &built.compact(), &built.positions).unwrap();
    let buffer = picks.vertex_buffer(Floats::Three).unwrap();
    picks.fill(0, 5..9, Floats::Three, &buffer).unwrap();
    let read = gpu.read::<[f32; 3]>(&buffer, built.positions.len() as u64 * 12).unwrap();
    assert!(read.iter().enumerate().all(|(v, p)| (*p == [0.0; 3]) != (5..9).contains(&v)));
}

#[test]
fn draw_lists_are_the_cpu_s_with_arguments_for_every_range() {
    let Some(gpu) = gpu() else { return };
    let built = sheet(30);
    let triangles = &built.mesh.triangles[..];
    let mut deaths = vec![0; triangles.len()];
    Compact::new(built.compact(), &built.positions).deaths(triangles, &mut deaths);
    let first = built.mesh.face_submesh.iter().filter(|s| s.0 == 0).count() as u32;
    let ranges = [[0, first], [first, triangles.len() as u32 - first], [7, 0]];
    let list = DrawList::new(&gpu, triangles, &deaths, &ranges).unwrap();
    for t in thresholds(&built) {
        list.fill(t).unwrap();
        let mut expected = vec![[0; 3]; triangles.len()];
        let alive = draw_list(triangles, &deaths, t, &mut expected);
        let read = gpu.read::<[u32; 3]>(list.indices(), 12 * alive as u64).unwrap();
        assert_eq!(read, expected[..alive], "threshold {t}");
        assert_eq!(read, built.alive(t));
        let living = |range: Range<u32>| 3 * range.filter(|f| deaths[*f as usize] < t).count() as u32;
        let arguments = gpu.read::<[u32; 5]>(list.arguments(), 60).unwrap();
        for (argument, [start, count]) in arguments.iter().zip(ranges) {
            assert_eq!(*argument, [living(start..start + count), 1, living(0..start), 0, 0], "threshold {t}");
        }
    }
}

/// The picture of `indices`, drawn with the vertex shader picking.
fn picture(gpu: &Gpu, picks: &Picks<'_>, threshold: u32, indices: &[[u32; 3]]) -> Vec<u32> {
    const IDENTITY: [[f32; 4]; 4] =
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let pipeline = picks.draw_pipeline().unwrap();
    let bindings = picks.draw_bindings(&pipeline, threshold, &IDENTITY).unwrap();
    let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
    let ids = gpu.picture("depth bits", [64, 64], wgpu::TextureFormat::R32Uint, usage).unwrap();
    let depth = wgpu::TextureUsages::RENDER_ATTACHMENT;
    let depth = gpu.picture("depth", [64, 64], wgpu::TextureFormat::Depth32Float, depth).unwrap();
    let index_buffer =
        drawable(gpu, "indices", 12 * indices.len() as u64, wgpu::BufferUsages::INDEX | wgpu::BufferUsages::COPY_DST)
            .unwrap();
    gpu.check("picture", || {
        gpu.queue().write_buffer(&index_buffer, 0, bytemuck::cast_slice(indices));
        let (ids, depth) = (ids.create_view(&Default::default()), depth.create_view(&Default::default()));
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &ids,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &depth,
                    depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store: wgpu::StoreOp::Store }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.set_index_buffer(index_buffer.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..3 * indices.len() as u32, 0, 0..1);
        }
        gpu.queue().submit([encoder.finish()]);
    })
    .unwrap();
    gpu.read_id_picture(&ids).unwrap()
}

#[test]
fn picking_while_drawing_gives_the_picture_of_the_picked_mesh() {
    let Some(gpu) = gpu() else { return };
    let built = sheet(16);
    let paper = Picks::tree_leaf(&gpu, &built.tree_leaf()).unwrap();
    let compact = Picks::compact(&gpu, &built.compact(), &built.positions).unwrap();
    let all = &built.mesh.triangles[..];
    for t in [0, 5, 40, built.tree.node_count()] {
        let mut picked = vec![[0.0; 3]; built.positions.len()];
        TreeLeaf::new(built.tree_leaf()).pick_at(t, 0..picked.len(), &mut picked);
        // At full detail every vertex is itself: the CPU's picks as they are.
        let twin = Picks::compact(&gpu, &built.compact(), &picked).unwrap();
        let expected = picture(&gpu, &twin, built.tree.node_count(), all);
        let covered = expected.iter().filter(|texel| **texel != 0).count();
        assert!(t == 0 || covered > 500, "{covered} pixels at {t}");
        for picks in [&paper, &compact] {
            assert!(picture(&gpu, picks, t, all) == expected, "threshold {t}");
            assert!(picture(&gpu, picks, t, &built.alive(t)) == expected || built.alive(t).is_empty(), "living at {t}");
        }
    }
}
