// The bake's hit pass. Twin: crates/kiln-bake/src/transfer/mirrored_vertex.rs
//
// One vertex invocation maps one corner of one high triangle into the texel space of one low triangle T (the affine map
// that sends T's corners to their texels, along T's normal) and gives the signed distance k from T's plane.
// One fragment invocation asks whether T owns the texel, and if so offers the high triangle with depth |k| / cage; the depth
// test (less; pairs come in ascending order of the high face) keeps the nearest one, in front of the plane or behind it.
//
// Reads:  `pass`    the pass's numbers
//         `points`  [high vertex_count] x 3 f32, object space
//         `corners` [high face_count] x 3 vertex indices
//         `frames`  [low face_count] affine maps (see Frame)
//         `pairs`   [pair_count] x (low face | FALLBACK, high face), sorted
//         `owners`  [size x size] low face + 1 that owns the texel, 0 = none
// Writes: colour 0  [size x size] R32Uint: high face + 1, 0 = no hit
//         depth     [size x size] half of |k| / cage, plus a half for pairs of different submeshes
//
// Nothing is clipped at k = 0, no winding is looked at (mirrored charts flip it) and high triangles that face away are not
// among the pairs. Corners are snapped to 1/256 texel, as the rasteriser of the twin does.

struct Pass {
    size: u32,          // texels across and down the sheet
    cage: f32,          // greatest |k|, object units
    pad0: u32,
    pad1: u32,
}

// x = dot(row_x.xyz, p - base.xyz) + base.w texels right of the origin, y likewise, k = dot(normal.xyz, p - base.xyz).
struct Frame {
    base: vec4<f32>,    // first corner of T in object space; w: its x, texels from the origin
    row_x: vec4<f32>,   // w: the first corner's y, texels from the origin
    row_y: vec4<f32>,   // w: origin x, whole texels
    normal: vec4<f32>,  // w: origin y, whole texels
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> corners: array<u32>;
@group(0) @binding(3) var<storage, read> frames: array<Frame>;
@group(0) @binding(4) var<storage, read> pairs: array<vec2<u32>>;
@group(0) @binding(5) var owners: texture_2d<u32>;

const FALLBACK: u32 = 0x80000000u;

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) k: f32,
    @location(1) @interpolate(flat) low: u32,
    @location(2) @interpolate(flat) high: u32,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    let pair = pairs[index / 3u];
    let frame = frames[pair.x & ~FALLBACK];
    let v = corners[pair.y * 3u + index % 3u] * 3u;
    let d = vec3<f32>(points[v], points[v + 1u], points[v + 2u]) - frame.base.xyz;
    let local = vec2<f32>(dot(frame.row_x.xyz, d) + frame.base.w, dot(frame.row_y.xyz, d) + frame.row_x.w);
    // Exact: a whole number of 256ths near the origin, moved by whole texels, scaled by a power of two where size is one.
    let texel = round(local * 256.0) / 256.0 + vec2<f32>(frame.row_y.w, frame.normal.w);
    let unit = texel * (2.0 / f32(pass_.size));
    return Corner(vec4<f32>(unit.x - 1.0, 1.0 - unit.y, 0.5, 1.0), dot(frame.normal.xyz, d), pair.x, pair.y);
}

struct Hit {
    @location(0) high: u32,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn fragment(corner: Corner) -> Hit {
    let owner = textureLoad(owners, vec2<u32>(corner.clip.xy), 0).r;
    let distance = abs(corner.k);
    if owner != (corner.low & ~FALLBACK) + 1u || !(distance <= pass_.cage) {
        discard;
    }
    let half = 0.499 * (distance / pass_.cage);
    let depth = select(half, 0.5 + half, (corner.low & FALLBACK) != 0u);
    return Hit(corner.high + 1u, depth);
}
