//! Which collapse rests on which: what makes any part of the log replayable on its own.
//!
//! **Problem.** A cut by parts leaves collapses out of the middle of the log. What is left can be replayed if every collapse finds
//! around it what it found when it was logged.
//!
//! **Method.** A collapse reads all faces at both of its ends and writes those at `from`: they vanish or change a corner. So it
//! rests on the last writer of each face that it reads. The log is walked once, with the faces at each point as a chain:
//! ```text
//! for each collapse:
//!     its dependencies <- writers of the faces at both ends
//!     faces at `from`: written by it; those that vanish leave a tombstone at their third point, with it as their writer
//!     append the chain of `from` to that of `to`, without the tombstones that it has read
//! ```
//! A tombstone is what a reader of faces would miss: that one was there. It is read like a face, and may go once a reader of its
//! chain has written to it.
//!
//! The walk is apart from the collapse loop: who asks for no rules by part does not pay for it, and the loop that everybody pays
//! for stays as it is. Chains are linked through the corners, so a collapse costs a cache line a face at its ends.
//!
//! A cut by thresholds a submesh takes, within a component of one submesh only, a prefix of what was done there, and prefixes are
//! closed: [`Dependencies::for_cuts`] does not walk those components, which in models of loose parts are nearly all.
//!
//! **Source.** H. Hoppe, "View-dependent refinement of progressive meshes", SIGGRAPH 1997, doi:10.1145/258734.258843, for the
//! idea; he tests neighbours at run time, here everything that was read counts.

use kiln_asset::Mesh;
use kiln_asset::blob::{BlobError, BlobReader, BlobWriter};

use super::CollapseSequence;
use super::components::{find, unite};
use crate::topology::{NONE, is_degenerate};

/// Marks the writer of a face that has vanished.
const DEAD: u32 = 1 << 31;

/// For each collapse of a sequence what it rests on and what it takes from which submesh.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Dependencies {
    /// `[collapse_count + 1]`: where each collapse's entries start in `on`.
    first: Vec<u32>,
    /// Collapses that it rests on, ascending.
    on: Vec<u32>,
    /// `[collapse_count + 1]`: where each collapse's entries start in `touches`.
    first_touch: Vec<u32>,
    /// (submesh some of whose faces it writes, how many of them vanish), ascending.
    touches: Vec<[u32; 2]>,
    /// Whether those of components of one submesh are left out.
    for_cuts: bool,
}

/// A face in the chains of its three corners.
#[derive(Clone, Copy)]
struct Link {
    /// The next corner in the chain of each of its corners, or [`NONE`].
    next: [u32; 3],
    /// The last collapse that wrote it, or [`NONE`]; [`DEAD`] is set once it has vanished.
    writer: u32,
    submesh: u32,
}

/// The faces at each point, as chains of corners.
struct Chains {
    links: Vec<Link>,
    head: Vec<u32>,
    tail: Vec<u32>,
}

impl Chains {
    fn new(mesh: &Mesh, walks: &[bool]) -> Chains {
        let mut chains = Chains {
            links: mesh.face_submesh.iter().map(|s| Link { next: [NONE; 3], writer: NONE, submesh: s.0 }).collect(),
            head: vec![NONE; mesh.point_count()],
            tail: vec![NONE; mesh.point_count()],
        };
        for (f, triangle) in mesh.triangles.iter().enumerate() {
            let points = triangle.map(|v| mesh.points[v as usize].0);
            if walks[points[0] as usize] && !is_degenerate(&points) {
                for (k, p) in points.into_iter().enumerate() {
                    chains.append(p as usize, (3 * f + k) as u32);
                }
            }
        }
        chains
    }

    fn set_next(&mut self, corner: u32, next: u32) {
        self.links[corner as usize / 3].next[corner as usize % 3] = next;
    }

    /// Appends the chain from `corner` on, whose last corner is `corner` itself.
    fn append(&mut self, point: usize, corner: u32) {
        match self.tail[point] {
            NONE => self.head[point] = corner,
            last => self.set_next(last, corner),
        }
        self.tail[point] = corner;
    }

