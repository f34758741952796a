//! Regions: which area of which texture a place on the surface shows.
//!
//! **Method.** Region 0 is the background. Then material by material, in the order in which submeshes name them:
//! ```text
//! base colour texture:  times its factor, segmented (segmentation); each area is a region, each texel tells its own
//! none, or no UVs:      one region for all that the material covers
//! ```
//! Submeshes of one material share its regions: a part cut in two stays one thing to a viewer. Two materials never share one, also where
//! they read the same picture, since something else tells them apart; the picture is segmented once all the same.
//!
//! A submesh reads its texels as its sampler says: the UV set that its material names, wrapped, nearest texel, of the picture at the
//! size at which it was segmented. UV transforms are gone since import. Transparency fades a colour where it counts.
//!
//! **Limits.** Colours of vertices make no regions, nor do normal maps, emission and the rest.

use std::sync::Arc;

use glam::DVec2;
use kiln_asset::{
    AlphaMode, ImageId, MapRole, Material, MaterialId, MaterialSet, Mesh, Raster, Submesh, SubmeshId, Wrap,
};
use kiln_geom::colour::{linear_to_srgb, srgb_to_linear};
use serde::{Deserialize, Serialize};

use super::segmentation::{Segmentation, SegmentationOptions, segment};

/// Which texture region a texel shows. Region 0 is the background.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Regions {
    /// Number of ids, the background's included: every id is below it.
    pub count: u32,
    /// `[submesh_count]`; ids are unique over the model.
    pub maps: Vec<RegionMap>,
}

/// The regions of a submesh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RegionMap {
    /// All of it is one.
    Whole(u32),
    /// Its texture tells.
    Picture {
        /// Texels across.
        width: u32,
        /// Texels down.
        height: u32,
        /// What its sampler does beyond its sides, in u and in v.
        wrap: [Wrap; 2],
        /// `[height * width]`, top row first: the region of each texel. Submeshes of one material share it.
        ids: Arc<[u32]>,
        /// The UV set that it is read by, 0 or 1.
        set: usize,
    },
}

/// What was segmented.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionsReport {
    /// Regions of the model, the background not counted.
    pub regions: u32,
    /// The pictures, in the order of their regions.
    pub pictures: Vec<RegionPicture>,
}

/// One picture of a [`RegionsReport`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionPicture {
    /// Its name.
    pub name: String,
    /// The material that reads it.
    pub material: String,
    /// The first submesh of that material.
    pub submesh: u32,
    /// The picture's index.
    pub image: u32,
    /// Width at which it was segmented, texels.
    pub width: u32,
    /// Height at which it was segmented, texels.
    pub height: u32,
    /// Its regions.
    pub regions: u32,
}

impl RegionMap {
    /// The region at texture coordinates (v down) of the submesh.
    #[inline]
    pub fn at(&self, uv: DVec2) -> u32 {
        match self {
            RegionMap::Whole(id) => *id,
            RegionMap::Picture { width, height, wrap, ids, .. } => {
                // A coordinate that is no number counts as 0.
                let x = wrap[0].texel((uv.x * f64::from(*width)).floor() as i64, *width as usize);
                let y = wrap[1].texel((uv.y * f64::from(*height)).floor() as i64, *height as usize);
                ids[y * *width as usize + x]
            }
        }
    }
}

/// A segmented picture as a material's sampler reads it.
struct Known {
    image: ImageId,
    wrap: [Wrap; 2],
    alpha: bool,
    factor: [f32; 3],
    segmentation: Segmentation,
}

/// A base colour texture that a submesh can read.
struct Reading<'a> {
    material: &'a Material,
    image: ImageId,
    wrap: [Wrap; 2],
    set: usize,
}

