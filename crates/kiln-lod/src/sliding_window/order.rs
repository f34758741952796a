//! The order: from a mesh and its collapse sequence to the window.

use kiln_asset::{Mesh, SubmeshId};
use rayon::prelude::*;

use super::{SlidingWindow, WindowError};
use crate::simplify::CollapseSequence;

const NONE: u32 = u32::MAX;

impl SlidingWindow {
    /// The window over the mesh as it is after the first `done` collapses of its sequence ([`CollapseSequence::replay`]): level 0.
    ///
    /// # Errors
    /// A sequence of another mesh, or one that moves points; a face with two corners at one point.
    pub fn new(mesh: &Mesh, sequence: &CollapseSequence, done: usize) -> Result<SlidingWindow, WindowError> {
        check_sequence(mesh, sequence, done)?;
        let level = Level0::new(mesh, sequence, done)?;
        let points = Points::new(&level, sequence, done)?;
        let (order, first) = points.vertices(&level.mesh);
        let new_of = inverse(&order);
        let parents = parents(&level, sequence, done, &points, &first, &new_of)?;
        let deaths = deaths(&level.mesh, &points)?;
        check_deaths(&level, sequence, done, &points, &deaths)?;

        // Keys beside the faces: looking them up would read memory at random for every comparison.
        let face_submesh = level.mesh.face_submesh.par_iter();
        let mut faces: Vec<(SubmeshId, u32, u32)> =
            face_submesh.zip(&deaths).enumerate().map(|(f, (submesh, death))| (*submesh, *death, f as u32)).collect();
        faces.par_sort_unstable();
        let submeshes = (0..level.mesh.submeshes.len() as u32).map(SubmeshId);
        Ok(SlidingWindow {
            faces: faces.into_iter().map(|(.., face)| face).collect(),
            submesh_faces: submeshes.map(|s| level.mesh.submesh_faces(s).len() as u32).collect(),
            parents,
            starts: if points.count as usize == order.len() { Vec::new() } else { bits(&first, order.len()) },
            base_vertices: first[points.base as usize],
            collapses: points.count - points.base,
            done: done as u32,
            order,
        })
    }
}

fn check_sequence(mesh: &Mesh, sequence: &CollapseSequence, done: usize) -> Result<(), WindowError> {
    let (faces, vertices) = (sequence.face_count() as usize, sequence.vertex_count() as usize);
    if (faces, vertices) != (mesh.face_count(), mesh.vertex_count()) {
        let (f, v) = (mesh.face_count(), mesh.vertex_count());
        let counts = format!("{vertices} vertices and {faces} faces for {v} and {f}");
        return Err(WindowError::Sequence(counts));
    }
    let all = &sequence.collapses;
    if done > all.len() {
        return Err(WindowError::Sequence(format!("{done} collapses done of {}", all.len())));
    }
    let points = mesh.point_count() as u32;
    if let Some(i) = all.iter().position(|c| c.from >= points || c.to >= points) {
        return Err(WindowError::Sequence(format!("collapse {i} names a point of at most {points}")));
    }
    if sequence.places.is_empty() {
        return Ok(());
    }
    let mut stands = vec![glam::Vec3::ZERO; mesh.point_count()];
    mesh.points.iter().zip(&mesh.positions).rev().for_each(|(point, place)| stands[point.index()] = *place);
    let stays = |(c, place): (&crate::simplify::Collapse, &[f32; 3])| stands[c.to as usize].to_array() == *place;
    match all.iter().zip(&sequence.places).position(|pair| !stays(pair)) {
        Some(collapse) => Err(WindowError::Moves { collapse }),
        None => Ok(()),
    }
}

/// For each value of a permutation its place.
pub(super) fn inverse(order: &[u32]) -> Vec<u32> {
    let mut new_of = vec![0; order.len()];
    order.iter().zip(0..).for_each(|(old, new)| new_of[*old as usize] = new);
    new_of
}

/// One bit a vertex, set for those in `first`.
fn bits(first: &[u32], vertices: usize) -> Vec<u32> {
    let mut words = vec![0; vertices.div_ceil(32)];
    for v in first.iter().filter(|v| (**v as usize) < vertices) {
        words[*v as usize / 32] |= 1 << (v % 32);
    }
    words
}

/// The mesh after the collapses that are done, and what its ids are in it.
struct Level0 {
    mesh: Mesh,
    /// `[mesh's points]` and `[mesh's vertices]`: those of the level; [`NONE`]: not there.
    point_of: Vec<u32>,
    vertex_of: Vec<u32>,
    /// `[mesh's faces]`.
    face_of: Vec<u32>,
}

impl Level0 {
    fn new(mesh: &Mesh, sequence: &CollapseSequence, done: usize) -> Result<Level0, WindowError> {
        let cut = sequence.replay_with_heirs(mesh, done)?;
        let mut point_of = vec![NONE; mesh.point_count()];
        cut.origin.iter().zip(0..).for_each(|(mesh_point, point)| point_of[*mesh_point as usize] = point);
        let mut vertex_of = cut.heirs;
        let mut face_of = vec![0; mesh.face_count()];
        for i in 0..done {
            sequence.pairs[sequence.pairs_of(i)].iter().for_each(|[gone, _]| vertex_of[*gone as usize] = NONE);
            sequence.faces[sequence.faces_of(i)].iter().for_each(|gone| face_of[*gone as usize] = NONE);
        }
        let left = face_of.iter_mut().filter(|face| **face != NONE);
        left.zip(0..).for_each(|(face, number)| *face = number);
        Ok(Level0 { mesh: cut.level, point_of, vertex_of, face_of })
    }
}

