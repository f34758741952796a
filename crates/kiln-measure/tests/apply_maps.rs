//! The shader that applies a container's maps, on a device, against its CPU twin.

use glam::{DVec3, Mat4, Vec2, Vec3, Vec4};
use kiln_asset::{
    ImageFormat, ImageId, ImageInfo, MapRole, Material, MaterialId, MaterialSet, Mesh, Raster, RawMesh, Sampler,
    Submesh, SubmeshId, Texture, TextureId, TextureRef, Wrap,
};
use kiln_geom::math::{cos64, sin64};
use kiln_gpu::{Gpu, GpuError, wgpu};
use kiln_measure::render::apply_maps::Lights;
use kiln_measure::{Camera, Mip, Mode, RenderOptions, Scene, Sphere, render};

const SIZE: u32 = 160;
const TEXELS: u32 = 64;

/// Codes, of 255, of the channel that is off most. Rounding to bytes alone makes a mean of 0.38; textures are filtered with 8 bits
/// between texels, normals interpolated in `f32`: three quarters of a code on the mean, at most one pixel in a hundred off by more
/// than 3, in highlights, and none by more than 12.
const MEAN: f64 = 0.75;
const USUAL: f32 = 3.0;
const MOST: f32 = 12.0;

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

/// A unit sphere with UVs as a picture lies, tangents along u; the half with x < 0 has mirrored UVs (w = -1).
fn ball() -> Mesh {
    let (rings, segments) = (24u32, 24u32);
    let (mut normals, mut tangents, mut uv0) = (Vec::new(), Vec::new(), Vec::new());
    let (mut triangles, mut face_submesh) = (Vec::new(), Vec::new());
    for hand in [1.0f32, -1.0] {
        let first = normals.len() as u32;
        for r in 0..=rings {
            for s in 0..=segments {
                let polar = (r as f64 / rings as f64 * 0.98 + 0.01) * std::f64::consts::PI;
                let around = s as f64 / segments as f64 * std::f64::consts::PI;
                let (sin, cos) = (sin64(around), cos64(around));
                let normal = DVec3::new(sin64(polar) * sin * hand as f64, cos64(polar), sin64(polar) * cos);
                normals.push(normal.as_vec3());
                // Along u, which runs around the axis from the front on either side.
                tangents.push(Vec4::new(cos as f32 * hand, 0.0, -sin as f32, hand));
                uv0.push(Vec2::new(s as f32 / segments as f32, r as f32 / rings as f32));
            }
        }
        let at = |r: u32, s: u32| first + r * (segments + 1) + s;
        for r in 0..rings {
            for s in 0..segments {
                let [a, b, c, d] = [at(r, s), at(r + 1, s), at(r + 1, s + 1), at(r, s + 1)];
                triangles.extend(if hand > 0.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
                face_submesh.extend([SubmeshId(0); 2]);
            }
        }
    }
    let raw = RawMesh {
        positions: normals.clone(),
        normals: Some(normals),
        tangents: Some(tangents),
        uv0: Some(uv0),
        triangles,
        face_submesh,
        submeshes: vec![Submesh { material: Some(MaterialId(0)), ..Default::default() }],
        ..Default::default()
    };
    Mesh::new(raw).expect("valid")
}

/// Five pictures that vary slowly, in the order of [`MapRole::ALL`]: metal and matt, smooth and rough, hidden and open.
fn pictures() -> Vec<Raster> {
    let wave = |t: u32, x: f64, y: f64, phase: f64| {
        let (u, v) = ((t % TEXELS) as f64 / TEXELS as f64, (t / TEXELS) as f64 / TEXELS as f64);
        0.5 + 0.5 * sin64(std::f64::consts::TAU * (x * u + y * v) + phase)
    };
    let byte = |value: f64| (255.0 * value + 0.5) as u8;
    let picture = |texel: &dyn Fn(u32) -> [u8; 4]| Raster {
        width: TEXELS,
        height: TEXELS,
        texels: (0..TEXELS * TEXELS).map(texel).collect(),
    };
    let normal = |t: u32| {
        let (x, y) = (0.5 * wave(t, 3.0, 0.0, 0.0) - 0.25, 0.5 * wave(t, 0.0, 3.0, 1.0) - 0.25);
        let [r, g, b] = [x, y, (1.0 - x * x - y * y).sqrt()].map(|c| byte(0.5 * c + 0.5));
        [r, g, b, 255]
    };
    vec![
        picture(&|t| [byte(wave(t, 1.0, 2.0, 0.0)), byte(wave(t, 3.0, 1.0, 1.0)), byte(wave(t, 2.0, 2.0, 2.0)), 255]),
        picture(&|t| [7, byte(0.35 + 0.65 * wave(t, 1.0, 1.0, 0.5)), byte(wave(t, 2.0, 0.0, 0.0)), 255]),
        picture(&normal),
        picture(&|t| [byte(wave(t, 0.0, 2.0, 0.0)), 9, 9, 255]),
        picture(&|t| [byte(0.3 * wave(t, 1.0, 0.0, 0.0)), 0, byte(0.2 * wave(t, 0.0, 1.0, 0.0)), 255]),
    ]
}

/// One material with all factors and all maps.
fn materials() -> MaterialSet {
    let mut material = Material {
        base_color_factor: [0.9, 0.8, 0.7, 1.0],
        metallic_factor: 0.8,
        roughness_factor: 0.9,
        normal_scale: 0.7,
        occlusion_strength: 0.6,
        emissive_factor: [0.5, 1.0, 0.25],
        ..Material::default()
    };
    let (mut textures, mut images) = (Vec::new(), Vec::new());
    for (k, role) in (0..).zip(MapRole::ALL) {
        *material.map_mut(role) = Some(TextureRef { texture: TextureId(k), uv_set: 0 });
        let sampler = Sampler { wrap_u: Wrap::ClampToEdge, wrap_v: Wrap::ClampToEdge, ..Sampler::default() };
        textures.push(Texture { image: ImageId(k), sampler });
        images.push(ImageInfo { name: role.name().into(), format: ImageFormat::Raster, hash: [0; 32] });
    }
    MaterialSet { materials: vec![material], textures, images, ..Default::default() }
}

/// The shader's `Frame`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Frame {
    clip_from_object: [f32; 16],
    eye: [f32; 4],
    towards_light: [f32; 4],
    light: [f32; 4],
    sky: [f32; 4],
    ground: [f32; 4],
}

