//! The mesh while it is collapsed: points, faces and the corners at a point, what forbids a collapse, and doing one.
//!
//! **Layout.** A point is one cache line ([`Point`]); a face is 24 bytes; the corners at a point lie together in one pool, moved
//! to its end with room to grow when they outgrow their place.

use glam::{DVec3, Vec2, Vec3};
use kiln_asset::{Mesh, SubmeshId, UvLayout};

use super::collapse::State;
use super::heap::rank;
use super::rules::Rule;
use super::texture_border::StarFace;
use super::uv_border::UvBorder;
use super::{Boundary, SimplifyOptions};
use crate::topology::{NONE, PointKind, Topology, is_degenerate, same_chart};

/// Cosine between the normals of two wedges; 1 where the mesh has none.
fn normal_likeness(mesh: &Mesh, a: u32, b: u32) -> f32 {
    mesh.normals.as_ref().map_or(1.0, |normals| normals[a as usize].dot(normals[b as usize]))
}

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
    room: u32,
    /// Rank of its entry in the queue.
    pub(super) rank: u32,
    /// Its two neighbours along its line, or [`NONE`].
    pub(super) line: [u32; 2],
    mark: u32,
    pub(super) kind: PointKind,
    pub(super) state: State,
    /// Whether it has several wedges.
    parted: bool,
}

/// Faces at a point above which its attributes are priced by one side of an edge.
const HUB: u32 = 64;

/// A face; `points[0]` is [`NONE`] once it has vanished.
#[derive(Clone, Copy)]
pub(super) struct Face {
    pub(super) points: [u32; 3],
    pub(super) wedges: [u32; 3],
}

pub(super) struct Working<'a> {
    mesh: &'a Mesh,
    options: &'a SimplifyOptions,
    /// `[vertex_count]`.
    submesh: Vec<u32>,
    pub(super) points: Vec<Point>,
    pub(super) faces: Vec<Face>,
    /// Corners by point.
    pub(super) pool: Vec<u32>,
    uv: Option<&'a [Vec2]>,
    uv_border: Option<UvBorder<'a>>,
    stamp: u32,
    /// (wedge that goes, wedge that stays) of the collapse at hand.
    pub(super) map: Vec<[u32; 2]>,
    /// Neighbours of the point that goes.
    pub(super) ring: Vec<u32>,
    /// Faces that vanished at the last collapse.
    pub(super) vanished: Vec<u32>,
}

