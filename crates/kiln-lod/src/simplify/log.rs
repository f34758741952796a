//! What a part has collapsed, and one log out of the logs of many parts.
//!
//! **Method.** A log is one order of a partial one: a collapse has to come after those that changed a face at either of its ends, and
//! any order that grants this gives the same meshes. So the logs of parts are joined by cost: each collapse stands at its own cost, or
//! behind the dearest of those that it rests on ([`Point::since`](super::working::Point::since)), whichever is greater. A prefix of the
//! joint log then holds what is cheap wherever it lies, whichever part or round did it.

use super::sequence::{Collapse, CollapseSequence};
use super::working::Names;

/// The collapses of a part.
#[derive(Default)]
pub(super) struct Log {
    /// Each with its own error.
    pub(super) collapses: Vec<Collapse>,
    /// By collapse, rank of its place in the joint log.
    since: Vec<u32>,
    pub(super) faces: Vec<u32>,
    pub(super) pairs: Vec<[u32; 2]>,
    /// As in [`CollapseSequence`].
    pub(super) places: Vec<[f32; 3]>,
}

impl Log {
    pub(super) fn reserve(&mut self, collapses: usize, faces: usize) {
        self.collapses.reserve(collapses);
        self.since.reserve(collapses);
        self.faces.reserve(faces);
        self.pairs.reserve(collapses);
    }

    /// Opens the entry of a collapse; its faces and pairs follow.
    pub(super) fn begin(&mut self, from: u32, to: u32, error: f32, since: u32) {
        let (first_face, first_pair) = (self.faces.len() as u32, self.pairs.len() as u32);
        self.collapses.push(Collapse { from, to, first_face, first_pair, error });
        self.since.push(since);
    }

    /// Appends the log of a part, in the mesh's ids.
    pub(super) fn append(&mut self, part: &Log, names: &Names) {
        let point = |p: u32| names.points[p as usize];
        let (faces, pairs) = (self.faces.len() as u32, self.pairs.len() as u32);
        self.collapses.extend(part.collapses.iter().map(|c| Collapse {
            from: point(c.from),
            to: point(c.to),
            first_face: c.first_face + faces,
            first_pair: c.first_pair + pairs,
            error: c.error,
        }));
        self.since.extend_from_slice(&part.since);
        self.faces.extend(part.faces.iter().map(|f| names.faces[*f as usize]));
        self.pairs.extend(part.pairs.iter().map(|pair| pair.map(|w| names.wedges[w as usize])));
        self.places.extend_from_slice(&part.places);
    }

    /// The sequence of a mesh; `joint`: of several parts, so that the order has to be made.
    pub(super) fn finish(mut self, face_count: u32, vertex_count: u32, joint: bool) -> CollapseSequence {
        if joint {
            self = self.in_order();
        }
        let mut out = CollapseSequence::new(face_count, vertex_count);
        let mut error = 0.0_f32;
        for collapse in &mut self.collapses {
            error = error.max(collapse.error);
            collapse.error = error;
        }
        (out.collapses, out.faces, out.pairs, out.places) = (self.collapses, self.faces, self.pairs, self.places);
        out
    }

    fn in_order(&self) -> Log {
        // A step of the upper half of a rank is less than a hundredth of a cost; within it, parts come one after the other.
        let step = |since: u32| (since >> 16) as usize;
        let mut first = vec![0_u32; (1 << 16) + 1];
        self.since.iter().for_each(|since| first[step(*since) + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut order = vec![0_u32; self.since.len()];
        for (i, since) in (0..).zip(&self.since) {
            let slot = &mut first[step(*since)];
            order[*slot as usize] = i;
            *slot += 1;
        }
        let mut out = Log::default();
        out.reserve(self.collapses.len(), self.faces.len());
        for i in order.into_iter().map(|i| i as usize) {
            let (one, next) = (self.collapses[i], self.collapses.get(i + 1));
            let faces = one.first_face as usize..next.map_or(self.faces.len(), |next| next.first_face as usize);
            let pairs = one.first_pair as usize..next.map_or(self.pairs.len(), |next| next.first_pair as usize);
            out.begin(one.from, one.to, one.error, self.since[i]);
            out.faces.extend_from_slice(&self.faces[faces]);
            out.pairs.extend_from_slice(&self.pairs[pairs]);
            out.places.extend(self.places.get(i));
        }
        out
    }
}
