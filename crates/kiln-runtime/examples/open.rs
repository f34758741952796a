//! Opens a container, prints its levels and textures, and the level that a viewer would choose from several distances.
//!
//! `cargo run --release --package kiln-runtime --example open -- build/pot.kiln`

use std::fmt::Write;
use std::io::Write as _;

use kiln_runtime::{AlignedBytes, Lods, View};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("usage: open FILE.kiln")?;
    let bytes = AlignedBytes::read_from(&mut std::fs::File::open(&path)?)?;
    let lods = Lods::open(&bytes)?;
    let mut out = String::new();

    writeln!(out, "{path}: {} bytes, {} levels", bytes.len(), lods.level_count())?;
    for lod in 0..lods.level_count() {
        let level = lods.level(lod).ok_or("a level is not at hand")?;
        let drawn = level.ranges.iter().filter(|range| range.index_count > 0).count();
        writeln!(
            out,
            "  lod {lod}: {} triangles, {} vertices, error {:.6}, {drawn} of {} submeshes drawn",
            level.indices().len() / 3,
            level.positions().len(),
            level.record.error,
            lods.submesh_count(),
        )?;
    }
    for number in 0..lods.texture_count() {
        let texture = lods.texture(number).ok_or("a texture is not at hand")?;
        let (format, mips) = (texture.format.name(), texture.mip_count);
        writeln!(out, "  texture {:?}: {} x {}, {format}, {mips} mips", texture.name, texture.width, texture.height)?;
    }

    let (lo, hi) = lods.bounds();
    let size = (0..3).map(|k| (hi[k] - lo[k]).powi(2)).sum::<f32>().sqrt();
    writeln!(out, "at most 1 pixel of error, 1080 lines, 60 degrees:")?;
    for times in [1.0, 2.0, 5.0, 10.0, 50.0, 200.0] {
        let distance = size * times;
        let view = View { distance, vertical_fov_radians: 60f32.to_radians(), viewport_height_px: 1080.0 };
        let lod = lods.choose_level(&view, 1.0);
        let pixels = lods.error(lod).unwrap_or(0.0) * view.pixels_per_unit();
        writeln!(out, "  from {distance:.3} ({times} diagonals): lod {lod}, {pixels:.3} pixels")?;
    }
    std::io::stdout().write_all(out.as_bytes())?;
    Ok(())
}
