//! Faces near a box or a convex body, conservatively: by separating axes.

use glam::Vec3;

use super::Bvh;

impl Bvh {
    /// Every face whose bounding box meets the closed box from `lo` to `hi` (object units), in any order.
    pub fn overlapping(&self, lo: Vec3, hi: Vec3, mut visit: impl FnMut(u32)) {
        let meets = |l: Vec3, h: Vec3| l.cmple(hi).all() && h.cmpge(lo).all();
        self.descend(
            |node| meets(node.lo, node.hi),
            |position| {
                let [a, b, c] = self.corners[position];
                if meets(a.min(b).min(c), a.max(b).max(c)) {
                    visit(self.faces[position]);
                }
            },
        );
    }

    /// Faces that may meet the prism swept by `triangle` from `-below normal` to `+above normal` (object units; `normal`
    /// of unit length): those whose bounding box no axis separates from it. `out` is cleared, then sorted ascending.
    pub fn overlapping_prism(&self, triangle: [Vec3; 3], normal: Vec3, below: f32, above: f32, out: &mut Vec<u32>) {
        let [a, b, c] = triangle;
        let points = [-below, above].map(|h| triangle.map(|p| p + h * normal));
        let axes = [(b - a).cross(c - a), (b - a).cross(normal), (c - b).cross(normal), (a - c).cross(normal)];
        self.overlapping_hull(points.as_flattened(), &axes, out);
    }

    /// Faces that may meet the convex hull of `points` (object space): those whose bounding box neither the coordinate axes
    /// nor any of `axes` (of any length; zero ones are skipped) separate from it. `out` is cleared, then sorted ascending.
    pub fn overlapping_hull(&self, points: &[Vec3], axes: &[Vec3], out: &mut Vec<u32>) {
        out.clear();
        let Some(first) = points.first() else { return };
        let (lo, hi) = points.iter().fold((*first, *first), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        // A few roundings of the coordinates in play, so that touching counts as meeting.
        let slack = 8.0 * f32::EPSILON * self.reach.max(lo.abs().max(hi.abs()).max_element());
        let (lo, hi) = (lo - slack, hi + slack);
        let slabs: Vec<(Vec3, f32, f32)> = axes
            .iter()
            .filter_map(|axis| axis.try_normalize())
            .map(|axis| {
                let (mut least, mut most) = (f32::INFINITY, f32::NEG_INFINITY);
                for p in points {
                    let at = axis.dot(*p);
                    (least, most) = (least.min(at), most.max(at));
                }
                (axis, least - 4.0 * slack, most + 4.0 * slack)
            })
            .collect();
        let meets = |l: Vec3, h: Vec3| {
            if !(l.cmple(hi).all() && h.cmpge(lo).all()) {
                return false;
            }
            let (centre, half) = (0.5 * (l + h), 0.5 * (h - l));
            slabs.iter().all(|(axis, least, most)| {
                let (at, reach) = (axis.dot(centre), axis.abs().dot(half));
                at - reach <= *most && at + reach >= *least
            })
        };
        self.descend(
            |node| meets(node.lo, node.hi),
            |position| {
                let [a, b, c] = self.corners[position];
                if meets(a.min(b).min(c), a.max(b).max(c)) {
                    out.push(self.faces[position]);
                }
            },
        );
        out.sort_unstable();
    }
}
