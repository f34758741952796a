//! The collapse loop: half-edge collapses in order of cost until no legal one is left.
//!
//! **Exact order at a low price.** Each collapse is the cheapest legal one of all, ties by lower ids, and yet few costs are
//! computed. Forms only grow, so what a collapse costs only rises, and a cost computed earlier is a lower bound of today's.
//! The queue holds one such bound a point; only the point at the front is priced again:
//! ```text
//! while the queue has a point p:
//!     for each target of p that the table of kinds allows, cheapest first:
//!         dearer than the next point in the queue: put p back with that cost; next p
//!         legal: collapse p onto it; next p
//!     no target is legal: p waits until a face of its star changes
//! ```
//! After a collapse of `from` onto `to`, bounds can be too high only where a new target or a newly legal one may be cheaper: at
//! `to`, which is priced anew, and at the neighbours of `from`, which get `to` as a target (and are priced anew if their
//! bound rests on a target that was illegal).
//!
//! **Layout.** A point is one cache line ([`Point`]), its form lies beside it; a face is 24 bytes; the corners at a point
//! lie together in one pool, moved to its end with room to grow when they outgrow their place.

use glam::{DVec3, Vec2};
use kiln_asset::{Mesh, QuadricCoefficients, UvLayout};

use super::heap::{Heap, entry, rank};
use super::quadric::{self, LineWeights, Quadric};
use super::rules::{Moves, RULE_COUNT, Rule, moves};
use super::sequence::{Collapse, CollapseSequence, SequenceReport};
use super::{SimplifyOptions, uv_border::UvBorder};
use crate::topology::{NONE, PointKind, Topology, is_degenerate, same_chart};

/// Cosine between the normals of two wedges; 1 where the mesh has none.
fn normal_likeness(mesh: &Mesh, a: u32, b: u32) -> f32 {
    mesh.normals.as_ref().map_or(1.0, |normals| normals[a as usize].dot(normals[b as usize]))
}

/// The error form of each point, as it grows along a sequence.
pub(super) struct Forms {
    positions: Vec<DVec3>,
    /// Before any collapse.
    initial: Vec<Quadric>,
    quadrics: Vec<Quadric>,
    /// Whether a point has taken in another.
    grown: Vec<bool>,
    applied: usize,
}

impl Forms {
    pub(super) fn new(mesh: &Mesh, carried: &[QuadricCoefficients], options: &SimplifyOptions) -> Forms {
        Forms::of(mesh, &Topology::new(mesh), carried, options)
    }

    fn of(mesh: &Mesh, topology: &Topology, carried: &[QuadricCoefficients], options: &SimplifyOptions) -> Forms {
        let mut positions = vec![DVec3::ZERO; mesh.point_count()];
        // A point's place is that of its lowest wedge; wedges of joined submeshes may lie a weld distance apart.
        for (v, p) in mesh.points.iter().enumerate().rev() {
            positions[p.index()] = mesh.positions[v].as_dvec3();
        }
        let weights = LineWeights { border: options.border_weight, inner: options.line_weight };
        let quadrics = quadric::initial(topology, &positions, carried, weights);
        let grown = vec![false; quadrics.len()];
        Forms { positions, initial: quadrics.clone(), quadrics, grown, applied: 0 }
    }

    /// Brings the forms to where they stand after the first `count` collapses; going back starts anew.
    pub(super) fn go_to(&mut self, sequence: &CollapseSequence, count: usize) {
        if count < self.applied {
            self.quadrics.copy_from_slice(&self.initial);
            self.grown.fill(false);
            self.applied = 0;
        }
        while self.applied < count {
            let Collapse { from, to, .. } = sequence.collapses[self.applied];
            let step = self.positions[to as usize] - self.positions[from as usize];
            let moved = self.quadrics[from as usize].about(step);
            self.quadrics[to as usize].add(&moved);
            self.grown[to as usize] = true;
            self.applied += 1;
        }
    }

