//! Known pictures of known models.

use glam::{DVec3, Vec2, Vec3, Vec4};
use kiln_asset::{
    AlphaMode, ImageFormat, ImageId, ImageInfo, Material, MaterialId, MaterialSet, Mesh, Raster, RawMesh, Sampler,
    Submesh, SubmeshId, Texture, TextureId, TextureRef,
};
use kiln_geom::math::{cos64, sin64};

use super::*;
use crate::camera::{Sphere, bounding_sphere};
use crate::image_error::image_error;

/// A frame whose picture spans exactly -1..1 in both directions.
fn front() -> Camera {
    Camera::orthographic(Vec3::Z, Sphere { centre: DVec3::ZERO, radius: 1.0 / 1.02 })
}

/// A quad over `[-1, 1]^2` at height `z`, facing +Z, with UVs as a picture lies (v down).
fn quad(z: f32) -> RawMesh {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(Vec2::from);
    RawMesh {
        positions: corners.map(|c| c.extend(z)).to_vec(),
        uv0: Some(corners.map(|c| Vec2::new(0.5 + 0.5 * c.x, 0.5 - 0.5 * c.y)).to_vec()),
        normals: Some(vec![Vec3::Z; 4]),
        tangents: Some(vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 4]),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        face_submesh: vec![SubmeshId(0); 2],
        submeshes: vec![Submesh { material: Some(MaterialId(0)), ..Default::default() }],
        ..Default::default()
    }
}

fn mesh(raw: RawMesh) -> Mesh {
    Mesh::new(raw).expect("valid")
}

/// One material whose map in `role` is image 0.
fn with_map(role: kiln_asset::MapRole, sampler: Sampler) -> MaterialSet {
    let mut material = Material::default();
    *material.map_mut(role) = Some(TextureRef { texture: TextureId(0), uv_set: 0 });
    MaterialSet {
        materials: vec![material],
        textures: vec![Texture { image: ImageId(0), sampler }],
        images: vec![ImageInfo { name: "map".into(), format: ImageFormat::Raster, hash: [0; 32] }],
        ..Default::default()
    }
}

fn plain() -> MaterialSet {
    MaterialSet { materials: vec![Material::default()], ..Default::default() }
}

fn options(size: u32) -> RenderOptions {
    RenderOptions { width: size, height: size, supersample: 1, ..Default::default() }
}

/// A unit sphere of `rings` rings.
fn sphere(rings: u32) -> RawMesh {
    let segments = 2 * rings;
    let mut raw = RawMesh { submeshes: vec![Submesh::default()], ..Default::default() };
    for r in 0..=rings {
        for s in 0..=segments {
            let (polar, around) =
                (r as f64 / rings as f64 * std::f64::consts::PI, s as f64 / segments as f64 * std::f64::consts::TAU);
            let (ring, y) = (sin64(polar), cos64(polar));
            raw.positions.push(DVec3::new(ring * sin64(around), y, ring * cos64(around)).as_vec3());
        }
    }
    let at = |r: u32, s: u32| r * (segments + 1) + s;
    for r in 0..rings {
        for s in 0..segments {
            raw.triangles
                .extend([[at(r, s), at(r + 1, s), at(r + 1, s + 1)], [at(r, s), at(r + 1, s + 1), at(r, s + 1)]]);
            raw.face_submesh.extend([SubmeshId(0); 2]);
        }
    }
    raw
}

#[test]
fn a_textured_quad_shows_its_texels_the_right_way_round() {
    let picture = Raster {
        width: 2,
        height: 2,
        texels: vec![[10, 0, 0, 255], [0, 20, 0, 255], [0, 0, 30, 255], [40, 40, 40, 255]],
    };
    let materials =
        with_map(kiln_asset::MapRole::BaseColor, Sampler { mag: kiln_asset::Filter::Nearest, ..Sampler::default() });
    let (mesh, images) = (mesh(quad(0.0)), [picture.clone()]);
    let scene = Scene { mesh: &mesh, materials: &materials, images: &images };
    let seen = render(&scene, &front(), &options(2));
    assert_eq!(seen.to_raster().texels, picture.texels);
    assert_eq!(seen.coverage, [1.0; 4]);
}

