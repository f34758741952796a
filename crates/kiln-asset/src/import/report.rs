//! What import found, repaired and left behind.

use std::collections::BTreeMap;

use serde::Serialize;

/// The format of a model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ModelFormat {
    /// Binary: JSON and buffer in one file.
    Glb,
    /// JSON, with buffers and images beside it or in data URIs.
    #[default]
    Gltf,
    /// Wavefront OBJ, with materials and images beside it.
    Obj,
    /// Polygon file format, text or binary.
    Ply,
}

/// Soft trouble, and the rule by which it was repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RepairKind {
    /// A normal that is not finite or has no length becomes the area-weighted mean of its own faces' normals.
    NormalRebuilt,
    /// A normal whose length is off by more than 1 % is scaled to length 1.
    NormalScaled,
    /// A tangent that is not finite or has no length becomes a vector square to the normal.
    TangentRebuilt,
    /// A tangent's sign that is neither +1 nor -1 becomes that of its sign bit, or +1.
    TangentSign,
    /// Tangents without normals are dropped, as glTF asks.
    TangentsDropped,
    /// A UV that is not finite becomes (0, 0).
    UvNotFinite,
    /// A colour that is not finite becomes white.
    ColorNotFinite,
    /// Joint weights that are not finite or negative become 0.
    WeightNotFinite,
    /// An importance (`_KILN_WEIGHT`) that is not finite or negative becomes 1.
    ImportanceNotFinite,
    /// One or two indices behind the last whole triangle are left out.
    IndicesLeftOver,
    /// Vertices that no triangle uses are left out.
    VerticesUnused,
    /// Data that is not aligned to its component's size is read all the same.
    Misaligned,
    /// A quaternion whose length is off by more than 1 % is scaled to length 1.
    RotationScaled,
    /// A material's factor outside its range is clamped.
    FactorClamped,
    /// A texture whose image file is missing is left out of its materials.
    ImageMissing,
    /// An image whose bytes are of another kind than its MIME type says is read as what its bytes are.
    MimeTypeWrong,
    /// A material reads a UV set that its submesh lacks; the UVs count as (0, 0).
    UvSetAbsent,
    /// A corner without UVs in a submesh that has some gets (0, 0).
    CornerUvAbsent,
    /// A colour outside `[0, 1]` is clamped.
    ColorClamped,
    /// What is left of a polygon that crosses itself is cut into a fan.
    PolygonCrossed,
    /// A material library whose file is missing is left out.
    LibraryMissing,
    /// A material that no library defines becomes white and rough.
    MaterialUndefined,
    /// Backslashes in a file's name are read as separators of folders.
    BackslashPath,
}

impl RepairKind {
    /// What was done, to put a count in front: `17 x UVs that are not finite: set to (0, 0)`.
    pub fn sentence(self) -> &'static str {
        match self {
            RepairKind::NormalRebuilt => "normals without direction: taken from their faces",
            RepairKind::NormalScaled => "normals not of unit length: scaled",
            RepairKind::TangentRebuilt => "tangents without direction: made square to the normal",
            RepairKind::TangentSign => "tangent signs that are neither +1 nor -1: set",
            RepairKind::TangentsDropped => "tangents without normals: dropped",
            RepairKind::UvNotFinite => "UVs that are not finite: set to (0, 0)",
            RepairKind::ColorNotFinite => "colours that are not finite: set to white",
            RepairKind::WeightNotFinite => "joint weights that are negative or not finite: set to 0",
            RepairKind::ImportanceNotFinite => "importances that are negative or not finite: set to 1",
            RepairKind::IndicesLeftOver => "indices behind the last whole triangle: left out",
            RepairKind::VerticesUnused => "vertices that no triangle uses: left out",
            RepairKind::Misaligned => "accessors not aligned to their component's size: read all the same",
            RepairKind::RotationScaled => "rotations not of unit length: scaled",
            RepairKind::FactorClamped => "material factors out of range: clamped",
            RepairKind::ImageMissing => "images whose file is missing: left out",
            RepairKind::MimeTypeWrong => "images with a wrong MIME type: read as what their bytes are",
            RepairKind::UvSetAbsent => "submeshes without the UV set that their material reads: (0, 0) assumed",
            RepairKind::CornerUvAbsent => "corners without UVs beside others with: (0, 0) assumed",
            RepairKind::ColorClamped => "colours out of range: clamped",
            RepairKind::PolygonCrossed => "polygons that cross themselves: cut into fans",
            RepairKind::LibraryMissing => "material libraries whose file is missing: left out",
            RepairKind::MaterialUndefined => "materials that no library defines: white and rough",
            RepairKind::BackslashPath => "file names with backslashes: read as folders",
        }
    }
}

