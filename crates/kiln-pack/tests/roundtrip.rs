//! Import, export, import: the same asset, for any asset.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use kiln_asset::import::{Files, ImageLimits, ImportLimits, decode_image, import};
use kiln_asset::{
    AlphaMode, Asset, AttributeSet, Filter, ImageFormat, ImageId, ImageInfo, Level, LodSet, MapRole, Material,
    MaterialId, MaterialSet, Mesh, Raster, RawMesh, Sampler, Submesh, SubmeshId, Texture, TextureId, TextureRef, Wrap,
};
use kiln_pack::{ExportLevels, export_glb};
use proptest::prelude::*;

struct Memory(BTreeMap<String, Vec<u8>>);

impl Files for Memory {
    fn read(&self, relative: &str) -> io::Result<Vec<u8>> {
        self.0.get(relative).cloned().ok_or_else(|| io::ErrorKind::NotFound.into())
    }
}

fn imported(glb: Vec<u8>) -> (Asset, Vec<Raster>) {
    let files = Memory(BTreeMap::from([("model.glb".to_owned(), glb)]));
    let (asset, report) = import(&files, "model.glb", &ImportLimits::default()).expect("what was exported is sound");
    assert!(report.repairs.is_empty(), "{:?}", report.repairs);
    assert!(report.not_carried.is_empty(), "{:?}", report.not_carried);
    let pictures = (asset.materials.images.iter().zip(&asset.images))
        .map(|(info, bytes)| decode_image(info.format, bytes, &ImageLimits::default()).expect("a PNG"))
        .collect();
    (asset, pictures)
}

fn exported(asset: &Asset, pictures: &[Raster]) -> Vec<u8> {
    let level = Level { mesh: asset.mesh.clone(), error: 0.0, quadrics: Vec::new() };
    let source_triangles = asset.mesh.face_count() as u32;
    let levels = LodSet { levels: vec![level], layout: None, source_triangles };
    let pictures: Vec<&Raster> = pictures.iter().collect();
    export_glb(&levels, &asset.materials, &pictures, ExportLevels::One(0)).expect("a sound asset").0
}

/// A source of numbers that a seed decides; the property framework shrinks the sizes, the seed fills in the values.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % sides
    }

    fn unit(&mut self) -> f32 {
        self.roll(1 << 20) as f32 / (1 << 20) as f32
    }

    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.unit() - 0.5, self.unit() - 0.5, self.unit() - 0.5) * [1.0, 1e-4, 1e5][self.roll(3) as usize]
    }

    fn direction(&mut self) -> Vec3 {
        (self.vector() + Vec3::new(0.0, 1e-6, 0.0)).normalize_or(Vec3::Y)
    }

    fn name(&mut self) -> String {
        ["", "part", "a/b", "..", "\"quoted\"", "zeile\n2", "\u{1f600}", "part"][self.roll(8) as usize].to_owned()
    }
}

fn materials(dice: &mut Dice, count: usize, picture_count: usize) -> (MaterialSet, Vec<Raster>) {
    let mut set = MaterialSet::default();
    let mut pictures = Vec::new();
    for image in 0..picture_count {
        let (width, height) = (1 + dice.roll(5) as u32, 1 + dice.roll(5) as u32);
        let texels = (0..width * height).map(|_| [0; 4].map(|_: u8| dice.roll(256) as u8)).collect();
        pictures.push(Raster { width, height, texels });
        set.images.push(ImageInfo { name: format!("image {image}"), format: ImageFormat::Raster, hash: [0; 32] });
        let wrap = |roll| [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge][roll as usize];
        let filter = |roll| [Filter::Linear, Filter::Nearest][roll as usize];
        let sampler = Sampler {
            wrap_u: wrap(dice.roll(3)),
            wrap_v: wrap(dice.roll(3)),
            mag: filter(dice.roll(2)),
            min: filter(dice.roll(2)),
            mip: [None, Some(Filter::Linear), Some(Filter::Nearest)][dice.roll(3) as usize],
        };
        set.textures.push(Texture { image: ImageId(image as u32), sampler });
    }
    for _ in 0..count {
        let mut material = Material {
            name: dice.name(),
            base_color_factor: [0.0; 4].map(|_: f32| dice.unit()),
            metallic_factor: dice.unit(),
            roughness_factor: dice.unit(),
            normal_scale: 1.0,
            occlusion_strength: 1.0,
            emissive_factor: [0.0; 3].map(|_: f32| dice.unit() * [1.0, 3.0][dice.roll(2) as usize]),
            alpha_mode: [AlphaMode::Opaque, AlphaMode::Mask, AlphaMode::Blend][dice.roll(3) as usize],
            double_sided: dice.roll(2) == 1,
            ..Material::default()
        };
        for role in MapRole::ALL.into_iter().filter(|_| picture_count > 0) {
            if dice.roll(2) == 1 {
                let texture = TextureId(dice.roll(picture_count as u64) as u32);
                *material.map_mut(role) = Some(TextureRef { texture, uv_set: dice.roll(2) as u32 });
            }
        }
        set.materials.push(material);
    }
    (set, pictures)
}

