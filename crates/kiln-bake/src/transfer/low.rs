//! The low surface as a bundle of lines: one for each sample of the sheet.
//!
//! A sample of face T with barycentric coordinates b has the line `o(b) + t d(b)`, where o is T's point and d mixes T's three corner
//! directions without normalising them, so both are linear in the sample's place (x, y) on the sheet. Then:
//!
//! ```text
//! moment  m = o x d                                           a quadratic in (x, y)
//! edge    E(x, y) = d . (p x q) + m . (q - p)                 which side of edge pq the line passes: its image is a conic
//! fold    J(b, t) = ((e1 + t f1) x (e2 + t f2)) . d(b)        lines of T cross where J changes sign (e: edges, f: of the directions)
//! ```
//!
//! Distances along a line are `t |d|`. A point v at height h over T's plane lies on the line of (x, y) only if its perpendicular foot
//! lies at `(x, y) + h s`, s the slope of d there. Slopes are quotients of linear functions with a positive denominator, so over T
//! they are extreme at its corners: that bounds the samples that a high triangle can reach, without approximation.

use glam::{DVec2, DVec3, Vec2, Vec3};
use kiln_asset::{FaceId, Mesh};
use rayon::prelude::*;

use super::options::{BakeOptions, Directions};

/// Greatest ratio of a triangle's longest edge to its height for which its normal still means something in `f32` positions.
const SLIVER_RATIO: f64 = 1e6;

/// Least cosine between a corner's direction and the face's normal; where one is less, the face goes by its own normal.
const STEEPEST: f64 = 0.05;

/// What of the way to the crossing of lines is used.
const CLIP_SHARE: f64 = 0.98;

/// Of the low mesh on one sheet, what lines need.
pub(crate) struct Low<'a> {
    pub(crate) mesh: &'a Mesh,
    /// `[vertex_count]` the layout.
    uv: &'a [Vec2],
    /// Which sheet of the layout.
    sheet: u32,
    /// Texels across and down.
    pub(crate) size: u32,
    /// Samples a texel has on each side.
    pub(crate) samples: u32,
    directions: Directions,
    /// `[point_count]`, for smooth directions.
    point_normals: Vec<Vec3>,
    /// `[point_count]` or empty: distance to the cage along the point's direction, object units.
    cage: Vec<f32>,
    front: f32,
    back: f32,
}

/// What is unusual about a face.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Oddities {
    /// Too thin for a normal.
    pub(crate) sliver: bool,
    /// No area on the sheet.
    pub(crate) flat: bool,
    /// A corner's direction lies across the face.
    pub(crate) steep: bool,
    /// Its lines cross within reach.
    pub(crate) crossing: bool,
}

/// The lines of one face. Places (x, y) are texels from `pixel`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lines {
    /// A whole texel near the face.
    pub(crate) pixel: [u32; 2],
    /// Corner 0 in object space; all points below are relative to it.
    pub(crate) base: DVec3,
    /// `o = origin[0] + x origin[1] + y origin[2]`.
    pub(crate) origin: [DVec3; 3],
    /// `d`, likewise.
    pub(crate) direction: [DVec3; 3],
    /// `m`: coefficients of 1, x, y, xx, xy, yy.
    pub(crate) moment: [DVec3; 6],
    /// Barycentric coordinates 1 and 2: coefficients of 1, x, y.
    bary: [[f64; 3]; 2],
    /// Greatest distance in front: coefficients of 1, x, y.
    pub(crate) front: [f64; 3],
    /// Greatest distance behind.
    pub(crate) back: f64,
    /// Greatest t in front and behind before lines cross.
    pub(crate) clip: [f64; 2],
    /// Unit normal.
    pub(crate) normal: DVec3,
    /// Texel of a point's foot: `foot + (rows[0] . p, rows[1] . p)`.
    rows: [DVec3; 2],
    foot: DVec2,
    /// Bounds of the slopes, texels a unit of height.
    slopes: [DVec2; 2],
    /// Greatest t on any line of the face, in front and behind.
    pub(crate) reach: [f64; 2],
    /// Corners, relative to `base`, and their directions.
    pub(crate) corners: [DVec3; 3],
    pub(crate) corner_directions: [DVec3; 3],
    /// Greatest component of a corner: for error bounds.
    pub(crate) extent: f64,
    /// Area on the sheet, square texels.
    pub(crate) texel_area: f64,
    odd: Oddities,
}