/// One kind of repair in one model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Repair {
    /// What was repaired, and how.
    pub kind: RepairKind,
    /// How often.
    pub count: u64,
    /// Where first.
    pub first: String,
}

/// Something in the model that this version does not carry; the asset is right without it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NotCarried {
    /// `animations`, `skins`, `morph targets`, `attribute TEXCOORD_2`, `extension KHR_materials_clearcoat`.
    pub what: String,
    /// How many there are.
    pub count: u64,
}

/// An image that some material uses.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ImageSummary {
    /// Its name.
    pub name: String,
    /// `png` or `jpeg`.
    pub format: String,
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Encoded length.
    pub bytes: u64,
}

/// What import found in a model: the counts that `kiln doctor` prints, all repairs, and what is not carried.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ImportReport {
    /// The model's shell.
    pub format: ModelFormat,
    /// What wrote the model, as it says itself; may be empty.
    pub generator: String,
    /// Vertices of the asset, all instances in place.
    pub vertices: u64,
    /// Triangles of the asset, all instances in place.
    pub triangles: u64,
    /// Triangles with two corners at one position (bitwise); legal, `merge` drops them.
    pub degenerate_triangles: u64,
    /// Submeshes: primitives in place.
    pub submeshes: u64,
    /// Nodes of the scene that place a mesh; a node with instances counts for each of them.
    pub instances: u64,
    /// Of these, how many mirror it (its winding was flipped).
    pub mirrored_instances: u64,
    /// Meshes in the file.
    pub meshes: u64,
    /// Primitives in the file.
    pub primitives: u64,
    /// Vertices in the file, every primitive once.
    pub stored_vertices: u64,
    /// Triangles in the file, every primitive once.
    pub stored_triangles: u64,
    /// Nodes in the file.
    pub nodes: u64,
    /// Materials.
    pub materials: u64,
    /// Textures that some material uses.
    pub textures: u64,
    /// Images that some material uses.
    pub images: Vec<ImageSummary>,
    /// `extensionsUsed`, as listed.
    pub extensions_used: Vec<String>,
    /// Those of them that had no influence on the asset.
    pub extensions_ignored: Vec<String>,
    /// What is not carried, by name.
    pub not_carried: Vec<NotCarried>,
    /// What was repaired, by kind.
    pub repairs: Vec<Repair>,
}

/// Gathers repairs and what is not carried; the lists come out sorted.
#[derive(Default)]
pub(super) struct Notes {
    repairs: BTreeMap<RepairKind, (u64, String)>,
    not_carried: BTreeMap<String, u64>,
}

impl Notes {
    pub(super) fn repair(&mut self, kind: RepairKind, count: u64, first: impl FnOnce() -> String) {
        if count > 0 {
            self.repairs.entry(kind).or_insert_with(|| (0, first())).0 += count;
        }
    }

    pub(super) fn not_carried(&mut self, what: &str, count: u64) {
        if count > 0 {
            match self.not_carried.get_mut(what) {
                Some(sum) => *sum += count,
                None => drop(self.not_carried.insert(what.to_owned(), count)),
            }
        }
    }

    pub(super) fn finish(self, report: &mut ImportReport) {
        report.repairs = self.repairs.into_iter().map(|(kind, (count, first))| Repair { kind, count, first }).collect();
        report.not_carried = self.not_carried.into_iter().map(|(what, count)| NotCarried { what, count }).collect();
    }
}
