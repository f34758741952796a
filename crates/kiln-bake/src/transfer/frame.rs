//! The affine map of each low triangle into its texels, and which low triangle owns each texel.

use bytemuck::{Pod, Zeroable};
use glam::{DVec2, DVec3, Vec2, Vec3};
use kiln_asset::{FaceId, Mesh};
use kiln_geom::raster::{Rect, rasterise_exact};

/// Greatest ratio of a triangle's longest edge to its height for which its normal still means something in `f32` positions.
const SLIVER_RATIO: f64 = 1e6;

/// Texel coordinates of a low face's corners: atlas UV x size, texel space.
pub(crate) fn corner_texels(low: &Mesh, uv: &[Vec2], face: usize, size: u32) -> [Vec2; 3] {
    low.triangles[face].map(|v| uv[v as usize] * size as f32)
}

/// The affine map that sends a low triangle's corners to their texels, along its normal; double precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TexelMap {
    base: DVec3,
    texel: DVec2,
    row_x: DVec3,
    row_y: DVec3,
    /// Unit face normal, object space.
    pub(crate) normal: DVec3,
}

impl TexelMap {
    /// The map of a triangle with corners at `positions` (object space) and `texels`; `None` if it is too thin for a normal.
    pub(crate) fn new(positions: [Vec3; 3], texels: [Vec2; 3]) -> Option<TexelMap> {
        let [p0, p1, p2] = positions.map(|p| p.as_dvec3());
        let [t0, t1, t2] = texels.map(|t| t.as_dvec2());
        let (e1, e2) = (p1 - p0, p2 - p0);
        let cross = e1.cross(e2);
        let square = cross.length_squared();
        let longest = e1.length_squared().max(e2.length_squared()).max((e2 - e1).length_squared());
        // |cross| = longest edge x height.
        if square.is_nan() || square * SLIVER_RATIO * SLIVER_RATIO <= longest * longest || square == 0.0 {
            return None;
        }
        // Barycentric coordinates 1 and 2 of a point p are dot(row, p - p0).
        let (row1, row2) = (e2.cross(cross) / square, cross.cross(e1) / square);
        Some(TexelMap {
            base: p0,
            texel: t0,
            row_x: row1 * (t1.x - t0.x) + row2 * (t2.x - t0.x),
            row_y: row1 * (t1.y - t0.y) + row2 * (t2.y - t0.y),
            normal: cross / square.sqrt(),
        })
    }

    /// Where a point of object space falls, texel space.
    pub(crate) fn texel(&self, p: Vec3) -> DVec2 {
        let d = p.as_dvec3() - self.base;
        self.texel + DVec2::new(self.row_x.dot(d), self.row_y.dot(d))
    }

    /// The map in single precision with texels counted from `origin`: what both backends project with.
    fn frame(&self, origin: [u32; 2]) -> Frame {
        let texel = self.texel - DVec2::new(origin[0] as f64, origin[1] as f64);
        let pack = |v: DVec3, w: f64| [v.x as f32, v.y as f32, v.z as f32, w as f32];
        Frame {
            base: pack(self.base, texel.x),
            row_x: pack(self.row_x, texel.y),
            row_y: pack(self.row_y, origin[0] as f64),
            normal: pack(self.normal, origin[1] as f64),
        }
    }
}

/// [`TexelMap`] in single precision; the layout is that of `Frame` in `shaders/mirrored_vertex.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Frame {
    base: [f32; 4],
    row_x: [f32; 4],
    row_y: [f32; 4],
    normal: [f32; 4],
}

impl Frame {
    /// A point of object space as (texels from the frame's origin, signed distance from the plane in object units).
    #[inline]
    pub(crate) fn project(&self, p: Vec3) -> (Vec2, f32) {
        let [x, y, z, texel_x] = self.base;
        let d = p - Vec3::new(x, y, z);
        let dot = |row: &[f32; 4]| row[0] * d.x + row[1] * d.y + row[2] * d.z;
        (Vec2::new(dot(&self.row_x) + texel_x, dot(&self.row_y) + self.row_x[3]), dot(&self.normal))
    }

