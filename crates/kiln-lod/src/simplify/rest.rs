//! The mesh between rounds, in its own ids: what the parts that are collapsed ([`Working`]) are taken from and given back to.
//!
//! **Order.** A part numbers its points, faces and wedges anew, faces along a Z-curve through their centres (Morton) and the others as
//! its faces come to them: whatever the order in the file, what lies together on the surface lies together in memory, and a part of a
//! few ten thousand faces fits a core's own cache.

use glam::{DVec3, Vec3};
use kiln_asset::Mesh;
use rayon::prelude::*;

use super::collapse::State;
use super::metric::Metric;
use super::working::{CORNER, Face, Names, Point, Working};
use super::{Boundary, SimplifyOptions};
use crate::topology::{NONE, PointKind, Topology, is_degenerate};

/// What a point is where no part holds it.
#[derive(Clone, Copy)]
pub(super) struct RestPoint {
    pub(super) position: Vec3,
    /// As in [`Point`].
    pub(super) own: f32,
    line: [u32; 2],
    /// Faces at the point.
    count: u32,
    since: u32,
    kind: PointKind,
    parted: bool,
    /// As in [`Point`].
    fixed: bool,
}

/// A face; `points[0]` is [`NONE`] once it has vanished.
#[derive(Clone, Copy)]
struct RestFace {
    points: [u32; 3],
    wedges: [u32; 3],
}

pub(super) struct Rest<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) options: &'a SimplifyOptions,
    pub(super) points: Vec<RestPoint>,
    faces: Vec<RestFace>,
    /// `[vertex_count]`.
    submesh: Vec<u32>,
}

/// Names while a part is numbered: a local id for each of the mesh's, or [`NONE`].
pub(super) struct Scratch {
    points: Vec<u32>,
    wedges: Vec<u32>,
}

impl Scratch {
    pub(super) fn new(mesh: &Mesh) -> Scratch {
        Scratch { points: vec![NONE; mesh.point_count()], wedges: vec![NONE; mesh.vertex_count()] }
    }
}

