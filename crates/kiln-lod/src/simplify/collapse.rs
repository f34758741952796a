//! The collapse loop: half-edge collapses in order of cost until no legal one is left.
//!
//! Every point holds its cheapest target that the table of kinds allows, in one indexed heap ordered by (cost, point). A popped
//! candidate is tested (link, partners, turn, sliver, UV); if a rule forbids it, the point's next dearer target takes its place.
//! After a collapse the kept point and its neighbours are priced again. Points without a target leave the heap and come back
//! in sweeps until a sweep collapses nothing, since what happened two rings away may have freed them.

use glam::{DVec3, Vec2};
use kiln_asset::{Mesh, QuadricCoefficients, UvLayout};

use super::heap::Heap;
use super::quadric::{self, LineWeights, Quadric};
use super::rules::{Moves, RULE_COUNT, Rule, moves};
use super::sequence::{Collapse, CollapseSequence, SequenceReport};
use super::{SimplifyOptions, uv_border::UvBorder};
use crate::topology::{NONE, Topology, is_degenerate, same_chart};

/// Cosine between the normals of two wedges; 1 where the mesh has none.
fn normal_likeness(mesh: &Mesh, a: u32, b: u32) -> f32 {
    mesh.normals.as_ref().map_or(1.0, |normals| normals[a as usize].dot(normals[b as usize]))
}

/// The error form of each point, as it grows along a sequence.
pub(super) struct Forms {
    positions: Vec<DVec3>,
    quadrics: Vec<Quadric>,
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
        Forms { positions, quadrics, applied: 0 }
    }

    /// Object-space forms of the points `points` after the first `count` collapses, no fewer than asked for before.
    pub(super) fn at(&mut self, sequence: &CollapseSequence, count: usize, points: &[u32]) -> Vec<QuadricCoefficients> {
        while self.applied < count {
            let Collapse { from, to, .. } = sequence.collapses[self.applied];
            let step = self.positions[to as usize] - self.positions[from as usize];
            let moved = self.quadrics[from as usize].about(step);
            self.quadrics[to as usize].add(&moved);
            self.applied += 1;
        }
        points.iter().map(|p| self.quadrics[*p as usize].about(-self.positions[*p as usize]).coefficients()).collect()
    }
}

