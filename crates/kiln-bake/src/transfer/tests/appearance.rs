//! What the maps hold: normals in tangent space, colours, materials, detail of the source's normal map.

use std::cell::RefCell;

use glam::{Vec2, Vec3, Vec4};
use kiln_asset::{
    AlphaMode, Filter, ImageFormat, ImageInfo, Material, MaterialId, MaterialSet, Mesh, Sampler, SubmeshId, Texture,
    TextureId, TextureRef, Wrap,
};

use super::models::*;
use super::*;
use crate::tangents::{UvSource, mikktspace};
use crate::transfer::low::Low;
use crate::transfer::resolve::TangentFrame;
use crate::transfer::resolve::{Locator, Meeting, Needs};
use crate::transfer::{Backend, BakeError, Matching, check};

/// A set of one material that `shape` fills in, with `count` images, one texture each, sampled as `sampler`.
fn one_material(count: u32, sampler: Sampler, shape: impl FnOnce(&mut Material)) -> MaterialSet {
    let mut material = Material::default();
    shape(&mut material);
    MaterialSet {
        materials: vec![material],
        textures: (0..count).map(|i| Texture { image: ImageId(i), sampler }).collect(),
        images: (0..count)
            .map(|i| ImageInfo { name: format!("image {i}"), format: ImageFormat::Png, hash: [i as u8; 32] })
            .collect(),
        ..MaterialSet::default()
    }
}

fn texture(index: u32) -> Option<TextureRef> {
    Some(TextureRef { texture: TextureId(index), uv_set: 0 })
}

fn checker(size: u32) -> Arc<Raster> {
    let at = |i: u32| if (i % size + i / size).is_multiple_of(2) { [250, 200, 30, 255] } else { [10, 40, 90, 255] };
    Arc::new(Raster { width: size, height: size, texels: (0..size * size).map(at).collect() })
}

#[test]
fn hills_over_a_plane_give_their_slopes_in_tangent_space() {
    let high = valid(hills(200, 0.02, 2.0));
    let low = one_level(plane(0.0, upright), 128, 8);
    let options = within(0.05, &normals_only(128, NormalSpace::Tangent));
    let (_, _, maps, report) = bake(&high, &low, &MaterialSet::default(), &no_images, &options, Backend::Cpu).unwrap();
    assert_eq!((report.covered, report.missed), (128 * 128, 0));
    let w = 2.0 * std::f32::consts::TAU;
    let mut worst = 0.0f32;
    for (i, texel) in maps[0].texels.iter().enumerate() {
        // Row 0 is the top: y = 1.
        let (x, y) = ((i % 128) as f32 + 0.5, 128.0 - (i / 128) as f32 - 0.5);
        let (x, y) = (w * x / 128.0, w * y / 128.0);
        let slope = Vec3::new(-0.02 * w * x.cos() * y.sin(), -0.02 * w * x.sin() * y.cos(), 1.0);
        worst = worst.max(degrees(decoded(*texel), slope));
    }
    // 8 bits alone make 0.4 degrees.
    assert!(worst < 0.7, "{worst} degrees");
}

#[test]
fn tangent_space_read_back_gives_the_object_space_normals_on_mirrored_charts_too() {
    let high = valid(hills(100, 0.02, 2.0));
    for layout in [upright as fn(f32, f32) -> Vec2, |x, y| Vec2::new(1.0 - x, 1.0 - y), |x, y| Vec2::new(y, x * 0.5)] {
        let mut raw = plane(0.0, layout).into_raw();
        // Leaning normals: the frame is not the plane's own.
        raw.normals =
            Some([Vec3::new(0.3, 0.0, 1.0), Vec3::Z, Vec3::new(-0.2, 0.3, 1.0), Vec3::Z].map(Vec3::normalize).to_vec());
        raw.tangents = None;
        let low = mikktspace(&valid(raw), UvSource::AtlasUv).unwrap();
        let set = one_level(low.clone(), 64, 8);
        let go = |space| {
            bake(
                &high,
                &set,
                &MaterialSet::default(),
                &no_images,
                &within(0.05, &normals_only(64, space)),
                Backend::Cpu,
            )
            .unwrap()
        };
        let (tangent, object) = (go(NormalSpace::Tangent).2, go(NormalSpace::Object).2);
        let options = within(0.1, &normals_only(64, NormalSpace::Object));
        let hits = find(&high, &low, &options, Backend::Cpu).unwrap();
        let lines = Low::new(&low, low.atlas_uv.as_ref().unwrap(), 0, &options, [0.1; 2]);
        let mut locator = Locator::new(&lines, &high, Meeting::Line);
        let mut compared = 0;
        for texel in 0..64 * 64 {
            let (l, h) = (hits.low_faces[texel] as usize, hits.high_faces[texel] as usize);
            if h == 0 {
                continue;
            }
            let hit = locator.at([texel as u32 % 64, texel as u32 / 64], l - 1, h - 1, Needs::default()).unwrap();
            let corners = low.triangles[hit.low].map(|v| v as usize);
            let normals = corners.map(|v| low.normals.as_ref().unwrap()[v]);
            let tangents = corners.map(|v| low.tangents.as_ref().unwrap()[v]);
            let read = TangentFrame::new(normals, tangents, hit.low_bary).decode(decoded(tangent[0].texels[texel]));
            let angle = degrees(read, decoded(object[0].texels[texel]));
            assert!(angle < 1.2, "{angle} degrees at texel {texel}");
            compared += 1;
        }
        assert!(compared > 2000);
    }
}

