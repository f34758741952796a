// What vertices pick in a compact tree. Twin: crates/kiln-runtime/src/tree/compact.rs
//
// One invocation of `fill` gives one vertex its position at a threshold: that of the shallowest node of rank `threshold` or more over
// it, or its own, by a walk from its terminal node. Positions are copied as bits. A walk ends because ranks fall.
// `pick` is for vertex shaders too: shaders/tree_draw.wgsl goes behind this text.
//
// Reads:  `pass_`     the pass's numbers
//         `nodes`     [nodes] bits of x, y, z; rank of the parent
//         `terminals` [vertices] rank of the terminal node
//         `positions` [vertices] x 3: bits of level 0's positions
// Writes: `places`    [vertices] x `floats`: x, y, z, and 1 if there are four

struct Pass {
    first: u32,         // vertex
    count: u32,
    floats: u32,        // of a place: 3 or 4
    threshold: u32,
    nodes: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> nodes: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> terminals: array<u32>;
@group(0) @binding(3) var<storage, read> positions: array<u32>;
@group(0) @binding(4) var<storage, read_write> places: array<u32>;

// Bits of a vertex' position.
fn pick(vertex: u32) -> vec3<u32> {
    var rank = terminals[vertex];
    if rank < pass_.threshold || rank >= pass_.nodes {
        return vec3<u32>(positions[3u * vertex], positions[3u * vertex + 1u], positions[3u * vertex + 2u]);
    }
    var node = nodes[rank];
    while node.w >= pass_.threshold && node.w < rank {
        rank = node.w;
        node = nodes[rank];
    }
    return node.xyz;
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