    /// Unit face normal, object space.
    pub(crate) fn normal(&self) -> Vec3 {
        Vec3::new(self.normal[0], self.normal[1], self.normal[2])
    }
}

/// A low face on the sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LowFace {
    /// Its map, counted from `rect`'s corner; `None` for slivers, which get no hits.
    pub(crate) frame: Option<Frame>,
    /// The least rectangle around the texels it owns; empty if it owns none.
    pub(crate) rect: Rect,
}

/// The sheet before anything is baked: who owns what.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    /// Texels across and down.
    pub(crate) size: u32,
    /// `[size * size]`: low face + 1, 0 = no triangle covers the texel's centre. Where charts overlap the lower face owns.
    pub(crate) owners: Vec<u32>,
    /// `[low face_count]`.
    pub(crate) faces: Vec<LowFace>,
    /// Texels that an earlier face owned already: 0 unless the layout overlaps.
    pub(crate) overlaps: u64,
}

impl Sheet {
    /// The sheet of `low` under the layout `uv` (`[vertex_count]`, in `[0, 1]`).
    pub(crate) fn new(low: &Mesh, uv: &[Vec2], size: u32) -> Sheet {
        let mut owners = vec![0u32; size as usize * size as usize];
        let mut overlaps = 0;
        let mut faces = Vec::with_capacity(low.face_count());
        for face in 0..low.face_count() {
            let texels = corner_texels(low, uv, face, size);
            let mut rect = Rect { x0: u32::MAX, y0: u32::MAX, x1: 0, y1: 0 };
            rasterise_exact(texels, Rect::whole(size, size), |x, y, _, _| {
                let owner = &mut owners[y as usize * size as usize + x as usize];
                if *owner != 0 {
                    overlaps += 1;
                    return;
                }
                *owner = face as u32 + 1;
                rect = Rect { x0: rect.x0.min(x), y0: rect.y0.min(y), x1: rect.x1.max(x + 1), y1: rect.y1.max(y + 1) };
            });
            if rect.x1 == 0 {
                rect = Rect { x0: 0, y0: 0, x1: 0, y1: 0 };
            }
            let map = TexelMap::new(low.face_positions(FaceId(face as u32)), texels);
            faces.push(LowFace { frame: map.map(|m| m.frame([rect.x0, rect.y0])), rect });
        }
        Sheet { size, owners, faces, overlaps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_sends_corners_to_their_texels_and_forgets_the_height() {
        let positions = [Vec3::new(1.0, 2.0, 3.0), Vec3::new(2.0, 2.5, 3.0), Vec3::new(1.0, 3.0, 3.7)];
        let texels = [Vec2::new(3.0, 90.0), Vec2::new(40.0, 70.0), Vec2::new(11.0, 20.0)];
        let map = TexelMap::new(positions, texels).expect("a triangle");
        let frame = map.frame([2, 10]);
        for (p, t) in positions.iter().zip(texels) {
            for k in [-0.3f32, 0.0, 2.0] {
                let lifted = *p + k * map.normal.as_vec3();
                assert!((map.texel(lifted) - t.as_dvec2()).length() < 1e-4);
                let (local, height) = frame.project(lifted);
                assert!((local + Vec2::new(2.0, 10.0) - t).length() < 1e-3);
                assert!((height - k).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn a_sliver_has_no_map() {
        let flat = [Vec3::ZERO, Vec3::X, Vec3::new(0.5, 1e-9, 0.0)];
        assert!(TexelMap::new(flat, [Vec2::ZERO, Vec2::X, Vec2::Y]).is_none());
        assert!(TexelMap::new([Vec3::ONE; 3], [Vec2::ZERO, Vec2::X, Vec2::Y]).is_none());
        let thin = [Vec3::ZERO, Vec3::X, Vec3::new(0.5, 1e-4, 0.0)];
        assert!(TexelMap::new(thin, [Vec2::ZERO, Vec2::X, Vec2::Y]).is_some());
    }
}
