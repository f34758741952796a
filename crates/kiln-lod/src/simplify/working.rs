//! A mesh, or a part of one, while it is collapsed: points, faces and the corners at a point, what forbids a collapse, and doing one.
//!
//! Ids are its own ([`Names`] has the mesh's), in the order of [`super::rest`].
//!
//! **Layout.** A point is one cache line ([`Point`]); a face half of one; the corners at a point lie together in one pool, moved
//! to its end with room to grow when they outgrow their place.

use glam::{DVec3, Vec2, Vec3};
use kiln_asset::{Mesh, SubmeshId, UvLayout};

use super::collapse::State;
use super::heap::rank;
use super::rules::Rule;
use super::texture_border::StarFace;
use super::uv_border::UvBorder;
use super::{Boundary, SimplifyOptions};
use crate::topology::{NONE, PointKind, same_chart};

/// All that the neighbours of a point ask of it.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Point {
    pub(super) position: Vec3,
    /// What the metric says of the point where it stands.
    pub(super) own: f32,
    /// Its corners: where they start in the pool, how many there are, how many fit.
    pub(super) first: u32,
    pub(super) count: u32,
    pub(super) room: u32,
    /// Rank of its entry in the queue.
    pub(super) rank: u32,
    /// Its two neighbours along its line, or [`NONE`].
    pub(super) line: [u32; 2],
    /// Greatest place in the log of a collapse that changed its star.
    pub(super) since: u32,
    pub(super) mark: u32,
    pub(super) kind: PointKind,
    pub(super) state: State,
    /// Whether it has several wedges.
    pub(super) parted: bool,
    /// Whether some of its faces lie in another part: then it neither goes nor takes others in.
    pub(super) held: bool,
    /// Whether faces beyond the mesh hang on it: then no new edge may lead from it to another such point.
    pub(super) fixed: bool,
}

/// Faces at a point above which its attributes are priced by one side of an edge.
const HUB: u32 = 64;

/// Corners of a face are `CORNER * face + k`, so that both are told by shifts.
pub(super) const CORNER: u32 = 4;

/// A face and which of its corners.
#[inline]
fn split(corner: u32) -> (usize, usize) {
    ((corner / CORNER) as usize, (corner % CORNER) as usize)
}

/// The corner after `k`, and the one before it: two bits each.
#[inline]
fn after(k: usize) -> usize {
    0b00_10_01 >> (2 * k) & 3
}

#[inline]
fn before(k: usize) -> usize {
    0b01_00_10 >> (2 * k) & 3
}

/// A face; `points[0]` is [`NONE`] once it has vanished. The fourth of each is padding: two bits are an index without a test, and no
/// face lies in two cache lines.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
pub(super) struct Face {
    pub(super) points: [u32; 4],
    pub(super) wedges: [u32; 4],
}

/// The mesh's ids of a part's points, faces and wedges.
pub(super) struct Names {
    pub(super) points: Vec<u32>,
    pub(super) faces: Vec<u32>,
    pub(super) wedges: Vec<u32>,
}

pub(super) struct Working<'a> {
    mesh: &'a Mesh,
    options: &'a SimplifyOptions,
    pub(super) names: Names,
    /// By wedge.
    submesh: Vec<u32>,
    pub(super) points: Vec<Point>,
    pub(super) faces: Vec<Face>,
    /// Corners by point.
    pub(super) pool: Vec<u32>,
    /// By wedge.
    uv: Option<Vec<Vec2>>,
    /// By point: by how much dearer than others it is to go; empty where none is.
    importance: Vec<f32>,
    uv_border: Option<UvBorder>,
    stamp: u32,
    /// (wedge that goes, wedge that stays) of the collapse at hand.
    pub(super) map: Vec<[u32; 2]>,
    /// Neighbours of the point that goes.
    pub(super) ring: Vec<u32>,
    /// Faces that vanished at the last collapse.
    pub(super) vanished: Vec<u32>,
}

