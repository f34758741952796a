// What collapses change on the screens. Twin: crates/kiln-lod/src/simplify/viewpoint/price.rs
//
// One workgroup prices one candidate collapse in one view: which regions win and lose how many pixels there. One invocation takes every
// 64th pixel of the box of the candidate's star:
//     shown <- the nearest fragment; where it is one of the star's, the nearest of another face
//     each face as it would be after the collapse, in order: where its fragment hides `shown`, it takes its place
// Pixels that go from one region to another are counted by integer atomics, so counts are those of the twin, whatever the order.
//
// Rules of rasterisation, all in whole numbers (x and y in 1/256 pixel, y down; what each quantity may be at most: screen.rs):
//     pixel (i, j) is covered where its centre (256 i + 128, 256 j + 128) lies in the face, by the top-left rule, whichever way it faces
//     edge function of an edge from p to q: E(c) = (q - p).x (c - p).y - (q - p).y (c - p).x, below 2^47; inside where E > 0, or E = 0 on a
//         top or a left edge, once the corners are in the order that makes the area A = E_0 + E_1 + E_2 positive; A = 0 covers nothing
//     corner 0 is the one at the lowest point id; share of corner i = 1, 2: s_i = E_i floor(2^62 / A) >> 32, of 2^30
//     value = value_0 + (s_1 (value_1 - value_0) + s_2 (value_2 - value_0) >> 30)            depth, u, v; >> rounds down
//     u, v where rays meet: weights s >> 14 times -depth >> 10, quotients rounded down
//     a fragment hides another if its (depth, face) is less
// A candidate whose star has too large a box for one workgroup is skipped.
// 64 bits are pairs of 32: x the low half, y the high one.
//
// Reads:  `pass`      the pass's numbers
//         `places`    [point_count x views] x 3: x, y, depth
//         `texels`    [vertex_count] x 2: u, v, 1/256 texel
//         `maps`      [map_count] x 8: region or NONE, first id, width, height, wrap u, wrap v, 0, 0; then region ids of all pictures
//         `heads`     [views x pixels + 1]: where a pixel's fragments begin; they end where the next one's begin
//         `fragments` nearest first, x 3: depth, face, region
//         `batch`     [candidates] x 8: where the star begins, its faces, `from`, where the changed faces begin, their number, 0, 0, 0;
//                     star: x 3: face, its other points; changed faces: x 8: face, 3 points, 3 vertices, map or NONE
// Writes: `spans`     [candidates x views] x 2: first row, rows; SKIPPED rows if regions, rows or pixels were too many
//         `rows`      x 3: region, pixels it wins (signed), rank of its first touch in the twin's order

struct Pass {
    views: u32,
    size: u32,      // pixels across and down a view
    row_limit: u32, // room in `rows`
    meets: u32,     // first word of the bits in `batch` that say whether a view's rays meet
}

