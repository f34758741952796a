//! From ids to places: where on the high triangle a sample's line meets it. Shared by all backends, so that a graphics card decides
//! winners and nothing else.

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4};
use kiln_asset::{FaceId, Mesh};

use super::low::{Lines, Low};

/// A sample's place on the low mesh and on the high one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HitPoint {
    /// Low face.
    pub(crate) low: usize,
    /// High face.
    pub(crate) high: usize,
    /// Barycentric coordinates on the low face.
    pub(crate) low_bary: [f32; 3],
    /// Barycentric coordinates on the high face, inside it.
    pub(crate) high_bary: [f32; 3],
    /// Change of `high_bary` from one sample to the next in x, before it is moved inside.
    pub(crate) step_x: [f32; 3],
    /// Likewise in y.
    pub(crate) step_y: [f32; 3],
    /// Signed distance of the high surface along the line, object units, outwards positive.
    pub(crate) height: f32,
    /// The high face looks against the line.
    pub(crate) turned: bool,
}

impl HitPoint {
    /// The value of a vertex attribute at the hit, and its change from sample to sample in x and y: linear over the high face.
    pub(crate) fn uv(&self, high: &Mesh, uv: &[Vec2]) -> (Vec2, Vec2, Vec2) {
        let corner = high.triangles[self.high].map(|v| uv[v as usize]);
        let mix = |b: [f32; 3]| corner[0] * b[0] + corner[1] * b[1] + corner[2] * b[2];
        (mix(self.high_bary), mix(self.step_x), mix(self.step_y))
    }
}

/// What of a hit is to be worked out beside its place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Needs {
    /// Its change from sample to sample.
    pub(crate) steps: bool,
    /// Its distance from the low surface.
    pub(crate) height: bool,
}

/// How a sample finds its place on the high face that won it.
#[derive(Clone, Copy)]
pub(crate) enum Meeting<'a> {
    /// Along its line.
    Line,
    /// At its own texture coordinates, in the high mesh's layout.
    Layout(&'a [Vec2]),
}

/// Finds hit points; keeps the last faces' numbers, since neighbours mostly share them.
pub(crate) struct Locator<'a> {
    low: &'a Low<'a>,
    high: &'a Mesh,
    meeting: Meeting<'a>,
    /// `[KEPT]` low faces and their lines, each at its number modulo the length: rows of samples cross the same few faces again and again.
    kept: Vec<(usize, Option<Lines>)>,
    /// The last pair.
    pair: [usize; 2],
    /// Of its high face, relative to the lines' base.
    corners: [DVec3; 3],
    flat: Plane,
}

/// Low faces whose lines a locator keeps: more than a bin of a usual layout holds.
const KEPT: usize = 32;

/// A line's meeting point with a triangle's plane.
struct Meet {
    bary: [f64; 3],
    t: f64,
    /// The triangle looks against the line.
    turned: bool,
}

/// Where the line `origin + t direction` meets the plane of `corners`; not finite where they are parallel.
#[inline]
fn meet((origin, direction): (DVec3, DVec3), corners: &[DVec3; 3]) -> Meet {
    let [a, b, c] = corners.map(|p| p - origin);
    let e = [direction.dot(b.cross(c)), direction.dot(c.cross(a)), direction.dot(a.cross(b))];
    // The sum is d . n.
    let sum = e[0] + e[1] + e[2];
    let height = a.dot((b - a).cross(c - a));
    let share = 1.0 / sum;
    Meet { bary: e.map(|e| e * share), t: height * share, turned: sum < 0.0 }
}

/// Barycentric coordinates in a layout, as affine functions of the place.
#[derive(Clone, Copy)]
struct Plane {
    corner: DVec2,
    row1: DVec2,
    row2: DVec2,
}

impl Plane {
    fn new([q0, q1, q2]: [DVec2; 3]) -> Plane {
        let (e1, e2) = (q1 - q0, q2 - q0);
        let area = e1.perp_dot(e2);
        Plane { corner: q0, row1: DVec2::new(e2.y, -e2.x) / area, row2: DVec2::new(-e1.y, e1.x) / area }
    }

    fn at(&self, place: DVec2) -> [f64; 3] {
        let d = place - self.corner;
        let (b1, b2) = (self.row1.dot(d), self.row2.dot(d));
        [1.0 - b1 - b2, b1, b2]
    }
}

