//! Builds the containers into `OUT_DIR` and tells Cargo of every file that was read.

use std::path::PathBuf;
use std::{env, error, fs};

fn main() -> Result<(), Box<dyn error::Error>> {
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: run me by Cargo")?);
    let pipeline = fs::canonicalize("../assets/assets.toml")?;
    let mut build = kiln::Build::new(&pipeline);
    build.sets = vec![format!("asset.output={}/{{name}}.kiln", out.display())];
    build.cache = Some(out.join("kiln-cache"));
    build.backend = kiln::Backend::Cpu;
    build.dependencies = true;
    let outcome = build.run(&kiln::NoObserver)?;
    if let Some(error) = outcome.summary.errors.first() {
        return Err(error.clone().into());
    }
    let root = pipeline.parent().ok_or("a file has a folder")?;
    for line in outcome.dependencies.iter().flat_map(|all| kiln::cargo_lines(all, root)) {
        println!("{line}");
    }
    Ok(())
}
