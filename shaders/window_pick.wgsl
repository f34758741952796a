// A LOD of a sliding window: vertex buffer, index buffer, draw arguments. Twin: crates/kiln-runtime/src/window/pick.rs
//
// Three passes. `alive` is v(d), the vertices that are alive at LOD d.
// `pick_elements`   one invocation a vertex: copies the element of the vertex that it picks, `words` words each
// `draw_arguments`  one invocation a submesh: how many of its triangles are drawn; they stand first, so it bisects
// `pick_indices`    one invocation a triangle that is drawn: its corners' picks, in the triangle's own place
//
// pick(i): while i >= alive: i = parents[i]. A parent that does not come first ends the walk, so every loop ends whatever is read.
// A triangle is drawn if its corners pick three points; vertices are of one point if no bit of `starts` behind the first and up to the
// second is set, or, without `starts`, if they are the same.
//
// Reads:  `pass_`     the pass's numbers
//         `parents`   [vertices]: where each vertex goes
//         `starts`    [vertices / 32]: bit v % 32 of word v / 32: vertex v is the first of its point; not read unless `has_starts`
//         `indices`   [3 x triangles] of level 0
//         `ranges`    [submeshes] x 2: first index, indices; ascending
//         `source`    [vertices x words]
//         `counts`    what `draw_arguments` wrote
// Writes: `draws`     [submeshes] x 5: indices, instances (1), first index, base vertex (0), first instance (0)
//         `picked`    [vertices x words], or [3 x triangles]

struct Pass {
    alive: u32,
    vertices: u32,
    // Of an element; or triangles of level 0.
    words: u32,
    // Submeshes; with the highest bit if `starts` is there.
    submeshes: u32,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> parents: array<u32>;

// pick_elements
@group(0) @binding(2) var<storage, read> source: array<u32>;
@group(0) @binding(3) var<storage, read_write> picked_elements: array<u32>;

// draw_arguments, pick_indices
@group(0) @binding(2) var<storage, read> indices: array<u32>;
@group(0) @binding(3) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> starts: array<u32>;
@group(0) @binding(5) var<storage, read_write> draws: array<u32>;

// pick_indices
@group(0) @binding(4) var<storage, read> counts: array<u32>;
@group(0) @binding(5) var<storage, read_write> picked_indices: array<u32>;

const LANES: u32 = 64u;
const HAS_STARTS: u32 = 0x80000000u;

fn pick(vertex: u32) -> u32 {
    var i = vertex;
    while (i >= pass_.alive && i < pass_.vertices) {
        let parent = parents[i];
        if (parent >= i) {
            break;
        }
        i = parent;
    }
    return i;
}

// Number of the invocation where the groups of a dispatch stand in rows.
fn number(id: vec3<u32>, groups: vec3<u32>) -> u32 {
    return id.y * groups.x * LANES + id.x;
}

@compute @workgroup_size(LANES)
fn pick_elements(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let vertex = number(id, groups);
    if (vertex >= pass_.vertices) {
        return;
    }
    let source_word = pick(vertex) * pass_.words;
    let picked_word = vertex * pass_.words;
    for (var word = 0u; word < pass_.words; word++) {
        picked_elements[picked_word + word] = source[source_word + word];
    }
}

fn is_one_point(a: u32, b: u32) -> bool {
    let low = min(a, b);
    let high = max(a, b);
    if (low == high || (pass_.submeshes & HAS_STARTS) == 0u) {
        return low == high;
    }
    let first = low + 1u;
    for (var word = first / 32u; word <= high / 32u; word++) {
        var bits = starts[word];
        if (word == first / 32u) {
            bits &= 0xffffffffu << (first % 32u);
        }
        if (word == high / 32u) {
            bits &= 0xffffffffu >> (31u - high % 32u);
        }
        if (bits != 0u) {
            return false;
        }
    }
    return true;
}

@compute @workgroup_size(LANES)
fn draw_arguments(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let submesh = number(id, groups);
    if (submesh >= (pass_.submeshes & ~HAS_STARTS)) {
        return;
    }
    let range = ranges[submesh];
    var low = 0u;
    var high = range.y / 3u;
    while (low < high) {
        let middle = low + (high - low) / 2u;
        let corner = range.x + 3u * middle;
        let a = pick(indices[corner]);
        let b = pick(indices[corner + 1u]);
        let c = pick(indices[corner + 2u]);
        if (is_one_point(a, b) || is_one_point(b, c) || is_one_point(c, a)) {
            high = middle;
        } else {
            low = middle + 1u;
        }
    }
    draws[5u * submesh] = 3u * low;
    draws[5u * submesh + 1u] = 1u;
    draws[5u * submesh + 2u] = range.x;
    draws[5u * submesh + 3u] = 0u;
    draws[5u * submesh + 4u] = 0u;
}

@compute @workgroup_size(LANES)
fn pick_indices(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let triangle = number(id, groups);
    if (triangle >= pass_.words) {
        return;
    }
    // The last range that does not begin behind it; empty ranges begin where the next one does.
    let corner = 3u * triangle;
    var low = 0u;
    var high = pass_.submeshes & ~HAS_STARTS;
    while (high - low > 1u) {
        let middle = low + (high - low) / 2u;
        if (ranges[middle].x <= corner) {
            low = middle;
        } else {
            high = middle;
        }
    }
    if (corner - ranges[low].x >= counts[5u * low]) {
        return;
    }
    for (var k = 0u; k < 3u; k++) {
        picked_indices[corner + k] = pick(indices[corner + k]);
    }
}