impl<'a> Low<'a> {
    pub(crate) fn new(
        mesh: &'a Mesh,
        uv: &'a [Vec2],
        sheet: u32,
        options: &BakeOptions,
        [front, back]: [f32; 2],
    ) -> Low<'a> {
        let directions = options.directions;
        let point_normals = match directions {
            Directions::Smooth => point_normals(mesh),
            Directions::Face | Directions::Mixed => Vec::new(),
        };
        let (size, samples) = (options.size, options.samples);
        Low { mesh, uv, sheet, size, samples, directions, point_normals, cage: Vec::new(), front, back }
    }

    /// Distances in front by a cage around the mesh: how far each point is from it along its direction. Where that meets no
    /// cage, the greatest distance stays.
    pub(crate) fn with_cage(mut self, cage: &Mesh) -> Low<'a> {
        let smooth = if self.point_normals.is_empty() { point_normals(self.mesh) } else { self.point_normals.clone() };
        let bvh = kiln_geom::Bvh::new(&cage.positions, &cage.triangles);
        let mut places = vec![Vec3::ZERO; self.mesh.point_count()];
        for (v, point) in self.mesh.points.iter().enumerate() {
            places[point.index()] = self.mesh.positions[v];
        }
        let far = cage.diagonal().max(self.mesh.diagonal());
        let distance = |(place, direction): (&Vec3, &Vec3)| {
            let hit = bvh.closest_hit(*place, *direction, 0.0, far);
            hit.map_or(self.front, |hit| hit.t)
        };
        self.cage = places.par_iter().zip(&smooth).map(distance).collect();
        self
    }

    /// Texels of a face's corners on this sheet.
    pub(crate) fn texels(&self, face: usize) -> [Vec2; 3] {
        let shift = Vec2::new(self.sheet as f32, 0.0);
        self.mesh.triangles[face].map(|v| (self.uv[v as usize] - shift) * self.size as f32)
    }

    /// Whether the face lies on this sheet.
    pub(crate) fn holds(&self, face: usize) -> bool {
        let corners = self.mesh.triangles[face].map(|v| self.uv[v as usize]);
        kiln_asset::UvLayout::sheet_of(corners) == self.sheet
    }

    /// The lines of a face; `None` if it has no normal or no area on the sheet.
    pub(crate) fn lines(&self, face: usize) -> Option<Lines> {
        self.look(face).ok()
    }

    pub(crate) fn oddities(&self, face: usize) -> Oddities {
        self.look(face).map_or_else(|odd| odd, |lines| lines.odd)
    }

    fn look(&self, face: usize) -> Result<Lines, Oddities> {
        let [p0, p1, p2] = self.mesh.face_positions(FaceId(face as u32)).map(|p| p.as_dvec3());
        let (e1, e2) = (p1 - p0, p2 - p0);
        let cross = e1.cross(e2);
        let square = cross.length_squared();
        let longest = e1.length_squared().max(e2.length_squared()).max((e2 - e1).length_squared());
        // |cross| = longest edge x height.
        if square.is_nan() || square * SLIVER_RATIO * SLIVER_RATIO <= longest * longest || square == 0.0 {
            return Err(Oddities { sliver: true, ..Oddities::default() });
        }
        let normal = cross / square.sqrt();
        let texels = self.texels(face).map(|t| t.as_dvec2());
        let floor = |c: f64| c.floor().clamp(0.0, f64::from(self.size)) as u32;
        let pixel = [
            floor(texels[0].x.min(texels[1].x).min(texels[2].x)),
            floor(texels[0].y.min(texels[1].y).min(texels[2].y)),
        ];
        let [t0, t1, t2] = texels.map(|t| t - DVec2::new(f64::from(pixel[0]), f64::from(pixel[1])));
        let (u1, u2) = (t1 - t0, t2 - t0);
        let area = u1.perp_dot(u2);
        if area == 0.0 || !area.is_finite() {
            return Err(Oddities { flat: true, ..Oddities::default() });
        }
        let (directions, steep) = self.corner_directions(face, normal);
        let [d0, d1, d2] = directions;
        let (f1, f2) = (d1 - d0, d2 - d0);

        // Barycentric coordinates as linear functions of the place.
        let linear = |gx: f64, gy: f64| [-(gx * t0.x + gy * t0.y), gx, gy];
        let bary = [linear(u2.y / area, -u2.x / area), linear(-u1.y / area, u1.x / area)];
        let spread = |v1: DVec3, v2: DVec3| [0, 1, 2].map(|k| v1 * bary[0][k] + v2 * bary[1][k]);
        let origin = spread(e1, e2);
        let mut direction = spread(f1, f2);
        direction[0] += d0;
        let [o, d] = [&origin, &direction];
        let moment = [
            o[0].cross(d[0]),
            o[0].cross(d[1]) + o[1].cross(d[0]),
            o[0].cross(d[2]) + o[2].cross(d[0]),
            o[1].cross(d[1]),
            o[1].cross(d[2]) + o[2].cross(d[1]),
            o[2].cross(d[2]),
        ];

        let far = self.corner_front(face);
        let front_spread = [0, 1, 2].map(|k| (far[1] - far[0]) * bary[0][k] + (far[2] - far[0]) * bary[1][k]);
        let front = [far[0] + front_spread[0], front_spread[1], front_spread[2]];
        let clip = crossing([e1, e2], [f1, f2], directions);
        let rises = directions.map(|d| d.dot(normal));
        // |d| is nowhere less than its part along the normal.
        let least = rises[0].min(rises[1]).min(rises[2]);
        let wanted = [far[0].max(far[1]).max(far[2]) / least, f64::from(self.back) / least];
        let reach = [wanted[0].min(clip[0]), wanted[1].min(clip[1])];

        // A point's barycentric coordinates 1 and 2, measured at its foot, are dot(row, p).
        let (row1, row2) = (e2.cross(cross) / square, cross.cross(e1) / square);
        let rows = [row1 * u1.x + row2 * u2.x, row1 * u1.y + row2 * u2.y];
        let slope = |d: DVec3| DVec2::new(rows[0].dot(d), rows[1].dot(d)) / d.dot(normal);
        let [s0, s1, s2] = directions.map(slope);
        let crossing = (0..2).any(|side| clip[side] < wanted[side]);
        Ok(Lines {
            pixel,
            base: p0,
            origin,
            direction,
            moment,
            bary,
            front,
            back: f64::from(self.back),
            clip,
            normal,
            rows,
            foot: t0,
            slopes: [s0.min(s1).min(s2), s0.max(s1).max(s2)],
            reach,
            corners: [DVec3::ZERO, e1, e2],
            corner_directions: directions,
            extent: e1.abs().max(e2.abs()).max_element(),
            texel_area: 0.5 * area.abs(),
            odd: Oddities { sliver: false, flat: false, steep, crossing },
        })
    }

    /// Unit directions of a face's corners, and whether they had to give way to its normal.
    fn corner_directions(&self, face: usize, normal: DVec3) -> ([DVec3; 3], bool) {
        let corners = match self.directions {
            Directions::Face => return ([normal; 3], false),
            Directions::Smooth => {
                self.mesh.face_points(FaceId(face as u32)).map(|p| self.point_normals[p.index()].as_dvec3())
            }
            Directions::Mixed => match &self.mesh.normals {
                Some(normals) => self.mesh.triangles[face].map(|v| normals[v as usize].as_dvec3().normalize_or_zero()),
                None => return ([normal; 3], false),
            },
        };
        if corners.iter().all(|d| d.dot(normal) >= STEEPEST) { (corners, false) } else { ([normal; 3], true) }
    }

    fn corner_front(&self, face: usize) -> [f64; 3] {
        if self.cage.is_empty() {
            return [f64::from(self.front); 3];
        }
        self.mesh.face_points(FaceId(face as u32)).map(|p| f64::from(self.cage[p.index()]))
    }
}