pub(super) struct Collapser<'a> {
    mesh: &'a Mesh,
    /// `[vertex_count]`.
    submesh: Vec<u32>,
    options: &'a SimplifyOptions,
    positions: Vec<DVec3>,
    topology: Topology,
    wedges: Vec<[u32; 3]>,
    alive: Vec<bool>,
    /// First and last corner of each point's list, and the corner behind each corner.
    head: Vec<u32>,
    tail: Vec<u32>,
    next: Vec<u32>,
    quadrics: Vec<Quadric>,
    uv: Option<&'a [Vec2]>,
    uv_border: Option<UvBorder<'a>>,
    mark: Vec<u32>,
    stamp: u32,
    heap: Heap,
    target: Vec<u32>,
    /// `[point_count]`: a rule forbade a cheaper target than the present one.
    passed_over: Vec<bool>,
    star: Vec<u32>,
    ring: Vec<u32>,
    map: Vec<[u32; 2]>,
    blocked: [u32; RULE_COUNT],
    faces_left: u32,
    out: CollapseSequence,
    error: f64,
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
        let points = positions.len();
        let (mut head, mut tail) = (vec![NONE; points], vec![NONE; points]);
        let mut next = vec![NONE; 3 * mesh.face_count()];
        let mut alive = vec![true; mesh.face_count()];
        for (f, face) in topology.face_points.iter().enumerate() {
            if is_degenerate(face) {
                alive[f] = false;
                continue;
            }
            for (k, p) in face.iter().enumerate() {
                let (corner, p) = ((3 * f + k) as u32, *p as usize);
                if head[p] == NONE {
                    head[p] = corner;
                } else {
                    next[tail[p] as usize] = corner;
                }
                tail[p] = corner;
            }
        }
        let uv_border = layout.map(|layout| UvBorder::new(mesh, layout));
        let mut submesh = vec![NONE; mesh.vertex_count()];
        for (triangle, s) in mesh.triangles.iter().zip(&mesh.face_submesh) {
            for v in triangle {
                submesh[*v as usize] = s.0;
            }
        }
        Collapser {
            mesh,
            submesh,
            options,
            positions,
            wedges: mesh.triangles.clone(),
            alive,
            head,
            tail,
            next,
            quadrics,
            uv: mesh.atlas_uv.as_deref().or(mesh.uv0.as_deref()),
            uv_border,
            topology,
            mark: vec![0; points],
            stamp: 0,
            heap: Heap::new(points),
            target: vec![NONE; points],
            passed_over: vec![false; points],
            star: Vec::new(),
            ring: Vec::new(),
            map: Vec::new(),
            blocked: [0; RULE_COUNT],
            faces_left: mesh.face_count() as u32,
            out: CollapseSequence::new(mesh.face_count() as u32, mesh.vertex_count() as u32),
            error: 0.0,
        }
    }

    /// Collapses until nothing legal is left or the floor is reached.
    pub(super) fn run(mut self) -> CollapseSequence {
        let floor = (self.options.floor * f64::from(self.faces_left)) as u32;
        loop {
            self.blocked = [0; RULE_COUNT];
            let before = self.out.collapses.len();
            for p in 0..self.positions.len() as u32 {
                self.gather(p);
                self.price(p, None);
            }
            while self.faces_left > floor {
                let Some((cost, from)) = self.heap.first() else { break };
                let to = self.target[from as usize];
                self.gather(from);
                match self.test(from, to) {
                    Some(rule) => {
                        self.blocked[rule as usize] += 1;
                        self.price(from, Some((cost, to)));
                    }
                    None => self.collapse(from, to),
                }
            }
            if self.faces_left <= floor || self.out.collapses.len() == before {
                break;
            }
        }
        let stuck = self.topology.kinds.iter().zip(&self.head).filter(|(k, h)| {
            **h != NONE && moves(**k) == Moves::Never
        });
        self.blocked[Rule::Kind as usize] = stuck.count() as u32;
        self.out.report = SequenceReport {
            collapses: self.out.collapses.len() as u32,
            faces_left: self.faces_left,
            at_floor: self.faces_left <= floor,
            blocked: self.blocked,
        };
        self.out
    }

    /// The living faces at `p`, as corners, into `star`; drops dead ones from the list.
    fn gather(&mut self, p: u32) {
        self.star.clear();
        let (mut corner, mut last) = (self.head[p as usize], NONE);
        self.head[p as usize] = NONE;
        while corner != NONE {
            let after = self.next[corner as usize];
            if self.alive[corner as usize / 3] {
                if last == NONE {
                    self.head[p as usize] = corner;
                } else {
                    self.next[last as usize] = corner;
                }
                last = corner;
                self.star.push(corner);
            }
            corner = after;
        }
        self.tail[p as usize] = last;
        if last != NONE {
            self.next[last as usize] = NONE;
        }
    }

    /// The other two points of a corner's face, in winding order.
    #[inline]
    fn others(&self, corner: u32) -> [u32; 2] {
        let (f, k) = (corner as usize / 3, corner as usize % 3);
        let face = &self.topology.face_points[f];
        [face[(k + 1) % 3], face[(k + 2) % 3]]
    }

    /// Cost of taking `from` to `to`: square distance times area, plus a share of square edge length times area that orders
    /// flat places by length.
    #[inline]
    fn cost(&self, from: u32, to: u32) -> f64 {
        let step = self.positions[to as usize] - self.positions[from as usize];
        let form = &self.quadrics[from as usize];
        let error = form.at(step).max(0.0) + self.quadrics[to as usize].one.max(0.0);
        error + self.options.length_weight * step.length_squared() * form.weight
    }

    /// Sets the cheapest target dearer than `above` of `p`, whose star was gathered, or takes it out of the heap.
    fn price(&mut self, p: u32, above: Option<(f64, u32)>) {
        let kind = self.topology.kinds[p as usize];
        let mut best: Option<(f64, u32)> = None;
        let mut offer = |this: &Self, to: u32| {
            let offered = (this.cost(p, to), to);
            let dearer = above.is_none_or(|a| a.0.total_cmp(&offered.0).then(a.1.cmp(&offered.1)).is_lt());
            if dearer && best.is_none_or(|b| offered.0.total_cmp(&b.0).then(offered.1.cmp(&b.1)).is_lt()) {
                best = Some(offered);
            }
        };
        match moves(kind) {
            Moves::Never => {}
            Moves::AlongLine => {
                if !self.star.is_empty() {
                    for to in self.topology.lines[p as usize] {
                        if to != NONE {
                            offer(self, to);
                        }
                    }
                }
            }
            Moves::Anywhere => {
                for i in 0..self.star.len() {
                    // In a closed fan every neighbour is the first of exactly one face's others.
                    offer(self, self.others(self.star[i])[0]);
                }
            }
        }
        self.passed_over[p as usize] = above.is_some();
        match best {
            Some((cost, to)) => {
                self.target[p as usize] = to;
                self.heap.set(p, cost);
            }
            None => self.heap.remove(p),
        }
    }

    /// The rule that forbids taking `from`, whose star was gathered, to `to`; fills `map` with its wedges' partners.
    fn test(&mut self, from: u32, to: u32) -> Option<Rule> {
        // Link: common neighbours are the third points of the dying faces, no more.
        self.stamp += 1;
        let beside_to = self.stamp;
        let mut corner = self.head[to as usize];
        while corner != NONE {
            if self.alive[corner as usize / 3] {
                for p in self.others(corner) {
                    self.mark[p as usize] = beside_to;
                }
            }
            corner = self.next[corner as usize];
        }
        if self.mark[from as usize] != beside_to {
            return Some(Rule::Link);
        }
        self.map.clear();
        self.stamp += 1;
        let counted = self.stamp;
        let (mut common, mut dying) = (0, 0);
        for i in 0..self.star.len() {
            let corner = self.star[i];
            let [a, b] = self.others(corner);
            let (f, k) = (corner as usize / 3, corner as usize % 3);
            if a == to || b == to {
                dying += 1;
                let partner = self.wedges[f][if a == to { (k + 1) % 3 } else { (k + 2) % 3 }];
                let wedge = self.wedges[f][k];
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
            } else if self.mark[a as usize] >= beside_to && self.mark[b as usize] >= beside_to {
                // Both others touch `to`: the face would fall onto one of its faces, or close a pocket.
                return Some(Rule::Link);
            }
            for p in [a, b] {
                if self.mark[p as usize] == beside_to {
                    self.mark[p as usize] = counted;
                    common += 1;
                }
            }
        }
        if common != dying || dying == 0 {
            return Some(Rule::Link);
        }
        let lines = self.topology.lines[from as usize];
        if lines != [NONE; 2] {
            let other = if lines[0] == to { lines[1] } else { lines[0] };
            // A line must keep three points.
            if self.topology.lines[to as usize].contains(&other) {
                return Some(Rule::Link);
            }
        }
        for i in 0..self.star.len() {
            let corner = self.star[i];
            let [a, b] = self.others(corner);
            if a == to || b == to {
                continue;
            }
            let (f, k) = (corner as usize / 3, corner as usize % 3);
            let wedge = self.wedges[f][k];
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
            if let Some(rule) = self.reshape(f, k, [from, to, a, b], partner) {
                return Some(rule);
            }
        }
        if let Some(guard) = &self.uv_border
            && lines != [NONE; 2]
            && !guard.allows(&self.map, |end| self.line_other(from, to, end))
        {
            return Some(Rule::UvBorder);
        }
        None
    }

    /// The partner of a wedge that no dying face uses, since creases cut its side into several wedges: of the wedges at `to` in
    /// the chart that the side's dying face leads to, the one with the nearest normal, then the lowest.
    fn partner_across_crease(&self, wedge: u32, to: u32) -> Option<u32> {
        let anchor = self.map.iter().find(|m| {
            self.submesh[m[0] as usize] == self.submesh[wedge as usize] && same_chart(self.mesh, m[0], wedge)
        })?[1];
        let mut best: Option<(f32, u32)> = None;
        let mut corner = self.head[to as usize];
        while corner != NONE {
            let (f, k) = (corner as usize / 3, corner as usize % 3);
            let candidate = self.wedges[f][k];
            // Wedges of another submesh may have equal attributes; a vertex belongs to one submesh.
            let fits = self.alive[f]
                && self.submesh[candidate as usize] == self.submesh[wedge as usize]
                && same_chart(self.mesh, candidate, anchor);
            let offered = (normal_likeness(self.mesh, wedge, candidate), candidate);
            if fits && best.is_none_or(|b| offered.0.total_cmp(&b.0).then(b.1.cmp(&offered.1)).is_gt()) {
                best = Some(offered);
            }
            corner = self.next[corner as usize];
        }
        best.map(|b| b.1)
    }

    /// What forbids face `f`'s corner `k` to go to `to`.
    fn reshape(&self, f: usize, k: usize, [from, to, a, b]: [u32; 4], partner: u32) -> Option<Rule> {
        let [p, q, a, b] = [from, to, a, b].map(|i| self.positions[i as usize]);
        let side = b - a;
        let (old, new) = (side.cross(p - a), side.cross(q - a));
        let (old_length, new_length) = (old.length(), new.length());
        if old.dot(new) < self.options.turn_cosine * old_length * new_length || (old_length > 0.0 && new_length <= 0.0) {
            return Some(Rule::Turn);
        }
        // Shape: area over the square of the longest edge; a face may not become both thin and much thinner than it was.
        let longest = |c: DVec3| (c - a).length_squared().max((c - b).length_squared()).max(side.length_squared());
        let (old_shape, new_shape) = (old_length / longest(p), new_length / longest(q));
        if new_shape < self.options.sliver && new_shape < 0.5 * old_shape {
            return Some(Rule::Sliver);
        }
        let uv = self.uv?;
        let triangle = self.wedges[f];
        let signed = |apex: u32| {
            let [c, d] = [triangle[(k + 1) % 3], triangle[(k + 2) % 3]].map(|w| uv[w as usize].as_dvec2());
            (d - c).perp_dot(uv[apex as usize].as_dvec2() - c)
        };
        let (old, new) = (signed(triangle[k]), signed(partner));
        if old * new < 0.0 || (old != 0.0 && new == 0.0) { Some(Rule::UvTurn) } else { None }
    }

    /// The wedge of the line's other neighbour in a living face that uses wedge `end` of `from`.
    fn line_other(&self, from: u32, to: u32, end: u32) -> Option<u32> {
        let lines = self.topology.lines[from as usize];
        let other = if lines[0] == to { lines[1] } else { lines[0] };
        self.star.iter().find_map(|corner| {
            let (f, k) = (*corner as usize / 3, *corner as usize % 3);
            if self.wedges[f][k] != end {
                return None;
            }
            (1..3).map(|i| (k + i) % 3).find(|k| self.topology.face_points[f][*k] == other).map(|k| self.wedges[f][k])
        })
    }

    /// Takes `from`, whose star and wedge map are gathered, to `to`.
    fn collapse(&mut self, from: u32, to: u32) {
        let step = self.positions[to as usize] - self.positions[from as usize];
        let moved = self.quadrics[from as usize].about(step);
        self.quadrics[to as usize].add(&moved);
        let form = &self.quadrics[to as usize];
        if form.weight > 0.0 {
            self.error = self.error.max((form.one.max(0.0) / form.weight).sqrt());
        }
        if self.topology.lines[from as usize] != [NONE; 2]
            && let Some(mut guard) = self.uv_border.take()
        {
            guard.applied(&self.map, |end| self.line_other(from, to, end));
            self.uv_border = Some(guard);
        }
        let first_face = self.out.faces.len() as u32;
        let first_pair = self.out.pairs.len() as u32;
        for i in 0..self.star.len() {
            let corner = self.star[i];
            let (f, k) = (corner as usize / 3, corner as usize % 3);
            if self.others(corner).contains(&to) {
                self.alive[f] = false;
                self.out.faces.push(f as u32);
                self.faces_left -= 1;
                continue;
            }
            self.topology.face_points[f][k] = to;
            let wedge = self.wedges[f][k];
            if let Some(m) = self.map.iter().find(|m| m[0] == wedge) {
                self.wedges[f][k] = m[1];
            }
            // To the end of the kept point's list.
            self.next[corner as usize] = NONE;
            let tail = self.tail[to as usize];
            if tail == NONE {
                self.head[to as usize] = corner;
            } else {
                self.next[tail as usize] = corner;
            }
            self.tail[to as usize] = corner;
        }
        self.out.pairs.extend_from_slice(&self.map);
        self.out.collapses.push(Collapse {
            from,
            to,
            first_face,
            first_pair,
            error: self.error as f32,
        });
        self.head[from as usize] = NONE;
        self.tail[from as usize] = NONE;
        self.heap.remove(from);
        let lines = self.topology.lines[from as usize];
        if lines != [NONE; 2] {
            let other = if lines[0] == to { lines[1] } else { lines[0] };
            for (point, with) in [(other, to), (to, other)] {
                for slot in &mut self.topology.lines[point as usize] {
                    if *slot == from {
                        *slot = with;
                    }
                }
            }
        }
        // Price the kept point and its neighbours again, each once.
        self.gather(to);
        self.stamp += 1;
        let stamp = self.stamp;
        let mut ring = std::mem::take(&mut self.ring);
        ring.clear();
        for i in 0..self.star.len() {
            for p in self.others(self.star[i]) {
                if self.mark[p as usize] != stamp {
                    self.mark[p as usize] = stamp;
                    ring.push(p);
                }
            }
        }
        self.price(to, None);
        for p in &ring {
            self.price_again(*p, from, to);
        }
        self.ring = ring;
    }

    /// Sets the cheapest target of `p`, beside which `from` went to `to`. Only the cost of going to `to` has changed, so its other
    /// targets are looked at only if the one it had is among them, or if it stood at a dearer one because a rule forbade the
    /// cheapest (which may be legal now).
    fn price_again(&mut self, p: u32, from: u32, to: u32) {
        let target = self.target[p as usize];
        match self.heap.cost(p) {
            Some(cost) if target != from && target != to && !self.passed_over[p as usize] => {
                let offered = self.cost(p, to);
                let may = match moves(self.topology.kinds[p as usize]) {
                    Moves::Anywhere => true,
                    Moves::AlongLine => self.topology.lines[p as usize].contains(&to),
                    Moves::Never => false,
                };
                if may && offered.total_cmp(&cost).then(to.cmp(&target)).is_lt() {
                    self.target[p as usize] = to;
                    self.heap.set(p, offered);
                }
            }
            _ => {
                self.gather(p);
                self.price(p, None);
            }
        }
    }
}
