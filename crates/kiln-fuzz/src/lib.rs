//! What fuzzing calls: every door for bytes from outside, once, with small limits.
//!
//! **Problem.** Bytes that nobody meant go in. Nothing comes out but a value that keeps its promises or an error that says where
//! the fault lies: no panic, no hang, no memory beyond what the input's length and the limits justify.
//!
//! **Method.** One function a door, [`TARGETS`] their table. Each opens the bytes, checks what holds for any bytes whatever, and
//! where they were accepted, looks at everything that the result lends.
//! ```text
//! cargo-fuzz   fuzz/fuzz_targets/NAME.rs    new inputs for hours; `cargo xtask long fuzz`
//! replay       tests/replay.rs              fuzz/seeds/NAME/*, fuzz/regressions/NAME/*, and seeded changes of them; in CI
//! ```
//! Some doors take several files; their input is split at lines that read `---` ([`split`]).
//!
//! **Limits.** Hashes would stop every mutation of a container at the door, so [`container`] tries the bytes also with their
//! hashes made right. Panics inside foreign decoders that the importer catches are no finding ([`pass_caught_panics`]). Nothing
//! behind import (merge to pack) is fuzzed here: it sees only values that validation let through.

mod container;
mod model;
#[cfg(feature = "pipeline")]
mod pipeline;

pub use container::container;
pub use model::{IMAGE_LIMITS, LIMITS, glb, gltf, image, imports, obj, ply};
#[cfg(feature = "pipeline")]
pub use pipeline::pipeline;

/// A door and its name, which is also that of its cargo-fuzz target and of its folders of seeds and regressions.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Name.
    pub name: &'static str,
    /// Tries the bytes; panics where a promise is broken.
    pub run: fn(&[u8]),
}

/// All doors.
pub const TARGETS: &[Target] = &[
    Target { name: "glb", run: glb },
    Target { name: "gltf", run: gltf },
    Target { name: "obj", run: obj },
    Target { name: "ply", run: ply },
    Target { name: "image", run: image },
    Target { name: "container", run: container },
    #[cfg(feature = "pipeline")]
    Target { name: "pipeline", run: pipeline },
];

/// Lets panics pass that the importer catches, of decoders that others wrote: it runs them behind `catch_unwind` and refuses the
/// input. To be called once by a fuzz target, whose own hook would end the process before anything could catch.
pub fn pass_caught_panics() {
    const CAUGHT: [&str; 5] = ["/basisu-", "/draco-core-", "/exr-", "/image-0", "/tiff-"];
    let end = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let file = panic.location().map_or("", |location| location.file());
        if !CAUGHT.iter().any(|name| file.contains(name)) {
            end(panic);
        }
    }));
}

/// The parts of an input that holds `N` files: what lies between lines that read `---`. Missing parts are empty, the last one
/// takes the rest.
pub fn split<const N: usize>(bytes: &[u8]) -> [&[u8]; N] {
    const BETWEEN: &[u8] = b"\n---\n";
    let mut rest = bytes;
    let mut parts = [&[][..]; N];
    for (k, part) in parts.iter_mut().enumerate() {
        let at = rest.windows(BETWEEN.len()).position(|window| window == BETWEEN).filter(|_| k + 1 < N);
        let (before, after) = match at {
            Some(at) => (&rest[..at + 1], &rest[at + BETWEEN.len()..]),
            None => (rest, &[][..]),
        };
        (*part, rest) = (before, after);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_is_split_at_its_lines_of_three_dashes_and_the_last_part_takes_the_rest() {
        assert_eq!(split(b"v 1\n---\nKd 1\n---\nrest"), [&b"v 1\n"[..], b"Kd 1\n---\nrest"]);
        assert_eq!(split(b"a\n---\nb\n---\nc"), [&b"a\n"[..], b"b\n", b"c"]);
        assert_eq!(split(b"a --- b"), [&b"a --- b"[..], b"", b""]);
    }
}