#[test]
fn a_quad_over_a_quarter_covers_a_quarter_of_pixels_exactly() {
    let mut raw = quad(0.0);
    raw.positions.iter_mut().for_each(|p| *p = *p * 0.5 + Vec3::new(-0.5, 0.5, 0.0));
    let mesh = mesh(raw);
    let scene = Scene { mesh: &mesh, materials: &plain(), images: &[] };
    let seen = render(&scene, &front(), &RenderOptions { background: [7, 8, 9], ..options(8) });
    for y in 0..8 {
        for x in 0..8 {
            let texel = seen.to_raster().texels[y * 8 + x];
            let expected = if x < 4 && y < 4 { [255; 4] } else { [7, 8, 9, 255] };
            assert_eq!(texel, expected, "({x}, {y})");
        }
    }
}

#[test]
fn samples_are_averaged() {
    let mut raw = quad(0.0);
    raw.positions.iter_mut().for_each(|p| p.x = 0.5 * p.x - 0.25);
    let mesh = mesh(raw);
    let scene = Scene { mesh: &mesh, materials: &plain(), images: &[] };
    // The right side lies at x = 0.25: pixel 2 of 4 spans 0..0.5 and is half covered.
    let seen = render(&scene, &front(), &RenderOptions { supersample: 4, background: [55; 3], ..options(4) });
    assert_eq!(seen.coverage[..4], [0.5, 1.0, 0.5, 0.0]);
    assert_eq!(seen.codes[2], Vec3::splat(155.0));
}

#[test]
fn the_nearer_face_hides_the_further_one_in_any_order() {
    for (first, second) in [(0.5, -0.5), (-0.5, 0.5)] {
        let (mut raw, other) = (quad(first), quad(second));
        raw.positions.extend(other.positions);
        raw.normals = None;
        raw.tangents = None;
        raw.uv0 = None;
        raw.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + 4)));
        raw.face_submesh.extend([SubmeshId(1); 2]);
        raw.submeshes.push(Submesh { material: Some(MaterialId(1)), ..Default::default() });
        let coloured = |r: f32| Material { base_color_factor: [r, 0.0, 0.0, 1.0], ..Material::default() };
        let materials = MaterialSet { materials: vec![coloured(0.2), coloured(0.6)], ..Default::default() };
        let mesh = mesh(raw);
        let scene = Scene { mesh: &mesh, materials: &materials, images: &[] };
        for camera in [front(), Camera::perspective(Vec3::Z, Sphere { centre: DVec3::ZERO, radius: 0.5 }, 45.0)] {
            let expected = if first > second { 51.0 } else { 153.0 };
            let seen = render(&scene, &camera, &options(5));
            assert!(seen.codes.iter().all(|c| (c.x - expected).abs() < 1e-3), "{first}: {:?}", seen.codes[0]);
        }
    }
}

#[test]
fn backs_are_hidden_unless_the_material_or_the_options_say_otherwise() {
    let mesh = mesh(quad(0.0));
    let behind = Camera { right: -DVec3::X, back: -DVec3::Z, ..front() };
    let covered = |materials: &MaterialSet, two_sided: bool| {
        let scene = Scene { mesh: &mesh, materials, images: &[] };
        render(&scene, &behind, &RenderOptions { two_sided, ..options(4) }).coverage.iter().sum::<f32>()
    };
    let mut double = plain();
    double.materials[0].double_sided = true;
    assert_eq!(covered(&plain(), false), 0.0);
    assert_eq!(covered(&plain(), true), 16.0);
    assert_eq!(covered(&double, false), 16.0);
}

#[test]
fn a_mask_cuts_holes_and_shows_what_lies_behind() {
    let mut materials =
        with_map(kiln_asset::MapRole::BaseColor, Sampler { mag: kiln_asset::Filter::Nearest, ..Sampler::default() });
    let images = [Raster { width: 2, height: 1, texels: vec![[200, 0, 0, 100], [200, 0, 0, 200]] }];
    let mesh = mesh(quad(0.0));
    let covered = |materials: &MaterialSet| {
        render(&Scene { mesh: &mesh, materials, images: &images }, &front(), &options(4)).coverage[..4].to_vec()
    };
    assert_eq!(covered(&materials), [1.0; 4]);
    materials.materials[0].alpha_mode = AlphaMode::Mask;
    assert_eq!(covered(&materials), [0.0, 0.0, 1.0, 1.0]);
    materials.materials[0].alpha_cutoff = 0.9;
    assert_eq!(covered(&materials), [0.0; 4]);
}

