//! Same input, same bytes, on any thread count.

use crate::space::{Space, small};

fn built_with(fixture: &str, threads: &str) -> Vec<u8> {
    let space: Space = small(fixture);
    let output = space
        .command(["build", "pipeline.toml", "--backend", "cpu", "--jobs", threads])
        .env("RAYON_NUM_THREADS", threads)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    space.read("out/model.kiln")
}

#[test]
fn one_thread_and_two_give_the_same_bytes() {
    for fixture in ["cube.glb", "boundary-pair.glb", "sphere.glb"] {
        assert_eq!(built_with(fixture, "1"), built_with(fixture, "2"), "{fixture}");
    }
}
