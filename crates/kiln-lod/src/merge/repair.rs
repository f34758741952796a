//! What merge repairs, in words and numbers.

use std::collections::BTreeMap;

use kiln_asset::{FaceId, Mesh};
use serde::{Deserialize, Serialize};

/// Soft trouble in a mesh, and the rule by which it is repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RepairKind {
    /// A face of which two corners lie at one point is dropped.
    DegenerateFaces,
    /// A face whose submesh has the same three points in the same winding already is dropped.
    DuplicateFaces,
    /// A vertex that no face uses is dropped.
    UnusedVertices,
    /// A normal shorter than 1e-6 becomes the area-weighted mean of its faces' normals.
    ZeroNormals,
    /// A face wound against its neighbours, or a closed part wound inwards, is turned over.
    Winding,
}

impl RepairKind {
    /// What was done, to put a count behind: `degenerate faces: dropped (17 times)`.
    pub fn sentence(self) -> &'static str {
        match self {
            RepairKind::DegenerateFaces => "faces with two corners at one point: dropped",
            RepairKind::DuplicateFaces => "faces that their submesh has already: dropped",
            RepairKind::UnusedVertices => "vertices that no face uses: dropped",
            RepairKind::ZeroNormals => "normals without direction: taken from their faces",
            RepairKind::Winding => "faces wound the wrong way round: turned over",
        }
    }
}

/// One kind of repair of one mesh.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repair {
    /// What was repaired, and how.
    pub kind: RepairKind,
    /// How often.
    pub count: u32,
    /// Where first: a submesh's name and a face of it as it came in, or a vertex.
    pub first: String,
}

/// Gathers repairs; they come out ordered by kind.
#[derive(Default)]
pub(super) struct Repairs(BTreeMap<RepairKind, (u32, String)>);

impl Repairs {
    /// Adds `count` repairs, the first of which stands at `first`; nothing if there is none.
    pub(super) fn add(&mut self, kind: RepairKind, count: usize, first: impl FnOnce() -> String) {
        if count > 0 {
            self.0.entry(kind).or_insert_with(|| (0, first())).0 += count as u32;
        }
    }

    pub(super) fn finish(self) -> Vec<Repair> {
        self.0.into_iter().map(|(kind, (count, first))| Repair { kind, count, first }).collect()
    }
}

/// `submesh "lid", face 3`: counted within the submesh.
pub(super) fn place(mesh: &Mesh, face: FaceId) -> String {
    let submesh = mesh.face_submesh[face.index()];
    let within = face.index() - mesh.submesh_faces(submesh).start;
    format!("submesh {:?}, face {within}", mesh.submeshes[submesh.index()].name)
}