/// The shader's `Material`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Factors {
    base_color: [f32; 4],
    emissive: [f32; 4],
    metallic: f32,
    roughness: f32,
    normal_scale: f32,
    occlusion_strength: f32,
    alpha_cutoff: f32,
    flags: u32,
    pad: [u32; 2],
}

impl Factors {
    fn of(material: &Material, flags: u32) -> Factors {
        Factors {
            base_color: material.base_color_factor,
            emissive: Vec3::from(material.emissive_factor).extend(0.0).to_array(),
            metallic: material.metallic_factor,
            roughness: material.roughness_factor,
            normal_scale: material.normal_scale,
            occlusion_strength: material.occlusion_strength,
            alpha_cutoff: 0.0,
            flags,
            pad: [0; 2],
        }
    }
}

/// What the twin's cameras do, as a matrix for a square picture with depth in `[0, 1]`.
fn frame(camera: &Camera) -> Frame {
    let row = |axis: DVec3| axis.as_vec3().extend(-axis.dot(camera.centre) as f32);
    let (right, up, back) = (row(camera.right), row(camera.up), row(camera.back));
    let half = camera.half_extent as f32;
    let (rows, eye) = match camera.distance {
        None => {
            let depth = Vec4::W * 0.5 - back * (0.25 / half);
            ([right / half, up / half, depth, Vec4::W], camera.back.as_vec3().extend(0.0))
        }
        Some(distance) => {
            let eye = (camera.centre + camera.back * distance).as_vec3();
            let distance = distance as f32;
            // w is the distance from the eye; near at a tenth of the centre's, far at twice.
            let w = Vec4::W * distance - back;
            let (near, far) = (0.1 * distance, 2.0 * distance);
            let depth = (w - Vec4::W * near) * (far / (far - near));
            ([right * (distance / half), up * (distance / half), depth, w], eye.extend(1.0))
        }
    };
    let lights = Lights::OBJECT;
    Frame {
        clip_from_object: Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose().to_cols_array(),
        eye: eye.to_array(),
        towards_light: lights.towards.extend(0.0).to_array(),
        light: lights.light.extend(0.0).to_array(),
        sky: lights.sky.extend(0.0).to_array(),
        ground: lights.ground.extend(0.0).to_array(),
    }
}

