// Draws what vertices pick, without a buffer of picks. Twin: crates/kiln-runtime/src/tree/mod.rs
//
// Goes behind the text of shaders/tree_leaf_pick.wgsl or shaders/tree_compact_pick.wgsl, whose `pick` it calls. One invocation of
// `draw` places the vertex that an index names; triangles whose corners pick one node cover no pixel. `shade` writes the depth's
// bits, for tests and prepasses; engines put their own there.
//
// Reads:  `clip_from_object`, and what `pick` reads

@group(0) @binding(5) var<uniform> clip_from_object: mat4x4<f32>;

@vertex
fn draw(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4<f32> {
    return clip_from_object * vec4<f32>(bitcast<vec3<f32>>(pick(vertex)), 1.0);
}

@fragment
fn shade(@builtin(position) position: vec4<f32>) -> @location(0) u32 {
    return bitcast<u32>(position.z);
}
