//! The collapse sequence: what was collapsed, in order; any prefix of it is a level.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use kiln_asset::blob::{BlobError, BlobReader, BlobWriter};
use kiln_asset::{Mesh, MeshError, SubmeshId};
use serde::{Deserialize, Serialize};

use super::rules::RULE_COUNT;

/// One collapse: `from` goes, `to` stays where it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Collapse {
    /// The point that goes.
    pub from: u32,
    /// The point that stays.
    pub to: u32,
    /// Where the faces that vanish start in [`CollapseSequence::faces`]; they end where the next collapse's start.
    pub first_face: u32,
    /// Where the wedge pairs start in [`CollapseSequence::pairs`].
    pub first_pair: u32,
    /// The metric's error so far, a length in object units: the largest root of a kept form's value by its area.
    pub error: f32,
}

/// What ended the sequence.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SequenceReport {
    /// Number of collapses.
    pub collapses: u32,
    /// Faces that are left at its end.
    pub faces_left: u32,
    /// It stopped at the floor, not for want of legal collapses.
    pub at_floor: bool,
    /// In its last sweep, how often each rule ([`super::rules::Rule::ALL`]) forbade a collapse.
    pub blocked: [u32; RULE_COUNT],
}

/// All collapses of a mesh in order, to exhaustion; independent of any level.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CollapseSequence {
    face_count: u32,
    vertex_count: u32,
    /// In order.
    pub collapses: Vec<Collapse>,
    /// Faces that vanish, by collapse.
    pub faces: Vec<u32>,
    /// (wedge that goes, wedge that its corners use from then on), by collapse.
    pub pairs: Vec<[u32; 2]>,
    /// By collapse, where the point that stays stands from then on; empty if it stays where it is.
    pub places: Vec<[f32; 3]>,
    pub(super) report: SequenceReport,
}

/// A cut, and what became of the mesh that it is cut from.
#[derive(Clone, Debug, PartialEq)]
pub struct Replayed {
    /// What is left.
    pub level: Mesh,
    /// For each point of the level the mesh's point that it is.
    pub origin: Vec<u32>,
    /// For each vertex of the mesh that of the level that it went to, or `u32::MAX` if its side of the point is gone.
    pub heirs: Vec<u32>,
    /// For each point of the level where the log placed it; empty if it placed none.
    pub places: Vec<Option<Vec3>>,
}

impl CollapseSequence {
    pub(crate) fn new(face_count: u32, vertex_count: u32) -> CollapseSequence {
        CollapseSequence { face_count, vertex_count, ..Default::default() }
    }

    /// Faces of the mesh that it is of.
    pub(crate) fn face_count(&self) -> u32 {
        self.face_count
    }

    /// Vertices of the mesh that it is of.
    pub(crate) fn vertex_count(&self) -> u32 {
        self.vertex_count
    }

    /// What ended it.
    pub fn report(&self) -> &SequenceReport {
        &self.report
    }

    /// Faces left after the first `count` collapses.
    pub fn faces_after(&self, count: usize) -> u32 {
        let removed = self.collapses.get(count).map_or(self.faces.len() as u32, |c| c.first_face);
        self.face_count - removed
    }

    /// The fewest collapses that leave at most `faces`; all of them if none leave so few.
    pub fn reach(&self, faces: u32) -> usize {
        // faces_after falls with count.
        let (mut low, mut high) = (0, self.collapses.len());
        while low < high {
            let middle = (low + high) / 2;
            if self.faces_after(middle) <= faces { high = middle } else { low = middle + 1 }
        }
        low
    }

    /// How many collapses keep the metric's error at or below `error`, object units.
    pub fn within(&self, error: f32) -> usize {
        self.collapses.partition_point(|c| c.error <= error)
    }

    /// Where the vanished faces of collapse `i` lie in [`CollapseSequence::faces`].
    pub(crate) fn faces_of(&self, i: usize) -> Range<usize> {
        let end = self.collapses.get(i + 1).map_or(self.faces.len(), |c| c.first_face as usize);
        self.collapses[i].first_face as usize..end
    }

    /// Where the wedge pairs of collapse `i` lie in [`CollapseSequence::pairs`].
    pub(crate) fn pairs_of(&self, i: usize) -> Range<usize> {
        let end = self.collapses.get(i + 1).map_or(self.pairs.len(), |c| c.first_pair as usize);
        self.collapses[i].first_pair as usize..end
    }

    /// The mesh after the first `count` collapses; the mesh itself, bit for bit, after none.
    ///
    /// # Errors
    /// The sequence belongs to another mesh.
    pub fn replay(&self, mesh: &Mesh, count: usize) -> Result<Mesh, MeshError> {
        self.replay_with_heirs(mesh, count).map(|replayed| replayed.level)
    }

    /// As [`CollapseSequence::replay`], with what became of the mesh's points and vertices.
    pub(crate) fn replay_with_heirs(&self, mesh: &Mesh, count: usize) -> Result<Replayed, MeshError> {
        let pair_end = self.collapses.get(count).map_or(self.pairs.len(), |c| c.first_pair as usize);
        let face_end = self.collapses.get(count).map_or(self.faces.len(), |c| c.first_face as usize);
        let cut = replayed(mesh, self.pairs[..pair_end].iter().rev(), self.faces[..face_end].iter())?;
        Ok(self.placed(mesh, cut, 0..count.min(self.collapses.len())))
    }