impl Lines {
    /// The place of a sample's centre. `sample`: column and row on the sheet of samples.
    #[inline]
    pub(crate) fn place(&self, sample: [u32; 2], samples: u32) -> DVec2 {
        // Samples are powers of two: exact, and no division.
        let step = match samples {
            1 => 1.0,
            2 => 0.5,
            4 => 0.25,
            _ => 0.125,
        };
        let at = |k: usize| (f64::from(sample[k]) + 0.5) * step - f64::from(self.pixel[k]);
        DVec2::new(at(0), at(1))
    }

    /// Origin (from `base`) and direction of the line at a place.
    #[inline]
    pub(crate) fn line(&self, at: DVec2) -> (DVec3, DVec3) {
        let [o, d] = [&self.origin, &self.direction];
        (o[0] + o[1] * at.x + o[2] * at.y, d[0] + d[1] * at.x + d[2] * at.y)
    }

    /// Greatest t in front and behind for the line at a place whose direction has this length.
    #[inline]
    pub(crate) fn limits(&self, at: DVec2, length: f64) -> [f64; 2] {
        let front = self.front[0] + self.front[1] * at.x + self.front[2] * at.y;
        [(front / length).min(self.clip[0]), (self.back / length).min(self.clip[1])]
    }

    /// Barycentric coordinates of a place.
    #[inline]
    pub(crate) fn bary(&self, at: DVec2) -> [f64; 3] {
        let [b1, b2] = self.bary.map(|b| b[0] + b[1] * at.x + b[2] * at.y);
        [1.0 - b1 - b2, b1, b2]
    }

