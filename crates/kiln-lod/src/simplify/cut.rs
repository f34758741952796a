//! Closed sets of collapses: what can be replayed, and what may be undone.
//!
//! A set is *closed* if it holds with every collapse all that it rests on. Replaying a closed set in the order of the log gives what
//! performing those collapses one by one gives, bit for bit, whatever was left out between them: each finds the faces that it
//! found when it was logged. Prefixes are closed. A split undoes a collapse: legal while no applied one rests on it.

use super::Dependencies;

/// A closed set of collapses, changed one by one.
#[derive(Clone, Debug)]
pub struct ClosedSet<'a> {
    dependencies: &'a Dependencies,
    applied: Vec<bool>,
    /// How many applied collapses rest on each.
    resting: Vec<u32>,
}

impl<'a> ClosedSet<'a> {
    /// The empty set: the source.
    ///
    /// # Panics
    /// If the dependencies are those of [`Dependencies::for_cuts`], which leave some out.
    pub fn new(dependencies: &'a Dependencies) -> ClosedSet<'a> {
        assert!(dependencies.is_complete(), "some dependencies are left out");
        let count = dependencies.len();
        ClosedSet { dependencies, applied: vec![false; count], resting: vec![0; count] }
    }

    /// The set of the collapses `i` with `applied[i]`, if it is closed.
    ///
    /// # Panics
    /// As [`ClosedSet::new`].
    pub fn of(dependencies: &'a Dependencies, applied: &[bool]) -> Option<ClosedSet<'a>> {
        let mut set = ClosedSet::new(dependencies);
        let whole = applied.len() == dependencies.len();
        (whole && (0..applied.len()).all(|i| !applied[i] || set.collapse(i))).then_some(set)
    }

    /// Which collapses are in it.
    pub fn applied(&self) -> &[bool] {
        &self.applied
    }

    /// Whether collapse `i` may be applied: it is not, and all that it rests on is.
    pub fn may_collapse(&self, i: usize) -> bool {
        !self.applied[i] && self.dependencies.of(i).iter().all(|d| self.applied[*d as usize])
    }

    /// Whether collapse `i` may be undone: it is applied, and nothing applied rests on it.
    pub fn may_split(&self, i: usize) -> bool {
        self.applied[i] && self.resting[i] == 0
    }

    /// Applies collapse `i` if it may be.
    pub fn collapse(&mut self, i: usize) -> bool {
        let may = self.may_collapse(i);
        if may {
            self.applied[i] = true;
            for d in self.dependencies.of(i) {
                self.resting[*d as usize] += 1;
            }
        }
        may
    }

    /// Undoes collapse `i` if it may be.
    pub fn split(&mut self, i: usize) -> bool {
        let may = self.may_split(i);
        if may {
            self.applied[i] = false;
            for d in self.dependencies.of(i) {
                self.resting[*d as usize] -= 1;
            }
        }
        may
    }
}

/// The largest closed set whose every collapse lies before the threshold of every submesh that it touches; `until`:
/// `[submesh_count]`.
pub fn closed_below(dependencies: &Dependencies, until: &[u32]) -> Vec<bool> {
    let mut applied = vec![false; dependencies.len()];
    for i in 0..applied.len() {
        applied[i] = dependencies.touches(i).iter().all(|t| (i as u32) < until[t[0] as usize])
            && dependencies.of(i).iter().all(|d| applied[*d as usize]);
    }
    applied
}

/// What a submesh shall have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Want {
    /// What the level's total leaves it.
    Free,
    /// At most so many triangles.
    Faces(u32),
}

/// Where the free submeshes stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop {
    /// When they have this many triangles together.
    pub faces: u32,
    /// But not before this collapse: a finer level went so far.
    pub earliest: usize,
    /// And not after this one.
    pub latest: usize,
}

/// A cut that keeps to wishes by submesh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartCut {
    /// The closed set.
    pub applied: Vec<bool>,
    /// `[submesh_count]`: the threshold that it is the closed set of.
    pub until: Vec<u32>,
    /// `[submesh_count]`: triangles left.
    pub faces: Vec<u32>,
    /// The threshold of the free submeshes.
    pub free_until: usize,
}

/// The cut in which each submesh is brought to its wish with the least threshold that does it; `faces` and `wants`:
/// `[submesh_count]`. In one pass: a submesh closes at the collapse that meets its wish, and what touches a closed one is left out.
/// The result is [`closed_below`] its own thresholds. `closed`: whether dependencies count; without them it tells where the
/// free submeshes would stop.
pub fn cut_by_parts(dependencies: &Dependencies, faces: &[u32], wants: &[Want], stop: Stop, closed: bool) -> PartCut {
    let count = dependencies.len();
    let mut faces = faces.to_vec();
    let mut free: u64 = faces.iter().zip(wants).filter(|(_, w)| **w == Want::Free).map(|(f, _)| u64::from(*f)).sum();
    let mut open: Vec<bool> =
        faces.iter().zip(wants).map(|(f, want)| !matches!(want, Want::Faces(most) if f <= most)).collect();
    let mut until: Vec<u32> = open.iter().map(|o| if *o { count as u32 } else { 0 }).collect();
    let stops =
        |free: u64, next: usize| (free <= u64::from(stop.faces) && next >= stop.earliest) || next >= stop.latest;
    let mut free_until = if stops(free, 0) { 0 } else { count };
    let mut left_open = open.iter().zip(wants).filter(|(o, w)| **o && **w != Want::Free).count();
    let mut applied = vec![false; count];
    for i in 0..count {
        if free_until <= i && left_open == 0 {
            break;
        }
        let touches = dependencies.touches(i);
        let may = touches.iter().all(|t| match wants[t[0] as usize] {
            Want::Free => i < free_until,
            Want::Faces(_) => open[t[0] as usize],
        });
        if may && (!closed || dependencies.of(i).iter().all(|d| applied[*d as usize])) {
            applied[i] = true;
            for [s, vanish] in touches {
                let s = *s as usize;
                // Bytes of a cache may promise more than the mesh has.
                faces[s] = faces[s].saturating_sub(*vanish);
                match wants[s] {
                    Want::Free => free = free.saturating_sub(u64::from(*vanish)),
                    Want::Faces(most) if faces[s] <= most => {
                        if open[s] {
                            left_open -= 1;
                        }
                        open[s] = false;
                        until[s] = i as u32 + 1;
                    }
                    Want::Faces(_) => {}
                }
            }
        }
        if free_until == count && stops(free, i + 1) {
            free_until = i + 1;
        }
    }
    for (slot, want) in until.iter_mut().zip(wants) {
        if *want == Want::Free {
            *slot = free_until as u32;
        }
    }
    PartCut { applied, until, faces, free_until }
}