impl<'a> Locator<'a> {
    pub(crate) fn new(low: &'a Low<'a>, high: &'a Mesh, meeting: Meeting<'a>) -> Locator<'a> {
        let nowhere = Plane { corner: DVec2::ZERO, row1: DVec2::ZERO, row2: DVec2::ZERO };
        let kept = vec![(usize::MAX, None); KEPT];
        Locator { low, high, meeting, kept, pair: [usize::MAX; 2], corners: [DVec3::ZERO; 3], flat: nowhere }
    }

    /// The lines of a low face.
    #[inline(always)]
    fn lines(&mut self, low: usize) -> Option<&Lines> {
        let kept = &mut self.kept[low % KEPT];
        if kept.0 != low {
            *kept = (low, self.low.lines(low));
        }
        kept.1.as_ref()
    }

    /// As [`Locator::at`] where nothing more is needed and the search has kept where it met a face that looks along the line:
    /// barycentric coordinates 0 and 1.
    #[inline(always)]
    pub(crate) fn met(&mut self, sample: [u32; 2], low: usize, high: usize, [b0, b1]: [f32; 2]) -> Option<HitPoint> {
        let samples = self.low.samples;
        let lines = self.lines(low)?;
        Some(HitPoint {
            low,
            high,
            low_bary: lines.bary(lines.place(sample, samples)).map(|b| b as f32),
            high_bary: inside([b0, b1, 1.0 - b0 - b1].map(f64::from)),
            step_x: [0.0; 3],
            step_y: [0.0; 3],
            height: 0.0,
            turned: false,
        })
    }

    /// The hit of a sample (column, row on the sheet of samples) of `low` whose winner is `high`. What is not
    /// needed is 0. `None`: the low face has no lines.
    #[inline(always)]
    pub(crate) fn at(&mut self, sample: [u32; 2], low: usize, high: usize, needs: Needs) -> Option<HitPoint> {
        self.lines(low)?;
        let lines = self.kept[low % KEPT].1.as_ref()?;
        if self.pair != [low, high] {
            self.corners = self.high.face_positions(FaceId(high as u32)).map(|p| p.as_dvec3() - lines.base);
            if let Meeting::Layout(uv) = self.meeting {
                self.flat = Plane::new(self.high.triangles[high].map(|v| uv[v as usize].as_dvec2()));
            }
            self.pair = [low, high];
        }
        let place = lines.place(sample, self.low.samples);
        let line = lines.line(place);
        let found = meet(line, &self.corners);
        let bary = match self.meeting {
            Meeting::Line => found.bary,
            Meeting::Layout(_) => self.in_layout(lines, place),
        };
        let height = match self.meeting {
            _ if !needs.height => 0.0,
            Meeting::Line => found.t * line.1.length(),
            Meeting::Layout(_) => {
                let point = self.corners[0] * bary[0] + self.corners[1] * bary[1] + self.corners[2] * bary[2];
                (point - line.0).dot(line.1.normalize_or_zero())
            }
        };
        let (mut step_x, mut step_y) = ([0.0; 3], [0.0; 3]);
        if needs.steps {
            let step = 1.0 / f64::from(self.low.samples);
            let change = |place: DVec2| {
                let other = match self.meeting {
                    Meeting::Line => meet(lines.line(place), &self.corners).bary,
                    Meeting::Layout(_) => self.in_layout(lines, place),
                };
                [0, 1, 2].map(|k| finite((other[k] - bary[k]) as f32))
            };
            (step_x, step_y) = (change(place + step * DVec2::X), change(place + step * DVec2::Y));
        }
        Some(HitPoint {
            low,
            high,
            low_bary: lines.bary(place).map(|b| b as f32),
            high_bary: inside(bary),
            step_x,
            step_y,
            height: finite(height as f32),
            turned: found.turned,
        })
    }

    /// Barycentric coordinates on the high face of a place, in the layout both meshes share.
    fn in_layout(&self, lines: &Lines, place: DVec2) -> [f64; 3] {
        let pixel = DVec2::new(f64::from(lines.pixel[0]), f64::from(lines.pixel[1]));
        self.flat.at((place + pixel) / f64::from(self.low.size))
    }
}

