//! The short replay: every seed, every file that once broke a promise, and seeded changes of each, through the same bodies as
//! fuzzing for hours. A broken promise is a panic here, which names the file and the change.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use kiln_fuzz::{TARGETS, Target};

/// Changes of each file: with ten times as many, seconds would become a minute.
const CHANGES: u64 = 2000;
/// No input may take longer. The slowest seed takes a hundredth of it.
const LONGEST: Duration = Duration::from_secs(1);

fn fuzz() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz")
}

/// The files of a folder by name; none where there is no such folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    found.sort();
    found
}

/// splitmix64 (Steele, Lea, Flood, OOPSLA 2014): a fixed sequence for each file.
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ z >> 31
}

/// One byte replaced, removed, or put in.
fn changed(bytes: &[u8], state: &mut u64) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let at = (next(state) % (bytes.len() as u64 + 1)) as usize;
    let byte = match next(state) % 4 {
        0 => [0, 0x7F, 0x80, 0xFF][(next(state) % 4) as usize],
        // Digits and signs turn numbers into other numbers.
        1 => b"0123456789-.e+"[(next(state) % 14) as usize],
        _ => next(state) as u8,
    };
    match next(state) % 8 {
        0 => out.insert(at, byte),
        1 if at < out.len() => drop(out.remove(at)),
        2 => out.truncate(at),
        _ if at < out.len() => out[at] = byte,
        _ => out.push(byte),
    }
    out
}

/// Runs the bytes. A machine that was busy elsewhere may slow one run, not three.
fn run(target: Target, bytes: &[u8], what: &dyn Fn() -> String) {
    let quick = || {
        let start = Instant::now();
        let unwound = std::panic::catch_unwind(|| (target.run)(bytes));
        assert!(unwound.is_ok(), "{}: {} broke a promise", target.name, what());
        start.elapsed() <= LONGEST
    };
    assert!((0..3).any(|_| quick()), "{}: {} takes longer than {LONGEST:?}", target.name, what());
}

fn replay(name: &str) {
    let target = *TARGETS.iter().find(|target| target.name == name).expect("a target of that name");
    let seeds = files(&fuzz().join("seeds").join(name));
    assert!(!seeds.is_empty(), "no seeds for {name}: run `cargo xtask fixtures --seeds`");
    for path in seeds.into_iter().chain(files(&fuzz().join("regressions").join(name))) {
        let bytes = fs::read(&path).unwrap();
        let shown = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        run(target, &bytes, &|| shown.clone());
        let mut state = bytes.iter().fold(0, |sum: u64, byte| sum.wrapping_mul(31).wrapping_add(*byte as u64));
        for change in 0..CHANGES {
            run(target, &changed(&bytes, &mut state), &|| format!("{shown}, change {change}"));
        }
    }
}

macro_rules! replays {
    ($($test:ident: $name:literal,)*) => {
        $(#[test]
        fn $test() {
            replay($name);
        })*

        /// Names of the targets that are replayed.
        const REPLAYED: &[&str] = &[$($name),*];
    };
}

replays! {
    glb_seeds_and_their_changes_break_no_promise: "glb",
    gltf_seeds_and_their_changes_break_no_promise: "gltf",
    obj_seeds_and_their_changes_break_no_promise: "obj",
    ply_seeds_and_their_changes_break_no_promise: "ply",
    image_seeds_and_their_changes_break_no_promise: "image",
    container_seeds_and_their_changes_break_no_promise: "container",
    pipeline_seeds_and_their_changes_break_no_promise: "pipeline",
}

#[test]
fn every_target_is_replayed_and_has_its_cargo_fuzz_file_and_dictionary() {
    let mut names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    assert_eq!(names, REPLAYED);
    names.sort_unstable();
    let stems = |folder: &str| -> Vec<String> {
        files(&fuzz().join(folder)).iter().map(|p| p.file_stem().unwrap().to_string_lossy().into_owned()).collect()
    };
    assert_eq!(stems("fuzz_targets"), names);
    assert_eq!(stems("dictionaries"), names);
}

/// Seeds that are meant to be refused; all others are accepted, else a reader would be fuzzed at its door only.
const REFUSED: &[&str] = &[
    "glb/cut.glb",
    "glb/huge-count.glb",
    "glb/ring.glb",
    "glb/stranger.glb",
    "gltf/deep.gltf",
    "gltf/huge-count.gltf",
    "gltf/image-above.gltf",
    "gltf/ring.gltf",
    "gltf/stranger.gltf",
    "obj/wrong-materials.obj",
    "obj/wrong.obj",
    "ply/strips.ply",
    "ply/wrong.ply",
];

#[test]
fn the_seeds_of_models_are_accepted_but_for_those_that_are_meant_to_be_wrong() {
    let mut refused = Vec::new();
    for name in ["glb", "gltf", "obj", "ply"] {
        for path in files(&fuzz().join("seeds").join(name)) {
            if let Err(error) = kiln_fuzz::imports(name, &fs::read(&path).unwrap()) {
                eprintln!("{}: {error}", path.display());
                refused.push(format!("{name}/{}", path.file_name().unwrap_or_default().to_string_lossy()));
            }
        }
    }
    assert_eq!(refused, REFUSED);
}