#[test]
fn a_spheres_silhouette_has_the_area_of_its_disc() {
    let mesh = mesh(sphere(64));
    let scene = Scene { mesh: &mesh, materials: &MaterialSet::default(), images: &[] };
    let camera = Camera::orthographic(Vec3::new(0.3, 0.5, 0.8), bounding_sphere(&mesh.positions));
    let seen = render(&scene, &camera, &RenderOptions { mode: Mode::Silhouette, supersample: 2, ..options(256) });
    let area: f64 = seen.coverage.iter().map(|c| *c as f64).sum();
    let radius = 128.0 / 1.02;
    let disc = std::f64::consts::PI * radius * radius;
    assert!((area / disc - 1.0).abs() < 2e-3, "{}", area / disc);
    // White on black.
    assert!(seen.codes.iter().zip(&seen.coverage).all(|(c, k)| (c.x - 255.0 * k).abs() < 1e-3));
}

#[test]
fn a_sphere_without_normals_shows_smooth_ones() {
    let mesh = mesh(sphere(64));
    let scene = Scene { mesh: &mesh, materials: &MaterialSet::default(), images: &[] };
    let seen = render(&scene, &front(), &RenderOptions { mode: Mode::Normals, ..options(65) });
    for (k, code) in seen.codes.iter().enumerate().filter(|(k, _)| seen.coverage[*k] == 1.0) {
        let x = ((k % 65) as f32 + 0.5) / 32.5 - 1.0;
        let y = 1.0 - ((k / 65) as f32 + 0.5) / 32.5;
        let r2 = x * x + y * y;
        if r2 < 0.8 {
            let expected = Vec3::new(x, y, (1.0 - r2).sqrt());
            let found = (*code / 127.5 - 1.0).normalize();
            assert!(found.dot(expected) > 0.999, "{found} against {expected}");
        }
    }
}

#[test]
fn light_at_the_camera_follows_the_slope() {
    let mut raw = quad(0.0);
    raw.normals = Some(vec![Vec3::new(0.6, 0.0, 0.8); 4]);
    let mesh = mesh(raw);
    let scene = Scene { mesh: &mesh, materials: &plain(), images: &[] };
    let seen = render(&scene, &front(), &RenderOptions { mode: Mode::Lit, ..options(3) });
    assert!(seen.codes.iter().all(|c| (c.x - 255.0 * (0.15 + 0.85 * 0.8)).abs() < 1e-2), "{:?}", seen.codes[0]);
}

/// The normal that a uniform map of `texel` gives on a quad with these vectors.
fn bent(texel: [u8; 4], raw: RawMesh) -> Vec3 {
    let materials = with_map(kiln_asset::MapRole::Normal, Sampler::default());
    let mesh = mesh(raw);
    let scene = Scene { mesh: &mesh, materials: &materials, images: &[Raster::filled(4, 4, texel)] };
    let seen = render(&scene, &front(), &RenderOptions { mode: Mode::Normals, normal_map: true, ..options(1) });
    seen.codes[0] / 127.5 - 1.0
}

#[test]
fn a_normal_map_bends_x_along_the_tangent_and_y_up_the_picture() {
    let right = [255, 128, 128, 255];
    let up = [128, 255, 128, 255];
    // With tangents (w = 1: bitangent up), and without, when they come from the UVs: the same.
    for tangents in [quad(0.0).tangents, None] {
        let raw = || RawMesh { tangents: tangents.clone(), ..quad(0.0) };
        assert!(bent(right, raw()).x > 0.99, "{}", bent(right, raw()));
        assert!(bent(up, raw()).y > 0.99, "{}", bent(up, raw()));
    }
    // A mirrored layout: u runs left, w = -1. X follows the tangent, Y stays up the picture.
    let mirrored = |tangents: bool| RawMesh {
        uv0: quad(0.0).uv0.map(|uv| uv.into_iter().map(|c| Vec2::new(1.0 - c.x, c.y)).collect()),
        tangents: tangents.then(|| vec![Vec4::new(-1.0, 0.0, 0.0, -1.0); 4]),
        ..quad(0.0)
    };
    for tangents in [true, false] {
        assert!(bent(right, mirrored(tangents)).x < -0.99);
        assert!(bent(up, mirrored(tangents)).y > 0.99);
    }
    // Switched off, or flat: the mesh's own normal.
    assert!(bent([128, 128, 255, 255], quad(0.0)).z > 0.999);
}