impl<'a> Rest<'a> {
    /// `positions`: `[point_count]`.
    pub(super) fn new(
        mesh: &'a Mesh,
        topology: &Topology,
        positions: &[DVec3],
        options: &'a SimplifyOptions,
    ) -> Rest<'a> {
        let mut points: Vec<RestPoint> = (0..positions.len())
            .map(|p| RestPoint {
                position: positions[p].as_vec3(),
                own: 0.0,
                line: topology.lines[p],
                count: topology.first[p + 1] - topology.first[p],
                since: 0,
                kind: match topology.kinds[p] {
                    PointKind::Boundary if options.boundary == Boundary::Lock => PointKind::Locked,
                    kind => kind,
                },
                parted: false,
                fixed: false,
            })
            .collect();
        let mut seen = vec![false; points.len()];
        for p in &mesh.points {
            let seen = &mut seen[p.index()];
            points[p.index()].parted |= *seen;
            *seen = true;
        }
        let sound = |(points, wedges): (&[u32; 3], &[u32; 3])| RestFace {
            points: if is_degenerate(points) { [NONE; 3] } else { *points },
            wedges: *wedges,
        };
        let mut submesh = vec![NONE; mesh.vertex_count()];
        for (triangle, s) in mesh.triangles.iter().zip(&mesh.face_submesh) {
            for v in triangle {
                submesh[*v as usize] = s.0;
            }
        }
        let faces = topology.face_points.iter().zip(&mesh.triangles).map(sound).collect();
        Rest { mesh, options, points, faces, submesh }
    }

    /// Keeps the points `locked` (empty, or `[point_count]`) where they are; others may come to them.
    pub(super) fn lock(&mut self, locked: &[bool]) {
        for (point, locked) in self.points.iter_mut().zip(locked) {
            if *locked {
                point.kind = PointKind::Locked;
            }
        }
    }

    /// As [`Rest::lock`] for points on which faces beyond the mesh hang: no new edge comes between two of them either.
    pub(super) fn fix(&mut self, fixed: &[bool]) {
        self.lock(fixed);
        self.points.iter_mut().zip(fixed).for_each(|(point, fixed)| point.fixed = *fixed);
    }

    /// The faces that are left, along a Z-curve. `shift`, 0 to 1, moves the cells of the curve over the mesh.
    pub(super) fn order(&self, shift: f64) -> Vec<u32> {
        let (low, high) = (self.points.iter())
            .fold((Vec3::MAX, Vec3::MIN), |(low, high), p| (low.min(p.position), high.max(p.position)));
        let (low, extent) = (low.as_dvec3(), (high.as_dvec3() - low.as_dvec3()).max_element());
        // The shift takes up to a quarter of the range.
        let scale = if extent > 0.0 { 0.75 * CELLS / extent } else { 0.0 };
        let cell = |point: &RestPoint| {
            let place = (point.position.as_dvec3() - low) * scale + DVec3::splat(0.25 * CELLS * shift);
            let [x, y, z] = place.to_array().map(|place| SPREAD[place as usize & 63]);
            x | y << 1 | z << 2
        };
        let of_points: Vec<u32> = self.points.par_iter().with_min_len(4096).map(cell).collect();
        // A face lies where its first point lies.
        let of_face = |face: &RestFace| of_points.get(face.points[0] as usize).copied().unwrap_or(NONE);
        let cells: Vec<u32> = self.faces.par_iter().with_min_len(4096).map(of_face).collect();
        let mut first = vec![0_u32; CELL_COUNT + 1];
        cells.iter().filter(|c| **c != NONE).for_each(|c| first[*c as usize + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut order = vec![0; first[CELL_COUNT] as usize];
        for (f, cell) in (0..).zip(cells).filter(|(_, c)| *c != NONE) {
            let slot = &mut first[cell as usize];
            order[*slot as usize] = f;
            *slot += 1;
        }
        order
    }

    /// Whether the face is left.
    pub(super) fn has_face(&self, face: u32) -> bool {
        self.faces[face as usize].points[0] != NONE
    }

    /// The part of those faces. Points with other faces, too, neither go nor take others in.
    pub(super) fn part(&self, faces: &[u32], scratch: &mut Scratch) -> Working<'a> {
        let mut names = Names { points: Vec::new(), faces: faces.to_vec(), wedges: Vec::new() };
        // Where every point has one vertex, both have the same names.
        let single = self.mesh.vertex_count() == self.mesh.point_count();
        let mut counts: Vec<u32> = Vec::new();
        let mut local: Vec<Face> = Vec::with_capacity(faces.len());
        for f in faces {
            let RestFace { points, wedges } = self.faces[*f as usize];
            let mut face = Face { points: [NONE; 4], wedges: [NONE; 4] };
            for k in 0..3 {
                let (point, wedge) = (points[k], wedges[k]);
                let slot = &mut scratch.points[point as usize];
                if *slot == NONE {
                    *slot = counts.len() as u32;
                    names.points.push(point);
                    counts.push(0);
                    if single {
                        names.wedges.push(wedge);
                    }
                }
                counts[*slot as usize] += 1;
                (face.points[k], face.wedges[k]) = (*slot, *slot);
                if !single {
                    let slot = &mut scratch.wedges[wedge as usize];
                    if *slot == NONE {
                        *slot = names.wedges.len() as u32;
                        names.wedges.push(wedge);
                    }
                    face.wedges[k] = *slot;
                }
            }
            local.push(face);
        }
        let mut first = 0;
        let mut points: Vec<Point> = Vec::with_capacity(counts.len());
        for (p, room) in names.points.iter().zip(&counts) {
            let point = &self.points[*p as usize];
            let held = point.count != *room;
            points.push(Point {
                position: point.position,
                own: point.own,
                first,
                count: 0,
                room: *room,
                rank: 0,
                line: point.line.map(|q| if q == NONE { NONE } else { scratch.points[q as usize] }),
                since: point.since,
                mark: 0,
                kind: if held { PointKind::Locked } else { point.kind },
                state: State::Out,
                parted: point.parted,
                held,
                fixed: point.fixed,
            });
            first += room;
        }
        let mut pool = vec![NONE; first as usize];
        for (face, first) in local.iter().zip((0..).step_by(CORNER as usize)) {
            for (p, corner) in face.points[..3].iter().zip(first..) {
                let point = &mut points[*p as usize];
                pool[(point.first + point.count) as usize] = corner;
                point.count += 1;
            }
        }
        names.points.iter().for_each(|p| scratch.points[*p as usize] = NONE);
        if !single {
            names.wedges.iter().for_each(|w| scratch.wedges[*w as usize] = NONE);
        }
        let submesh = names.wedges.iter().map(|w| self.submesh[*w as usize]).collect();
        Working::new(self.mesh, self.options, names, submesh, points, local, pool)
    }

    /// Takes the part back as it is now.
    pub(super) fn take_back(&mut self, part: &Working<'_>) {
        let Names { points, faces, wedges } = &part.names;
        for (p, point) in points.iter().zip(&part.points).filter(|(_, point)| point.count > 0 || point.held) {
            let rest = &mut self.points[*p as usize];
            (rest.position, rest.own, rest.since) = (point.position, point.own, rest.since.max(point.since));
            // A held point has its first place in the pool: it only loses faces.
            rest.count = if point.held { rest.count - (point.room - point.count) } else { point.count };
            // Who lies beside a held point in another part is that part's affair.
            for (old, new) in rest.line.iter_mut().zip(point.line) {
                if new != NONE {
                    *old = points[new as usize];
                }
            }
        }
        for (f, face) in faces.iter().zip(&part.faces) {
            let rest = &mut self.faces[*f as usize];
            if face.points[0] == NONE {
                rest.points = [NONE; 3];
            } else {
                for k in 0..3 {
                    (rest.points[k], rest.wedges[k]) =
                        (points[face.points[k] as usize], wedges[face.wedges[k] as usize]);
                }
            }
        }
    }
}

/// Cells along an axis.
const CELLS: f64 = 64.0;
const CELL_COUNT: usize = 64 * 64 * 64;

/// The six bits of each number below 64, two zeros after each.
const SPREAD: [u32; 64] = {
    let mut spread = [0; 64];
    let mut i = 0;
    while i < 6 * 64 {
        let (number, bit) = (i / 6, i % 6);
        spread[number] |= ((number >> bit & 1) << (3 * bit)) as u32;
        i += 1;
    }
    spread
};

/// A metric as it is between rounds.
pub(super) trait MetricRest: Send + Sync {
    /// What prices the collapses of a part.
    type Part: Metric + Send + Sync;

    /// The metric of a part.
    fn part(&self, work: &Working<'_>) -> Self::Part;

    /// Takes the part's values back as they are now.
    fn take_back(&mut self, part: &Self::Part, names: &Names);
}