    /// The mesh after the collapses of a closed set, `applied[i]` for collapse `i`, with what became of the mesh's points and
    /// vertices; the mesh itself, bit for bit, after none.
    ///
    /// # Errors
    /// The sequence belongs to another mesh.
    ///
    /// # Panics
    /// If `applied` is shorter than the sequence.
    pub fn replay_set(&self, mesh: &Mesh, applied: &[bool]) -> Result<Replayed, MeshError> {
        let chosen = || (0..self.collapses.len()).filter(|i| applied[*i]);
        let pairs = chosen().rev().flat_map(|i| &self.pairs[self.pairs_of(i)]);
        let cut = replayed(mesh, pairs, chosen().flat_map(|i| &self.faces[self.faces_of(i)]))?;
        Ok(self.placed(mesh, cut, chosen()))
    }

    /// The cut with the places that the collapses `applied` gave its points.
    fn placed(&self, mesh: &Mesh, mut cut: Replayed, applied: impl Iterator<Item = usize>) -> Replayed {
        if !self.places.is_empty() {
            let mut places = vec![None; mesh.point_count()];
            for i in applied {
                if let Some(slot) = places.get_mut(self.collapses[i].to as usize) {
                    *slot = Some(Vec3::from_array(self.places[i]));
                }
            }
            cut.places = cut.origin.iter().map(|p| places[*p as usize]).collect();
        }
        cut
    }

    /// The sequence as bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = BlobWriter::new(*b"CSEQ", 2);
        blob.meta(&(self.face_count, self.vertex_count, &self.report));
        blob.array(&self.collapses);
        blob.array(&self.faces);
        blob.array(&self.pairs);
        blob.array(&self.places);
        blob.finish()
    }

    /// The sequence out of [`CollapseSequence::to_blob`] bytes.
    ///
    /// # Errors
    /// Wrong type, version or length, an index out of range, or errors that shrink.
    pub fn from_blob(bytes: &[u8]) -> Result<CollapseSequence, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"CSEQ", 2)?;
        let (face_count, vertex_count, report): (u32, u32, SequenceReport) = blob.meta()?;
        let sequence = CollapseSequence {
            face_count,
            vertex_count,
            report,
            collapses: blob.array()?,
            faces: blob.array()?,
            pairs: blob.array()?,
            places: blob.array()?,
        };
        blob.finish()?;
        let s = &sequence;
        let sound = s.faces.len() as u64 <= u64::from(face_count)
            && s.faces.iter().all(|f| *f < face_count)
            && s.pairs.iter().flatten().all(|w| *w < vertex_count)
            && (s.places.is_empty() || s.places.len() == s.collapses.len())
            && s.places.iter().flatten().all(|c| c.is_finite())
            && s.collapses.windows(2).all(|w| {
                w[0].first_face <= w[1].first_face && w[0].first_pair <= w[1].first_pair && w[0].error <= w[1].error
            })
            && s.collapses.first().is_none_or(|c| c.first_face == 0 && c.first_pair == 0)
            && s.collapses
                .last()
                .is_none_or(|c| c.first_face as usize <= s.faces.len() && c.first_pair as usize <= s.pairs.len());
        if sound { Ok(sequence) } else { Err(BlobError::Content("collapse sequence out of range or order".into())) }
    }
}

/// `mesh` without the faces `vanished`, its corners moved along `pairs`, which come last collapse first.
fn replayed<'a>(
    mesh: &Mesh,
    pairs: impl Iterator<Item = &'a [u32; 2]>,
    vanished: impl Iterator<Item = &'a u32>,
) -> Result<Replayed, MeshError> {
    // A partner may go later: resolve from the last pair backwards, when its own end is known already.
    let mut stands: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    for [wedge, partner] in pairs {
        if let (Some(end), true) = (stands.get(*partner as usize).copied(), (*wedge as usize) < stands.len()) {
            stands[*wedge as usize] = end;
        }
    }
    let mut gone = vec![false; mesh.face_count()];
    let mut gone_count = 0;
    for face in vanished {
        if let Some(slot) = gone.get_mut(*face as usize) {
            *slot = true;
            gone_count += 1;
        }
    }
    // Every collapse takes a face with it.
    if gone_count == 0 {
        return Ok(Replayed {
            level: mesh.clone(),
            origin: (0..mesh.point_count() as u32).collect(),
            heirs: (0..mesh.vertex_count() as u32).collect(),
            places: Vec::new(),
        });
    }
    let mut new_index = vec![u32::MAX; mesh.vertex_count()];
    let mut triangles = Vec::with_capacity(mesh.face_count() - gone_count.min(mesh.face_count()));
    let mut face_submesh: Vec<SubmeshId> = Vec::with_capacity(triangles.capacity());
    for (f, triangle) in mesh.triangles.iter().enumerate().filter(|(f, _)| !gone[*f]) {
        triangles.push(triangle.map(|v| stands[v as usize]));
        face_submesh.push(mesh.face_submesh[f]);
    }
    // Vertices keep the mesh's order.
    for v in triangles.iter().flatten() {
        new_index[*v as usize] = 0;
    }
    let keep: Vec<u32> = (0..mesh.vertex_count() as u32).filter(|v| new_index[*v as usize] == 0).collect();
    for (i, v) in keep.iter().enumerate() {
        new_index[*v as usize] = i as u32;
    }
    for triangle in &mut triangles {
        *triangle = triangle.map(|v| new_index[v as usize]);
    }
    let level = Mesh::new(mesh.gather(&keep, triangles, face_submesh))?;
    let mut origin = vec![0; level.point_count()];
    for (v, old) in keep.iter().enumerate() {
        origin[level.points[v].index()] = mesh.points[*old as usize].0;
    }
    let heirs = stands.iter().map(|v| new_index[*v as usize]).collect();
    Ok(Replayed { level, origin, heirs, places: Vec::new() })
}
