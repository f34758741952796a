//! The window as bytes for the private cache.

use kiln_asset::blob::{BlobError, BlobReader, BlobWriter};

use super::SlidingWindow;

const TAG: [u8; 4] = *b"WNDW";
const VERSION: u32 = 1;

impl SlidingWindow {
    /// The window as bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = BlobWriter::new(TAG, VERSION);
        blob.meta(&(self.base_vertices, self.collapses, self.done));
        blob.array(&self.submesh_faces);
        blob.array(&self.order);
        blob.array(&self.faces);
        blob.array(&self.parents);
        blob.array(&self.starts);
        blob.finish()
    }

    /// The window out of [`SlidingWindow::to_blob`] bytes.
    ///
    /// # Errors
    /// Wrong type, version or length, or a broken promise.
    pub fn from_blob(bytes: &[u8]) -> Result<SlidingWindow, BlobError> {
        let mut blob = BlobReader::open(bytes, TAG, VERSION)?;
        let (base_vertices, collapses, done) = blob.meta()?;
        let window = SlidingWindow {
            base_vertices,
            collapses,
            done,
            submesh_faces: blob.array()?,
            order: blob.array()?,
            faces: blob.array()?,
            parents: blob.array()?,
            starts: blob.array()?,
        };
        blob.finish()?;
        match window.defect() {
            None => Ok(window),
            Some(defect) => Err(BlobError::Content(defect.into())),
        }
    }

    /// What is wrong with it, if anything is.
    fn defect(&self) -> Option<&'static str> {
        let vertices = self.parents.len();
        if u32::try_from(vertices).is_err() || self.order.len() != vertices || !is_permutation(&self.order) {
            return Some("the vertices' order is no order");
        }
        if !self.faces_stay_in_submeshes() {
            return Some("the faces' order is none of each submesh");
        }
        if !self.starts.is_empty() && !self.starts_are_sound() {
            return Some("the points' starts are not the vertices'");
        }
        let base = self.base_vertices as usize;
        let at_start = base == vertices || (base < vertices && self.is_start(self.base_vertices));
        if !at_start || (vertices > 0 && base == 0) {
            return Some("the last LOD begins within a point, or is empty");
        }
        let collapsed = (base as u32..vertices as u32).filter(|v| self.is_start(*v)).count();
        if collapsed as u64 != u64::from(self.collapses) || self.done.checked_add(self.collapses).is_none() {
            return Some("the collapses are not as many as points that go");
        }
        (!self.parents_are_sound()).then_some("a parent is not of one earlier point")
    }

    fn faces_stay_in_submeshes(&self) -> bool {
        let total: u64 = self.submesh_faces.iter().map(|n| u64::from(*n)).sum();
        if total != self.faces.len() as u64 || total >= u64::from(u32::MAX) || !is_permutation(&self.faces) {
            return false;
        }
        let mut first = 0;
        self.submesh_faces.iter().all(|count| {
            let range = first..first + *count;
            first += count;
            self.faces[range.start as usize..range.end as usize].iter().all(|face| range.contains(face))
        })
    }

    fn starts_are_sound(&self) -> bool {
        let vertices = self.parents.len();
        let behind =
            self.starts.last().is_some_and(|word| !vertices.is_multiple_of(32) && word >> (vertices % 32) != 0);
        self.starts.len() == vertices.div_ceil(32) && self.is_start(0) && !behind
    }

    fn parents_are_sound(&self) -> bool {
        let starts = self.point_starts();
        let mut to = 0;
        self.parents.iter().zip(0..).all(|(parent, v)| {
            if v < self.base_vertices {
                return *parent == v;
            }
            let Some(point) = starts.get(*parent as usize) else { return false };
            to = if self.is_start(v) { *point } else { to };
            *parent < starts[v as usize] && *point == to
        })
    }
}

fn is_permutation(order: &[u32]) -> bool {
    let mut seen = vec![false; order.len()];
    order.iter().all(|v| seen.get_mut(*v as usize).is_some_and(|seen| !std::mem::replace(seen, true)))
}
