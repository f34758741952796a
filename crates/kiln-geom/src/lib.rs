//! Shared geometry: the one CPU rasteriser, the one BVH with a watertight test, sampling, colour spaces, deterministic maths.
//!
//! Reading order: [`bvh`] (lines, nearest points, boxes and prisms against triangles), [`triangle`] (nearest point on one),
//! [`raster`] (which texels a triangle covers), [`sample`] (points spread over spheres and surfaces), [`sphere`] (around positions), [`colour`],
//! [`math`].
//!
//! Everything here gives the same bits on any thread count and any machine: integer or strictly ordered float arithmetic,
//! and `libm` for what the standard library takes from the system.

pub mod bvh;
pub mod colour;
pub mod math;
pub mod raster;
pub mod sample;
pub mod sphere;
pub mod triangle;

pub use bvh::{Bvh, Hint, LineHit, Nearby, NearestPoint};