#[test]
fn a_checker_on_the_same_plane_comes_out_as_it_was() {
    let set = one_material(1, Sampler::default(), |m| m.base_color = texture(0));
    let picture = checker(32);
    let give = |_| Ok(Arc::clone(&picture));
    let high = plane(0.0, upright);
    let options = BakeOptions { maps: vec![MapRole::BaseColor], size: 32, ..BakeOptions::default() };
    let low = one_level(high.clone(), 32, 8);
    let (levels, materials, maps, report) = bake(&high, &low, &set, &give, &options, Backend::Cpu).unwrap();
    assert_eq!(maps[0], *picture);
    assert_eq!(report.maps, [MapRole::BaseColor]);
    check::check(&low, &levels, &materials, maps.len()).unwrap();
    assert_eq!(materials.materials[0].base_color_factor, [1.0; 4]);
    assert_eq!(materials.images[0].hash, *blake3::hash(&maps[0].to_blob()).as_bytes());
    // A quarter of the size: each texel is the light of its 4 x 4, half bright and half dark.
    let small = BakeOptions { size: 8, ..options };
    let (_, _, maps, _) = bake(&high, &low, &set, &give, &small, Backend::Cpu).unwrap();
    for texel in &maps[0].texels {
        for (c, (bright, dark)) in [(250, 10), (200, 40), (30, 90)].into_iter().enumerate() {
            let light = |b| kiln_geom::colour::srgb_to_linear(b);
            let mean = kiln_geom::colour::linear_to_srgb(0.5 * (light(bright) + light(dark)));
            assert!(texel[c].abs_diff(mean) <= 1, "{texel:?} against {mean}");
        }
    }
}

#[test]
fn factors_and_vertex_colours_are_multiplied_in_linear_light() {
    let set = one_material(0, Sampler::default(), |m| {
        m.base_color_factor = [0.5, 1.0, 0.25, 1.0];
        (m.metallic_factor, m.roughness_factor) = (0.2, 0.6);
        m.emissive_factor = [0.0, 0.5, 1.0];
    });
    let mut raw = plane(0.0, upright).into_raw();
    raw.colors = Some(vec![Vec4::new(1.0, 0.5, 1.0, 1.0); raw.positions.len()]);
    raw.submeshes[0].attributes.colors = true;
    let high = valid(raw);
    let options = BakeOptions { maps: MapRole::ALL.to_vec(), size: 8, ..BakeOptions::default() };
    let low = one_level(high.clone(), 8, 8);
    let (levels, materials, maps, report) = bake(&high, &low, &set, &no_images, &options, Backend::Cpu).unwrap();
    assert_eq!(report.neutral_maps, [MapRole::Occlusion]);
    let srgb = |l: f32| kiln_geom::colour::linear_to_srgb(l);
    assert!(maps[0].texels.iter().all(|t| *t == [srgb(0.5), srgb(0.5), srgb(0.25), 255]));
    assert!(maps[1].texels.iter().all(|t| *t == [255, 153, 51, 255]));
    assert!(maps[2].texels.iter().all(|t| *t == [128, 128, 255, 255]));
    assert!(maps[3].texels.iter().all(|t| *t == [0, srgb(0.5), 255, 255]));
    let material = &materials.materials[0];
    assert_eq!((material.metallic_factor, material.roughness_factor), (1.0, 1.0));
    assert_eq!(material.emissive_factor, [1.0; 3]);
    assert!(levels.levels[0].mesh.colors.is_none(), "baked colours are not multiplied twice");
}

