#![allow(clippy::unwrap_used, reason = "tests")]

mod appearance;
mod hits;
mod lines;
mod maps;
mod models;
mod twin;

use std::sync::Arc;

use glam::Vec3;
use kiln_asset::{ImageId, LodSet, MapRole, MaterialSet, Mesh, Raster};

use super::{
    Backend, BakeError, BakeInput, BakeOptions, BakeReport, Directions, HitRule, Images, NormalSpace, Picture,
    find_hits,
};

/// No pictures: asking for one fails the test's bake.
fn no_images(image: ImageId) -> Result<Arc<Raster>, String> {
    Err(format!("nobody has image {image}"))
}

/// Only a normal map, one sample a texel, along the faces' normals, nearest hits.
fn normals_only(size: u32, space: NormalSpace) -> BakeOptions {
    let (directions, hit) = (Directions::Face, HitRule::Nearest);
    BakeOptions { maps: vec![MapRole::Normal], size, space, directions, hit, ..BakeOptions::default() }
}

/// With this reach in front and behind.
fn within(reach: f32, options: &BakeOptions) -> BakeOptions {
    BakeOptions { front: Some(reach), back: Some(reach), ..options.clone() }
}

/// What the hit pass finds.
struct Hits {
    low_faces: Vec<u32>,
    high_faces: Vec<u32>,
    normals: Vec<Vec3>,
    positions: Vec<Option<Vec3>>,
    report: BakeReport,
}

fn find(high: &Mesh, low: &Mesh, options: &BakeOptions, backend: Backend<'_>) -> Result<Hits, BakeError> {
    let (low, set) = (models::one_level(low.clone(), options.size, 8), MaterialSet::default());
    let input = BakeInput { high, low: &low, materials: &set, images: &no_images, cage: None };
    let found = find_hits(&input, options, backend)?;
    let (normals, positions) = (found.object_normals(), found.positions());
    Ok(Hits { low_faces: found.low_faces, high_faces: found.high_faces, normals, positions, report: found.report })
}

/// A bake whose pictures are all of 8 bits.
type Plain = (LodSet, MaterialSet, Vec<Raster>, BakeReport);

fn bake(
    high: &Mesh,
    low: &LodSet,
    materials: &MaterialSet,
    images: &Images<'_>,
    options: &BakeOptions,
    backend: Backend<'_>,
) -> Result<Plain, BakeError> {
    let input = BakeInput { high, low, materials, images, cage: None };
    let baked = super::bake(&input, options, backend)?;
    let plain = |picture| match picture {
        Picture::Plain(raster) => raster,
        Picture::Deep(_) => panic!("deep"),
    };
    Ok((baked.levels, baked.materials, baked.pictures.into_iter().map(plain).collect(), baked.report))
}

/// The unit vector of a normal map's texel.
fn decoded(texel: [u8; 4]) -> glam::Vec3 {
    glam::Vec3::new(texel[0] as f32, texel[1] as f32, texel[2] as f32) / 127.5 - 1.0
}

fn degrees(a: glam::Vec3, b: glam::Vec3) -> f32 {
    // By sine and cosine: the arc cosine alone turns rounding near 1 into hundredths of a degree.
    kiln_geom::math::atan2(a.cross(b).length(), a.dot(b)).to_degrees()
}
