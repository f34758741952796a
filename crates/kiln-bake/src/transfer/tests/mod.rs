#![allow(clippy::unwrap_used, reason = "tests")]

mod appearance;
mod hits;
mod models;
mod twin;

use std::sync::Arc;

use kiln_asset::{ImageId, MapRole, Raster};

use super::{BakeOptions, NormalSpace};

/// No pictures: asking for one fails the test's bake.
fn no_images(image: ImageId) -> Result<Arc<Raster>, String> {
    Err(format!("nobody has image {image}"))
}

/// Only a normal map.
fn normals_only(size: u32, space: NormalSpace) -> BakeOptions {
    BakeOptions { maps: vec![MapRole::Normal], size, space, ..BakeOptions::default() }
}

/// The unit vector of a normal map's texel.
fn decoded(texel: [u8; 4]) -> glam::Vec3 {
    glam::Vec3::new(texel[0] as f32, texel[1] as f32, texel[2] as f32) / 127.5 - 1.0
}

fn degrees(a: glam::Vec3, b: glam::Vec3) -> f32 {
    // By sine and cosine: the arc cosine alone turns rounding near 1 into hundredths of a degree.
    kiln_geom::math::atan2(a.cross(b).length(), a.dot(b)).to_degrees()
}