#[test]
fn the_sources_normal_map_bends_the_baked_normals() {
    // The map leans 0.6 towards its own u, which runs along +Y on the high plane.
    let set = one_material(1, Sampler::default(), |m| m.normal = texture(0));
    let lean = Arc::new(Raster::filled(4, 4, [204, 128, 230, 255]));
    let give = |_| Ok(Arc::clone(&lean));
    for own_tangents in [false, true] {
        let mut raw = plane(0.01, |x, y| Vec2::new(y, x)).into_raw();
        raw.tangents = None;
        let mut high = valid(raw);
        if own_tangents {
            let mut raw = mikktspace(&high, UvSource::Uv0).unwrap().into_raw();
            raw.submeshes[0].attributes.tangents = true;
            high = valid(raw);
        }
        let low = one_level(plane(0.0, upright), 16, 8);
        let (_, _, maps, _) =
            bake(&high, &low, &set, &give, &within(0.05, &normals_only(16, NormalSpace::Tangent)), Backend::Cpu)
                .unwrap();
        for texel in &maps[0].texels {
            let angle = degrees(decoded(*texel), Vec3::new(0.0, 0.6, 0.8));
            assert!(angle < 1.0, "{texel:?} is {angle} degrees off");
        }
    }
}

/// `parts` planes side by side in x, each a submesh with its own material id, charts side by side in u.
fn row_of_parts(parts: u32) -> Mesh {
    let mut out = plane(0.0, upright).into_raw();
    let one = out.clone();
    let count = one.positions.len() as u32;
    for k in 1..parts {
        out.positions.extend(one.positions.iter().map(|p| *p + 2.0 * k as f32 * Vec3::X));
        out.normals.as_mut().unwrap().extend(one.normals.as_ref().unwrap());
        out.tangents.as_mut().unwrap().extend(one.tangents.as_ref().unwrap());
        out.uv0.as_mut().unwrap().extend(one.uv0.as_ref().unwrap());
        out.atlas_uv.as_mut().unwrap().extend(one.atlas_uv.as_ref().unwrap());
        out.triangles.extend(one.triangles.iter().map(|t| t.map(|v| v + count * k)));
        out.face_submesh.extend(one.face_submesh.iter().map(|_| SubmeshId(k)));
        let mut submesh = one.submeshes[0].clone();
        submesh.name = format!("part {k}");
        submesh.material = Some(MaterialId(k));
        out.submeshes.push(submesh);
    }
    for (v, uv) in out.atlas_uv.as_mut().unwrap().iter_mut().enumerate() {
        uv.x = (uv.x + (v as u32 / count) as f32) / parts as f32;
    }
    out.points.clear();
    valid(out)
}

#[test]
fn materials_are_split_by_alpha_mode_and_sides_and_masks_meet_at_one_cutoff() {
    let shape = |alpha_mode, double_sided, alpha_cutoff, alpha| Material {
        alpha_mode,
        double_sided,
        alpha_cutoff,
        base_color_factor: [1.0, 1.0, 1.0, alpha],
        ..Material::default()
    };
    let set = MaterialSet {
        materials: vec![
            shape(AlphaMode::Mask, false, 0.2, 0.1),
            shape(AlphaMode::Opaque, false, 0.5, 0.3),
            shape(AlphaMode::Mask, false, 0.8, 0.4),
            shape(AlphaMode::Opaque, true, 0.5, 1.0),
        ],
        ..MaterialSet::default()
    };
    let mesh = row_of_parts(4);
    let options = BakeOptions { maps: vec![MapRole::BaseColor], size: 32, ..BakeOptions::default() };
    let low = one_level(mesh.clone(), 32, 8);
    let (levels, materials, maps, _) = bake(&mesh, &low, &set, &no_images, &options, Backend::Cpu).unwrap();
    let kinds: Vec<_> = materials.materials.iter().map(|m| (m.alpha_mode, m.double_sided, m.alpha_cutoff)).collect();
    assert_eq!(kinds, [(AlphaMode::Opaque, false, 0.5), (AlphaMode::Opaque, true, 0.5), (AlphaMode::Mask, false, 0.5)]);
    let of: Vec<_> = levels.levels[0].mesh.submeshes.iter().map(|s| s.material.unwrap().0).collect();
    assert_eq!(of, [2, 0, 2, 1]);
    assert_eq!(levels.levels[0].mesh.submeshes[2].name, "part 2");
    // Half of each cutoff is half of the common one; opaque alpha says nothing and is written as 1.
    let alpha = |x: usize| maps[0].texels[16 * 32 + x][3];
    assert_eq!([alpha(4), alpha(12), alpha(20), alpha(28)], [64, 255, 64, 255]);
}

