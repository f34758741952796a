//! The one CPU rasteriser: which texels a triangle covers, decided by integers.
//!
//! Comes in: a triangle in texel coordinates (x right, y down, texel `(x, y)` covers `[x, x+1] x [y, y+1]`). Goes out: every
//! texel whose centre lies in the triangle, with barycentric coordinates. Texels of neighbouring triangles never overlap and
//! never leave a gap.
//!
//! ```text
//! snap corners to 1/256 texel; orient so that twice the area A > 0; stop at A = 0
//! edge function E_i(p) = cross(b - a, p - a), an i64, exact; bary_i = E_i / A
//! covered: for all i, E_i(p) > 0, or E_i(p) = 0 and edge i is a top or a left edge
//! for each row of the box: solve the three inequalities for x in integers, visit the span
//! ```
//!
//! Limits: a corner further than 2^21 texels from the origin is moved to that distance in each coordinate (the edge
//! functions would leave 64 bits); triangles with a coordinate that is no number cover nothing.
//!
//! Sources: J. Pineda, A Parallel Algorithm for Polygon Rasterization, SIGGRAPH 1988, doi:10.1145/54852.378457; the
//! top-left rule as in the Direct3D 11.3 functional specification, section 3.4.2.1.

use glam::Vec2;

/// Subdivisions of a texel: corners are snapped to 1/256, as GPUs do.
pub const SUBTEXEL: i64 = 256;

/// Greatest magnitude of a coordinate, texels: differences stay below 2^30 / 256, edge functions below 2^62.
const COORDINATE_LIMIT: f32 = (1 << 21) as f32;

/// A rectangle of texels, half open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// Behind the last column.
    pub x1: u32,
    /// Behind the last row.
    pub y1: u32,
}

impl Rect {
    /// The whole of a picture.
    pub fn whole(width: u32, height: u32) -> Rect {
        Rect { x0: 0, y0: 0, x1: width, y1: height }
    }
}

/// Coordinates in 1/256 texel; `None` if one is no number.
pub fn snap(corners: [Vec2; 3]) -> Option<[[i64; 2]; 3]> {
    let fixed =
        |v: f32| (v.clamp(-COORDINATE_LIMIT, COORDINATE_LIMIT) as f64 * SUBTEXEL as f64).round_ties_even() as i64;
    corners.iter().all(|c| !c.is_nan()).then(|| corners.map(|c| [fixed(c.x), fixed(c.y)]))
}

/// Visits every texel of a `width` by `height` picture whose centre the triangle covers, row by row, left to right, with
/// the barycentric coordinates of the centre (three values in `[0, 1]` that sum to 1 within rounding). Either winding.
pub fn rasterise(corners: [Vec2; 3], width: u32, height: u32, visit: impl FnMut(u32, u32, [f32; 3])) {
    rasterise_rect(corners, Rect::whole(width, height), visit);
}

/// [`rasterise`] inside a rectangle: the same texels and values as for the whole picture, for tiles and bands.
pub fn rasterise_rect(corners: [Vec2; 3], rect: Rect, mut visit: impl FnMut(u32, u32, [f32; 3])) {
    rasterise_exact(corners, rect, |x, y, weights, area| {
        let scale = 1.0 / area as f64;
        visit(x, y, weights.map(|w| (w as f64 * scale) as f32));
    });
}

/// [`rasterise_rect`] with exact integers: `visit(x, y, weights, area)`, barycentric coordinate `i` = `weights[i] / area`,
/// weights sum to `area`, which is positive. For callers that interpolate depth or compare exactly.
pub fn rasterise_exact(corners: [Vec2; 3], rect: Rect, mut visit: impl FnMut(u32, u32, [i64; 3], i64)) {
    let Some(corners) = snap(corners) else { return };
    rasterise_spans(corners, rect, |span| {
        let mut weights = span.weights;
        for x in span.x0..span.x1 {
            visit(x, span.y, weights, span.area);
            weights = [0, 1, 2].map(|i| weights[i] + span.steps[i]);
        }
    });
}

/// A row of covered texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// The row.
    pub y: u32,
    /// First column.
    pub x0: u32,
    /// Behind the last column.
    pub x1: u32,
    /// Weights of the corners at the first column: barycentric coordinate `i` = `weights[i] / area`.
    pub weights: [i64; 3],
    /// What the weights grow by from column to column.
    pub steps: [i64; 3],
    /// Sum of the weights, above 0.
    pub area: i64,
}