fn mesh(dice: &mut Dice, parts: &[(usize, usize)], material_count: usize) -> Mesh {
    let has: [bool; 5] = std::array::from_fn(|_| dice.roll(3) > 0);
    let mut raw = RawMesh {
        normals: has[0].then(Vec::new),
        tangents: (has[0] && has[1]).then(Vec::new),
        uv0: has[2].then(Vec::new),
        uv1: has[3].then(Vec::new),
        colors: has[4].then(Vec::new),
        ..RawMesh::default()
    };
    for (number, (vertices, faces)) in parts.iter().enumerate() {
        let first = raw.positions.len() as u32;
        for _ in 0..*vertices {
            raw.positions.push(dice.vector());
            let normal = dice.direction();
            raw.normals.iter_mut().for_each(|list| list.push(normal));
            let tangent = normal.any_orthonormal_vector().extend([1.0, -1.0][dice.roll(2) as usize]);
            raw.tangents.iter_mut().for_each(|list| list.push(tangent));
            let uvs = [Vec2::new(dice.unit(), dice.unit()), Vec2::new(dice.unit() * 9.0, -dice.unit())];
            raw.uv0.iter_mut().for_each(|list| list.push(uvs[0]));
            raw.uv1.iter_mut().for_each(|list| list.push(uvs[1]));
            let color = Vec4::new(dice.unit(), dice.unit(), dice.unit(), dice.unit());
            raw.colors.iter_mut().for_each(|list| list.push(color));
        }
        for _ in 0..*faces {
            raw.triangles.push([0; 3].map(|_: u32| first + dice.roll(*vertices as u64) as u32));
            raw.face_submesh.push(SubmeshId(number as u32));
        }
        raw.submeshes.push(Submesh {
            name: format!("{}{number}", dice.name()),
            material: (dice.roll(3) > 0 && material_count > 0)
                .then(|| MaterialId(dice.roll(material_count as u64) as u32)),
            attributes: AttributeSet {
                normals: has[0],
                tangents: has[0] && has[1],
                uv0: has[2],
                uv1: has[3],
                colors: has[4],
                skin: false,
                importance: false,
            },
            source_triangles: *faces as u32,
        });
    }
    Mesh::new(raw).expect("built in range")
}

/// Corner positions in order: what no renumbering of vertices changes.
fn corners(mesh: &Mesh) -> Vec<Vec3> {
    mesh.triangles.iter().flatten().map(|v| mesh.positions[*v as usize]).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn what_is_exported_and_imported_again_is_the_same_asset(
        seed in any::<u64>(),
        parts in prop::collection::vec((1usize..12, 1usize..16), 1..5),
        material_count in 0usize..4,
        picture_count in 0usize..4,
    ) {
        let mut dice = Dice(seed);
        let (set, pictures) = materials(&mut dice, material_count, picture_count);
        let made = Asset { mesh: mesh(&mut dice, &parts, material_count), materials: set, images: vec![Arc::from([]); picture_count] };

        let (first, first_pictures) = imported(exported(&made, &pictures));
        prop_assert_eq!(corners(&first.mesh), corners(&made.mesh));
        prop_assert_eq!(&first.mesh.face_submesh, &made.mesh.face_submesh);
        let names = |mesh: &Mesh| mesh.submeshes.iter().map(|s| s.name.trim().to_owned()).collect::<Vec<_>>();
        prop_assert_eq!(names(&first.mesh), names(&made.mesh));

        let glb = exported(&first, &first_pictures);
        let (second, second_pictures) = imported(glb.clone());
        prop_assert_eq!(&first.mesh, &second.mesh);
        prop_assert_eq!(&first_pictures, &second_pictures);
        prop_assert_eq!(&first.materials.images, &second.materials.images);
        prop_assert_eq!(&first.materials.textures, &second.materials.textures);
        for (a, b) in first.materials.materials.iter().zip(&second.materials.materials) {
            // Emission above 1 is divided by its strength and multiplied again.
            let near = |k: usize| (a.emissive_factor[k] - b.emissive_factor[k]).abs() <= 2e-7 * a.emissive_factor[k];
            prop_assert!((0..3).all(near), "{:?} and {:?}", a.emissive_factor, b.emissive_factor);
            prop_assert_eq!(a, &Material { emissive_factor: a.emissive_factor, ..b.clone() });
        }
        prop_assert_eq!(exported(&second, &second_pictures).len(), glb.len());
    }
}
