// What views lose by collapses. Twin: crates/kiln-lod/src/simplify/viewpoint/formula.rs
//
// One workgroup takes the changes of pixel counts of one candidate, as the pass `price` writes them, and gives the sum over views of how
// much a view's worth would change: entropy or mutual information of order a. One invocation takes every 64th view.
//     a region's term in a view        p L,   p = n / pixels of a view,   L = ((n s / t)^(a - 1) - 1) / (a - 1) -> ln (n s / t)
//     entropy                          s = 1, t = pixels of a view
//     mutual information               s = views, t = the region's pixels in all views; a view changes with t too, where n stays
//     its change, without cancellation p1 L1 - p0 L0 = (p1 - p0) L1 + p0 (L1 - L0), L1 - L0 from logarithms of n1 / n0 and t1 / t0
// In single precision; the twin has the same sums in double precision. Changes of regions come in any order, so the last bits may
// differ from run to run.
//
// Reads:  `pass`    the pass's numbers
//         `counts`  [region_count x views] pixels, before
//         `totals`  [region_count] pixels in all views, before
//         `spans`   [candidates x views] x 2: first row, rows or SKIPPED
//         `rows`    4 words, then x 3: region, pixels it wins (signed), rank
// Writes: `costs`   [candidates] nats; -1 where a view was skipped or regions or changes were too many

struct Pass {
    views: u32,
    pixels: u32,    // of a view
    coupled: u32,   // 1: mutual information
    order: f32,     // a - 1
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> totals: array<u32>;
@group(0) @binding(3) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> rows: array<u32>;
@group(0) @binding(5) var<storage, read_write> costs: array<f32>;

const LANES: u32 = 64u;
const SKIPPED: u32 = 0xffffffffu;
// Turns of loops that an invocation may take before the candidate is skipped: a driver that runs on the CPU ends loops after 65535.
const TURNS: u32 = 32768u;
const SLOTS: u32 = 512u;    // most regions that a candidate changes in all views together

// ln of b / a, both above 0.
fn log_of_ratio(a: u32, b: u32) -> f32 {
    let x = (f32(b) - f32(a)) / f32(a);
    if x <= -0.5 || x >= 1.0 {
        return log(f32(b) / f32(a));
    }
    // Whole numbers subtract exactly; the series is that of atanh.
    let s = f32(bitcast<i32>(b - a)) / (f32(a) + f32(b));
    let q = s * s;
    let series = 1.0 + q * (1.0 / 3.0 + q * (0.2 + q * (1.0 / 7.0 + q * (1.0 / 9.0 + q * (1.0 / 11.0 + q / 13.0)))));
    return 2.0 * s * series;
}

// (exp(order l) - 1) / order.
fn power(l: f32) -> f32 {
    if pass_.order == 0.0 {
        return l;
    }
    let y = pass_.order * l;
    if abs(y) > 0.5 {
        return (exp(y) - 1.0) / pass_.order;
    }
    let series = 1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0 + y / 5040.0)))));
    return l * series;
}

// The change of a region's term; n and t before and after.
fn term_change(n0: u32, n1: u32, t0: u32, t1: u32) -> f32 {
    let scale = select(1u, pass_.views, pass_.coupled != 0u);
    let pixels = f32(pass_.pixels);
    if n1 == 0u {
        if n0 == 0u {
            return 0.0;
        }
        return -(f32(n0) / pixels) * power(log_of_ratio(t0, n0 * scale));
    }
    let l1 = power(log_of_ratio(t1, n1 * scale));
    if n0 == 0u {
        return f32(n1) / pixels * l1;
    }
    var step = log_of_ratio(n0, n1);
    if t0 != t1 {
        step -= log_of_ratio(t0, t1);
    }
    let growth = exp(pass_.order * log_of_ratio(t0, n0 * scale)) * power(step);
    return f32(bitcast<i32>(n1 - n0)) / pixels * l1 + f32(n0) / pixels * growth;
}

var<workgroup> keys: array<atomic<u32>, SLOTS>;     // region + 1
var<workgroup> changes: array<atomic<i32>, SLOTS>;  // pixels it wins in all views
var<workgroup> bad: atomic<u32>;
var<private> turns: u32;
var<workgroup> parts: array<f32, LANES>;

fn add(region: u32, count: i32) {
    var slot = (region * 2654435761u) >> 23u;
    for (var tries = 0u; tries < SLOTS; tries++) {
        let key = atomicLoad(&keys[slot]);
        if key == region + 1u {
            atomicAdd(&changes[slot], count);
            return;
        }
        if key == 0u {
            let r = atomicCompareExchangeWeak(&keys[slot], 0u, region + 1u);
            if r.exchanged || r.old_value == region + 1u {
                atomicAdd(&changes[slot], count);
                return;
            }
            // The exchange may fail for no reason: the same slot again.
            if r.old_value == 0u {
                continue;
            }
        }
        slot = (slot + 1u) % SLOTS;
    }
    atomicStore(&bad, 1u);
}

// What a view would change by, regions apart from each other.
fn apart(view: u32, span: vec2<u32>) -> f32 {
    var change = 0.0;
    for (var i = 0u; i < span.y; i++) {
        let row = 4u + 3u * (span.x + i);
        let n = counts[rows[row] * pass_.views + view];
        change += term_change(n, n + rows[row + 1u], pass_.pixels, pass_.pixels);
    }
    return change;
}

// The same where a region's term depends on its pixels in all views.
fn coupled(view: u32, span: vec2<u32>) -> f32 {
    var change = 0.0;
    for (var slot = 0u; slot < SLOTS; slot++) {
        turns += 1u;
        if turns > TURNS {
            atomicStore(&bad, 1u);
            break;
        }
        let key = atomicLoad(&keys[slot]);
        if key == 0u {
            continue;
        }
        let region = key - 1u;
        let n = counts[region * pass_.views + view];
        var after = n;
        turns += span.y;
        for (var i = 0u; i < span.y; i++) {
            let row = 4u + 3u * (span.x + i);
            if rows[row] == region {
                after = n + rows[row + 1u];
            }
        }
        let t = totals[region];
        change += term_change(n, after, t, t + bitcast<u32>(atomicLoad(&changes[slot])));
    }
    return change;
}

@compute @workgroup_size(64)
fn formula(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let candidate = group.x;
    for (var slot = lane; slot < SLOTS; slot += LANES) {
        atomicStore(&keys[slot], 0u);
        atomicStore(&changes[slot], 0);
    }
    if lane == 0u {
        atomicStore(&bad, 0u);
    }
    workgroupBarrier();
    for (var view = lane; view < pass_.views; view += LANES) {
        let span = spans[candidate * pass_.views + view];
        if span.y == SKIPPED {
            atomicStore(&bad, 1u);
        } else if pass_.coupled != 0u {
            for (var i = 0u; i < span.y; i++) {
                let row = 4u + 3u * (span.x + i);
                add(rows[row], bitcast<i32>(rows[row + 1u]));
            }
        }
    }
    workgroupBarrier();
    turns = 0u;
    var cost = 0.0;
    if atomicLoad(&bad) == 0u {
        for (var view = lane; view < pass_.views; view += LANES) {
            let span = spans[candidate * pass_.views + view];
            if pass_.coupled != 0u {
                cost += abs(coupled(view, span));
            } else {
                cost += abs(apart(view, span));
            }
        }
    }
    parts[lane] = cost;
    workgroupBarrier();
    if lane == 0u {
        var all = 0.0;
        for (var i = 0u; i < LANES; i++) {
            all += parts[i];
        }
        costs[candidate] = select(-1.0, all, atomicLoad(&bad) == 0u);
    }
}