/// The points of level 0, numbered anew: those that never go, then the others, the first to go last.
struct Points {
    count: u32,
    /// How many never go.
    base: u32,
    /// `[count]`, by new number: the point that it turns into, an earlier one; itself below `base`.
    parents: Vec<u32>,
    /// `[vertex_count]` of level 0: the point by its new number.
    at: Vec<u32>,
}

impl Points {
    fn new(level: &Level0, sequence: &CollapseSequence, done: usize) -> Result<Points, WindowError> {
        let count = level.mesh.point_count() as u32;
        let steps = &sequence.collapses[done..];
        let odd = |i: usize| WindowError::Sequence(format!("collapse {} is of points that are gone", done + i));
        if steps.len() >= count.max(1) as usize {
            return Err(odd(count as usize));
        }
        let base = count - steps.len() as u32;
        let mut number = vec![NONE; count as usize];
        for (i, step) in steps.iter().enumerate() {
            let from = level.point_of[step.from as usize];
            match number.get_mut(from as usize) {
                Some(slot) if *slot == NONE => *slot = count - 1 - i as u32,
                _ => return Err(odd(i)),
            }
        }
        let mut next = 0;
        for point in &level.mesh.points {
            let slot = &mut number[point.index()];
            if *slot == NONE {
                *slot = next;
                next += 1;
            }
        }
        let mut parents: Vec<u32> = (0..count).collect();
        for (i, step) in steps.iter().enumerate() {
            let from = count - 1 - i as u32;
            match number.get(level.point_of[step.to as usize] as usize) {
                Some(to) if *to < from => parents[from as usize] = *to,
                _ => return Err(odd(i)),
            }
        }
        let at = level.mesh.points.iter().map(|point| number[point.index()]).collect();
        Ok(Points { count, base, parents, at })
    }

    /// Level 0's vertices by point, and for each point its first, then their number.
    fn vertices(&self, level: &Mesh) -> (Vec<u32>, Vec<u32>) {
        let mut first = vec![0_u32; self.count as usize + 1];
        self.at.iter().for_each(|point| first[*point as usize + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let (mut next, mut order) = (first.clone(), vec![0; level.vertex_count()]);
        for (v, point) in (0..).zip(&self.at) {
            let slot = &mut next[*point as usize];
            order[*slot as usize] = v;
            *slot += 1;
        }
        (order, first)
    }
}

/// `[vertex_count]`, in the new order: where each vertex goes.
fn parents(
    level: &Level0,
    sequence: &CollapseSequence,
    done: usize,
    points: &Points,
    first: &[u32],
    new_of: &[u32],
) -> Result<Vec<u32>, WindowError> {
    // Itself where its point never goes; else the first wedge of its point's parent, for wedges that no living face uses.
    let mut parents: Vec<u32> = (0..new_of.len() as u32).collect();
    for point in points.base..points.count {
        let block = first[point as usize] as usize..first[point as usize + 1] as usize;
        parents[block].fill(first[points.parents[point as usize] as usize]);
    }
    for i in done..sequence.collapses.len() {
        let from = points.count - 1 - (i - done) as u32;
        for pair in &sequence.pairs[sequence.pairs_of(i)] {
            let [wedge, partner] = pair.map(|w| level.vertex_of[w as usize]);
            let at = |w: u32| points.at.get(w as usize).copied();
            if at(wedge) != Some(from) || at(partner) != Some(points.parents[from as usize]) {
                let [a, b] = pair;
                return Err(WindowError::Sequence(format!("collapse {i} gives wedge {a} to {b}, of other points")));
            }
            parents[new_of[wedge as usize] as usize] = new_of[partner as usize];
        }
    }
    Ok(parents)
}

/// `[face_count]` of level 0: the point whose going takes each face along; 0 for those that stay.
fn deaths(level: &Mesh, points: &Points) -> Result<Vec<u32>, WindowError> {
    let of = |f: &[u32; 3]| death(f.map(|v| points.at[v as usize]), &points.parents);
    let deaths: Vec<u32> = level.triangles.par_iter().map(of).collect();
    match deaths.iter().position(|death| *death == NONE) {
        Some(face) => Err(WindowError::Degenerate { face: face as u32 }),
        None => Ok(deaths),
    }
}

/// The latest of the merges of the corners of a face; [`NONE`] if two are the same.
///
/// `parents`: of points or of first vertices of points; those that never go are their own.
pub(super) fn death([a, b, c]: [u32; 3], parents: &[u32]) -> u32 {
    merge(a, b, parents).max(merge(b, c, parents)).max(merge(c, a, parents))
}

fn merge(mut a: u32, mut b: u32, parents: &[u32]) -> u32 {
    let mut last = NONE;
    while a != b {
        let later = if a > b { &mut a } else { &mut b };
        last = *later;
        *later = parents[last as usize];
        if *later == last {
            // It never goes, nor does the earlier one.
            return 0;
        }
    }
    last
}

/// The order rests on merges alone; a sequence that lets other faces vanish is of another mesh.
fn check_deaths(
    level: &Level0,
    sequence: &CollapseSequence,
    done: usize,
    points: &Points,
    deaths: &[u32],
) -> Result<(), WindowError> {
    let mut said = 0;
    for i in done..sequence.collapses.len() {
        let from = points.count - 1 - (i - done) as u32;
        for face in &sequence.faces[sequence.faces_of(i)] {
            said += 1;
            if deaths.get(level.face_of[*face as usize] as usize) != Some(&from) {
                return Err(WindowError::Sequence(format!("face {face} does not vanish in collapse {i}")));
            }
        }
    }
    let found = deaths.iter().filter(|d| **d != 0).count();
    if said == found { Ok(()) } else { Err(WindowError::Sequence(format!("{said} faces vanish for {found}"))) }
}
