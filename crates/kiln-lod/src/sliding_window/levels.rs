//! Levels out of a window, and how far they are from the source.

use kiln_asset::{Mesh, SubmeshId};
use rayon::prelude::*;

use super::order::{death, inverse};
use super::{SlidingWindow, WindowError};
use crate::checkpoint::Checkpoint;
use crate::simplify::error::Surface;

impl SlidingWindow {
    /// `level0` in the window's order, with all its attributes. Its vertices and faces are those of the level that the window was
    /// made of, in that order; positions, attributes and points may be others.
    ///
    /// # Errors
    /// Another number of vertices or faces, or faces that vanish in another order.
    pub fn apply(&self, level0: &Mesh) -> Result<Mesh, WindowError> {
        self.check_counts(level0)?;
        let new_of = inverse(&self.order);
        let reordered = |f: &u32| level0.triangles[*f as usize].map(|v| new_of[v as usize]);
        let triangles: Vec<[u32; 3]> = self.faces.iter().map(reordered).collect();
        let face_submesh = self.faces.iter().map(|f| level0.face_submesh[*f as usize]).collect();
        let mesh = Mesh::new(level0.gather(&self.order, triangles, face_submesh))?;
        self.check_order(&mesh)?;
        Ok(mesh)
    }

    fn check_counts(&self, level0: &Mesh) -> Result<(), WindowError> {
        let submeshes = (0..level0.submeshes.len() as u32).map(SubmeshId);
        let faces: Vec<u32> = submeshes.map(|s| level0.submesh_faces(s).len() as u32).collect();
        if level0.vertex_count() == self.vertex_count() && faces == self.submesh_faces {
            return Ok(());
        }
        let said = |vertices: usize, faces: &[u32]| format!("{vertices} vertices and {faces:?} faces by submesh");
        let expected = said(self.vertex_count(), &self.submesh_faces);
        Err(WindowError::Counts { expected, found: said(level0.vertex_count(), &faces) })
    }

    /// Whether no face vanishes after one behind it in its submesh, and all are there at LOD 0.
    fn check_order(&self, level0: &Mesh) -> Result<(), WindowError> {
        let starts = self.point_starts();
        // Over first vertices: a point's wedges go to wedges of one point.
        let parents: Vec<u32> = self.parents.iter().map(|p| starts[*p as usize]).collect();
        let corners = |f: &[u32; 3]| f.map(|v| starts[v as usize]);
        let deaths: Vec<u32> = level0.triangles.par_iter().map(|f| death(corners(f), &parents)).collect();
        let wrong = |f: &usize| {
            let of_next = |f: usize| deaths.get(f + 1).filter(|_| level0.face_submesh[f] == level0.face_submesh[f + 1]);
            deaths[*f] == u32::MAX || of_next(*f).is_some_and(|next| *next < deaths[*f])
        };
        match (0..deaths.len()).find(wrong) {
            Some(face) => Err(WindowError::Order { face: face as u32 }),
            None => Ok(()),
        }
    }

    /// The vertex whose attributes vertex `i` has while the first `alive` vertices are.
    ///
    /// # Panics
    /// If there is no vertex `i`.
    pub fn pick(&self, mut i: u32, alive: u32) -> u32 {
        let alive = alive.max(self.base_vertices);
        while i >= alive {
            i = self.parents[i as usize];
        }
        i
    }