impl Regions {
    /// The regions of `mesh` under `materials`. `decode` gives a picture.
    ///
    /// # Errors
    /// What `decode` says of a picture, or more regions than a 32-bit id can name.
    pub fn new(
        mesh: &Mesh,
        materials: &MaterialSet,
        decode: &dyn Fn(ImageId) -> Result<Arc<Raster>, String>,
        options: &SegmentationOptions,
    ) -> Result<(Regions, RegionsReport), String> {
        let mut regions = Regions { count: 1, maps: Vec::with_capacity(mesh.submeshes.len()) };
        let mut report = RegionsReport::default();
        let mut known: Vec<Known> = Vec::new();
        // By material, and whether it is read by a texture there: submeshes of one may have UVs or not.
        let mut given: Vec<(Option<MaterialId>, bool, usize)> = Vec::new();
        for (index, submesh) in mesh.submeshes.iter().enumerate() {
            let reading = reading(mesh, submesh, materials);
            let same = |g: &&(Option<MaterialId>, bool, usize)| g.0 == submesh.material && g.1 == reading.is_some();
            if let Some((.., first)) = given.iter().find(same) {
                let map = regions.maps[*first].clone();
                regions.maps.push(map);
                continue;
            }
            given.push((submesh.material, reading.is_some(), index));
            let Some(reading) = reading else {
                regions.maps.push(RegionMap::Whole(regions.count));
                regions.count = regions.count.checked_add(1).ok_or("too many regions")?;
                continue;
            };
            let at = segmented(&mut known, &reading, decode, options)?;
            let found = &known[at].segmentation;
            if found.labels.is_empty() {
                regions.maps.push(RegionMap::Whole(regions.count));
                regions.count = regions.count.checked_add(1).ok_or("too many regions")?;
                continue;
            }
            let first = regions.count;
            regions.count = first.checked_add(found.count).ok_or("too many regions")?;
            regions.maps.push(RegionMap::Picture {
                width: found.width,
                height: found.height,
                wrap: reading.wrap,
                ids: found.labels.iter().map(|label| first + label).collect(),
                set: reading.set,
            });
            report.pictures.push(RegionPicture {
                name: materials.images.get(reading.image.index()).map_or_else(String::new, |i| i.name.clone()),
                material: reading.material.name.clone(),
                submesh: index as u32,
                image: reading.image.0,
                width: found.width,
                height: found.height,
                regions: found.count,
            });
        }
        report.regions = regions.count - 1;
        Ok((regions, report))
    }

    /// The region of `submesh` at texture coordinates of both UV sets, v down.
    ///
    /// # Panics
    /// If there is no such submesh.
    #[inline]
    pub fn at(&self, submesh: SubmeshId, uv: [DVec2; 2]) -> u32 {
        let map = &self.maps[submesh.index()];
        match map {
            RegionMap::Whole(id) => *id,
            RegionMap::Picture { set, .. } => map.at(uv[*set]),
        }
    }
}

/// What a submesh reads its base colour from, if it has all that this takes.
fn reading<'a>(mesh: &Mesh, submesh: &Submesh, materials: &'a MaterialSet) -> Option<Reading<'a>> {
    let material = materials.materials.get(submesh.material?.index())?;
    let reference = material.map(MapRole::BaseColor)?;
    let has_uv = match reference.uv_set {
        0 => mesh.uv0.is_some() && submesh.attributes.uv0,
        1 => mesh.uv1.is_some() && submesh.attributes.uv1,
        _ => false,
    };
    let texture = materials.textures.get(reference.texture.index()).filter(|_| has_uv)?;
    let wrap = [texture.sampler.wrap_u, texture.sampler.wrap_v];
    Some(Reading { material, image: texture.image, wrap, set: reference.uv_set as usize })
}

/// Where in `known` the segmentation for a reading stands; made if it is new.
fn segmented(
    known: &mut Vec<Known>,
    reading: &Reading<'_>,
    decode: &dyn Fn(ImageId) -> Result<Arc<Raster>, String>,
    options: &SegmentationOptions,
) -> Result<usize, String> {
    let (image, wrap) = (reading.image, reading.wrap);
    let alpha = reading.material.alpha_mode != AlphaMode::Opaque;
    let [r, g, b, _] = reading.material.base_color_factor;
    let factor = [r, g, b];
    let same = |k: &Known| k.image == image && k.wrap == wrap && k.alpha == alpha && k.factor == factor;
    if let Some(at) = known.iter().position(same) {
        return Ok(at);
    }
    let picture = decode(image)?;
    let segmentation = match factor == [1.0; 3] {
        true => segment(&picture, alpha, wrap, options),
        false => segment(&tinted(&picture, factor), alpha, wrap, options),
    };
    known.push(Known { image, wrap, alpha, factor, segmentation });
    Ok(known.len() - 1)
}