    /// The form of a point about its own place, if it has taken in another.
    pub(super) fn grown(&self, point: u32) -> Option<Quadric> {
        self.grown[point as usize].then(|| self.quadrics[point as usize])
    }

    /// Object-space forms of the points `points`.
    pub(super) fn object_space(&self, points: &[u32]) -> Vec<QuadricCoefficients> {
        points.iter().map(|p| self.quadrics[*p as usize].about(-self.positions[*p as usize]).coefficients()).collect()
    }
}

/// Whether and how a point stands in the queue.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum State {
    /// It was collapsed, or may never move.
    Out,
    /// In the queue; its rank is a lower bound over all its targets.
    Queued,
    /// In the queue; its rank passes over cheaper targets that were illegal.
    Raised,
    /// None of its targets is legal; not in the queue.
    Blocked,
}

/// All that the neighbours of a point ask of it.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Point {
    position: DVec3,
    /// Value of its form at its own place, square distance times area.
    own: f64,
    /// Its corners: where they start in the pool, how many there are, how many fit.
    first: u32,
    count: u32,
    room: u32,
    /// Rank of its entry in the queue.
    rank: u32,
    /// Its two neighbours along its line, or [`NONE`].
    line: [u32; 2],
    mark: u32,
    kind: PointKind,
    state: State,
}

/// A face; `points[0]` is [`NONE`] once it has vanished.
#[derive(Clone, Copy)]
struct Face {
    points: [u32; 3],
    wedges: [u32; 3],
}

pub(super) struct Collapser<'a> {
    mesh: &'a Mesh,
    options: &'a SimplifyOptions,
    /// `[vertex_count]`.
    submesh: Vec<u32>,
    points: Vec<Point>,
    quadrics: Vec<Quadric>,
    faces: Vec<Face>,
    /// Corners by point.
    pool: Vec<u32>,
    heap: Heap,
    uv: Option<&'a [Vec2]>,
    uv_border: Option<UvBorder<'a>>,
    /// Makes costs unitless, so that their f32 ranks neither overflow nor vanish: 1 / diagonal^4.
    scale: f64,
    stamp: u32,
    /// Targets of the point at hand, by (rank, point).
    targets: Vec<(u32, u32)>,
    /// (wedge that goes, wedge that stays) of the collapse at hand.
    map: Vec<[u32; 2]>,
    /// Neighbours of the point that goes.
    ring: Vec<u32>,
    faces_left: u32,
    error: f64,
    out: CollapseSequence,
}