const FORMATS: [wgpu::VertexFormat; 4] = [
    wgpu::VertexFormat::Float32x3,
    wgpu::VertexFormat::Float32x3,
    wgpu::VertexFormat::Float32x4,
    wgpu::VertexFormat::Float32x2,
];

/// A mesh and its maps on the device.
struct Model {
    /// Positions, normals, tangents, UVs, corner after corner.
    buffers: [wgpu::Buffer; 4],
    corner_count: u32,
    maps: Vec<wgpu::TextureView>,
}

impl Model {
    fn new(gpu: &Gpu, mesh: &Mesh, pictures: &[Raster]) -> Result<Model, GpuError> {
        let corners: Vec<usize> = mesh.triangles.iter().flatten().map(|v| *v as usize).collect();
        let floats = |values: Vec<f32>| {
            gpu.check("vertices", || {
                let buffer = gpu.device().create_buffer(&wgpu::BufferDescriptor {
                    label: Some("vertices"),
                    size: 4 * values.len() as u64,
                    usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                });
                gpu.queue().write_buffer(&buffer, 0, bytemuck::cast_slice(&values));
                buffer
            })
        };
        let normals = mesh.normals.as_ref().expect("has normals");
        let tangents = mesh.tangents.as_ref().expect("has tangents");
        let uv = mesh.uv0.as_ref().expect("has uvs");
        let buffers = [
            floats(corners.iter().flat_map(|v| mesh.positions[*v].to_array()).collect())?,
            floats(corners.iter().flat_map(|v| normals[*v].to_array()).collect())?,
            floats(corners.iter().flat_map(|v| tangents[*v].to_array()).collect())?,
            floats(corners.iter().flat_map(|v| uv[*v].to_array()).collect())?,
        ];
        let map = |(role, picture): (&MapRole, &Raster)| {
            let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
            let format =
                if role.is_srgb() { wgpu::TextureFormat::Rgba8UnormSrgb } else { wgpu::TextureFormat::Rgba8Unorm };
            let texture = gpu.picture(role.name(), [TEXELS; 2], format, usage)?;
            let layout =
                wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * TEXELS), rows_per_image: None };
            let bytes = picture.texels.as_flattened();
            gpu.check("maps", || gpu.queue().write_texture(texture.as_image_copy(), bytes, layout, texture.size()))?;
            Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
        };
        let maps = MapRole::ALL.iter().zip(pictures).map(map).collect::<Result<_, GpuError>>()?;
        Ok(Model { buffers, corner_count: corners.len() as u32, maps })
    }
}

fn pipeline(gpu: &Gpu) -> Result<wgpu::RenderPipeline, GpuError> {
    let shader = kiln_shaders::APPLY_MAPS;
    let attributes: Vec<[wgpu::VertexAttribute; 1]> = FORMATS
        .iter()
        .zip(0..)
        .map(|(format, location)| [wgpu::VertexAttribute { format: *format, offset: 0, shader_location: location }])
        .collect();
    let layouts: Vec<_> = FORMATS
        .iter()
        .zip(&attributes)
        .map(|(format, attributes)| {
            let step_mode = wgpu::VertexStepMode::Vertex;
            Some(wgpu::VertexBufferLayout { array_stride: format.size(), step_mode, attributes })
        })
        .collect();
    gpu.check(shader.name, || {
        let module = gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(shader.name),
            source: wgpu::ShaderSource::Wgsl(shader.source.into()),
        });
        gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(shader.name),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: Default::default(),
                buffers: &layouts,
            },
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: Default::default(),
                targets: &[Some(wgpu::TextureFormat::Rgba8UnormSrgb.into())],
            }),
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: wgpu::TextureFormat::Depth32Float,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Less),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: Default::default(),
            multiview_mask: None,
            cache: None,
        })
    })
}