impl<'a> Working<'a> {
    /// `positions`: `[point_count]`.
    pub(super) fn new(
        mesh: &'a Mesh,
        topology: &Topology,
        positions: &[DVec3],
        layout: Option<&UvLayout>,
        options: &'a SimplifyOptions,
    ) -> Working<'a> {
        let mut points: Vec<Point> = (0..positions.len())
            .map(|p| {
                let (first, count) = (topology.first[p], topology.first[p + 1] - topology.first[p]);
                Point {
                    position: positions[p].as_vec3(),
                    own: 0.0,
                    first,
                    count,
                    room: count,
                    rank: 0,
                    line: topology.lines[p],
                    mark: 0,
                    kind: match topology.kinds[p] {
                        PointKind::Boundary if options.boundary == Boundary::Lock => PointKind::Locked,
                        kind => kind,
                    },
                    state: State::Out,
                    parted: false,
                }
            })
            .collect();
        let mut seen = vec![false; points.len()];
        for p in &mesh.points {
            let seen = &mut seen[p.index()];
            points[p.index()].parted |= *seen;
            *seen = true;
        }
        let sound = |(points, wedges): (&[u32; 3], &[u32; 3])| Face {
            points: if is_degenerate(points) { [NONE; 3] } else { *points },
            wedges: *wedges,
        };
        let mut submesh = vec![NONE; mesh.vertex_count()];
        for (triangle, s) in mesh.triangles.iter().zip(&mesh.face_submesh) {
            for v in triangle {
                submesh[*v as usize] = s.0;
            }
        }
        Working {
            mesh,
            options,
            submesh,
            points,
            faces: topology.face_points.iter().zip(&mesh.triangles).map(sound).collect(),
            pool: topology.corners.clone(),
            uv: mesh.atlas_uv.as_deref().or(mesh.uv0.as_deref()),
            uv_border: layout.map(|layout| UvBorder::new(mesh, layout)),
            stamp: 0,
            map: Vec::new(),
            ring: Vec::new(),
            vanished: Vec::new(),
        }
    }

    /// Keeps the points `locked` (empty, or `[point_count]`) where they are; others may come to them.
    pub(super) fn lock(&mut self, locked: &[bool]) {
        for (point, locked) in self.points.iter_mut().zip(locked) {
            if *locked {
                point.kind = PointKind::Locked;
            }
        }
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
        let (f, k) = (corner as usize / 3, corner as usize % 3);
        let face = &self.faces[f].points;
        [face[(k + 1) % 3], face[(k + 2) % 3]]
    }

    /// A corner at `from` whose face holds `to`.
    fn corner_towards(&self, from: u32, to: u32) -> Option<u32> {
        self.corners(from).iter().copied().find(|corner| self.others(*corner).contains(&to))
    }

    /// The wedge at a corner of `from`, and the wedge that the same face has at `to`.
    #[inline]
    fn pair(&self, corner: u32, to: u32) -> [u32; 2] {
        let (f, k) = (corner as usize / 3, corner as usize % 3);
        let face = &self.faces[f];
        let next = (k + 1) % 3;
        [face.wedges[k], face.wedges[if face.points[next] == to { next } else { (k + 2) % 3 }]]
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

    /// Rank of a cost of `from`.
    #[inline]
    pub(super) fn ranked(&self, from: u32, cost: f32) -> u32 {
        // The sign bit of a cost is free: with it set, a rank lies behind all others.
        let last = self.options.boundary == Boundary::Last && self.points[from as usize].kind == PointKind::Boundary;
        rank(cost) | u32::from(last) << 31
    }

    /// The faces at `from`, as the texture-border extension reads them.
    pub(super) fn star(&self, from: u32, to: u32) -> impl Iterator<Item = StarFace> + Clone + '_ {
        self.corners(from).iter().map(move |corner| {
            let (face, k) = (&self.faces[*corner as usize / 3], *corner as usize % 3);
            let around = [k, (k + 1) % 3, (k + 2) % 3];
            let wedges = around.map(|i| face.wedges[i]);
            StarFace {
                submesh: SubmeshId(self.submesh[wedges[0] as usize]),
                wedges,
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
        let mut dying = 0;
        for i in start..start + count {
            let corner = self.pool[i];
            let [a, b] = self.others(corner);
            if a != to && b != to {
                for p in [a, b] {
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
            let (f, k) = (corner as usize / 3, corner as usize % 3);
            let wedges = &self.faces[f].wedges;
            let (wedge, partner) = (wedges[k], wedges[if a == to { (k + 1) % 3 } else { (k + 2) % 3 }]);
            match self.map.iter_mut().find(|m| m[0] == wedge) {
                Some(m) if m[1] == partner => {}
                // A crease runs through `to`: the side whose normal is nearer takes the wedge.
                Some(m) if same_chart(self.mesh, m[1], partner) => {
                    let likeness = |p: u32| normal_likeness(self.mesh, wedge, p);
                    if likeness(partner).total_cmp(&likeness(m[1])).then(m[1].cmp(&partner)).is_gt() {
                        m[1] = partner;
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
        // A line must keep three points.
        let end = self.line_end(from, to);
        (end != NONE && self.points[to as usize].line.contains(&end)).then_some(Rule::Link)
    }

    /// Whether every wedge has its partner and every face keeps its shape. Completes `map`.
    fn test_shape(&mut self, from: u32, to: u32, place: Option<DVec3>) -> Option<Rule> {
        let target = place.unwrap_or_else(|| self.points[to as usize].position.as_dvec3());
        let (start, count) = (self.points[from as usize].first as usize, self.points[from as usize].count as usize);
        for i in start..start + count {
            let corner = self.pool[i];
            let [a, b] = self.others(corner);
            if a == to || b == to {
                continue;
            }
            let (f, k) = (corner as usize / 3, corner as usize % 3);
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
            if let Some(rule) = self.reshape([from, a, b], target).or_else(|| self.reshape_uv(f, k, partner)) {
                return Some(rule);
            }
        }
        if place.is_some() {
            for corner in self.corners(to) {
                let [a, b] = self.others(*corner);
                if a != from
                    && b != from
                    && let Some(rule) = self.reshape([to, a, b], target)
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
            self.map.iter().find(|m| self.submesh[m[0] as usize] == submesh && same_chart(self.mesh, m[0], wedge))?[1];
        let mut best: Option<(f32, u32)> = None;
        for corner in self.corners(to) {
            let candidate = self.faces[*corner as usize / 3].wedges[*corner as usize % 3];
            // Wedges of another submesh may have equal attributes; a vertex belongs to one submesh.
            let fits = self.submesh[candidate as usize] == submesh && same_chart(self.mesh, candidate, anchor);
            let offered = (normal_likeness(self.mesh, wedge, candidate), candidate);
            if fits && best.is_none_or(|b| offered.0.total_cmp(&b.0).then(b.1.cmp(&offered.1)).is_gt()) {
                best = Some(offered);
            }
        }
        best.map(|b| b.1)
    }

    /// What forbids the corner `p` of the face (p, a, b) to go to `q`.
    #[inline]
    fn reshape(&self, [p, a, b]: [u32; 3], q: DVec3) -> Option<Rule> {
        let [p, a, b] = [p, a, b].map(|i| self.points[i as usize].position.as_dvec3());
        let side = b - a;
        let (old, new) = (side.cross(p - a), side.cross(q - a));
        let (old_square, new_square) = (old.length_squared(), new.length_squared());
        if old.dot(new) < self.options.turn_cosine * (old_square * new_square).sqrt()
            || (old_square > 0.0 && new_square <= 0.0)
        {
            return Some(Rule::Turn);
        }
        // Shape: twice the area over the square of the longest edge; a face may not become both thin and much thinner than it
        // was. Compared as squares.
        let longest = |c: DVec3| (c - a).length_squared().max((c - b).length_squared()).max(side.length_squared());
        let (old_longest, new_longest) = (longest(p), longest(q));
        let thin = new_square < (self.options.sliver * new_longest).powi(2);
        (thin && new_square * old_longest * old_longest < 0.25 * old_square * new_longest * new_longest)
            .then_some(Rule::Sliver)
    }

    /// What forbids face `f`'s corner `k` to take the UVs of the wedge `partner`.
    #[inline]
    fn reshape_uv(&self, f: usize, k: usize, partner: u32) -> Option<Rule> {
        let uv = self.uv?;
        let wedges = self.faces[f].wedges;
        let [p, c, d, q] =
            [wedges[k], wedges[(k + 1) % 3], wedges[(k + 2) % 3], partner].map(|w| uv[w as usize].as_dvec2());
        let (old, new) = ((d - c).perp_dot(p - c), (d - c).perp_dot(q - c));
        (old * new < 0.0 || (old != 0.0 && new == 0.0)).then_some(Rule::UvTurn)
    }

    /// The wedge of the line's other neighbour in a face that uses wedge `end` of `from`.
    fn line_other(&self, from: u32, to: u32, end: u32) -> Option<u32> {
        let other = self.line_end(from, to);
        self.corners(from).iter().find_map(|corner| {
            let (face, k) = (&self.faces[*corner as usize / 3], *corner as usize % 3);
            if face.wedges[k] != end {
                return None;
            }
            (1..3).map(|i| (k + i) % 3).find(|k| face.points[*k] == other).map(|k| face.wedges[k])
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
            let (f, k) = (corner as usize / 3, corner as usize % 3);
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
                self.faces[f].points = [NONE; 3];
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
        if let Some(at) = corners.iter().position(|corner| corner / 3 == f) {
            corners[at] = corners[corners.len() - 1];
            point.count -= 1;
        }
    }
}
