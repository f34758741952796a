// Which clusters of a DAG a view draws. Twin: crates/kiln-runtime/src/clusters.rs
//
// Three passes, so that the list is in ascending order whatever the device does when:
//     select_clusters   one invocation a cluster: whether it is drawn; a workgroup counts its own
//     scan_clusters     one workgroup: where the list of each workgroup begins; how much is drawn
//     list_clusters     one invocation a cluster: its number to its place in the list
// A group is above what is allowed if it is a root (greatest finite error), or
//     by error   error > allowed
//     by view    scale error > near and |centre - eye|^2 < (scale error + radius)^2
// A cluster is drawn if its group is above and the one that made it is not. Only where both sides of a comparison agree to the last
// bits may a device that fuses products and sums decide otherwise than the twin.
//
// Reads:  `pass_`     what is wanted
//         `clusters`  [clusters]: the container's records
//         `groups`    [groups]: likewise
// Writes: `flags`     [clusters]: 1 if drawn
//         `counts`    [workgroups]: how many of 256 clusters are drawn; then where they begin in the list
//         `list`      [clusters]: numbers of the drawn clusters
//         `arguments` x, y, z: workgroups of an indirect mesh draw, one a cluster, cluster y * 65535 + x of the list; how many are drawn;
//                     vertices (384), instances (one a cluster), first vertex, first instance: an indirect draw that pulls its vertices

struct Pass {
    eye: vec3<f32>,
    scale: f32,
    allowed: f32,  // by view: the near distance
    by_view: u32,
    clusters: u32, // of `clusters`
    groups: u32,   // of `groups`
}

struct Cluster {
    first_reference: u32,
    vertex_count: u32,
    first_triangle: u32,
    triangle_count: u32,
    submesh: u32,
    group: u32,
    made_by: u32,
    level: u32,
    sphere: vec4<f32>,
    cone: vec4<f32>,
}

struct Group {
    sphere: vec4<f32>,
    error: f32,
    first_cluster: u32,
    cluster_count: u32,
    level: u32,
}

const NONE: u32 = 0xffffffffu;
const ROOT: u32 = 0x7f7fffffu; // bits of the greatest finite number
const SIZE: u32 = 256u;

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> clusters: array<Cluster>;
@group(0) @binding(2) var<storage, read> groups: array<Group>;
@group(0) @binding(3) var<storage, read_write> flags: array<u32>;
@group(0) @binding(4) var<storage, read_write> counts: array<u32>;

var<workgroup> drawn_here: atomic<u32>;

fn is_above(group: u32) -> bool {
    let error = groups[group].error;
    if bitcast<u32>(error) == ROOT {
        return true;
    }
    if pass_.by_view == 0u {
        return error > pass_.allowed;
    }
    let sphere = groups[group].sphere;
    let way = sphere.xyz - pass_.eye;
    let shows = pass_.scale * error;
    let reach = shows + sphere.w;
    return shows > pass_.allowed && way.x * way.x + way.y * way.y + way.z * way.z < reach * reach;
}

fn is_drawn(number: u32) -> bool {
    if number >= pass_.clusters {
        return false;
    }
    let group = clusters[number].group;
    let made_by = clusters[number].made_by;
    if group >= pass_.groups || !is_above(group) {
        return false;
    }
    return made_by == NONE || (made_by < pass_.groups && !is_above(made_by));
}

@compute @workgroup_size(256)
fn select_clusters(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
    @builtin(workgroup_id) workgroup: vec3<u32>,
) {
    let drawn = select(0u, 1u, is_drawn(id.x));
    if id.x < pass_.clusters {
        flags[id.x] = drawn;
    }
    atomicAdd(&drawn_here, drawn);
    workgroupBarrier();
    if local == 0u {
        counts[workgroup.x] = atomicLoad(&drawn_here);
    }
}

@group(0) @binding(0) var<storage, read_write> starts: array<u32>;
@group(0) @binding(1) var<storage, read_write> arguments: array<u32>;

var<workgroup> sums: array<u32, 256>;

// Sums of the values of all invocations up to this one.
fn scanned(local: u32, value: u32) -> u32 {
    sums[local] = value;
    workgroupBarrier();
    for (var step = 1u; step < SIZE; step = 2u * step) {
        var before = 0u;
        if local >= step {
            before = sums[local - step];
        }
        workgroupBarrier();
        sums[local] = sums[local] + before;
        workgroupBarrier();
    }
    return sums[local];
}

@compute @workgroup_size(256)
fn scan_clusters(@builtin(local_invocation_index) local: u32) {
    // Each invocation has a stretch of workgroups.
    let count = arrayLength(&starts);
    let stretch = (count + SIZE - 1u) / SIZE;
    let begin = min(local * stretch, count);
    let end = min(begin + stretch, count);
    var own = 0u;
    for (var i = begin; i < end; i++) {
        own += starts[i];
    }
    let upto = scanned(local, own);
    var start = upto - own;
    for (var i = begin; i < end; i++) {
        let here = starts[i];
        starts[i] = start;
        start += here;
    }
    if local == SIZE - 1u {
        arguments[0] = min(upto, 65535u);
        arguments[1] = (upto + 65534u) / 65535u;
        arguments[2] = 1u;
        arguments[3] = upto;
        arguments[4] = 384u;
        arguments[5] = upto;
        arguments[6] = 0u;
        arguments[7] = 0u;
    }
}

@group(0) @binding(0) var<storage, read> drawn_flags: array<u32>;
@group(0) @binding(1) var<storage, read> list_starts: array<u32>;
@group(0) @binding(2) var<storage, read_write> list: array<u32>;

@compute @workgroup_size(256)
fn list_clusters(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
    @builtin(workgroup_id) workgroup: vec3<u32>,
) {
    var drawn = 0u;
    if id.x < arrayLength(&drawn_flags) {
        drawn = drawn_flags[id.x];
    }
    let upto = scanned(local, drawn);
    if drawn == 1u {
        list[list_starts[workgroup.x] + upto - 1u] = id.x;
    }
}