    /// The paper's evolution of vertex `i`: what it turns into, one after the other; empty for those that never go.
    pub fn chain(&self, i: u32) -> impl Iterator<Item = u32> + '_ {
        let parent = |v: u32| (v >= self.base_vertices).then(|| self.parents[v as usize]);
        std::iter::successors(parent(i), move |v| parent(*v))
    }

    /// `[submesh_count]`: faces of each submesh at LOD `lod`; they stand first in it. `level0`: in the window's order.
    ///
    /// # Errors
    /// `level0` is another level.
    pub fn triangles_at(&self, level0: &Mesh, lod: u32) -> Result<Vec<u32>, WindowError> {
        self.check_counts(level0)?;
        let (alive, mut first) = (self.vertices_at(lod), 0);
        let mut of_submesh = |count: &u32| {
            let range = &level0.triangles[first..first + *count as usize];
            first += *count as usize;
            range.partition_point(|triangle| self.is_drawn(*triangle, alive)) as u32
        };
        Ok(self.submesh_faces.iter().map(&mut of_submesh).collect())
    }

    fn is_drawn(&self, triangle: [u32; 3], alive: u32) -> bool {
        let [a, b, c] = triangle.map(|v| self.point(self.pick(v, alive)));
        a != b && b != c && c != a
    }

    /// First vertex of the point of vertex `v`.
    fn point(&self, mut v: u32) -> u32 {
        while !self.is_start(v) {
            v -= 1;
        }
        v
    }

    /// What is drawn at LOD `lod`: the first v(d) vertices, the faces that are left. `level0`: in the window's order.
    ///
    /// # Errors
    /// `level0` is another level.
    pub fn level(&self, level0: &Mesh, lod: u32) -> Result<Mesh, WindowError> {
        let (counts, alive) = (self.triangles_at(level0, lod)?, self.vertices_at(lod));
        let (mut triangles, mut face_submesh) = (Vec::new(), Vec::new());
        let mut first = 0;
        for ((count, all), submesh) in counts.iter().zip(&self.submesh_faces).zip(0..) {
            let drawn = &level0.triangles[first..first + *count as usize];
            triangles.par_extend(drawn.par_iter().map(|t| t.map(|v| self.pick(v, alive))));
            face_submesh.resize(triangles.len(), SubmeshId(submesh));
            first += *all as usize;
        }
        let keep: Vec<u32> = (0..alive).collect();
        Ok(Mesh::new(level0.gather(&keep, triangles, face_submesh))?)
    }

    /// LOD `lod` in the order of the level that the window was made of: sample points depend on order, and where it equals a
    /// discrete level it shall have that one's error.
    pub(super) fn level_as_it_was(&self, level0: &Mesh, lod: u32) -> Result<Mesh, WindowError> {
        const GONE: u32 = u32::MAX;
        let (counts, alive) = (self.triangles_at(level0, lod)?, self.vertices_at(lod));
        let mut drawn = vec![GONE; self.face_count()];
        let mut first = 0;
        for (count, all) in counts.iter().zip(&self.submesh_faces) {
            (first..first + count).for_each(|face| drawn[self.faces[face as usize] as usize] = face);
            first += all;
        }
        drawn.retain(|face| *face != GONE);
        let mut triangles: Vec<[u32; 3]> =
            drawn.par_iter().map(|f| level0.triangles[*f as usize].map(|v| self.pick(v, alive))).collect();
        // A level from which nothing is gone keeps the vertices that no face uses.
        let mut used = vec![drawn.len() == self.face_count(); self.vertex_count()];
        triangles.iter().flatten().for_each(|v| used[*v as usize] = true);
        let keep: Vec<u32> = inverse(&self.order).into_iter().filter(|v| used[*v as usize]).collect();
        let mut place = vec![0; self.vertex_count()];
        keep.iter().zip(0..).for_each(|(v, new)| place[*v as usize] = new);
        triangles.par_iter_mut().for_each(|t| *t = t.map(|v| place[v as usize]));
        let face_submesh = drawn.iter().map(|f| level0.face_submesh[*f as usize]).collect();
        Ok(Mesh::new(level0.gather(&keep, triangles, face_submesh))?)
    }

    /// Measured places: `count` (at least 2) from LOD 0 to the coarsest, each with the same share of points less than the one before,
    /// and those of `lods`. `level0`: in the window's order.
    ///
    /// # Errors
    /// `level0` is another level.
    pub fn checkpoints(
        &self,
        level0: &Mesh,
        source: &Surface<'_>,
        count: usize,
        lods: &[u32],
    ) -> Result<Vec<Checkpoint>, WindowError> {
        let mut details: Vec<u32> =
            self.details(count.max(2) as u32).chain(lods.iter().map(|lod| *lod.min(&self.collapses))).collect();
        details.sort_unstable();
        details.dedup();
        let mut least = 0.0_f32;
        let mut checkpoint = |detail: u32| {
            let level = self.level_as_it_was(level0, detail)?;
            // Nothing is infinitely far from something.
            least = least.max(source.distance(&level).min(f32::MAX));
            let (vertices, triangles) = (self.vertices_at(detail), level.face_count() as u32);
            Ok(Checkpoint { detail, vertices, triangles, error: least })
        };
        details.into_iter().map(&mut checkpoint).collect()
    }

    /// From 0 to the coarsest, the points that are left falling geometrically.
    fn details(&self, count: u32) -> impl Iterator<Item = u32> {
        let points = match self.starts.is_empty() {
            true => self.vertex_count() as u32,
            false => self.starts.iter().map(|word| word.count_ones()).sum(),
        };
        let collapses = self.collapses;
        let base = f64::from((points - collapses).max(1));
        let left = move |k: u32| {
            f64::from(points.max(1)) * libm::pow(base / f64::from(points.max(1)), f64::from(k) / f64::from(count - 1))
        };
        (0..count).map(move |k| match k {
            0 => 0,
            k if k + 1 == count => collapses,
            k => points.saturating_sub(left(k).round() as u32).min(collapses),
        })
    }
}