struct Rows {
    count: atomic<u32>,
    pad0: u32,
    pad1: u32,
    pad2: u32,
    values: array<u32>,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> places: array<i32>;
@group(0) @binding(2) var<storage, read> texels: array<vec2<i32>>;
@group(0) @binding(3) var<storage, read> maps: array<u32>;
@group(0) @binding(4) var<storage, read> heads: array<u32>;
@group(0) @binding(5) var<storage, read> fragments: array<u32>;
@group(0) @binding(6) var<storage, read> batch: array<u32>;
@group(0) @binding(7) var<storage, read_write> spans: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> rows: Rows;

const LANES: u32 = 64u;
const NONE: u32 = 0xffffffffu;
const SKIPPED: u32 = 0xffffffffu;
const NOWHERE: i32 = -2147483647 - 1;
const FARTHEST: i32 = 2147483647;
const FACES: u32 = 64u;      // most faces of a star
const SLOTS: u32 = 128u;     // most regions that a candidate touches in a view
// Turns of loops that an invocation may take before the candidate is skipped: a driver that runs on the CPU ends loops after 65535.
const TURNS: u32 = 32768u;
const FILLED: u32 = 0x10000000u; // ranks of what the changed faces touch lie behind all of the hole's

// --- 64 bits ---

fn unsigned_product(a: u32, b: u32) -> vec2<u32> {
    let a0 = a & 0xffffu;
    let a1 = a >> 16u;
    let b0 = b & 0xffffu;
    let b1 = b >> 16u;
    let low = a0 * b0;
    let cross_0 = a0 * b1;
    let cross_1 = a1 * b0;
    let middle = (low >> 16u) + (cross_0 & 0xffffu) + (cross_1 & 0xffffu);
    let high = a1 * b1 + (cross_0 >> 16u) + (cross_1 >> 16u) + (middle >> 16u);
    return vec2<u32>((low & 0xffffu) | (middle << 16u), high);
}

fn product(a: i32, b: i32) -> vec2<u32> {
    let r = unsigned_product(bitcast<u32>(a), bitcast<u32>(b));
    return vec2<u32>(r.x, r.y - select(0u, bitcast<u32>(b), a < 0) - select(0u, bitcast<u32>(a), b < 0));
}

fn sum(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.x + b.x;
    return vec2<u32>(low, a.y + b.y + select(0u, 1u, low < a.x));
}

fn difference(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return vec2<u32>(a.x - b.x, a.y - b.y - select(0u, 1u, a.x < b.x));
}

fn negative(a: vec2<u32>) -> bool {
    return (a.y >> 31u) != 0u;
}

fn less(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.y < b.y || (a.y == b.y && a.x < b.x);
}

// `n d`, d of 33 bits at most, the product of 64.
fn long_product(n: u32, d: vec2<u32>) -> vec2<u32> {
    let r = unsigned_product(n, d.x);
    return vec2<u32>(r.x, r.y + n * d.y);
}

// A number not above floor(n / d), short of it by 2^-19 of it and 1 at most: the factor is wider than the errors of single precision.
fn too_small(n: vec2<u32>, d: vec2<u32>) -> u32 {
    let ratio = (f32(n.y) * 4294967296.0 + f32(n.x)) / (f32(d.y) * 4294967296.0 + f32(d.x));
    return u32(ratio * 0.999999);
}

// floor(n / d) of numbers without sign, below 2^31; d of 33 bits at most. Exact: the rests are whole numbers.
fn quotient(n: vec2<u32>, d: vec2<u32>) -> u32 {
    var q = too_small(n, d);
    var rest = difference(n, long_product(q, d));
    let more = too_small(rest, d);
    q += more;
    rest = difference(rest, long_product(more, d));
    for (var i = 0u; i < 4u && !less(rest, d); i++) {
        rest = difference(rest, d);
        q++;
    }
    return q;
}

// floor(2^62 / d), d in [1, 2^62): the first bits of the quotient are 0.
fn inverse(d: vec2<u32>) -> vec2<u32> {
    let length = select(32u - countLeadingZeros(d.x), 64u - countLeadingZeros(d.y), d.y != 0u);
    // 2^(length - 1) is at most d: what is left of 2^62 after as many bits.
    let top = length - 1u;
    var rest = select(vec2<u32>(1u << (top & 31u), 0u), vec2<u32>(0u, 1u << (top & 31u)), top >= 32u);
    var q = vec2<u32>(0u, 0u);
    if !less(rest, d) {
        rest = vec2<u32>(0u, 0u);
        q.x = 1u;
    }
    for (var i = top; i < 62u; i++) {
        rest = vec2<u32>(rest.x << 1u, (rest.y << 1u) | (rest.x >> 31u));
        q = vec2<u32>(q.x << 1u, (q.y << 1u) | (q.x >> 31u));
        if !less(rest, d) {
            rest = difference(rest, d);
            q.x |= 1u;
        }
    }
    return q;
}

// --- a face on the screen ---

struct Shape {
    low: vec2<i32>,            // pixels that it may cover, the last ones in them; none if it covers nothing
    high: vec2<i32>,
    origin: array<vec2<i32>, 2>, // of the edges against corners 1 and 2
    edge: array<vec2<i32>, 2>,
    owns: vec3<u32>,           // whether the edge against a corner owns its points
    face: u32,
    depth: vec3<i32>,
    map: u32,
    vertices: vec3<u32>,
    area: vec2<u32>,
    scale: vec2<u32>,
}

var<workgroup> shapes: array<Shape, FACES>;

fn place(point: u32, view: u32) -> vec3<i32> {
    let at = (point * pass_.views + view) * 3u;
    return vec3<i32>(places[at], places[at + 1u], places[at + 2u]);
}

fn edge_value(edge: vec2<i32>, origin: vec2<i32>, centre: vec2<i32>) -> vec2<u32> {
    let d = centre - origin;
    return difference(product(edge.x, d.y), product(edge.y, d.x));
}

fn owner(edge: vec2<i32>) -> u32 {
    return select(0u, 1u, edge.y < 0 || (edge.y == 0 && edge.x > 0));
}

// First pixel whose centre lies at or behind `low`, last one at or before `high`, on the screen.
fn first_centre(low: vec2<i32>) -> vec2<i32> {
    return max((max(low, vec2<i32>(-16777216)) + 127) >> vec2<u32>(8u), vec2<i32>(0));
}
fn last_centre(high: vec2<i32>) -> vec2<i32> {
    return min((max(high, vec2<i32>(-16777216)) - 128) >> vec2<u32>(8u), vec2<i32>(i32(pass_.size) - 1));
}

// The changed face that stands at `at` in `batch`.
fn shape_of(at: u32, view: u32) -> Shape {
    var points = vec3<u32>(batch[at + 1u], batch[at + 2u], batch[at + 3u]);
    var vertices = vec3<u32>(batch[at + 4u], batch[at + 5u], batch[at + 6u]);
    if !(points.x < points.y && points.x < points.z) {
        if points.y < points.z {
            points = points.yzx;
            vertices = vertices.yzx;
        } else {
            points = points.zxy;
            vertices = vertices.zxy;
        }
    }
    let a = place(points.x, view);
    let b = place(points.y, view);
    let c = place(points.z, view);
    var shape: Shape;
    shape.low = vec2<i32>(0);
    shape.high = vec2<i32>(-1);
    shape.face = batch[at];
    shape.map = batch[at + 7u];
    shape.vertices = vertices;
    shape.depth = vec3<i32>(a.z, b.z, c.z);
    if a.x == NOWHERE || b.x == NOWHERE || c.x == NOWHERE {
        return shape;
    }
    // Edges against the corners run from the next corner to the one after.
    var edge_0 = c.xy - b.xy;
    var edge_1 = a.xy - c.xy;
    var edge_2 = b.xy - a.xy;
    var area = difference(product(edge_2.x, c.y - a.y), product(edge_2.y, c.x - a.x));
    if area.x == 0u && area.y == 0u {
        return shape;
    }
    if negative(area) {
        area = difference(vec2<u32>(0u), area);
        edge_0 = -edge_0;
        edge_1 = -edge_1;
        edge_2 = -edge_2;
    }
    shape.low = first_centre(min(min(a.xy, b.xy), c.xy));
    shape.high = last_centre(max(max(a.xy, b.xy), c.xy));
    shape.origin[0] = a.xy;
    shape.origin[1] = a.xy;
    shape.edge[0] = edge_1;
    shape.edge[1] = edge_2;
    shape.owns = vec3<u32>(owner(edge_0), owner(edge_1), owner(edge_2));
    shape.area = area;
    if all(shape.low <= shape.high) {
        shape.scale = inverse(area);
    }
    return shape;
}

fn outside(weight: vec2<u32>, owns: u32) -> bool {
    return negative(weight) || (owns == 0u && weight.x == 0u && weight.y == 0u);
}

fn share(weight: vec2<u32>, scale: vec2<u32>) -> i32 {
    let low = unsigned_product(weight.x, scale.x);
    return i32(low.y + weight.x * scale.y + weight.y * scale.x);
}

fn between(values: vec3<i32>, shares: vec2<i32>) -> i32 {
    let r = sum(product(shares.x, values.y - values.x), product(shares.y, values.z - values.x));
    return values.x + bitcast<i32>((r.y << 2u) | (r.x >> 30u));
}

// `n d` of a number of 33 bits without sign and one of 31 with it.
fn signed_product(n: vec2<u32>, d: i32) -> vec2<u32> {
    let r = long_product(u32(abs(d)), n);
    if d < 0 {
        return difference(vec2<u32>(0u), r);
    }
    return r;
}

// floor(n / d), n with a sign.
fn floor_quotient(n: vec2<u32>, d: vec2<u32>) -> i32 {
    if !negative(n) {
        return bitcast<i32>(quotient(n, d));
    }
    let up = sum(difference(vec2<u32>(0u), n), difference(d, vec2<u32>(1u, 0u)));
    return -bitcast<i32>(quotient(up, d));
}

// u or v where rays meet.
fn between_meeting(values: vec3<i32>, depth: vec3<i32>, shares: vec2<i32>) -> i32 {
    let near = vec3<u32>((-depth) >> vec3<u32>(10u));
    let weights = vec3<u32>(vec3<i32>(1073741824 - shares.x - shares.y, shares.x, shares.y) >> vec3<u32>(14u));
    let a = unsigned_product(weights.x, near.x);
    let b = unsigned_product(weights.y, near.y);
    let c = unsigned_product(weights.z, near.z);
    var whole = sum(a, sum(b, c));
    if whole.x == 0u && whole.y == 0u {
        whole.x = 1u;
    }
    let n = sum(signed_product(b, values.y - values.x), signed_product(c, values.z - values.x));
    return values.x + floor_quotient(n, whole);
}

fn remainder(at: i32, side: i32) -> i32 {
    let r = at % side;
    return select(r, r + side, r < 0);
}

// Wrap modes: 0 repeats, 1 clamps, 2 mirrors.
fn wrapped(at: i32, side: i32, wrap: u32) -> i32 {
    if wrap == 0u {
        return remainder(at, side);
    }
    if wrap == 1u {
        return clamp(at, 0, side - 1);
    }
    let twice = remainder(at, 2 * side);
    return min(twice, 2 * side - 1 - twice);
}

// What the face shows where corners 1 and 2 have these shares.
fn region_of(f: u32, shares: vec2<i32>, meets: bool) -> u32 {
    let map = shapes[f].map;
    if map == NONE {
        return shapes[f].face + 1u;
    }
    let whole = maps[map * 8u];
    if whole != NONE {
        return whole;
    }
    let vertices = shapes[f].vertices;
    let a = texels[vertices.x];
    let b = texels[vertices.y];
    let c = texels[vertices.z];
    var uv: vec2<i32>;
    if meets {
        let depth = shapes[f].depth;
        uv = vec2<i32>(
            between_meeting(vec3<i32>(a.x, b.x, c.x), depth, shares),
            between_meeting(vec3<i32>(a.y, b.y, c.y), depth, shares),
        );
    } else {
        uv = vec2<i32>(between(vec3<i32>(a.x, b.x, c.x), shares), between(vec3<i32>(a.y, b.y, c.y), shares));
    }
    let width = maps[map * 8u + 2u];
    let column = wrapped(uv.x >> 8u, i32(width), maps[map * 8u + 4u]);
    let row = wrapped(uv.y >> 8u, i32(maps[map * 8u + 3u]), maps[map * 8u + 5u]);
    return maps[maps[map * 8u + 1u] + u32(row) * width + u32(column)];
}

// --- pixels won and lost by region ---

var<workgroup> keys: array<atomic<u32>, SLOTS>;          // region + 1
var<workgroup> opened: array<atomic<i32>, SLOTS>;        // pixels won by the hole
var<workgroup> won: array<atomic<i32>, SLOTS>;           // and by the changed faces
var<workgroup> opened_first: array<atomic<u32>, SLOTS>;  // ranks of the first touches
var<workgroup> won_first: array<atomic<u32>, SLOTS>;
var<workgroup> seen: atomic<u32>;                        // whether a pixel may show the star
var<workgroup> full: atomic<u32>;
var<workgroup> found: atomic<u32>;
var<workgroup> written: atomic<u32>;
var<workgroup> base: u32;
var<private> turns: u32;

fn slot_of(region: u32) -> u32 {
    var slot = (region * 2654435761u) >> 25u;
    for (var tries = 0u; tries < SLOTS; tries++) {
        turns++;
        let key = atomicLoad(&keys[slot]);
        if key == region + 1u {
            return slot;
        }
        if key == 0u {
            let r = atomicCompareExchangeWeak(&keys[slot], 0u, region + 1u);
            if r.exchanged || r.old_value == region + 1u {
                return slot;
            }
            // The exchange may fail for no reason: the same slot again.
            if r.old_value == 0u {
                continue;
            }
        }
        slot = (slot + 1u) % SLOTS;
    }
    atomicStore(&full, 1u);
    return NONE;
}

fn pass_hole(before: u32, after: u32, rank: u32) {
    if before == after {
        return;
    }
    let lost = slot_of(before);
    let gained = slot_of(after);
    if lost == NONE || gained == NONE {
        return;
    }
    atomicSub(&opened[lost], 1);
    atomicAdd(&opened[gained], 1);
    atomicMin(&opened_first[lost], rank);
    atomicMin(&opened_first[gained], rank + 1u);
}

fn pass_changed(before: u32, after: u32, rank: u32) {
    if before == after {
        return;
    }
    let lost = slot_of(before);
    let gained = slot_of(after);
    if lost == NONE || gained == NONE {
        return;
    }
    atomicSub(&won[lost], 1);
    atomicAdd(&won[gained], 1);
    atomicMin(&won_first[lost], FILLED + rank);
    atomicMin(&won_first[gained], FILLED + rank + 1u);
}

// --- the pass ---

// Which face of the star it is; NONE if it is none.
fn in_star(face: u32, star: u32, count: u32) -> u32 {
    for (var i = 0u; i < count; i++) {
        turns++;
        if batch[star + 3u * i] == face {
            return i;
        }
    }
    return NONE;
}

@compute @workgroup_size(64)
fn price(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let view = group.x;
    let candidate = group.y * 8u;
    let star = batch[candidate];
    let star_faces = batch[candidate + 1u];
    let changed = batch[candidate + 3u];
    let changed_faces = batch[candidate + 4u];
    let meets = ((batch[pass_.meets + (view >> 5u)] >> (view & 31u)) & 1u) != 0u;

    // The box of the star, before and after, and its least depth.
    let kept = place(batch[candidate + 2u], view);
    var low = kept.xy;
    var high = kept.xy;
    var near = kept.z;
    for (var i = 0u; i < star_faces; i++) {
        for (var k = 1u; k < 3u; k++) {
            let p = place(batch[star + 3u * i + k], view);
            low = min(low, p.xy);
            high = max(high, p.xy);
            near = min(near, p.z);
        }
    }
    low = first_centre(low);
    high = last_centre(high);
    var width = 0u;
    var pixels = 0u;
    if all(low <= high) && star_faces > 0u {
        width = u32(high.x - low.x + 1);
        pixels = width * u32(high.y - low.y + 1);
    }
    for (var slot = lane; slot < SLOTS; slot += LANES) {
        atomicStore(&keys[slot], 0u);
        atomicStore(&opened[slot], 0);
        atomicStore(&won[slot], 0);
        atomicStore(&opened_first[slot], NONE);
        atomicStore(&won_first[slot], NONE);
    }
    if lane == 0u {
        atomicStore(&seen, 0u);
        atomicStore(&full, 0u);
        atomicStore(&found, 0u);
        atomicStore(&written, 0u);
    }
    workgroupBarrier();
    // Most stars are hidden in half of the views.
    turns = 0u;
    for (var i = lane; i < pixels; i += LANES) {
        turns++;
        let at = (view * pass_.size + u32(low.y) + i / width) * pass_.size + u32(low.x) + i % width;
        let first = heads[at];
        if first == heads[at + 1u] || bitcast<i32>(fragments[3u * first]) >= near {
            atomicStore(&seen, 1u);
            break;
        }
    }
    workgroupBarrier();
    if atomicLoad(&seen) == 0u {
        pixels = 0u;
    } else if lane < changed_faces {
        shapes[lane] = shape_of(changed + 8u * lane, view);
    }
    workgroupBarrier();

    for (var i = lane; i < pixels; i += LANES) {
        turns++;
        if turns > TURNS {
            atomicStore(&full, 1u);
            break;
        }
        let pixel = vec2<i32>(low.x + i32(i % width), low.y + i32(i / width));
        let at = (view * pass_.size + u32(pixel.y)) * pass_.size + u32(pixel.x);
        let first = heads[at];
        let end = heads[at + 1u];
        var depth = FARTHEST;
        var face = NONE;
        var region = 0u;
        if first < end {
            depth = bitcast<i32>(fragments[3u * first]);
            face = fragments[3u * first + 1u];
            region = fragments[3u * first + 2u];
        }
        // Nothing of the star lies before `near`.
        if depth < near {
            continue;
        }
        let mine = in_star(face, star, star_faces);
        if mine != NONE {
            let before = region;
            depth = FARTHEST;
            face = NONE;
            region = 0u;
            for (var next = first + 1u; next < end; next++) {
                turns++;
                if in_star(fragments[3u * next + 1u], star, star_faces) == NONE {
                    depth = bitcast<i32>(fragments[3u * next]);
                    face = fragments[3u * next + 1u];
                    region = fragments[3u * next + 2u];
                    break;
                }
            }
            pass_hole(before, region, ((mine << 20u) + i) * 2u);
        }
        let middle = pixel * 256 + 128;
        for (var f = 0u; f < changed_faces; f++) {
            turns += 5u; // with those of a quotient
            if any(pixel < shapes[f].low) || any(pixel > shapes[f].high) {
                continue;
            }
            let w1 = edge_value(shapes[f].edge[0], shapes[f].origin[0], middle);
            let w2 = edge_value(shapes[f].edge[1], shapes[f].origin[1], middle);
            let owns = shapes[f].owns;
            let w0 = difference(difference(shapes[f].area, w1), w2);
            if outside(w1, owns.y) || outside(w2, owns.z) || outside(w0, owns.x) {
                continue;
            }
            let shares = vec2<i32>(share(w1, shapes[f].scale), share(w2, shapes[f].scale));
            let its_depth = between(shapes[f].depth, shares);
            let its_face = shapes[f].face;
            if its_depth < depth || (its_depth == depth && its_face < face) {
                let its_region = region_of(f, shares, meets);
                pass_changed(region, its_region, ((f << 20u) + i) * 2u);
                depth = its_depth;
                face = its_face;
                region = its_region;
            }
        }
    }
    workgroupBarrier();

    for (var slot = lane; slot < SLOTS; slot += LANES) {
        if atomicLoad(&opened[slot]) + atomicLoad(&won[slot]) != 0 {
            atomicAdd(&found, 1u);
        }
    }
    workgroupBarrier();
    if lane == 0u {
        let count = atomicLoad(&found);
        var span = vec2<u32>(0u, count);
        if count > 0u {
            span.x = atomicAdd(&rows.count, count);
        }
        if atomicLoad(&full) != 0u || span.x + count > pass_.row_limit {
            span = vec2<u32>(0u, SKIPPED);
        }
        spans[group.y * pass_.views + view] = span;
        base = select(span.x, NONE, span.y == SKIPPED);
    }
    workgroupBarrier();
    if base != NONE {
        for (var slot = lane; slot < SLOTS; slot += LANES) {
            let hole = atomicLoad(&opened[slot]);
            let count = hole + atomicLoad(&won[slot]);
            if count != 0 {
                let row = 3u * (base + atomicAdd(&written, 1u));
                rows.values[row] = atomicLoad(&keys[slot]) - 1u;
                rows.values[row + 1u] = bitcast<u32>(count);
                rows.values[row + 2u] = select(atomicLoad(&won_first[slot]), atomicLoad(&opened_first[slot]), hole != 0);
            }
        }
    }
}
