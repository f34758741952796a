// The triangles alive at a threshold, in their order. Twin: crates/kiln-runtime/src/tree/draw_list.rs
//
// A triangle is alive if its death, the rank of the node at which two of its corners meet, is below the threshold. Four dispatches:
//     count      a workgroup a block of 256 triangles: how many of it are alive
//     scan       one workgroup: how many are alive before each block, and in all
//     scatter    a workgroup a block: the living triangles' indices to their places
//     arguments  an invocation a draw range: the arguments of its indexed indirect draw
// Nothing depends on the order in which invocations run.
//
// Reads:  `pass_`      the pass's numbers
//         `deaths`     [triangles]
//         `triangles`  [triangles] x 3 indices
//         `ranges`     [ranges] first triangle, triangles
// Writes: `sums`       [blocks + 1]
//         `indices`    [alive triangles] x 3
//         `arguments_` [ranges] x 5: indices, instances, first index, base vertex, first instance

struct Pass {
    triangles: u32,
    threshold: u32,
    blocks: u32,
    ranges: u32,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> deaths: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read> triangles: array<u32>;
@group(0) @binding(4) var<storage, read_write> indices: array<u32>;
@group(0) @binding(5) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> arguments_: array<u32>;

const LANES: u32 = 256u;

var<workgroup> partial: array<u32, 256>;

fn alive(triangle: u32) -> u32 {
    if triangle >= pass_.triangles {
        return 0u;
    }
    return u32(deaths[triangle] < pass_.threshold);
}

// How much the lanes before this one have, and this one.
fn before(lane: u32, own: u32) -> u32 {
    partial[lane] = own;
    workgroupBarrier();
    for (var step = 1u; step < LANES; step *= 2u) {
        var other = 0u;
        if lane >= step {
            other = partial[lane - step];
        }
        workgroupBarrier();
        partial[lane] += other;
        workgroupBarrier();
    }
    return partial[lane] - own;
}

@compute @workgroup_size(256)
fn count(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>,
         @builtin(num_workgroups) groups: vec3<u32>) {
    let block = group.y * groups.x + group.x;
    let own = alive(block * LANES + lane);
    let sum = before(lane, own) + own;
    if lane == LANES - 1u && block < pass_.blocks {
        sums[block] = sum;
    }
}

@compute @workgroup_size(256)
fn scan(@builtin(local_invocation_index) lane: u32) {
    let span = (pass_.blocks + LANES - 1u) / LANES;
    let first = min(lane * span, pass_.blocks);
    let end = min(first + span, pass_.blocks);
    var own = 0u;
    for (var block = first; block < end; block++) {
        own += sums[block];
    }
    var sum = before(lane, own);
    for (var block = first; block < end; block++) {
        let here = sums[block];
        sums[block] = sum;
        sum += here;
    }
    if lane == LANES - 1u {
        sums[pass_.blocks] = sum;
    }
}

@compute @workgroup_size(256)
fn scatter(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>,
           @builtin(num_workgroups) groups: vec3<u32>) {
    let block = group.y * groups.x + group.x;
    let triangle = block * LANES + lane;
    let own = alive(triangle);
    let place = before(lane, own);
    if own == 1u {
        let at = 3u * (sums[block] + place);
        indices[at] = triangles[3u * triangle];
        indices[at + 1u] = triangles[3u * triangle + 1u];
        indices[at + 2u] = triangles[3u * triangle + 2u];
    }
}

// Living triangles before this one.
fn living_before(triangle: u32) -> u32 {
    let end = min(triangle, pass_.triangles);
    let block = end / LANES;
    var sum = sums[block];
    for (var i = block * LANES; i < end; i++) {
        sum += alive(i);
    }
    return sum;
}

@compute @workgroup_size(64)
fn arguments(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= pass_.ranges {
        return;
    }
    let range = ranges[id.x];
    let first = living_before(range.x);
    let end = living_before(range.x + range.y);
    arguments_[5u * id.x] = 3u * (end - first);
    arguments_[5u * id.x + 1u] = 1u;
    arguments_[5u * id.x + 2u] = 3u * first;
    arguments_[5u * id.x + 3u] = 0u;
    arguments_[5u * id.x + 4u] = 0u;
}