#[test]
fn an_asset_against_itself_is_no_distance_away() {
    let mesh = mesh(sphere(12));
    let scene = Scene { mesh: &mesh, materials: &MaterialSet::default(), images: &[] };
    let views = Camera::views(6, bounding_sphere(&mesh.positions));
    for mode in [Mode::Flat, Mode::Lit, Mode::Shaded, Mode::Normals, Mode::Silhouette] {
        let seen: Vec<Picture> =
            views.iter().map(|c| render(&scene, c, &RenderOptions { mode, ..options(48) })).collect();
        let error = image_error(&seen, &seen).expect("pairs");
        assert_eq!((error.rmse, error.silhouette_xor), (0.0, 0.0));
        assert!(seen.iter().all(|p| p.codes.iter().all(|c| c.is_finite())));
    }
}

#[test]
fn pictures_are_the_same_on_any_thread_count() {
    let mesh = mesh(sphere(20));
    let scene = Scene { mesh: &mesh, materials: &MaterialSet::default(), images: &[] };
    let camera = Camera::perspective(Vec3::ONE, bounding_sphere(&mesh.positions), 40.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| render(&scene, &camera, &RenderOptions { mode: Mode::Shaded, ..options(100) }))
    };
    assert_eq!(on(1), on(4));
}

#[test]
fn perspective_interpolates_by_distance() {
    // A floor that runs away from the eye: its middle in space lies well above the middle of its picture.
    let mut raw = quad(0.0);
    raw.positions = vec![
        Vec3::new(-1.0, -1.0, 1.0),
        Vec3::new(1.0, -1.0, 1.0),
        Vec3::new(1.0, -1.0, -9.0),
        Vec3::new(-1.0, -1.0, -9.0),
    ];
    raw.normals = Some(vec![Vec3::Y; 4]);
    let images = [Raster { width: 1, height: 2, texels: vec![[0, 0, 0, 255], [255, 255, 255, 255]] }];
    let sampler = Sampler { mag: kiln_asset::Filter::Nearest, mip: None, ..Sampler::default() };
    let materials = with_map(kiln_asset::MapRole::BaseColor, sampler);
    let mesh = mesh(raw);
    let scene = Scene { mesh: &mesh, materials: &materials, images: &images };
    let sphere = Sphere { centre: DVec3::ZERO, radius: 1.0 };
    let camera = Camera::perspective(Vec3::Z, sphere, 60.0);
    let eye = camera.distance.expect("perspective");
    let seen = render(&scene, &camera, &RenderOptions { two_sided: true, ..options(200) });
    // v = 0.5 lies at z = -4.
    let row = 100.0 + 100.0 / camera.half_extent * eye / (eye + 4.0);
    for y in 0..200 {
        let k = y * 200 + 100;
        if seen.coverage[k] == 1.0 && (y as f64 - row).abs() > 1.0 {
            assert_eq!(seen.codes[k].x, if (y as f64) < row { 0.0 } else { 255.0 }, "row {y} against {row}");
        }
    }
    assert!(seen.coverage[(row as usize + 2) * 200 + 100] == 1.0);
}

#[test]
fn the_mean_mip_counts_texels_a_sample() {
    let mesh = mesh(quad(0.0));
    let materials = with_map(kiln_asset::MapRole::BaseColor, Sampler::default());
    let images = [Raster::filled(512, 512, [1; 4])];
    let scene = Scene { mesh: &mesh, materials: &materials, images: &images };
    let sphere = Sphere { centre: DVec3::ZERO, radius: 1.0 };
    assert_eq!([64, 128, 511, 512, 1024].map(|pixels| scene.mean_mip(sphere, pixels)), [3, 2, 0, 0, 0]);
    let none = Scene { images: &[], ..scene };
    assert_eq!(none.mean_mip(sphere, 64), 0);
}