impl<'a> Working<'a> {
    /// A part: `names` of its points, faces and wedges, and these; `submesh` by wedge, `pool` the corners by point.
    pub(super) fn new(
        mesh: &'a Mesh,
        options: &'a SimplifyOptions,
        names: Names,
        submesh: Vec<u32>,
        points: Vec<Point>,
        faces: Vec<Face>,
        pool: Vec<u32>,
    ) -> Working<'a> {
        let uv = mesh.atlas_uv.as_deref().or(mesh.uv0.as_deref());
        let uv = uv.map(|uv| names.wedges.iter().map(|w| uv[*w as usize]).collect());
        let importance = mesh.importance.as_ref().map_or_else(Vec::new, |importance| {
            // The greatest of its wedges.
            let mut of_point = vec![0.0_f32; points.len()];
            for face in &faces {
                for k in 0..3 {
                    // Without its sign: that of a zero would be one of a cost.
                    let of_wedge = importance[names.wedges[face.wedges[k] as usize] as usize].abs();
                    let of_point = &mut of_point[face.points[k] as usize];
                    *of_point = of_point.max(of_wedge);
                }
            }
            of_point
        });
        Working {
            mesh,
            options,
            names,
            submesh,
            points,
            faces,
            pool,
            uv,
            importance,
            uv_border: None,
            stamp: 0,
            map: Vec::new(),
            ring: Vec::new(),
            vanished: Vec::new(),
        }
    }

    /// Holds chart borders in the place that they have in `layout`.
    pub(super) fn hold_borders(&mut self, layout: &UvLayout) {
        self.uv_border = Some(UvBorder::new(self.mesh, layout, &self.names.wedges));
    }

    /// Cosine between the normals of two wedges; 1 where the mesh has none.
    fn normal_likeness(&self, a: u32, b: u32) -> f32 {
        let normal = |normals: &Vec<Vec3>, w: u32| normals[self.names.wedges[w as usize] as usize];
        self.mesh.normals.as_ref().map_or(1.0, |normals| normal(normals, a).dot(normal(normals, b)))
    }

    /// Whether two wedges of one point differ in normal and tangent at most.
    fn same_chart(&self, a: u32, b: u32) -> bool {
        a == b || same_chart(self.mesh, self.names.wedges[a as usize], self.names.wedges[b as usize])
    }

    /// The corners at `p`.
    #[inline]
    pub(super) fn corners(&self, p: u32) -> &[u32] {
        let point = &self.points[p as usize];
        &self.pool[point.first as usize..(point.first + point.count) as usize]
    }

    /// The other two points of a corner's face, in winding order.
    #[inline]
    pub(super) fn others(&self, corner: u32) -> [u32; 2] {
        let (f, k) = split(corner);
        let face = &self.faces[f].points;
        [face[after(k)], face[before(k)]]
    }

    /// A corner at `from` whose face holds `to`.
    fn corner_towards(&self, from: u32, to: u32) -> Option<u32> {
        self.corners(from).iter().copied().find(|corner| self.others(*corner).contains(&to))
    }

    /// The wedge at a corner of `from`, and the wedge that the same face has at `to`.
    #[inline]
    fn pair(&self, corner: u32, to: u32) -> [u32; 2] {
        let (f, k) = split(corner);
        let face = &self.faces[f];
        [face.wedges[k], face.wedges[if face.points[after(k)] == to { after(k) } else { before(k) }]]
    }

    /// The pairs of wedges on both sides of the edge; one where they are the same or there is one side. `corner` as for a cost.
    #[inline]
    pub(super) fn pairs_beside(&self, from: u32, to: u32, corner: u32) -> [Option<[u32; 2]>; 2] {
        let known = (corner != NONE).then_some(corner).or_else(|| self.corner_towards(from, to));
        let Some(corner) = known else { return [None; 2] };
        let pair = self.pair(corner, to);
        // Asking all faces for each target of a hub would take the square of their number; there one side speaks for both.
        if !self.points[from as usize].parted || self.points[from as usize].count > HUB {
            return [Some(pair), None];
        }
        let other = self.corners(from).iter().find(|c| **c != corner && self.others(**c).contains(&to));
        let other = other.map(|other| self.pair(*other, to)).filter(|other| other[0] != pair[0]);
        [Some(pair), other]
    }

    /// By how much dearer than others it is for `from` to go: unitless, 0 or more.
    #[inline]
    pub(super) fn importance(&self, from: u32) -> f32 {
        self.importance.get(from as usize).copied().unwrap_or(1.0)
    }

    /// The cost of `from` by its importance.
    #[inline]
    pub(super) fn weighed(&self, from: u32, cost: f32) -> f32 {
        self.importance(from) * cost
    }

    /// Rank of a cost of `from`.
    #[inline]
    pub(super) fn ranked(&self, from: u32, cost: f32) -> u32 {
        // The sign bit of a cost is free: with it set, a rank lies behind all others.
        let last = self.options.boundary == Boundary::Last && self.points[from as usize].kind == PointKind::Boundary;
        rank(self.weighed(from, cost)) | u32::from(last) << 31
    }

    /// The faces at `from`, as the texture-border extension reads them.
    pub(super) fn star(&self, from: u32, to: u32) -> impl Iterator<Item = StarFace> + Clone + '_ {
        self.corners(from).iter().map(move |corner| {
            let (f, k) = split(*corner);
            let (face, around) = (&self.faces[f], [k, after(k), before(k)]);
            let wedges = around.map(|i| face.wedges[i]);
            StarFace {
                submesh: SubmeshId(self.submesh[wedges[0] as usize]),
                wedges: wedges.map(|w| self.names.wedges[w as usize]),
                places: around.map(|i| self.points[face.points[i] as usize].position.as_dvec3()),
                to: (1..3).find(|i| face.points[around[*i]] == to),
            }
        })
    }

    /// The point beside `from` on its line that is not `to`.
    pub(super) fn line_end(&self, from: u32, to: u32) -> u32 {
        let line = self.points[from as usize].line;
        if line[0] == to { line[1] } else { line[0] }
    }

    /// The rule that forbids taking `from` to `to`; fills `map` with the partners of its wedges.
    /// `place`: where `to` goes then, if not where it is.
    pub(super) fn test(&mut self, from: u32, to: u32, place: Option<DVec3>) -> Option<Rule> {
        self.test_link(from, to).or_else(|| self.test_shape(from, to, place))
    }

    /// Link condition: the points beside both ends are the third points of the dying faces and no others, and no face falls
    /// onto another. Fills `map` with the wedges of the dying faces.
    fn test_link(&mut self, from: u32, to: u32) -> Option<Rule> {
        let (beside, apex) = (self.stamp + 1, self.stamp + 2);
        self.stamp += 2;
        self.map.clear();
        let (start, count) = (self.points[from as usize].first as usize, self.points[from as usize].count as usize);
        let closed_fan = self.points[from as usize].kind == PointKind::Manifold;
        let mut dying = 0;
        for i in start..start + count {
            let corner = self.pool[i];
            let [a, b] = self.others(corner);
            if a != to && b != to {
                // In a closed fan every neighbour comes first once.
                for p in [a, b].into_iter().take(if closed_fan { 1 } else { 2 }) {
                    let mark = &mut self.points[p as usize].mark;
                    *mark = (*mark).max(beside);
                }
                continue;
            }
            dying += 1;
            let third = &mut self.points[if a == to { b } else { a } as usize].mark;
            if *third == apex {
                return Some(Rule::Link);
            }
            *third = apex;
            let (f, k) = split(corner);
            let wedges = &self.faces[f].wedges;
            let (wedge, partner) = (wedges[k], wedges[if a == to { after(k) } else { before(k) }]);
            match self.map.iter().position(|m| m[0] == wedge) {
                Some(at) if self.map[at][1] == partner => {}
                // A crease runs through `to`: the side whose normal is nearer takes the wedge.
                Some(at) if self.same_chart(self.map[at][1], partner) => {
                    let (likeness, old) = (|p: u32| self.normal_likeness(wedge, p), self.map[at][1]);
                    if likeness(partner).total_cmp(&likeness(old)).then(old.cmp(&partner)).is_gt() {
                        self.map[at][1] = partner;
                    }
                }
                Some(_) => return Some(Rule::Partner),
                None => self.map.push([wedge, partner]),
            }
        }
        if dying == 0 {
            return Some(Rule::Link);
        }
        // `to` has a face over both third points; then `from` may not have one.
        let (mut closed, mut third_is_held) = (false, false);
        for corner in self.corners(to) {
            let others = self.others(*corner);
            if others.contains(&from) {
                continue;
            }
            let marks = others.map(|p| self.points[p as usize].mark);
            if marks.contains(&beside) {
                return Some(Rule::Link);
            }
            third_is_held |= marks.contains(&apex);
            closed |= marks == [apex; 2];
        }
        let closes = |corner: &u32| self.others(*corner).iter().all(|p| self.points[*p as usize].mark == apex);
        if (closed && self.corners(from).iter().any(closes)) || (dying == count && !third_is_held) {
            return Some(Rule::Link);
        }
        // What lies beyond the mesh may have that edge.
        let fixed = |p: &u32| self.points[*p as usize].fixed && self.points[*p as usize].mark == beside;
        if self.points[to as usize].fixed && self.corners(from).iter().any(|c| self.others(*c).iter().any(fixed)) {
            return Some(Rule::Link);
        }
        // A line must keep three points.
        let end = self.line_end(from, to);
        (end != NONE && self.points[to as usize].line.contains(&end)).then_some(Rule::Link)
    }

    /// Whether every wedge has its partner and every face keeps its shape. Completes `map`.
    fn test_shape(&mut self, from: u32, to: u32, place: Option<DVec3>) -> Option<Rule> {
        let [source, stays] = [from, to].map(|p| self.points[p as usize].position.as_dvec3());
        let target = place.unwrap_or(stays);
        let (start, count) = (self.points[from as usize].first as usize, self.points[from as usize].count as usize);
        for i in start..start + count {
            let corner = self.pool[i];
            let [a, b] = self.others(corner);
            if a == to || b == to {
                continue;
            }
            let (f, k) = split(corner);
            let wedge = self.faces[f].wedges[k];
            let partner = match self.map.iter().find(|m| m[0] == wedge) {
                Some(m) => m[1],
                None => match self.partner_across_crease(wedge, to) {
                    Some(partner) => {
                        self.map.push([wedge, partner]);
                        partner
                    }
                    None => return Some(Rule::Partner),
                },
            };
            if let Some(rule) = self.reshape([a, b], source, target).or_else(|| self.reshape_uv(f, k, partner)) {
                return Some(rule);
            }
        }
        if place.is_some() {
            for corner in self.corners(to) {
                let [a, b] = self.others(*corner);
                if a != from
                    && b != from
                    && let Some(rule) = self.reshape([a, b], stays, target)
                {
                    return Some(rule);
                }
            }
        }
        let guard = self.uv_border.as_ref()?;
        let on_line = self.points[from as usize].line != [NONE; 2];
        (on_line && !guard.allows(&self.map, |end| self.line_other(from, to, end))).then_some(Rule::UvBorder)
    }

    /// The partner of a wedge that no dying face uses, since creases cut its side into several wedges: of the wedges at `to` in
    /// the chart that the side's dying face leads to, the one with the nearest normal, then the lowest.
    #[cold]
    fn partner_across_crease(&self, wedge: u32, to: u32) -> Option<u32> {
        let submesh = self.submesh[wedge as usize];
        let anchor =
            self.map.iter().find(|m| self.submesh[m[0] as usize] == submesh && self.same_chart(m[0], wedge))?[1];
        let mut best: Option<(f32, u32)> = None;
        for corner in self.corners(to) {
            let (f, k) = split(*corner);
            let candidate = self.faces[f].wedges[k];
            // Wedges of another submesh may have equal attributes; a vertex belongs to one submesh.
            let fits = self.submesh[candidate as usize] == submesh && self.same_chart(candidate, anchor);
            let offered = (self.normal_likeness(wedge, candidate), candidate);
            if fits && best.is_none_or(|b| offered.0.total_cmp(&b.0).then(b.1.cmp(&offered.1)).is_gt()) {
                best = Some(offered);
            }
        }
        best.map(|b| b.1)
    }

    /// What forbids the corner at `p` of the face (p, a, b) to go to `q`.
    #[inline(always)]
    fn reshape(&self, [a, b]: [u32; 2], p: DVec3, q: DVec3) -> Option<Rule> {
        let [a, b] = [a, b].map(|i| self.points[i as usize].position.as_dvec3());
        let (side, old, new) = (b - a, p - a, q - a);
        let (old_normal, new_normal) = (side.cross(old), side.cross(new));
        let (old_square, new_square) = (old_normal.length_squared(), new_normal.length_squared());
        if old_normal.dot(new_normal) < self.options.turn_cosine * (old_square * new_square).sqrt()
            || (old_square > 0.0 && new_square <= 0.0)
        {
            return Some(Rule::Turn);
        }
        // Shape: twice the area over the square of the longest edge; a face may not become both thin and much thinner than it
        // was. Compared as squares.
        let side_square = side.length_squared();
        let longest = |c: DVec3, to_a: DVec3| to_a.length_squared().max((c - b).length_squared()).max(side_square);
        let new_longest = longest(q, new);
        if new_square >= (self.options.sliver * new_longest).powi(2) {
            return None;
        }
        let old_longest = longest(p, old);
        (new_square * old_longest * old_longest < 0.25 * old_square * new_longest * new_longest).then_some(Rule::Sliver)
    }

    /// What forbids face `f`'s corner `k` to take the UVs of the wedge `partner`.
    #[inline]
    fn reshape_uv(&self, f: usize, k: usize, partner: u32) -> Option<Rule> {
        let uv = self.uv.as_ref()?;
        let wedges = self.faces[f].wedges;
        let [p, c, d, q] = [wedges[k], wedges[after(k)], wedges[before(k)], partner].map(|w| uv[w as usize].as_dvec2());
        let (old, new) = ((d - c).perp_dot(p - c), (d - c).perp_dot(q - c));
        (old * new < 0.0 || (old != 0.0 && new == 0.0)).then_some(Rule::UvTurn)
    }

    /// The wedge of the line's other neighbour in a face that uses wedge `end` of `from`.
    fn line_other(&self, from: u32, to: u32, end: u32) -> Option<u32> {
        let other = self.line_end(from, to);
        self.corners(from).iter().find_map(|corner| {
            let (f, k) = split(*corner);
            let face = &self.faces[f];
            if face.wedges[k] != end {
                return None;
            }
            [after(k), before(k)].into_iter().find(|k| face.points[*k] == other).map(|k| face.wedges[k])
        })
    }

    /// Takes `from`, whose partners are in `map`, to `to`.
    pub(super) fn collapse(&mut self, from: u32, to: u32) {
        if self.points[from as usize].line != [NONE; 2]
            && let Some(mut guard) = self.uv_border.take()
        {
            guard.applied(&self.map, |end| self.line_other(from, to, end));
            self.uv_border = Some(guard);
        }
        self.move_faces(from, to);
        let end = self.line_end(from, to);
        if end != NONE {
            for (point, with) in [(end, to), (to, end)] {
                for slot in &mut self.points[point as usize].line {
                    if *slot == from {
                        *slot = with;
                    }
                }
            }
        }
        self.points[from as usize].count = 0;
    }

    /// Drops the faces at both ends, gives those at `from` alone to `to`, and notes the neighbours of `from` in `ring`.
    fn move_faces(&mut self, from: u32, to: u32) {
        self.ring.clear();
        self.vanished.clear();
        self.stamp += 1;
        let seen = self.stamp;
        self.points[to as usize].mark = seen;
        let Point { first, count, .. } = self.points[from as usize];
        let mut moved = first;
        for i in first..first + count {
            let corner = self.pool[i as usize];
            let (f, k) = split(corner);
            let others = self.others(corner);
            for p in others {
                let mark = &mut self.points[p as usize].mark;
                if *mark != seen {
                    *mark = seen;
                    self.ring.push(p);
                }
            }
            if others.contains(&to) {
                self.vanished.push(f as u32);
                self.faces[f].points = [NONE; 4];
                self.drop_corner(if others[0] == to { others[1] } else { others[0] }, f as u32);
                self.drop_corner(to, f as u32);
                continue;
            }
            let face = &mut self.faces[f];
            face.points[k] = to;
            if let Some(m) = self.map.iter().find(|m| m[0] == face.wedges[k]) {
                face.wedges[k] = m[1];
            }
            self.pool[moved as usize] = corner;
            moved += 1;
        }
        let added = moved - first;
        let stays = &mut self.points[to as usize];
        if stays.count + added > stays.room {
            let old = stays.first as usize..(stays.first + stays.count) as usize;
            stays.first = self.pool.len() as u32;
            // Half as much again as it holds, so that a hub is copied seldom.
            stays.room = (stays.count + added) * 3 / 2 + 2;
            self.pool.extend_from_within(old);
            self.pool.resize((stays.first + stays.room) as usize, NONE);
        }
        let end = (stays.first + stays.count) as usize;
        stays.count += added;
        self.pool.copy_within(first as usize..moved as usize, end);
    }

    /// Takes the corner of face `f` out of the corners at `p`; the last one fills its place.
    fn drop_corner(&mut self, p: u32, f: u32) {
        let point = &mut self.points[p as usize];
        let corners = &mut self.pool[point.first as usize..(point.first + point.count) as usize];
        if let Some(at) = corners.iter().position(|corner| corner / CORNER == f) {
            corners[at] = corners[corners.len() - 1];
            point.count -= 1;
        }
    }
}