    /// Notes the writers of all that hangs at `to`, and takes tombstones and the faces in `dying` out of its chain.
    fn read(&mut self, to: usize, dying: &[u32], on: &mut Vec<u32>) {
        let (mut at, mut last) = (self.head[to], NONE);
        while at != NONE {
            let Link { next, writer, .. } = self.links[at as usize / 3];
            let next = next[at as usize % 3];
            let mut stays = true;
            if writer != NONE {
                on.push(writer & !DEAD);
                stays = writer & DEAD == 0;
            }
            if stays && !dying.contains(&(at / 3)) {
                last = at;
            } else if last == NONE {
                self.head[to] = next;
            } else {
                self.set_next(last, next);
            }
            at = next;
        }
        self.tail[to] = last;
    }

    /// Lets collapse `i`, which moved `to`, write all faces there.
    fn claim(&mut self, i: u32, to: usize) {
        let mut at = self.head[to];
        while at != NONE {
            let link = &mut self.links[at as usize / 3];
            if link.writer == NONE || link.writer & DEAD == 0 {
                link.writer = i;
            }
            at = link.next[at as usize % 3];
        }
    }

    /// Notes the writers of all that hangs at `from`, lets collapse `i` write it, and hangs it to `to`.
    fn write(&mut self, i: u32, [from, to]: [usize; 2], dying: &[u32], on: &mut Vec<u32>, touched: &mut Vec<[u32; 2]>) {
        let (mut at, mut tombstone, mut moved) = (self.head[from], NONE, false);
        while at != NONE {
            let link = &mut self.links[at as usize / 3];
            let next = std::mem::replace(&mut link.next[at as usize % 3], NONE);
            if link.writer != NONE {
                on.push(link.writer & !DEAD);
            }
            if link.writer == NONE || link.writer & DEAD == 0 {
                touch(touched, link.submesh);
                if dying.contains(&(at / 3)) {
                    tombstone = at;
                } else {
                    link.writer = i;
                    moved = true;
                    self.append(to, at);
                }
            }
            at = next;
        }
        // A chain that lost faces and gained none has to tell it.
        if !moved && tombstone != NONE {
            self.append(to, tombstone);
        }
        for face in dying {
            self.links[*face as usize].writer = i | DEAD;
        }
        (self.head[from], self.tail[from]) = (NONE, NONE);
    }
}

fn touch(touched: &mut Vec<[u32; 2]>, submesh: u32) -> &mut u32 {
    let at = touched.iter().position(|t| t[0] == submesh).unwrap_or_else(|| {
        touched.push([submesh, 0]);
        touched.len() - 1
    });
    &mut touched[at][1]
}

impl Dependencies {
    /// Of `sequence`, which was made from `mesh`.
    ///
    /// # Errors
    /// The sequence belongs to another mesh.
    pub fn new(mesh: &Mesh, sequence: &CollapseSequence) -> Result<Dependencies, BlobError> {
        Dependencies::walked(mesh, sequence, &vec![true; mesh.point_count()], false)
    }

    /// What cuts by one threshold a submesh need: as [`Dependencies::new`], but nothing in components of one submesh.
    ///
    /// # Errors
    /// The sequence belongs to another mesh.
    pub fn for_cuts(mesh: &Mesh, sequence: &CollapseSequence) -> Result<Dependencies, BlobError> {
        Dependencies::walked(mesh, sequence, &shared_points(mesh), true)
    }

    /// `walks`: `[point_count]`, the same for all points of a component.
    fn walked(
        mesh: &Mesh,
        sequence: &CollapseSequence,
        walks: &[bool],
        for_cuts: bool,
    ) -> Result<Dependencies, BlobError> {
        let (points, faces) = (mesh.point_count() as u32, mesh.face_count() as u32);
        let sound = sequence.collapses.len() < DEAD as usize
            && sequence.collapses.iter().all(|c| c.from < points && c.to < points && c.from != c.to)
            && sequence.faces.iter().all(|f| *f < faces);
        if !sound {
            return Err(BlobError::Content("the collapse sequence belongs to another mesh".into()));
        }
        let mut chains = Chains::new(mesh, walks);
        let count = sequence.collapses.len();
        let mut out = Dependencies { first: vec![0], first_touch: vec![0], for_cuts, ..Dependencies::default() };
        out.first.reserve_exact(count);
        out.first_touch.reserve_exact(count);
        out.touches.reserve(count + count / 8);
        let (mut on, mut touched) = (Vec::new(), Vec::new());
        for (i, collapse) in sequence.collapses.iter().enumerate() {
            on.clear();
            touched.clear();
            let dying = &sequence.faces[sequence.faces_of(i)];
            if walks[collapse.from as usize] {
                let ends = [collapse.from as usize, collapse.to as usize];
                chains.read(ends[1], dying, &mut on);
                chains.write(i as u32, ends, dying, &mut on, &mut touched);
                if !sequence.places.is_empty() {
                    chains.claim(i as u32, ends[1]);
                }
                on.sort_unstable();
                on.dedup();
            }
            for face in dying {
                *touch(&mut touched, mesh.face_submesh[*face as usize].0) += 1;
            }
            touched.sort_unstable();
            out.on.extend_from_slice(&on);
            out.touches.extend_from_slice(&touched);
            out.first.push(out.on.len() as u32);
            out.first_touch.push(out.touches.len() as u32);
        }
        Ok(out)
    }