#[test]
fn every_map_of_the_material_is_drawn_by_the_shaders_formulas() {
    use apply_maps::{Lights, Surface, shade};
    use kiln_asset::MapRole;
    let lights = Lights::OBJECT;
    let flat = mesh(quad(0.0));
    let plain = Surface { base: Vec3::ONE, metallic: 1.0, roughness: 1.0, open: 1.0, emissive: Vec3::ZERO };
    let light = |code: u8| kiln_geom::colour::srgb_to_linear(code);
    // The expected surface and normal for a material whose one map is filled with (51, 102, 204).
    let part = [51, 102, 204].map(|c| c as f32 / 255.0);
    let cases = [
        (MapRole::BaseColor, Surface { base: Vec3::new(light(51), light(102), light(204)), ..plain }, Vec3::Z),
        (MapRole::MetallicRoughness, Surface { roughness: part[1], metallic: part[2], ..plain }, Vec3::Z),
        (MapRole::Occlusion, Surface { open: part[0], ..plain }, Vec3::Z),
        (MapRole::Emissive, Surface { emissive: 0.5 * Vec3::new(light(51), light(102), light(204)), ..plain }, Vec3::Z),
        (MapRole::Normal, plain, (2.0 * Vec3::from(part) - 1.0).normalize()),
    ];
    for (role, surface, normal) in cases {
        let mut materials = with_map(role, Sampler::default());
        materials.materials[0].emissive_factor = if role == MapRole::Emissive { [0.5; 3] } else { [0.0; 3] };
        let images = [Raster::filled(4, 4, [51, 102, 204, 255])];
        let scene = Scene { mesh: &flat, materials: &materials, images: &images };
        let drawn = render(&scene, &front(), &RenderOptions { mode: Mode::Material, normal_map: true, ..options(8) });
        let expected = shade(&surface, normal, Vec3::Z, &lights).clamp(Vec3::ZERO, Vec3::ONE);
        let codes = Vec3::from(expected.to_array().map(kiln_geom::colour::linear_to_srgb_f32)) * 255.0;
        assert!((drawn.codes[27] - codes).length() < 0.02, "{role:?}: {} for {codes}", drawn.codes[27]);
        assert!(surface != plain || normal != Vec3::Z, "a case that tests nothing");
    }
    // From behind, a sheet shows its back, lit from there.
    let bare = MaterialSet::default();
    let scene = Scene { mesh: &flat, materials: &bare, images: &[] };
    let behind = Camera { right: -DVec3::X, back: -DVec3::Z, ..front() };
    let both = RenderOptions { mode: Mode::Material, two_sided: true, ..options(8) };
    let clay = Surface { base: Vec3::splat(0.42), metallic: 0.0, ..plain };
    for (camera, normal) in [(front(), Vec3::Z), (behind, -Vec3::Z)] {
        let code = kiln_geom::colour::linear_to_srgb_f32(shade(&clay, normal, normal, &lights).x) * 255.0;
        assert!((render(&scene, &camera, &both).codes[27].x - code).abs() < 0.02);
    }
}

#[test]
fn a_map_of_half_the_size_is_read_one_level_finer() {
    use kiln_asset::MapRole;
    // Base colour of 16, occlusion of 8 texels: at level 2 of the one the other is at level 1.
    let mut materials = with_map(MapRole::BaseColor, Sampler::default());
    materials.materials[0].occlusion = Some(TextureRef { texture: TextureId(1), uv_set: 0 });
    materials.textures.push(Texture { image: ImageId(1), sampler: Sampler::default() });
    materials.images.push(materials.images[0].clone());
    let checks = (0..64u32).map(|t| [if (t % 8 / 2 + t / 16) % 2 == 0 { 255 } else { 0 }; 4]).collect();
    let images = [Raster::filled(16, 16, [255; 4]), Raster { width: 8, height: 8, texels: checks }];
    let flat = mesh(quad(0.0));
    let scene = Scene { mesh: &flat, materials: &materials, images: &images };
    let draw = |level| {
        let options = RenderOptions { mode: Mode::Material, mip: Mip::Fixed(level), ..options(8) };
        let codes = render(&scene, &front(), &options).codes;
        codes.iter().fold((255.0f32, 0.0f32), |(low, high), c| (low.min(c.x), high.max(c.x)))
    };
    let (low, high) = draw(2);
    assert!(high - low > 8.0, "checks of two texels are whole at level 1: {low} to {high}");
    let (low, high) = draw(3);
    assert!(high - low < 1.0, "and grey at level 2: {low} to {high}");
}