#[test]
fn a_part_close_by_does_not_bleed_into_its_neighbour() {
    // Two coincident sheets of two submeshes; the wrong one lies exactly in the plane, the right one a little above.
    let mut raw = row_of_parts(2).into_raw();
    for p in &mut raw.positions {
        p.x %= 2.0;
    }
    let low = one_level(valid(raw.clone()), 16, 8);
    let half = raw.positions.len() / 2;
    for p in &mut raw.positions[half..] {
        p.z += 0.01;
    }
    // The low mesh's second part at 0.01 too would be easy; leave it at 0, where the first part's high sheet is.
    let high = valid(raw);
    let paint = |r, g| Material { base_color_factor: [r, g, 0.0, 1.0], ..Material::default() };
    let set = MaterialSet { materials: vec![paint(1.0, 0.0), paint(0.0, 1.0)], ..MaterialSet::default() };
    for (matching, right) in
        [(Matching::Prefer, [0, 255, 0, 255]), (Matching::Name, [0, 255, 0, 255]), (Matching::Any, [255, 0, 0, 255])]
    {
        let hit = HitRule::Nearest;
        let options = BakeOptions { maps: vec![MapRole::BaseColor], size: 16, matching, hit, ..BakeOptions::default() };
        let options = within(0.05, &options);
        let (_, _, maps, _) = bake(&high, &low, &set, &no_images, &options, Backend::Cpu).unwrap();
        assert_eq!(maps[0].texels[8 * 16 + 4], [255, 0, 0, 255]);
        assert_eq!(maps[0].texels[8 * 16 + 12], right);
    }
}

#[test]
fn only_pictures_that_a_baked_map_reads_are_decoded_and_a_bad_one_is_named() {
    let sampler = Sampler { wrap_u: Wrap::ClampToEdge, mag: Filter::Nearest, ..Sampler::default() };
    let set = one_material(3, sampler, |m| {
        m.base_color = texture(0);
        m.normal = texture(1);
        m.occlusion = texture(2);
    });
    let asked = RefCell::new(Vec::new());
    let give = |image: ImageId| {
        asked.borrow_mut().push(image.0);
        Ok(checker(4))
    };
    let mesh = plane(0.0, upright);
    let low = one_level(mesh.clone(), 16, 2);
    let options = BakeOptions { maps: vec![MapRole::BaseColor], size: 16, ..BakeOptions::default() };
    let (_, _, _, report) = bake(&mesh, &low, &set, &give, &options, Backend::Cpu).unwrap();
    assert_eq!(*asked.borrow(), [0]);
    assert_eq!(report.lost_maps, [MapRole::Normal, MapRole::Occlusion]);
    assert_eq!(report.short_padding, Some(2));
    match bake(&mesh, &low, &set, &no_images, &options, Backend::Cpu) {
        Err(BakeError::Image { image: ImageId(0), .. }) => {}
        other => panic!("{:?}", other.map(|r| r.3)),
    }
}

#[test]
fn what_is_missing_is_said() {
    let mesh = plane(0.0, upright);
    let options = normals_only(8, NormalSpace::Tangent);
    let go = |high: &Mesh, low: Mesh| {
        bake(high, &one_level(low, 8, 8), &MaterialSet::default(), &no_images, &options, Backend::Cpu).err()
    };
    let without = |change: fn(&mut kiln_asset::RawMesh)| {
        let mut raw = mesh.clone().into_raw();
        change(&mut raw);
        valid(raw)
    };
    assert_eq!(go(&mesh, without(|r| r.atlas_uv = None)), Some(BakeError::NoAtlas { level: 0 }));
    assert_eq!(go(&mesh, without(|r| r.normals = None)), Some(BakeError::NoNormals { mesh: "low" }));
    assert_eq!(go(&without(|r| r.normals = None), mesh.clone()), Some(BakeError::NoNormals { mesh: "high" }));
    // Tangents of a layout that was turned by half since.
    let turned = without(|r| r.atlas_uv.as_mut().unwrap().iter_mut().for_each(|uv| *uv = Vec2::ONE - *uv));
    assert_eq!(go(&mesh, turned), Some(BakeError::StaleTangents { level: 0 }));
    assert_eq!(go(&mesh, without(|r| r.tangents = None)), None);
    let nothing = bake(&mesh, &Default::default(), &MaterialSet::default(), &no_images, &options, Backend::Cpu);
    assert!(matches!(nothing, Err(BakeError::NoLevels)));
}

#[test]
fn normals_behind_the_shading_normal_are_counted() {
    let high = valid(hills(8, 0.0, 1.0));
    let mut raw = plane(0.0, upright).into_raw();
    // Shading normals that lean down behind the plane they belong to.
    raw.normals = Some(vec![Vec3::new(0.9, 0.0, -0.3).normalize(); 4]);
    raw.tangents = None;
    let low = one_level(valid(raw), 16, 8);
    let options = normals_only(16, NormalSpace::Tangent);
    let go = |low| bake(&high, low, &MaterialSet::default(), &no_images, &options, Backend::Cpu).unwrap().3.behind;
    assert_eq!(go(&low), 256);
    assert_eq!(go(&one_level(plane(0.0, upright), 16, 8)), 0);
}
