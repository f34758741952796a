//! From ids to values: where on the high triangle a texel's line meets it, and the normal there. Shared by both backends, so
//! that a graphics card decides winners and nothing else.

use glam::{DVec2, Vec2, Vec3, Vec4};
use kiln_asset::{FaceId, Mesh};

use super::frame::{TexelMap, corner_texels};

/// The line through a texel's centre along its low triangle's normal, and the high triangle it ends on.
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
    /// Change of `high_bary` from one texel to the next in x, before it is moved inside.
    pub(crate) step_x: [f32; 3],
    /// Likewise in y.
    pub(crate) step_y: [f32; 3],
}

impl HitPoint {
    /// The value of a vertex attribute at the hit: linear over the high face.
    pub(crate) fn uv(&self, high: &Mesh, uv: &[Vec2]) -> (Vec2, Vec2, Vec2) {
        let corner = high.triangles[self.high].map(|v| uv[v as usize]);
        let mix = |b: [f32; 3]| corner[0] * b[0] + corner[1] * b[1] + corner[2] * b[2];
        (mix(self.high_bary), mix(self.step_x), mix(self.step_y))
    }
}

/// Finds hit points; keeps the last pair's maps, since neighbours mostly share them.
pub(crate) struct Locator<'a> {
    low: &'a Mesh,
    high: &'a Mesh,
    atlas_uv: &'a [Vec2],
    size: u32,
    low_face: usize,
    low_map: Option<(TexelMap, Plane)>,
    high_face: usize,
    high_map: Plane,
}

/// Barycentric coordinates as affine functions of the texel.
#[derive(Clone, Copy)]
struct Plane {
    corner: DVec2,
    row1: DVec2,
    row2: DVec2,
}

impl Plane {
    /// Of a triangle in texel space; `None` if it is seen edge on.
    fn new([q0, q1, q2]: [DVec2; 3]) -> Option<Plane> {
        let (e1, e2) = (q1 - q0, q2 - q0);
        let area = e1.perp_dot(e2);
        let plane = Plane { corner: q0, row1: DVec2::new(e2.y, -e2.x) / area, row2: DVec2::new(-e1.y, e1.x) / area };
        (plane.row1.is_finite() && plane.row2.is_finite()).then_some(plane)
    }

    /// The middle of a triangle that is seen edge on.
    const EDGE_ON: Plane = Plane { corner: DVec2::ZERO, row1: DVec2::ZERO, row2: DVec2::ZERO };

    fn at(&self, centre: DVec2) -> [f64; 3] {
        let d = centre - self.corner;
        let (b1, b2) = (self.row1.dot(d), self.row2.dot(d));
        [1.0 - b1 - b2, b1, b2]
    }

    fn step(&self, axis: DVec2) -> [f32; 3] {
        let (b1, b2) = (self.row1.dot(axis), self.row2.dot(axis));
        [-(b1 + b2) as f32, b1 as f32, b2 as f32]
    }
}

impl<'a> Locator<'a> {
    pub(crate) fn new(low: &'a Mesh, high: &'a Mesh, atlas_uv: &'a [Vec2], size: u32) -> Locator<'a> {
        let none = usize::MAX;
        Locator { low, high, atlas_uv, size, low_face: none, low_map: None, high_face: none, high_map: Plane::EDGE_ON }
    }

    /// The hit point of texel `(x, y)`, which low face `low` owns and whose hit lies on high face `high`.
    pub(crate) fn at(&mut self, x: u32, y: u32, low: usize, high: usize) -> Option<HitPoint> {
        if self.low_face != low {
            let texels = corner_texels(self.low, self.atlas_uv, low, self.size);
            let map = TexelMap::new(self.low.face_positions(FaceId(low as u32)), texels);
            self.low_map = map.zip(Plane::new(texels.map(|t| t.as_dvec2())));
            self.low_face = low;
            self.high_face = usize::MAX;
        }
        let (map, plane) = self.low_map.as_ref()?;
        if self.high_face != high {
            let corners = self.high.face_positions(FaceId(high as u32)).map(|p| map.texel(p));
            self.high_map = Plane::new(corners).unwrap_or(Plane::EDGE_ON);
            self.high_face = high;
        }
        let centre = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        Some(HitPoint {
            low,
            high,
            low_bary: plane.at(centre).map(|b| b as f32),
            high_bary: inside(self.high_map.at(centre)),
            step_x: self.high_map.step(DVec2::X),
            step_y: self.high_map.step(DVec2::Y),
        })
    }
}

/// Barycentric coordinates moved into the triangle: the winner was found with corners snapped to 1/256 texel.
fn inside(bary: [f64; 3]) -> [f32; 3] {
    let clamped = bary.map(|b| b.max(0.0));
    let sum: f64 = clamped.iter().sum();
    if sum > 0.0 && sum.is_finite() { clamped.map(|b| (b / sum) as f32) } else { [1.0 / 3.0; 3] }
}

/// `values[corner]` mixed by `bary`.
pub(crate) fn mix3(values: [Vec3; 3], bary: [f32; 3]) -> Vec3 {
    values[0] * bary[0] + values[1] * bary[1] + values[2] * bary[2]
}

/// `values[corner]` mixed by `bary`.
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
