//! Planted answers: pairs whose differences are known.

use glam::{Vec2, Vec3};
use kiln_asset::{
    ImageFormat, ImageId, ImageInfo, Material, MaterialId, MaterialSet, Mesh, Raster, RawMesh, Sampler, Submesh,
    SubmeshId, Texture, TextureId, TextureRef,
};

use super::pictures::{mips, spread};
use super::*;
use crate::render::{RenderOptions, render};

const QUICK: CompareOptions = CompareOptions {
    views: 4,
    size: 64,
    supersample: 2,
    samples: 20_000,
    normal_maps: true,
    pixels_per_degree: PIXELS_PER_DEGREE,
};

/// A box of 12 triangles from `-half` to `half` around `centre`, hard edges, one material.
fn cuboid(centre: Vec3, half: Vec3) -> Mesh {
    let mut raw = RawMesh {
        submeshes: vec![Submesh { material: Some(MaterialId(0)), ..Default::default() }],
        uv0: Some(Vec::new()),
        ..Default::default()
    };
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let mut normal = Vec3::ZERO;
            normal[axis] = side;
            let mut u = Vec3::ZERO;
            u[(axis + 1) % 3] = 1.0;
            let v = normal.cross(u);
            let first = raw.positions.len() as u32;
            for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                raw.positions.push(centre + half * (normal + x * u + y * v));
                raw.uv0.as_mut().expect("set above").push(Vec2::new(0.5 + 0.5 * x, 0.5 + 0.5 * y));
            }
            raw.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            raw.face_submesh.extend([SubmeshId(0); 2]);
        }
    }
    Mesh::new(raw).expect("valid")
}

/// A latitude-longitude sphere of 64 rings.
fn ball(radius: f32) -> Mesh {
    let (rings, segments) = (64u32, 128u32);
    let mut raw = RawMesh { submeshes: vec![Submesh::default()], ..Default::default() };
    for ring in 0..=rings {
        let (polar, azimuth_step) =
            (std::f32::consts::PI * ring as f32 / rings as f32, std::f32::consts::TAU / segments as f32);
        for segment in 0..segments {
            let azimuth = azimuth_step * segment as f32;
            let (s, c) = (kiln_geom::math::sin(polar), kiln_geom::math::cos(polar));
            let at = Vec3::new(s * kiln_geom::math::sin(azimuth), c, s * kiln_geom::math::cos(azimuth));
            raw.positions.push(at * radius);
        }
    }
    for ring in 0..rings {
        for segment in 0..segments {
            let at = |r: u32, s: u32| r * segments + s % segments;
            let [a, b, c, d] =
                [at(ring, segment), at(ring + 1, segment), at(ring + 1, segment + 1), at(ring, segment + 1)];
            raw.triangles.extend([[a, b, c], [a, c, d]]);
            raw.face_submesh.extend([SubmeshId(0); 2]);
        }
    }
    Mesh::new(raw).expect("valid")
}

fn painted(grey: f32) -> MaterialSet {
    let material = Material { base_color_factor: [grey, grey, grey, 1.0], ..Default::default() };
    MaterialSet { materials: vec![material], ..Default::default() }
}

/// One material with image 0 as base colour.
fn textured() -> MaterialSet {
    let reference = TextureRef { texture: TextureId(0), uv_set: 0 };
    MaterialSet {
        materials: vec![Material { base_color: Some(reference), ..Default::default() }],
        textures: vec![Texture { image: ImageId(0), sampler: Sampler::default() }],
        images: vec![ImageInfo { name: "map".into(), format: ImageFormat::Raster, hash: [0; 32] }],
        ..Default::default()
    }
}

fn measured(a: (&Mesh, &MaterialSet), b: (&Mesh, &MaterialSet)) -> Comparison {
    let scene = |(mesh, materials)| Scene { mesh, materials, images: &[] };
    compare(&scene(a), &scene(b), &QUICK, &|_, _| {}).expect("surfaces")
}

#[test]
fn an_asset_is_nowhere_different_from_itself() {
    let (mesh, paint) = (cuboid(Vec3::ONE, Vec3::new(1.0, 2.0, 0.5)), painted(0.7));
    let same = measured((&mesh, &paint), (&mesh, &paint));
    for mode in [&same.flat, &same.lit, &same.normals, &same.material] {
        assert_eq!((mode.rmse_both, &mode.per_view_both[..]), (0.0, &[0.0; 4][..]));
        assert_eq!((mode.rmse, mode.rmse_object, mode.rmse_worst, mode.psnr), (0.0, 0.0, 0.0, f64::INFINITY));
        assert_eq!((mode.ssim.all, mode.ssim.object, mode.flip.all, mode.flip.object), (1.0, 1.0, 0.0, 0.0));
        assert_eq!(mode.per_view, [0.0; 4]);
    }
    assert_eq!((same.silhouette.rmse, same.silhouette.xor, same.silhouette.iou), (0.0, 0.0, 1.0));
    assert!(same.relative_distance.hausdorff < 1e-6 && same.distance.normal_degrees < 0.1, "{same:?}");
    assert_eq!((same.reference, same.border_kept), (same.other, None));
    assert_eq!(same.reference.triangles, 12);
}

