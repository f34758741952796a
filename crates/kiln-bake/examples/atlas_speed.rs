//! Seconds that the atlas of a model takes, what it came to, and a hash of its bytes.
//!
//! `cargo run --release -p kiln-bake --example atlas_speed -- MODEL.glb [SIZE] [PADDING]`

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use kiln_asset::Level;
use kiln_asset::import::{Folder, import};
use kiln_bake::atlas::{AtlasOptions, Uvunwrap, unwrap};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize, standard| arguments.get(at).map_or(Ok(standard), |text| text.parse());
    let (size, padding) = (number(1, 2048)?, number(2, 16)?);
    let path = Path::new(arguments.first().ok_or("which model?")?);
    let name = path.file_name().ok_or("no file")?.to_string_lossy().into_owned();
    let (asset, _) = import(&Folder(path.parent().unwrap_or(Path::new(".")).into()), &name, &Default::default())?;
    let level = Level { mesh: asset.mesh, ..Level::default() };
    let options = AtlasOptions { size, padding, ..AtlasOptions::default() };
    let start = Instant::now();
    let (level, _, report) = unwrap(&level, &options, &Uvunwrap::STANDARD)?;
    let seconds = start.elapsed().as_secs_f64();
    let hash = blake3::hash(&level.mesh.to_blob()).to_hex();
    eprintln!("{name}, {} triangles, {size}/{padding}: {seconds:.2} s, blob {}", level.mesh.face_count(), &hash[..16]);
    eprintln!("{report:?}");
    Ok(())
}