    /// Whether the triangle faces none of the lines: their directions lie between the corners'.
    #[inline]
    pub(crate) fn behind(&self, [a, b, c]: &[DVec3; 3]) -> bool {
        let normal = (*b - *a).cross(*c - *a);
        self.corner_directions.iter().all(|d| d.dot(normal) <= 0.0)
    }

    /// Places from which lines can reach the triangle (corners from `base`): least and greatest; `None`: none within reach.
    #[inline]
    pub(crate) fn places(&self, corners: &[DVec3; 3]) -> Option<[DVec2; 2]> {
        let rises = self.corner_directions.map(|d| d.dot(self.normal));
        let most = rises[0].max(rises[1]).max(rises[2]);
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let (mut above, mut below) = (true, true);
        for p in corners {
            let h = self.normal.dot(*p);
            above &= h > self.reach[0] * most;
            below &= h < -self.reach[1] * most;
            let foot = self.foot + DVec2::new(self.rows[0].dot(*p), self.rows[1].dot(*p));
            let (a, b) = (foot - h * self.slopes[0], foot - h * self.slopes[1]);
            lo = lo.min(a.min(b));
            hi = hi.max(a.max(b));
        }
        if above || below { None } else { Some([lo, hi]) }
    }
}

/// How far t may go in front and behind before two lines of a face cross. `edges` and `spread`: from corner 0 to 1 and 2, of points
/// and of directions.
fn crossing([e1, e2]: [DVec3; 2], [f1, f2]: [DVec3; 2], directions: [DVec3; 3]) -> [f64; 2] {
    let [c0, c1, c2] = [e1.cross(e2), e1.cross(f2) + f1.cross(e2), f1.cross(f2)];
    let mut clip = [f64::INFINITY; 2];
    for d in directions {
        // J at a corner, a quadratic in t that is positive at 0; linear in between, so corners bound it.
        let (a, b, c) = (d.dot(c2), d.dot(c1), d.dot(c0));
        for root in roots(a, b, c) {
            let side = usize::from(root < 0.0);
            clip[side] = clip[side].min(CLIP_SHARE * root.abs());
        }
    }
    clip
}

/// Real roots of `a t^2 + b t + c`; NaN where there is none.
fn roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return [f64::NAN; 2];
    }
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    // A vanishing divisor sends a root to infinity, where it harms nobody; 0 / 0 gives NaN, and min drops that.
    [q / a, c / q]
}

/// `[point_count]` mean of the wedges' normals, weighted by the angle at the corner, unit length; zero where they cancel.
fn point_normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; mesh.point_count()];
    let Some(normals) = &mesh.normals else { return sums.iter().map(|s| s.as_vec3()).collect() };
    for (face, triangle) in mesh.triangles.iter().enumerate() {
        let p = mesh.face_positions(FaceId(face as u32)).map(|p| p.as_dvec3());
        for k in 0..3 {
            let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
            let angle = kiln_geom::math::atan2(a.cross(b).length() as f32, a.dot(b) as f32);
            let v = triangle[k] as usize;
            sums[mesh.points[v].index()] += f64::from(angle) * normals[v].as_dvec3().normalize_or_zero();
        }
    }
    sums.iter().map(|s| s.normalize_or_zero().as_vec3()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_a_cone_cross_at_its_tip() {
        // Directions that lean inwards meet at height 2 over the middle.
        let p = [DVec3::new(1.0, 0.0, 0.0), DVec3::new(-0.5, 0.8, 0.0), DVec3::new(-0.5, -0.8, 0.0)];
        let tip = DVec3::new(0.0, 0.0, 2.0);
        let d = p.map(|p| (tip - p).normalize());
        let [front, back] = crossing([p[1] - p[0], p[2] - p[0]], [d[1] - d[0], d[2] - d[0]], d);
        let least = p.map(|p| (tip - p).length()).into_iter().fold(f64::INFINITY, f64::min);
        assert!(front <= least && front > 0.9 * CLIP_SHARE * least, "{front} for {least}");
        assert!(back > 10.0, "{back}");
        assert_eq!(crossing([p[1] - p[0], p[2] - p[0]], [DVec3::ZERO; 2], [DVec3::Z; 3]), [f64::INFINITY; 2]);
    }

    #[test]
    fn roots_of_quadratics_lines_and_constants() {
        let mut found = roots(1.0, -3.0, 2.0);
        found.sort_by(f64::total_cmp);
        assert_eq!(found, [1.0, 2.0]);
        assert!(roots(1.0, 0.0, 1.0).iter().all(|r| r.is_nan()));
        assert!(roots(0.0, 2.0, -1.0).contains(&0.5));
        assert!(roots(0.0, 0.0, 1.0).iter().all(|r| !r.is_finite()));
    }
}