#[test]
fn a_recoloured_box_differs_by_its_greys_on_the_object_and_nowhere_else() {
    let mesh = cuboid(Vec3::ZERO, Vec3::ONE);
    let got = measured((&mesh, &painted(0.6)), (&mesh, &painted(0.4)));
    // 51 codes on every pixel that the box covers wholly, the covered share of it on its outline.
    assert!(got.flat.rmse_object > 48.0 && got.flat.rmse_object < 51.0, "{}", got.flat.rmse_object);
    // And exactly those on the pixels that it covers wholly.
    assert!((got.flat.rmse_both - 51.0).abs() < 1e-3, "{}", got.flat.rmse_both);
    assert!(got.flat.per_view_both.iter().all(|e| (e - 51.0).abs() < 1e-3));
    assert!(got.material.rmse_both > 5.0 && got.silhouette.per_view_xor == [0.0; 4], "{:?}", got.material);
    assert!(got.flat.rmse < got.flat.rmse_object && got.flat.rmse_worst >= got.flat.rmse);
    assert!((got.flat.psnr - 20.0 * (255.0 / got.flat.rmse).log10()).abs() < 1e-9);
    assert!(got.flat.flip.object > 0.3 && got.flat.flip.all < got.flat.flip.object);
    // 0.923 within the object, less around its outline, where the contrast against the background turns.
    assert!(got.flat.ssim.object < 0.923 && got.flat.ssim.object > 0.5, "{:?}", got.flat.ssim);
    assert_eq!((got.normals.rmse, got.silhouette.iou), (0.0, 1.0));
    assert!(got.relative_distance.hausdorff < 1e-6);
}

#[test]
fn a_larger_ball_is_its_radius_further_and_has_its_silhouette() {
    let (small, large) = (ball(1.0), ball(1.05));
    let paint = painted(1.0);
    let got = measured((&large, &paint), (&small, &paint));
    // Ideal: 0.05; facets of 64 rings lie up to 0.0012 within.
    for length in [got.distance.mean, got.distance.rms, got.distance.p99, got.distance.hausdorff] {
        assert!((length - 0.05).abs() < 2e-3, "{:?}", got.distance);
    }
    assert!(got.distance.normal_degrees < 2.0);
    assert!((got.relative_distance.mean - got.distance.mean / (2.1 * 3f64.sqrt())).abs() < 1e-6);
    // Discs: area in common over area of either.
    assert!((got.silhouette.iou - 1.0 / 1.05f64.powi(2)).abs() < 5e-3, "{:?}", got.silhouette);
    assert!((got.silhouette.xor - (1.0 - 1.0 / 1.05f64.powi(2))).abs() < 5e-3);
    assert!(got.silhouette.per_view_xor.iter().all(|xor| (xor - got.silhouette.xor).abs() < 2e-3));
    // Where both are, both are white: an outline's difference is no difference on the surface.
    assert!(got.flat.rmse_both < 1e-3 && got.flat.rmse_object > 10.0, "{:?}", got.flat);
    // 4 pi r^2 over 20,000 points, in diagonals.
    let spacing = (4.0 * std::f64::consts::PI * 1.05f64.powi(2) / 20_000.0).sqrt() / (2.1 * 3f64.sqrt());
    assert!((got.relative_spacing - spacing).abs() < 0.01 * spacing);
}

#[test]
fn a_box_without_its_lid_has_a_border_where_it_had_none() {
    let whole = cuboid(Vec3::ZERO, Vec3::ONE);
    let mut raw = whole.clone().into_raw();
    raw.triangles.truncate(10);
    raw.face_submesh.truncate(10);
    let open = Mesh::new(raw).expect("valid");
    let paint = painted(1.0);
    assert_eq!(measured((&whole, &paint), (&open, &paint)).other.border.length, 8.0);
    assert_eq!(measured((&open, &paint), (&whole, &paint)).border_kept, Some(0.0));
}

#[test]
fn the_outline_is_what_the_silhouette_mode_draws() {
    let (mesh, paint) = (cuboid(Vec3::ZERO, Vec3::ONE), painted(0.3));
    let scene = Scene { mesh: &mesh, materials: &paint, images: &[] };
    let camera = Camera::orthographic(Vec3::new(1.0, 2.0, 3.0), bounding_sphere(&mesh.positions));
    let draw = |mode| render(&scene, &camera, &RenderOptions { width: 40, height: 40, mode, ..Default::default() });
    assert_eq!(outline(&draw(Mode::Flat)), draw(Mode::Silhouette));
}