impl<'a> Collapser<'a> {
    pub(super) fn new(
        mesh: &'a Mesh,
        carried: &[QuadricCoefficients],
        layout: Option<&UvLayout>,
        options: &'a SimplifyOptions,
    ) -> Collapser<'a> {
        let topology = Topology::new(mesh);
        let Forms { positions, quadrics, .. } = Forms::of(mesh, &topology, carried, options);
        let points = (0..positions.len())
            .map(|p| {
                let (first, count) = (topology.first[p], topology.first[p + 1] - topology.first[p]);
                let kind = topology.kinds[p];
                let (position, own, line) = (positions[p], quadrics[p].one, topology.lines[p]);
                Point { position, own, first, count, room: count, rank: 0, line, mark: 0, kind, state: State::Out }
            })
            .collect();
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
        let diagonal = f64::from(mesh.diagonal());
        Collapser {
            mesh,
            options,
            submesh,
            points,
            quadrics,
            faces: topology.face_points.iter().zip(&mesh.triangles).map(sound).collect(),
            pool: topology.corners,
            heap: Heap::new(),
            uv: mesh.atlas_uv.as_deref().or(mesh.uv0.as_deref()),
            uv_border: layout.map(|layout| UvBorder::new(mesh, layout)),
            scale: if diagonal > 0.0 { diagonal.powi(-4) } else { 1.0 },
            stamp: 0,
            targets: Vec::new(),
            map: Vec::new(),
            ring: Vec::new(),
            faces_left: mesh.face_count() as u32,
            error: 0.0,
            out: CollapseSequence::new(mesh.face_count() as u32, mesh.vertex_count() as u32),
        }
    }

    /// Collapses until nothing legal is left or the floor is reached.
    pub(super) fn run(mut self) -> CollapseSequence {
        let floor = (self.options.floor * f64::from(self.faces_left)) as u32;
        for p in 0..self.points.len() as u32 {
            self.price(p);
        }
        while self.faces_left > floor
            && let Some(front) = self.heap.pop()
        {
            let (rank, from) = ((front >> 32) as u32, front as u32);
            let point = &self.points[from as usize];
            if point.rank == rank && matches!(point.state, State::Queued | State::Raised) {
                self.advance(from, rank);
            }
        }
        self.out.report = SequenceReport {
            collapses: self.out.collapses.len() as u32,
            faces_left: self.faces_left,
            at_floor: self.faces_left <= floor,
            blocked: self.tally(),
        };
        self.out
    }

    /// Does the cheapest legal collapse of `from`, the front of the queue, if it is the cheapest of all; puts `from` back, if not.
    fn advance(&mut self, from: u32, rank: u32) {
        self.find_targets(from);
        self.targets.sort_unstable();
        for i in 0..self.targets.len() {
            let (cost, to) = self.targets[i];
            if cost > rank && entry(cost, from) > self.heap.first() {
                self.enqueue(from, cost, if i == 0 { State::Queued } else { State::Raised });
                return;
            }
            if self.test(from, to).is_none() {
                self.collapse(from, to);
                return;
            }
        }
        self.points[from as usize].state = State::Blocked;
    }

    #[inline]
    fn enqueue(&mut self, p: u32, rank: u32, state: State) {
        let point = &mut self.points[p as usize];
        point.rank = rank;
        point.state = state;
        self.heap.push(entry(rank, p));
    }

    /// Puts `p` into the queue with the cost of its cheapest target, legal or not.
    fn price(&mut self, p: u32) {
        self.find_targets(p);
        match self.targets.iter().min() {
            Some((rank, _)) => self.enqueue(p, *rank, State::Queued),
            None => self.points[p as usize].state = State::Out,
        }
    }

    /// The targets that the table of kinds allows `p`, in no order.
    fn find_targets(&mut self, p: u32) {
        self.targets.clear();
        let point = self.points[p as usize];
        if point.count == 0 {
            return;
        }
        match moves(point.kind) {
            Moves::Never => {}
            Moves::AlongLine => {
                for to in point.line {
                    if to != NONE {
                        self.targets.push((self.rank_of(p, to), to));
                    }
                }
            }
            Moves::Anywhere => {
                for i in point.first..point.first + point.count {
                    // In a closed fan every neighbour follows `p` in exactly one face.
                    let to = self.others(self.pool[i as usize])[0];
                    self.targets.push((self.rank_of(p, to), to));
                }
            }
        }
    }

    /// Rank of the cost of taking `from` to `to`: square distance times area, plus a share of square edge length times area
    /// that orders flat places by length.
    #[inline]
    fn rank_of(&self, from: u32, to: u32) -> u32 {
        let step = self.points[to as usize].position - self.points[from as usize].position;
        let form = &self.quadrics[from as usize];
        let error = form.at(step).max(0.0) + self.points[to as usize].own.max(0.0);
        rank((error + self.options.length_weight * step.length_squared() * form.weight) * self.scale)
    }

    /// The corners at `p`.
    #[inline]
    fn corners(&self, p: u32) -> &[u32] {
        let point = &self.points[p as usize];
        &self.pool[point.first as usize..(point.first + point.count) as usize]
    }

    /// The other two points of a corner's face, in winding order.
    #[inline]
    fn others(&self, corner: u32) -> [u32; 2] {
        let (f, k) = (corner as usize / 3, corner as usize % 3);
        let face = &self.faces[f].points;
        [face[(k + 1) % 3], face[(k + 2) % 3]]
    }

    /// The point beside `from` on its line that is not `to`.
    fn line_end(&self, from: u32, to: u32) -> u32 {
        let line = self.points[from as usize].line;
        if line[0] == to { line[1] } else { line[0] }
    }

    /// The rule that forbids taking `from` to `to`; fills `map` with the partners of its wedges.
    fn test(&mut self, from: u32, to: u32) -> Option<Rule> {
        self.test_link(from, to).or_else(|| self.test_shape(from, to))
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
    fn test_shape(&mut self, from: u32, to: u32) -> Option<Rule> {
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
            if let Some(rule) = self.reshape([from, to, a, b]).or_else(|| self.reshape_uv(f, k, partner)) {
                return Some(rule);
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

    /// What forbids the face (from, a, b) to become (to, a, b).
    #[inline]
    fn reshape(&self, [from, to, a, b]: [u32; 4]) -> Option<Rule> {
        let [p, q, a, b] = [from, to, a, b].map(|i| self.points[i as usize].position);
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
    fn collapse(&mut self, from: u32, to: u32) {
        let step = self.points[to as usize].position - self.points[from as usize].position;
        let moved = self.quadrics[from as usize].about(step);
        let form = &mut self.quadrics[to as usize];
        form.add(&moved);
        self.points[to as usize].own = form.one;
        if form.weight > 0.0 {
            self.error = self.error.max((form.one.max(0.0) / form.weight).sqrt());
        }
        if self.points[from as usize].line != [NONE; 2]
            && let Some(mut guard) = self.uv_border.take()
        {
            guard.applied(&self.map, |end| self.line_other(from, to, end));
            self.uv_border = Some(guard);
        }
        let (first_face, first_pair) = (self.out.faces.len() as u32, self.out.pairs.len() as u32);
        self.move_faces(from, to);
        self.out.pairs.extend_from_slice(&self.map);
        self.out.collapses.push(Collapse { from, to, first_face, first_pair, error: self.error as f32 });

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
        let gone = &mut self.points[from as usize];
        gone.state = State::Out;
        gone.count = 0;

        self.price(to);
        for i in 0..self.ring.len() {
            self.offer(self.ring[i], to);
        }
    }

    /// Drops the faces at both ends, gives those at `from` alone to `to`, and notes the neighbours of `from` in `ring`.
    fn move_faces(&mut self, from: u32, to: u32) {
        self.ring.clear();
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
                self.out.faces.push(f as u32);
                self.faces_left -= 1;
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

    /// Brings the bound of `p`, whose star has changed and which has `to` as a neighbour now, down to where it may lie.
    #[inline]
    fn offer(&mut self, p: u32, to: u32) {
        let point = &self.points[p as usize];
        match (point.state, moves(point.kind)) {
            (State::Out, _) | (_, Moves::Never) => {}
            (State::Raised | State::Blocked, _) => self.price(p),
            (State::Queued, Moves::AlongLine) if !point.line.contains(&to) => {}
            (State::Queued, _) => {
                let offered = self.rank_of(p, to);
                if offered < point.rank {
                    self.enqueue(p, offered, State::Queued);
                }
            }
        }
    }

    /// For each rule, how many of the points that are left it keeps: each by the rule that forbids its cheapest target.
    fn tally(&mut self) -> [u32; RULE_COUNT] {
        let mut blocked = [0; RULE_COUNT];
        for p in 0..self.points.len() as u32 {
            if self.points[p as usize].count == 0 {
                continue;
            }
            self.find_targets(p);
            let rule = match self.targets.iter().min() {
                None => Some(Rule::Kind),
                Some((_, to)) => self.test(p, *to),
            };
            if let Some(rule) = rule {
                blocked[rule as usize] += 1;
            }
        }
        blocked
    }
}