/// The texels `[SIZE * SIZE]` of the shader's picture, sRGB bytes on a background of zeros.
fn draw(gpu: &Gpu, model: &Model, frame: &Frame, factors: &Factors) -> Result<Vec<[u8; 4]>, GpuError> {
    let pipeline = pipeline(gpu)?;
    let (frame, factors) = (gpu.uniform("frame", frame)?, gpu.uniform("material", factors)?);
    let usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
    let target =
        gpu.picture("target", [SIZE; 2], wgpu::TextureFormat::Rgba8UnormSrgb, usage | wgpu::TextureUsages::COPY_SRC)?;
    let depth = gpu.picture("depth", [SIZE; 2], wgpu::TextureFormat::Depth32Float, usage)?;
    gpu.check("draw", || {
        let sampler = gpu.device().create_sampler(&wgpu::SamplerDescriptor {
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let mut resources = vec![frame.as_entire_binding(), factors.as_entire_binding()];
        resources.push(wgpu::BindingResource::Sampler(&sampler));
        resources.extend(model.maps.iter().map(wgpu::BindingResource::TextureView));
        let entries: Vec<_> = resources
            .into_iter()
            .zip(0..)
            .map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        let layout = pipeline.get_bind_group_layout(0);
        let group = wgpu::BindGroupDescriptor { label: None, layout: &layout, entries: &entries };
        let bindings = gpu.device().create_bind_group(&group);
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        {
            let (colour, depth) = (target.create_view(&Default::default()), depth.create_view(&Default::default()));
            let clear = wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT);
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("draw"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &colour,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load: clear, store: wgpu::StoreOp::Store },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &depth,
                    depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store: wgpu::StoreOp::Discard }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            for (buffer, slot) in model.buffers.iter().zip(0..) {
                pass.set_vertex_buffer(slot, buffer.slice(..));
            }
            pass.draw(0..model.corner_count, 0..1);
        }
        gpu.queue().submit([encoder.finish()]);
    })?;
    Ok(gpu.read_id_picture(&target)?.into_iter().map(u32::to_le_bytes).collect())
}

#[test]
fn the_shader_draws_what_its_twin_draws() {
    let Some(gpu) = gpu() else { return };
    let (mesh, set, pictures) = (ball(), materials(), pictures());
    let scene = Scene { mesh: &mesh, materials: &set, images: &pictures };
    // As BC5 leaves them: no z.
    let mut two_channels = pictures.clone();
    two_channels[2].texels.iter_mut().for_each(|texel| texel[2] = 0);
    let models = [&pictures, &two_channels].map(|maps| Model::new(&gpu, &mesh, maps).expect("fits"));
    let sphere = Sphere { centre: DVec3::ZERO, radius: 1.0 };
    let cameras = [
        Camera::orthographic(Vec3::new(0.4, 0.3, 1.0), sphere),
        Camera::perspective(Vec3::new(0.9, 0.5, -0.6), sphere, 45.0),
        Camera::perspective(Vec3::new(0.0, -0.2, 1.0), sphere, 80.0),
    ];
    for (view, camera) in cameras.iter().enumerate() {
        for (what, normal_map, flags, model) in
            [("whole", true, 2, &models[0]), ("no normals", false, 0, &models[0]), ("BC5", true, 3, &models[1])]
        {
            let options = RenderOptions {
                width: SIZE,
                height: SIZE,
                supersample: 1,
                mode: Mode::Material,
                normal_map,
                mip: Mip::Fixed(0),
                background: [0; 3],
                two_sided: true,
            };
            let twin = render(&scene, camera, &options);
            let factors = Factors::of(&set.materials[0], flags);
            let drawn = draw(&gpu, model, &frame(camera), &factors).expect("draws");
            let (mut sum, mut count, mut unusual, mut apart) = (0.0, 0u32, 0u32, 0u32);
            for (k, texel) in drawn.iter().enumerate() {
                let empty = (texel[3] == 0, twin.coverage[k] == 0.0);
                apart += u32::from(empty.0 != empty.1);
                // Pixels that one of them leaves empty lie on the outline.
                if empty.0 || empty.1 {
                    continue;
                }
                let seen = Vec3::new(texel[0].into(), texel[1].into(), texel[2].into());
                let off = (seen - twin.codes[k]).abs().max_element();
                assert!(off <= MOST, "{what}, view {view}, pixel {k}: {texel:?} for {}", twin.codes[k]);
                sum += f64::from(off);
                count += 1;
                unusual += u32::from(off > USUAL);
            }
            let mean = sum / f64::from(count);
            eprintln!("{what}, view {view}: mean {mean:.3} codes, {unusual} of {count} above {USUAL}");
            assert!(count > SIZE * SIZE / 3 && apart * 100 < count, "{what}, view {view}: {apart} of {count}");
            assert!(mean < MEAN && unusual * 100 < count, "{what}, view {view}: mean {mean}, {unusual} of {count}");
        }
    }
}
