// The bake's hit pass. Twin: crates/kiln-bake/src/transfer/search.rs
//
// Six vertex invocations make the rectangle of samples from which the lines of one low triangle T can meet one high triangle.
// One fragment invocation asks whether T owns the sample; if so it takes the sample's line `o + t d`, meets it with the high
// triangle and offers that with a depth by the hit rule; the depth test (less; the pairs of a low triangle come in ascending
// order of the high face) keeps the best one, of equals the lower face.
//
//   (x, y) = texels from `pixel`;  o = o0 + x o1 + y o2, from `base`;  d likewise
//   s      = (a - o) . d / (d . d)                  corners a, b, c are seen from o + s d: near them, so that little cancels
//   E      = d . (b x c), d . (c x a), d . (a x b)  inside where none is below -open; their sum is d . n: below 0 it looks away
//   t      = s + sum of E (corner . d) / (sum of E) (d . d)
//   front  = min(least of (f0 + x f1 + y f2) / |d|, clip), back likewise: -back <= t <= front
//   depth  = (front - t) / (front + back) or |t| / max(front, back), halved; plus a half for pairs of different submeshes
//
// Reads:  `pass`    the picture's numbers
//         `points`  [high vertex_count] x 3 f32, object space
//         `corners` [high face_count] x 3 vertex indices
//         `lines`   [runs] the lines of a low face (see Lines), lengths in units of 1 / scale
//         `pairs`   [pair_count] x (index in `lines` | FALLBACK, high face, first and last + 1 column, likewise row: 16 bits each)
//         `owners`  [height x width] low face + 1 that owns the sample, 0 = none
// Writes: colour 0  [height x width] R32Uint: high face + 1, 0 = no hit
//         depth     [height x width] as above
//
// Two triangles with a common edge see it from different s, so both are opened by what that rounds by: no line slips through.
// Winners are names only; places on them are worked out on the CPU in double precision.

struct Pass {
    size: vec2<f32>,    // samples across and down the picture
    step: f32,          // texels from sample to sample
    flags: u32,         // NEAREST, BACK_FACES
}

struct Lines {
    base: vec3<f32>,    // corner 0 of T, object space, object units
    owner: u32,         // T + 1
    o0: vec3<f32>,
    shift_x: i32,       // column of the picture's first sample, from `pixel`
    o1: vec3<f32>,
    shift_y: i32,       // row likewise
    o2: vec3<f32>,
    scale: f32,         // power of two that brings lengths near 1: 1 / object units
    d0: vec3<f32>,
    f0: f32,
    d1: vec3<f32>,
    f1: f32,
    d2: vec3<f32>,
    f2: f32,
    back: f32,
    clip_front: f32,    // greatest t before lines cross
    clip_back: f32,
    pad: f32,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> corners: array<u32>;
@group(0) @binding(3) var<storage, read> lines: array<Lines>;
@group(0) @binding(4) var<storage, read> pairs: array<vec4<u32>>;
@group(0) @binding(5) var owners: texture_2d<u32>;

const FALLBACK: u32 = 0x80000000u;
const NEAREST: u32 = 1u;
const BACK_FACES: u32 = 2u;

// Roundings of an edge's value, in units of the corners' extent times that and |s|: 2^-24 times about 10 operations.
const ROUNDING: f32 = 1.0 / 1048576.0;

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) @interpolate(flat) low: u32,
    @location(1) @interpolate(flat) high: u32,
    @location(2) @interpolate(flat) a: vec3<f32>,
    @location(3) @interpolate(flat) b: vec3<f32>,
    @location(4) @interpolate(flat) c: vec3<f32>,
}

fn point(index: u32) -> vec3<f32> {
    let v = corners[index] * 3u;
    return vec3<f32>(points[v], points[v + 1u], points[v + 2u]);
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    let pair = pairs[index / 6u];
    // Corners 0 1 2 and 2 1 3 of the rectangle; bit 0: right, bit 1: down.
    let corner = (0x312210u >> (4u * (index % 6u))) & 3u;
    let x = select(pair.z & 0xffffu, pair.z >> 16u, (corner & 1u) != 0u);
    let y = select(pair.w & 0xffffu, pair.w >> 16u, (corner & 2u) != 0u);
    let unit = vec2<f32>(f32(x), f32(y)) * (2.0 / pass_.size);
    let base = lines[pair.x & ~FALLBACK].base;
    let scale = lines[pair.x & ~FALLBACK].scale;
    let first = pair.y * 3u;
    return Corner(
        vec4<f32>(unit.x - 1.0, 1.0 - unit.y, 0.5, 1.0),
        pair.x,
        pair.y,
        (point(first) - base) * scale,
        (point(first + 1u) - base) * scale,
        (point(first + 2u) - base) * scale,
    );
}

struct Hit {
    @location(0) high: u32,
    @builtin(frag_depth) depth: f32,
}

fn largest(v: vec3<f32>) -> f32 {
    return max(abs(v.x), max(abs(v.y), abs(v.z)));
}

@fragment
fn fragment(corner: Corner) -> Hit {
    let low = corner.low & ~FALLBACK;
    let sample = vec2<i32>(corner.clip.xy);
    if textureLoad(owners, sample, 0).r != lines[low].owner {
        discard;
    }
    let x = (f32(sample.x + lines[low].shift_x) + 0.5) * pass_.step;
    let y = (f32(sample.y + lines[low].shift_y) + 0.5) * pass_.step;
    let o = lines[low].o0 + x * lines[low].o1 + y * lines[low].o2;
    let d = lines[low].d0 + x * lines[low].d1 + y * lines[low].d2;
    let square = dot(d, d);
    let s = dot(corner.a - o, d) / square;
    let near = o + s * d;
    let a = corner.a - near;
    let b = corner.b - near;
    let c = corner.c - near;
    let edges = vec3<f32>(dot(d, cross(b, c)), dot(d, cross(c, a)), dot(d, cross(a, b)));
    let sum = edges.x + edges.y + edges.z;
    let extent = max(largest(a), max(largest(b), largest(c)));
    let open = ROUNDING * extent * (extent + abs(s));
    var inside = min(edges.x, min(edges.y, edges.z)) >= -open;
    if sum < 0.0 {
        inside = (pass_.flags & BACK_FACES) != 0u && max(edges.x, max(edges.y, edges.z)) <= open;
    }
    // Edge on: no meeting point worth its name.
    if !inside || !(abs(sum) > 3.0 * open) {
        discard;
    }
    let t = s + dot(edges, vec3<f32>(dot(a, d), dot(b, d), dot(c, d))) / (sum * square);
    let length = sqrt(square);
    let front = min((lines[low].f0 + x * lines[low].f1 + y * lines[low].f2) / length, lines[low].clip_front);
    let back = min(lines[low].back / length, lines[low].clip_back);
    if !(t <= front && -t <= back) {
        discard;
    }
    let nearest = (pass_.flags & NEAREST) != 0u;
    let way = select(front - t, abs(t), nearest);
    let whole = select(front + back, max(front, back), nearest);
    // Below 1 even where it is rounded up, since the picture is cleared to 1.
    let share = select(0.0, 0.499 * clamp(way / whole, 0.0, 1.0), whole > 0.0);
    return Hit(corner.high + 1u, select(share, 0.5 + share, (corner.low & FALLBACK) != 0u));
}