#[inline]
fn finite(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

/// Barycentric coordinates moved into the triangle: winners are found with edges opened by their rounding.
#[inline]
fn inside(bary: [f64; 3]) -> [f32; 3] {
    if bary[0].min(bary[1]).min(bary[2]) >= 0.0 && bary[0].is_finite() {
        return bary.map(|b| b as f32);
    }
    let clamped = bary.map(|b| b.max(0.0));
    let sum: f64 = clamped.iter().sum();
    if sum > 0.0 && sum.is_finite() { clamped.map(|b| (b / sum) as f32) } else { [1.0 / 3.0; 3] }
}
/// `values[corner]` mixed by `bary`.
#[inline]
pub(crate) fn mix3(values: [Vec3; 3], bary: [f32; 3]) -> Vec3 {
    values[0] * bary[0] + values[1] * bary[1] + values[2] * bary[2]
}

/// `values[corner]` mixed by `bary`.
#[inline]
pub(crate) fn mix4(values: [Vec4; 3], bary: [f32; 3]) -> Vec4 {
    values[0] * bary[0] + values[1] * bary[1] + values[2] * bary[2]
}

/// A tangent frame as MikkTSpace wants it read: normal and tangent interpolated and not normalised again, bitangent =
/// w cross(n, t) at the texel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TangentFrame {
    pub(crate) tangent: Vec3,
    pub(crate) bitangent: Vec3,
    pub(crate) normal: Vec3,
}

impl TangentFrame {
    pub(crate) fn new(normals: [Vec3; 3], tangents: [Vec4; 3], bary: [f32; 3]) -> TangentFrame {
        let normal = mix3(normals, bary);
        let tangent = mix4(tangents, bary);
        let sign = if tangent.w < 0.0 { -1.0 } else { 1.0 };
        TangentFrame { tangent: tangent.truncate(), bitangent: sign * normal.cross(tangent.truncate()), normal }
    }

    /// Tangent-space vector to object space, unit length; what a renderer does.
    pub(crate) fn decode(&self, v: Vec3) -> Vec3 {
        (v.x * self.tangent + v.y * self.bitangent + v.z * self.normal).normalize_or_zero()
    }

    /// Object-space vector to tangent space, unit length: the inverse of [`TangentFrame::decode`]. A frame without volume
    /// (a face whose UVs have no area) gives straight up.
    pub(crate) fn encode(&self, n: Vec3) -> Vec3 {
        let (t, b, m) = (self.tangent.as_dvec3(), self.bitangent.as_dvec3(), self.normal.as_dvec3());
        let n = n.as_dvec3();
        let volume = t.cross(b).dot(m);
        if volume.abs() < 1e-9 {
            return Vec3::Z;
        }
        // Cramer's rule; the sign of the volume matters, its size goes with the normalisation.
        let v = glam::DVec3::new(n.dot(b.cross(m)), n.dot(m.cross(t)), n.dot(t.cross(b))) / volume;
        v.as_vec3().try_normalize().unwrap_or(Vec3::Z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encode_is_the_inverse_of_decode_in_skewed_and_mirrored_frames() {
        let normals =
            [Vec3::new(0.1, 0.2, 1.0), Vec3::new(-0.3, 0.1, 0.9), Vec3::new(0.0, 0.5, 0.8)].map(Vec3::normalize);
        for sign in [1.0, -1.0] {
            let tangents =
                [Vec4::new(1.0, 0.0, -0.1, sign), Vec4::new(0.9, 0.3, 0.1, sign), Vec4::new(0.8, -0.5, 0.0, sign)];
            let frame = TangentFrame::new(normals, tangents, [0.2, 0.5, 0.3]);
            for n in kiln_geom::sample::fibonacci_sphere(200) {
                let back = frame.decode(frame.encode(n));
                assert!((back - n).length() < 1e-4, "{n} came back as {back}");
            }
        }
    }

    #[test]
    fn a_frame_without_volume_points_straight_up() {
        let frame = TangentFrame::new([Vec3::Z; 3], [Vec4::new(0.0, 0.0, 0.0, 1.0); 3], [0.2, 0.3, 0.5]);
        assert_eq!(frame.encode(Vec3::X), Vec3::Z);
    }

    #[test]
    fn a_point_outside_by_rounding_is_moved_onto_the_edge() {
        assert_eq!(inside([-0.001, 0.5, 0.501])[0], 0.0);
        assert_eq!(inside([f64::NAN, f64::NAN, f64::NAN]), [1.0 / 3.0; 3]);
    }
}
