//! Reads the lock file, so that fingerprints name the exact foreign crates under each stage.

use std::{env, fs, path::PathBuf};

/// The crates whose behaviour reaches a stage's output, in the order of [`foreign`](src/foreign.rs)'s table.
const NAMES: [&str; 15] = [
    "basisu",
    "bevy_mikktspace",
    "ctt-bc7f",
    "draco-core",
    "exr",
    "glam",
    "image",
    "libm",
    "meshopt",
    "obvhs",
    "serde_json",
    "uvunwrap",
    "wgpu",
    "xatlas-rs-v2",
    "zstd-sys",
];

fn main() {
    let lock = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default()).join("../../Cargo.lock");
    println!("cargo::rerun-if-changed={}", lock.display());
    println!("cargo::rerun-if-changed=build.rs");
    let text = fs::read_to_string(&lock).unwrap_or_default();
    for name in NAMES {
        let mut version = "unknown";
        for package in text.split("[[package]]") {
            let field =
                |key: &str| package.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix(" = \"")?.strip_suffix('"'));
            if field("name") == Some(name) {
                version = field("version").unwrap_or("unknown");
            }
        }
        println!("cargo::rustc-env=KILN_VERSION_{}={version}", name.replace('-', "_").to_uppercase());
    }
}
