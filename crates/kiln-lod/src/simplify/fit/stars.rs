//! Places on a level: where a point of the source lies on the faces around its heir.

use glam::DVec3;
use kiln_geom::triangle::closest_point;
use rayon::prelude::*;

use crate::topology::{NONE, Topology};

/// Most points that a walk visits.
const STEPS: usize = 6;

/// Where a sample lies on the level: `face` is [`NONE`] if nowhere.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) face: u32,
    pub(super) bary: [f32; 3],
    /// Square distance to there.
    pub(super) distance: f64,
}

/// What tells quickly where a place lies over a face.
pub(super) struct Frame {
    origin: DVec3,
    /// Dotted with the way from the origin: the barycentric coordinates of the second and third corner.
    b: DVec3,
    c: DVec3,
    normal: DVec3,
}

/// `[face_count]`; no place lies over a face without area.
pub(super) fn frames(faces: &[[u32; 3]], at: &[DVec3]) -> Vec<Frame> {
    let frame = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|p| at[p as usize]);
        let (ab, ac) = (b - a, c - a);
        let cross = ab.cross(ac);
        let square = cross.length_squared();
        let over = |edge: DVec3| if square > 0.0 { edge / square } else { DVec3::ZERO };
        Frame { origin: a, b: over(ac.cross(cross)), c: over(cross.cross(ab)), normal: cross.normalize_or_zero() }
    };
    faces.par_iter().map(frame).collect()
}

/// Faces by the nodes that a walk goes over: points, or vertices, whose faces do not leave their chart.
pub(super) struct Stars<'a> {
    pub(super) frames: &'a [Frame],
    pub(super) face_points: &'a [[u32; 3]],
    pub(super) face_nodes: &'a [[u32; 3]],
    /// `[node_count + 1]`.
    pub(super) first: &'a [u32],
    pub(super) corners: &'a [u32],
}

impl<'a> Stars<'a> {
    /// Those of points.
    pub(super) fn of_points(topology: &'a Topology, frames: &'a [Frame]) -> Stars<'a> {
        let faces = &topology.face_points;
        Stars { frames, face_points: faces, face_nodes: faces, first: &topology.first, corners: &topology.corners }
    }

    /// The place of `x` in the nearest of the faces at `node` over or under which it lies; else as [`Stars::walk`] finds it.
    pub(super) fn nearest(&self, at: &[DVec3], node: u32, x: DVec3) -> Place {
        let mut best = Place { face: NONE, bary: [0.0; 3], distance: f64::INFINITY };
        for corner in &self.corners[self.first[node as usize] as usize..self.first[node as usize + 1] as usize] {
            let face = corner / 3;
            let frame = &self.frames[face as usize];
            let way = x - frame.origin;
            let (b, c) = (frame.b.dot(way), frame.c.dot(way));
            let a = 1.0 - b - c;
            if a > 0.0 && b > 0.0 && c > 0.0 {
                let distance = frame.normal.dot(way).powi(2);
                if distance < best.distance {
                    best = Place { face, bary: [a, b, c].map(|share| share as f32), distance };
                }
            }
        }
        if best.face == NONE { self.walk(at, node, x) } else { best }
    }

    /// The nearest place to `x` that a walk from the faces at `node` finds: on to the nearest corner while that is nearer.
    #[cold]
    pub(super) fn walk(&self, at: &[DVec3], mut node: u32, x: DVec3) -> Place {
        let mut best = Place { face: NONE, bary: [0.0; 3], distance: f64::INFINITY };
        for _ in 0..STEPS {
            let before = best.distance;
            best = self.around(at, node, x, best);
            if best.distance >= before || best.bary.iter().all(|b| *b > 0.0) {
                break;
            }
            let [a, b, c] = best.bary;
            let nearest = if a >= b && a >= c { 0 } else { if b >= c { 1 } else { 2 } };
            let next = self.face_nodes[best.face as usize][nearest];
            if next == node {
                break;
            }
            node = next;
        }
        best
    }

    /// The nearer to `x` of `best` and the places on the faces at `node`.
    pub(super) fn around(&self, at: &[DVec3], node: u32, x: DVec3, mut best: Place) -> Place {
        for corner in &self.corners[self.first[node as usize] as usize..self.first[node as usize + 1] as usize] {
            let face = corner / 3;
            let [a, b, c] = self.face_points[face as usize].map(|p| at[p as usize]);
            let near = closest_point(x, a, b, c);
            if near.distance_squared < best.distance {
                best = Place { face, bary: near.bary.map(|b| b as f32), distance: near.distance_squared };
            }
        }
        best
    }
}