/// The picture times a linear factor.
fn tinted(picture: &Raster, factor: [f32; 3]) -> Raster {
    let tables: [[u8; 256]; 3] =
        factor.map(|f| std::array::from_fn(|code| linear_to_srgb(f * srgb_to_linear(code as u8))));
    let texel = |t: &[u8; 4]| [tables[0][t[0] as usize], tables[1][t[1] as usize], tables[2][t[2] as usize], t[3]];
    Raster { width: picture.width, height: picture.height, texels: picture.texels.iter().map(texel).collect() }
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3};
    use kiln_asset::{AttributeSet, ImageFormat, ImageInfo, RawMesh, Sampler, Texture, TextureId, TextureRef};

    use super::*;

    /// One triangle a submesh: material, and whether it has uv0.
    fn mesh(submeshes: &[(Option<u32>, bool)]) -> Mesh {
        let count = submeshes.len();
        let submesh = |(k, (material, uv0)): (usize, &(Option<u32>, bool))| Submesh {
            name: format!("part {k}"),
            material: material.map(MaterialId),
            attributes: AttributeSet { uv0: *uv0, ..AttributeSet::default() },
            source_triangles: 1,
        };
        let place = |v: usize| Vec3::new((v % 3 == 1) as u8 as f32, (v % 3 == 2) as u8 as f32, (v / 3) as f32);
        Mesh::new(RawMesh {
            positions: (0..3 * count).map(place).collect(),
            uv0: Some(vec![Vec2::ZERO; 3 * count]),
            triangles: (0..count as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
            face_submesh: (0..count as u32).map(SubmeshId).collect(),
            submeshes: submeshes.iter().enumerate().map(submesh).collect(),
            ..RawMesh::default()
        })
        .expect("a sound mesh")
    }

    /// `[left, right]` halves of 32 x 16.
    fn halves(colours: [[u8; 4]; 2]) -> Raster {
        let texels = (0..512).map(|i| colours[i % 32 / 16]).collect();
        Raster { width: 32, height: 16, texels }
    }

    fn textured(texture: u32) -> Material {
        Material { base_color: Some(TextureRef { texture: TextureId(texture), uv_set: 0 }), ..Material::default() }
    }

    /// Textures by (image, wrap).
    fn set(materials: Vec<Material>, textures: &[(u32, Wrap)]) -> MaterialSet {
        let texture = |(image, wrap): &(u32, Wrap)| Texture {
            image: ImageId(*image),
            sampler: Sampler { wrap_u: *wrap, wrap_v: *wrap, ..Sampler::default() },
        };
        let info = |k: u32| ImageInfo { name: format!("image {k}"), format: ImageFormat::Png, hash: [k as u8; 32] };
        MaterialSet {
            materials,
            textures: textures.iter().map(texture).collect(),
            images: (0..4).map(info).collect(),
            ..MaterialSet::default()
        }
    }

    const SHARP: SegmentationOptions = SegmentationOptions { sigma: 0.0, k: 300.0, min_size: 1, reach: 0, side: 512 };

    fn regions(mesh: &Mesh, materials: &MaterialSet, pictures: &[Raster]) -> (Regions, RegionsReport) {
        let decode = |image: ImageId| {
            pictures.get(image.index()).map(|p| Arc::new(p.clone())).ok_or_else(|| format!("no image {image}"))
        };
        Regions::new(mesh, materials, &decode, &SHARP).expect("regions")
    }

    #[test]
    fn ids_are_unique_over_materials_and_shared_within_one() {
        let pictures = [halves([[255, 0, 0, 255], [0, 0, 255, 255]])];
        let clamp = Wrap::ClampToEdge;
        let materials = set(vec![textured(0), Material::default(), textured(0)], &[(0, clamp)]);
        let parts = [(Some(0), true), (Some(1), true), (Some(0), true), (None, true), (Some(2), true), (None, false)];
        let (found, report) = regions(&mesh(&parts), &materials, &pictures);
        assert_eq!(found.count, 1 + 2 + 1 + 1 + 2);
        let ids = |s: usize| [0.1, 0.9].map(|u| found.maps[s].at(DVec2::new(u, 0.5)));
        assert_eq!(ids(0), [1, 2]);
        assert_eq!(ids(1), [3, 3]);
        assert_eq!(found.maps[2], found.maps[0]);
        assert_eq!(ids(3), [4, 4]);
        assert_eq!(ids(4), [5, 6], "another material, the same picture");
        assert_eq!(found.maps[5], found.maps[3], "no material is one material");
        assert_eq!((report.regions, report.pictures.len()), (6, 2));
        assert_eq!(report.pictures[1].name, "image 0");
        assert_eq!((report.pictures[1].submesh, report.pictures[1].regions), (4, 2));
        let all = |s: u32, u: f64| found.at(SubmeshId(s), [DVec2::new(u, 0.5), DVec2::NAN]);
        assert_eq!([all(0, 0.1), all(1, 0.1), all(4, 0.9)], [1, 3, 6]);
    }

    #[test]
    fn a_submesh_without_the_uvs_that_its_material_reads_is_one_region_of_its_own() {
        let pictures = [halves([[255; 4], [0, 0, 0, 255]])];
        let materials = set(vec![textured(0)], &[(0, Wrap::Repeat)]);
        let (found, _) = regions(&mesh(&[(Some(0), false), (Some(0), true), (Some(0), false)]), &materials, &pictures);
        assert_eq!(found.maps[0], RegionMap::Whole(1));
        assert_eq!(found.maps[2], RegionMap::Whole(1));
        assert!(matches!(&found.maps[1], RegionMap::Picture { set: 0, .. }));
        assert_eq!(found.count, 4);
    }

    #[test]
    fn wrap_modes_are_obeyed_beyond_the_picture() {
        let pictures = [halves([[255; 4], [0, 0, 0, 255]])];
        let at = |wrap: Wrap, u: f64| {
            let (found, _) = regions(&mesh(&[(Some(0), true)]), &set(vec![textured(0)], &[(0, wrap)]), &pictures);
            found.maps[0].at(DVec2::new(u, 0.5))
        };
        for (u, repeat, mirrored, clamped) in [(0.25, 1, 1, 1), (1.25, 1, 2, 2), (-0.25, 2, 1, 1), (-1.25, 2, 2, 1)] {
            assert_eq!(at(Wrap::Repeat, u), repeat, "{u}");
            assert_eq!(at(Wrap::MirroredRepeat, u), mirrored, "{u}");
            assert_eq!(at(Wrap::ClampToEdge, u), clamped, "{u}");
        }
        for wild in [f64::NAN, f64::INFINITY, -1e300] {
            assert!([1, 2].contains(&at(Wrap::Repeat, wild)));
            assert!([1, 2].contains(&at(Wrap::ClampToEdge, wild)));
        }
    }

    #[test]
    fn the_factor_colours_the_picture_and_alpha_counts_where_it_is_seen() {
        // Red against blue-red: without red they are one.
        let pictures = [halves([[0, 90, 0, 255], [255, 90, 0, 255]]), halves([[80, 80, 80, 255], [80, 80, 80, 0]])];
        let without_red = Material { base_color_factor: [0.0, 1.0, 1.0, 1.0], ..textured(0) };
        let cut_out = Material { alpha_mode: AlphaMode::Mask, ..textured(1) };
        let count = |material: Material| {
            let materials = set(vec![material], &[(0, Wrap::ClampToEdge), (1, Wrap::ClampToEdge)]);
            regions(&mesh(&[(Some(0), true)]), &materials, &pictures).1.regions
        };
        assert_eq!(count(textured(0)), 2);
        assert_eq!(count(without_red), 1);
        assert_eq!(count(textured(1)), 1);
        assert_eq!(count(cut_out), 2);
    }

    #[test]
    fn a_picture_that_cannot_be_had_is_an_error_and_an_empty_one_a_region() {
        let materials = set(vec![textured(0)], &[(0, Wrap::Repeat)]);
        let mesh = mesh(&[(Some(0), true)]);
        let failed = Regions::new(&mesh, &materials, &|_| Err("gone".into()), &SHARP);
        assert_eq!(failed.err().as_deref(), Some("gone"));
        let (found, report) = regions(&mesh, &materials, &[Raster::default()]);
        assert_eq!(found.maps, [RegionMap::Whole(1)]);
        assert_eq!((found.count, report.regions), (2, 1));
    }
}
