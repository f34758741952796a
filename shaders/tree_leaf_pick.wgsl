// What vertices pick in tree and leaf buffers. Twin: crates/kiln-runtime/src/tree/tree_leaf.rs
//
// One invocation of `fill` gives one vertex its position at r = row + fraction: that of its shallowest ancestor whose r_level is above
// r, or its own. Three reads at most. Positions are copied as bits; the only floats that are looked at are q and the pointer.
// `pick` is for vertex shaders too: shaders/tree_draw.wgsl goes behind this text.
//
// Reads:  `pass_`  the pass's numbers
//         `tree`   [width * rows * blocks] bits of x, y, z, q
//         `leaf`   [vertices] bits of x, y, z and of the number of the terminal node's texel, an exact integer
// Writes: `places` [vertices] x `floats`: x, y, z, and 1 if there are four

struct Pass {
    first: u32,         // vertex
    count: u32,
    floats: u32,        // of a place: 3 or 4
    row: u32,           // of r
    fraction: f32,      // of r, in [0, 1)
    width: u32,         // texels of a row
    rows: u32,
    pad: u32,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> tree: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> leaf: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read_write> places: array<u32>;

// Bits of a vertex' position.
fn pick(vertex: u32) -> vec3<u32> {
    let own = leaf[vertex];
    let pointer = u32(bitcast<f32>(own.w));
    let terminal_row = pointer / pass_.width % pass_.rows;
    if terminal_row < pass_.row {
        return own.xyz;
    }
    let texel = pointer - (terminal_row - pass_.row) * pass_.width;
    let node = tree[texel];
    if bitcast<f32>(node.w) > pass_.fraction {
        return node.xyz;
    }
    if terminal_row == pass_.row {
        return own.xyz;
    }
    return tree[texel + pass_.width].xyz;
}

@compute @workgroup_size(256)
fn fill(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = id.y * groups.x * 256u + id.x;
    if i >= pass_.count {
        return;
    }
    let vertex = pass_.first + i;
    let place = pick(vertex);
    let at = vertex * pass_.floats;
    places[at] = place.x;
    places[at + 1u] = place.y;
    places[at + 2u] = place.z;
    if pass_.floats == 4u {
        places[at + 3u] = bitcast<u32>(1.0);
    }
}