/// [`rasterise_exact`] row by row, from corners in 1/256 texel, as [`snap`] gives them: at most 2^29 in magnitude.
#[inline]
pub fn rasterise_spans([a, b, c]: [[i64; 2]; 3], rect: Rect, mut visit: impl FnMut(Span)) {
    let centre_floor = |v: i64| (v - SUBTEXEL / 2).div_euclid(SUBTEXEL);
    let low = |k: usize| a[k].min(b[k]).min(c[k]);
    let high = |k: usize| a[k].max(b[k]).max(c[k]);
    let x_first = (centre_floor(low(0) - 1) + 1).max(rect.x0 as i64);
    let y_first = (centre_floor(low(1) - 1) + 1).max(rect.y0 as i64);
    let x_end = (centre_floor(high(0)) + 1).min(rect.x1 as i64);
    let y_end = (centre_floor(high(1)) + 1).min(rect.y1 as i64);
    if x_first >= x_end || y_first >= y_end {
        return;
    }
    let cross = |o: [i64; 2], p: [i64; 2], q: [i64; 2]| (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
    let area = cross(a, b, c);
    if area == 0 {
        return;
    }
    // Positive area: edge i runs against corner i, from the next corner to the one after.
    let flip = area < 0;
    let (area, ring) = if flip { (-area, [a, c, b]) } else { (area, [a, b, c]) };
    let edges = [Edge::new(ring[1], ring[2]), Edge::new(ring[2], ring[0]), Edge::new(ring[0], ring[1])];
    let ordered = |[w0, w1, w2]: [i64; 3]| if flip { [w0, w2, w1] } else { [w0, w1, w2] };
    let steps = ordered([edges[0].step_x, edges[1].step_x, edges[2].step_x]);
    let mut sides = [Side::new(&edges[0], y_first), Side::new(&edges[1], y_first), Side::new(&edges[2], y_first)];
    for y in y_first..y_end {
        let (mut from, mut to) = (x_first, x_end);
        for side in &mut sides {
            side.narrow(&mut from, &mut to);
            side.descend();
        }
        if from < to {
            let weights = ordered([edges[0].at(from, y), edges[1].at(from, y), edges[2].at(from, y)]);
            visit(Span { y: y as u32, x0: from as u32, x1: to as u32, weights, steps, area });
        }
    }
}

/// `E(x, y) = origin + step_x x + step_y y` over texel centres; covered where `E >= least`.
struct Edge {
    origin: i64,
    step_x: i64,
    step_y: i64,
    /// 0 for top and left edges, which own their points; 1 for the others.
    least: i64,
}

impl Edge {
    #[inline]
    fn new(from: [i64; 2], to: [i64; 2]) -> Edge {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let half = SUBTEXEL / 2;
        Edge {
            origin: dx * (half - from[1]) - dy * (half - from[0]),
            step_x: -dy * SUBTEXEL,
            step_y: dx * SUBTEXEL,
            least: if dy < 0 || (dy == 0 && dx > 0) { 0 } else { 1 },
        }
    }

    #[inline]
    fn at(&self, x: i64, y: i64) -> i64 {
        self.origin + self.step_x * x + self.step_y * y
    }
}

/// Where an edge bounds the columns of a row: `step_x x >= need`, `need` changing by the same amount from row to row, so that after
/// the first row the quotient follows by additions.
struct Side {
    /// |step_x|.
    step: i64,
    rising: bool,
    /// `-need` by `step`, rounded down, and what is left of it, in `[0, step)`. A vertical edge has no quotient, and the rest is `need`.
    quotient: i64,
    rest: i64,
    quotient_step: i64,
    rest_step: i64,
}

impl Side {
    #[inline]
    fn new(edge: &Edge, y: i64) -> Side {
        let need = edge.least - edge.origin - edge.step_y * y;
        let (step, rising) = (edge.step_x.abs(), edge.step_x > 0);
        if step == 0 {
            return Side { step, rising, quotient: 0, rest: need, quotient_step: 0, rest_step: -edge.step_y };
        }
        // ceil(need / step) = -floor(-need / step); a falling edge needs x <= floor(-need / step).
        let (value, change) = (-need, edge.step_y);
        let (quotient, rest) = (value.div_euclid(step), value.rem_euclid(step));
        let (quotient_step, rest_step) = (change.div_euclid(step), change.rem_euclid(step));
        Side { step, rising, quotient, rest, quotient_step, rest_step }
    }

    /// Shrinks `[from, to)` to the columns on the inner side.
    #[inline]
    fn narrow(&self, from: &mut i64, to: &mut i64) {
        if self.step == 0 {
            if self.rest > 0 {
                *to = *from;
            }
        } else if self.rising {
            *from = (*from).max(-self.quotient);
        } else {
            *to = (*to).min(self.quotient + 1);
        }
    }

    /// Goes on to the next row.
    #[inline]
    fn descend(&mut self) {
        self.quotient += self.quotient_step;
        self.rest += self.rest_step;
        if self.step != 0 && self.rest >= self.step {
            self.rest -= self.step;
            self.quotient += 1;
        }
    }
}

#[cfg(test)]
mod tests;
