//! A game with its models in it.

static LEFT: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/left.kiln"));
static RIGHT: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/right.kiln"));

fn main() {
    println!("left: {} bytes, right: {} bytes", LEFT.len(), RIGHT.len());
}