    /// Whether all dependencies are there, not only those that cuts by submesh need.
    pub fn is_complete(&self) -> bool {
        !self.for_cuts
    }

    /// Number of collapses.
    pub fn len(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    /// Whether the sequence has no collapse.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The collapses that collapse `i` rests on, ascending; all are below `i`.
    #[inline]
    pub fn of(&self, i: usize) -> &[u32] {
        &self.on[self.first[i] as usize..self.first[i + 1] as usize]
    }

    /// The submeshes some of whose faces collapse `i` writes, and how many of them vanish.
    #[inline]
    pub fn touches(&self, i: usize) -> &[[u32; 2]] {
        &self.touches[self.first_touch[i] as usize..self.first_touch[i + 1] as usize]
    }

    /// Bytes in memory.
    pub fn byte_size(&self) -> usize {
        4 * (self.first.len() + self.on.len() + self.first_touch.len()) + 8 * self.touches.len()
    }

    /// As bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = BlobWriter::new(*b"CDEP", 1);
        blob.meta(&self.for_cuts);
        blob.array(&self.first);
        blob.array(&self.on);
        blob.array(&self.first_touch);
        blob.array(&self.touches);
        blob.finish()
    }

    /// Out of [`Dependencies::to_blob`] bytes; `submesh_count` is that of the mesh.
    ///
    /// # Errors
    /// Wrong type, version or length, a collapse that rests on a later one, or a submesh that there is not.
    pub fn from_blob(bytes: &[u8], submesh_count: usize) -> Result<Dependencies, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"CDEP", 1)?;
        let for_cuts = blob.meta()?;
        let read = Dependencies {
            for_cuts,
            first: blob.array()?,
            on: blob.array()?,
            first_touch: blob.array()?,
            touches: blob.array()?,
        };
        blob.finish()?;
        let counted = |first: &[u32], total: usize| {
            first.first() == Some(&0)
                && first.windows(2).all(|w| w[0] <= w[1])
                && first.last().is_some_and(|last| *last as usize == total)
        };
        let sound = counted(&read.first, read.on.len())
            && counted(&read.first_touch, read.touches.len())
            && read.first.len() == read.first_touch.len()
            && read.len() < DEAD as usize
            && (0..read.len()).all(|i| ascending_below(read.of(i).iter().copied(), i as u64))
            && (0..read.len()).all(|i| ascending_below(read.touches(i).iter().map(|t| t[0]), submesh_count as u64));
        if sound { Ok(read) } else { Err(BlobError::Content("dependencies out of range or order".into())) }
    }
}

/// `[point_count]`: whether the component of each point has faces of several submeshes.
fn shared_points(mesh: &Mesh) -> Vec<bool> {
    let mut leader: Vec<u32> = (0..mesh.point_count() as u32).collect();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.points[v as usize].0);
        unite(&mut leader, a, b);
        unite(&mut leader, b, c);
    }
    let mut only = vec![NONE; leader.len()];
    let mut shared = vec![false; leader.len()];
    for (triangle, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
        let top = find(&mut leader, mesh.points[triangle[0] as usize].0) as usize;
        shared[top] |= only[top] != NONE && only[top] != submesh.0;
        only[top] = submesh.0;
    }
    (0..leader.len() as u32).map(|p| shared[find(&mut leader, p) as usize]).collect()
}

fn ascending_below(values: impl Iterator<Item = u32>, end: u64) -> bool {
    let mut least = 0;
    values.into_iter().all(|v| {
        let fits = u64::from(v) >= least && u64::from(v) < end;
        least = u64::from(v) + 1;
        fits
    })
}