#[test]
fn another_atlas_is_read_at_the_fineness_of_the_references() {
    let mesh = cuboid(Vec3::ZERO, Vec3::ONE);
    let sphere = bounding_sphere(&mesh.positions);
    let set = textured();
    let images = [1024, 256, 32].map(|side| vec![Raster::filled(side, side, [200; 4])]);
    let [fine, coarse, tiny] = [0, 1, 2].map(|k: usize| Scene { mesh: &mesh, materials: &set, images: &images[k] });
    // 1024 texels over the side 2 of a box whose sphere of radius sqrt 3 spans 128 samples: 13.9 texels a sample.
    assert_eq!(mips(&fine, &fine, sphere, 128), [3, 3]);
    assert_eq!(mips(&fine, &coarse, sphere, 128), [3, 1]);
    assert_eq!(mips(&fine, &tiny, sphere, 128), [3, 0]);
    assert_eq!(mips(&tiny, &fine, sphere, 128), [0, 5]);
    let bare = Scene { images: &[], ..fine };
    assert_eq!(mips(&bare, &bare, sphere, 128), [0, 0]);
    assert_eq!(mips(&fine, &bare, sphere, 128)[0], 3);
}

#[test]
fn the_flat_reference_has_the_figures_of_the_whole_comparison() {
    let (whole, less) = (cuboid(Vec3::ZERO, Vec3::ONE), cuboid(Vec3::ZERO, Vec3::new(1.0, 0.8, 0.9)));
    let set = textured();
    let texels = (0..256u32 * 256).map(|i| [(i % 251) as u8, (i / 997) as u8, (i % 13 * 19) as u8, 255]).collect();
    let images = [Raster { width: 256, height: 256, texels }];
    let scene = |mesh| Scene { mesh, materials: &set, images: &images };
    let reference = crate::FlatReference::new(&scene(&whole), &QUICK);
    for other in [&whole, &less] {
        let flat = compare(&scene(&whole), &scene(other), &QUICK, &|_, _| {}).expect("surfaces").flat;
        let alone = reference.compare(other).expect("one size");
        assert_eq!((alone.rmse, alone.rmse_object, alone.per_view), (flat.rmse, flat.rmse_object, flat.per_view));
    }
    assert!(reference.compare(&less).expect("one size").rmse_object > 1.0);
}

#[test]
fn an_asset_without_a_surface_is_refused_by_its_side() {
    let (mesh, none) = (cuboid(Vec3::ZERO, Vec3::ONE), Mesh::new(RawMesh::default()).expect("valid"));
    let paint = painted(1.0);
    let scene = |mesh| Scene { mesh, materials: &paint, images: &[] };
    let refused = |a, b| compare(&scene(a), &scene(b), &QUICK, &|_, _| {}).expect_err("no surface");
    assert_eq!(refused(&none, &mesh), MeasureError::NoSurface("reference"));
    assert_eq!(refused(&mesh, &none), MeasureError::NoSurface("other"));
}

#[test]
fn the_report_is_the_same_on_any_thread_count() {
    let (a, b, paint) = (cuboid(Vec3::ZERO, Vec3::ONE), ball(1.1), painted(0.5));
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| measured((&a, &paint), (&b, &paint)))
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn progress_runs_from_0_to_1() {
    let (mesh, paint) = (cuboid(Vec3::ZERO, Vec3::ONE), painted(0.5));
    let scene = Scene { mesh: &mesh, materials: &paint, images: &[] };
    let heard = std::cell::RefCell::new(Vec::new());
    compare(&scene, &scene, &QUICK, &|share, _| heard.borrow_mut().push(share)).expect("surfaces");
    let heard = heard.into_inner();
    assert_eq!((heard[0], heard[heard.len() - 1]), (0.0, 1.0));
    assert!(heard.is_sorted() && heard.len() == 6);
}

#[test]
fn the_sheet_shows_worst_middle_and_best_with_one_scale() {
    assert_eq!(spread(&[1.0, 5.0, 3.0, 4.0, 2.0], 3), [1, 2, 0]);
    assert_eq!(spread(&[1.0, 1.0], 5), [0, 1]);
    assert_eq!(spread(&[1.0, 2.0], 1), [1]);
    assert_eq!(spread(&[], 3), [0usize; 0]);

    let mesh = cuboid(Vec3::ZERO, Vec3::ONE);
    let (light, dark) = (painted(0.9), painted(0.1));
    let (a, b) =
        (Scene { mesh: &mesh, materials: &light, images: &[] }, Scene { mesh: &mesh, materials: &dark, images: &[] });
    let comparison = compare(&a, &b, &QUICK, &|_, _| {}).expect("surfaces");
    let drawn = contact_sheet(&a, &b, &comparison, 2);
    assert!(drawn.width > 3 * 64 + 5 * 8 && drawn.height > 2 * 64 + 3 * 8);
    // The middle of the third tile (a side of the box, less lit than its top) is far from the ramp's dark end, its corner is at it: no difference on the background.
    let at = |x: u32, y: u32| drawn.texels[(y * drawn.width + x) as usize];
    let third = 3 * 8 + 2 * 64;
    assert!(at(third + 32, 8 + 32)[0] > 100, "{:?}", at(third + 32, 8 + 32));
    assert_eq!(at(third + 1, 8 + 1), [0, 0, 4, 255]);
}
