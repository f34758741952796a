//! Import: the door for model files. glTF 2.0 (text and GLB), OBJ or PLY in, a validated [`Asset`] in object space and a report
//! out. This page is about glTF; `obj` and `ply` have their own, and share the errors, the report, the check of images and the
//! last step.
//!
//! **Problem.** A file from anywhere may be wrong in every value. What is accepted must be right: never a guess, never a panic,
//! never more memory than the file's length justifies, and all defects told in one go, each with its path.
//!
//! **Method.**
//! ```text
//! open            GLB chunks or bare JSON -> JSON values                          (container)
//! buffers         load claimed bytes: data URIs, files inside the folder          (source, uri)
//! views, accessors  offsets, strides, counts, types against claimed lengths       (accessor)
//! materials       factors, textures, samplers, images by header                   (material, image)
//! meshes          each attribute's accessor against the core table                (primitive)
//! nodes           forest check, then an iterative walk -> placements              (scene)
//! limits          sums over placements, before any content is read
//! decompression   meshopt views, Draco primitives -> buffers                    (meshopt, draco)
//! contents        indices in range, positions finite; soft trouble repaired       (primitive)
//! flatten         each placed primitive a submesh, in f64, mirrors turned over    (flatten)
//! ```
//! Steps up to *nodes* go on after a defect and gather more; what depends on a defective part is left out.
//!
//! **Rules.** Names of submeshes: the node's, or its mesh's, or `mesh<i>`; for meshes of several primitives then `/` and the
//! material's name or the primitive's number; what kiln exported says its names in `extras`; repeats get `#2`, `#3`. Submeshes
//! stand depth first in the order of the nodes. Where some submeshes have an attribute and others lack it, the others get normals +Z, tangents +X, UVs 0, colours 1,
//! weights 0 ([`crate::AttributeSet`] remembers). Soft trouble is repaired as [`RepairKind`] says and reported.
//!
//! UV transforms are applied to the UVs; a material whose textures need more than two different sets of UVs is refused.
//!
//! **Limits.** Not carried, and listed in the report: skins (the bind pose is kept), animations, morph targets, cameras, lights,
//! UV sets that no texture reads, further colour sets, material extensions but for emissive strength and the colour and gloss
//! factors of specular-glossiness. Refused by name: other required extensions, points and lines, images other
//! than PNG, JPEG, WebP, TIFF, TGA, EXR and KTX2 of Basis Universal. Pictures come in 8 bits a channel.
//!
//! **Source.** glTF 2.0 Specification, The Khronos Group, version 2.0.1, 2021 (ISO/IEC 12113:2022).

mod accessor;
mod container;
mod draco;
mod error;
mod exr;
mod flatten;
mod image;
mod json;
mod material;
mod meshopt;
mod obj;
mod picture;
mod ply;
mod polygon;
mod primitive;
mod report;
mod scene;
mod soup;
mod source;
mod text;
mod tiff;
mod uri;

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests;

use std::io;
use std::path::PathBuf;

pub use self::error::{Defect, ImportError};
pub use self::image::{decode_image, image_format, image_format_of_file, image_size};
pub use self::report::{ImageSummary, ImportReport, ModelFormat, NotCarried, Repair, RepairKind};

use self::accessor::MostElements;
use self::error::Defects;
use self::json::Object;
use self::primitive::{Context, MeshDef};
use self::report::Notes;
use self::scene::Placement;
use self::source::{Failure, Sources};
use crate::Asset;
use crate::mesh::Mesh;

/// The files of a model's folder.
pub trait Files {
    /// The bytes of a file. `relative`: '/'-separated, seen from the model's folder; already checked to stay below it, unless
    /// [`ImportLimits::allow_outside`] lets it start with `..`.
    ///
    /// # Errors
    /// The system's. [`io::ErrorKind::NotFound`] for an image or a material library is soft trouble, for anything else fatal.
    fn read(&self, relative: &str) -> io::Result<Vec<u8>>;

    /// Like [`Files::read`], where a file of more than `limit` bytes need not be read to its end: whatever comes back longer than
    /// `limit` is refused.
    ///
    /// # Errors
    /// As for [`Files::read`].
    fn read_at_most(&self, relative: &str, _limit: u64) -> io::Result<Vec<u8>> {
        self.read(relative)
    }
}

/// A plain folder. It follows links; builds use the recording reader of the pipeline instead.
#[derive(Clone, Debug)]
pub struct Folder(pub PathBuf);

impl Files for Folder {
    fn read(&self, relative: &str) -> io::Result<Vec<u8>> {
        std::fs::read(self.0.join(relative))
    }

    fn read_at_most(&self, relative: &str, limit: u64) -> io::Result<Vec<u8>> {
        use io::Read;
        let mut bytes = Vec::new();
        std::fs::File::open(self.0.join(relative))?.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

/// Limits on images, checked by their headers before anything is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageLimits {
    /// Greatest width and height, texels. Default 16,384: the largest texture that today's GPUs commonly take.
    pub max_side: u32,
    /// Greatest width x height, texels. Default 2^28, the square of the above (1 GiB as RGBA8).
    pub max_texels: u64,
}

impl Default for ImageLimits {
    fn default() -> Self {
        ImageLimits { max_side: 16_384, max_texels: 1 << 28 }
    }
}

/// Limits on a model. They keep a small file from costing much; a model that passes them by honest size can be given higher ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImportLimits {
    /// All files of the model together, bytes. Default 8 GiB.
    pub max_file_bytes: u64,
    /// JSON text, bytes. Default 512 MiB.
    pub max_json_bytes: u64,
    /// Vertices of the asset, all instances in place; also replaced elements of sparse accessors, each use. Default 2^26.
    pub max_vertices: u64,
    /// Triangles of the asset, all instances in place. Default 2^26.
    pub max_triangles: u64,
    /// Submeshes. Default 2^20.
    pub max_submeshes: u64,
    /// Nodes from a root down to a mesh. Default 4,096.
    pub max_node_depth: u32,
    /// Limits on images.
    pub images: ImageLimits,
    /// Whether the model may refer to files outside its own folder. Default: it may not.
    pub allow_outside: bool,
}

impl Default for ImportLimits {
    fn default() -> Self {
        ImportLimits {
            max_file_bytes: 8 << 30,
            max_json_bytes: 512 << 20,
            max_vertices: 1 << 26,
            max_triangles: 1 << 26,
            max_submeshes: 1 << 20,
            max_node_depth: 4096,
            images: ImageLimits::default(),
            allow_outside: false,
        }
    }
}

/// Whether [`import`] takes a file of this name: `.glb`, `.gltf`, `.obj` or `.ply` in any case.
pub fn is_supported_path(path: &str) -> bool {
    ["glb", "gltf", "obj", "ply"].iter().any(|extension| has_extension(path, extension))
}

fn has_extension(path: &str, extension: &str) -> bool {
    let name = path.rsplit(['/', '\\']).next().unwrap_or(path);
    name.rsplit_once('.').is_some_and(|(_, found)| found.eq_ignore_ascii_case(extension))
}

/// The model in `main`, with all files that it refers to, flattened into one mesh in object space.
///
/// # Errors
/// All defects of the gravest family found: see [`ImportError`].
pub fn import(files: &dyn Files, main: &str, limits: &ImportLimits) -> Result<(Asset, ImportReport), ImportError> {
    let (mut asset, report) = import_model(files, main, limits)?;
    exr::settle_uses(&mut asset);
    Ok((asset, report))
}

fn import_model(files: &dyn Files, main: &str, limits: &ImportLimits) -> Result<(Asset, ImportReport), ImportError> {
    if !is_supported_path(main) {
        return Err(ImportError::unsupported(main, "only .glb, .gltf, .obj and .ply models are read"));
    }
    let mut sources = Sources::new(files, limits);
    let bytes = sources.file(main).map_err(|failure| match failure {
        Failure::Invalid(message) => ImportError::invalid(main, message),
        Failure::Missing(message) | Failure::Io(message) => {
            ImportError::Io(vec![Defect { path: main.to_owned(), message }])
        }
    })?;
    if has_extension(main, "obj") {
        return obj::import(main, &bytes, &mut sources, limits);
    }
    if has_extension(main, "ply") {
        return ply::import(main, &bytes, &mut sources, limits);
    }
    let shell = container::open(main, &bytes, limits)?;
    let mut defects = Defects::default();
    let Some(root) = Object::root(&shell.json, &mut defects) else {
        defects.check()?;
        return Err(ImportError::invalid(main, "the document is no object"));
    };
    let mut notes = Notes::default();
    let mut report = ImportReport { format: shell.format, ..Default::default() };
    read_head(&root, &mut report, &mut defects);

    let (lengths, mut buffers) = source::read_buffers(&root, shell.binary, &mut sources, &mut defects);
    let views = accessor::read_views(&root, &lengths, &mut defects);
    let most = MostElements {
        stored: limits.max_triangles.saturating_mul(3).max(limits.max_vertices).min(u32::MAX as u64),
        // No more zeros than the model has bytes.
        zeros: lengths.iter().flatten().fold(0, |sum, length| sum.saturating_add(*length)),
    };
    let mut accessors = accessor::read_accessors(&root, &views, most, &mut defects, &mut notes);
    let library = material::read_materials(&root, &views, &buffers, &mut sources, limits, &mut defects, &mut notes);
    let context = Context {
        accessors: &accessors,
        view_count: views.len(),
        uv_slots: &library.uv_slots,
        quantized: report.extensions_used.iter().any(|e| e == "KHR_mesh_quantization"),
    };
    let mut meshes = primitive::read_meshes(&root, &context, &mut defects, &mut notes);
    let placements = scene::read_placements(&root, meshes.len(), &context, limits, &mut defects, &mut notes);
    note_not_carried(&root, &mut notes);
    defects.check()?;
    check_sums(&placements, &meshes, limits)?;

    let mut placed = vec![false; meshes.len()];
    placements.iter().for_each(|placement| placed[placement.mesh] = true);
    notes.not_carried("meshes that the scene does not place", placed.iter().filter(|placed| !**placed).count() as u64);
    meshopt::decode_views(&views, &mut buffers, limits.max_file_bytes, &mut defects);
    draco::decode_primitives(&mut meshes, &placed, &views, &mut accessors, &mut buffers, &mut defects);
    defects.check()?;
    let placements = scene::spread(placements, &accessors, &buffers, &mut defects, &mut notes);
    let mut contents = Vec::with_capacity(meshes.len());
    for (mesh, placed) in meshes.iter().zip(placed) {
        let primitives = if placed { mesh.primitives.as_slice() } else { &[] };
        let read =
            primitives.iter().map(|p| primitive::read_contents(p, &accessors, &buffers, &mut defects, &mut notes));
        contents.push(read.collect::<Vec<_>>());
    }
    defects.check()?;
    let materials = &library.set.materials;
    let raw = flatten::flatten(&placements, &meshes, &contents, materials, &mut report, &mut defects, &mut notes);
    drop(contents);
    defects.check()?;
    if raw.triangles.is_empty() {
        return Err(ImportError::invalid("scenes", "the scene holds no triangle"));
    }
    let mesh = Mesh::new(raw).map_err(|error| {
        let defect = |d: crate::MeshDefect| Defect { path: format!("flattened mesh: {}", d.path), message: d.message };
        ImportError::Invalid(error.0.into_iter().map(defect).collect())
    })?;

    count(&mut report, &root, &mesh, &meshes, &library.set);
    report.images = library.summaries;
    notes.finish(&mut report);
    Ok((Asset { mesh, materials: library.set, images: library.images }, report))
}

/// Versions and extensions: what decides whether the rest can be read at all.
fn read_head(root: &Object<'_>, report: &mut ImportReport, defects: &mut Defects) {
    if let Some(asset) = root.need_object("asset", defects) {
        report.generator = asset.string("generator", defects).unwrap_or_default().to_owned();
        let version = asset.string("version", defects);
        if version.is_none() && !asset.has("version") {
            defects.invalid(asset.path_of("version"), "is missing");
        }
        if let Some(version) = version.filter(|v| *v != "2" && !v.starts_with("2.")) {
            defects.unsupported(asset.path_of("version"), format!("glTF {version}; only 2.x is read"));
        }
        if let Some(version) = asset.string("minVersion", defects).filter(|v| *v != "2.0") {
            defects.unsupported(asset.path_of("minVersion"), format!("glTF {version} at least; 2.0 is read"));
        }
    }
    let unknown = |name: &str| !EXTENSIONS.contains(&name);
    for (path, name) in root.strings("extensionsRequired", defects).into_iter().filter(|(_, name)| unknown(name)) {
        defects.unsupported(path, format!("the model cannot be read without {name}, which kiln does not know"));
    }
    let used = root.strings("extensionsUsed", defects);
    report.extensions_used = used.into_iter().map(|(_, name)| name.to_owned()).collect();
    // Every other extension that has an influence is refused where it is in use, so what is left had none.
    report.extensions_ignored = report.extensions_used.iter().filter(|name| unknown(name)).cloned().collect();
}

/// Extensions that are read wherever they occur.
pub const EXTENSIONS: [&str; 10] = [
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "KHR_texture_transform",
];

fn note_not_carried(root: &Object<'_>, notes: &mut Notes) {
    for what in ["animations", "skins", "cameras"] {
        notes.not_carried(what, root.count(what) as u64);
    }
}

/// Ids have 32 bits, whatever the limits say.
const MOST_IDS: u64 = u32::MAX as u64 - 1;

/// Sums over all placements against the limits, before any content is read: instances multiply.
fn check_sums(placements: &[Placement], meshes: &[MeshDef], limits: &ImportLimits) -> Result<(), ImportError> {
    let (mut vertices, mut triangles, mut replaced, mut submeshes) = (0u64, 0u64, 0u64, 0u64);
    for placement in placements {
        for primitive in &meshes[placement.mesh].primitives {
            let times = placement.instances.map_or(1, |instances| instances.count);
            vertices = vertices.saturating_add(times.saturating_mul(primitive.used_vertices_at_most()));
            triangles = triangles.saturating_add(times.saturating_mul(primitive.triangle_count()));
            replaced = replaced.saturating_add(times.saturating_mul(primitive.replaced_count));
            submeshes = submeshes.saturating_add(times);
        }
    }
    let mut defects = Defects::default();
    for (what, sum, limit) in [
        ("vertices", vertices, limits.max_vertices.min(MOST_IDS)),
        ("triangles", triangles, limits.max_triangles.min(MOST_IDS / 3)),
        ("replaced elements", replaced, limits.max_vertices),
        ("submeshes", submeshes, limits.max_submeshes),
    ] {
        if sum > limit {
            defects.invalid("scenes", format!("{sum} {what} with all instances, the limit is {limit}"));
        }
    }
    defects.check()
}

fn count(
    report: &mut ImportReport,
    root: &Object<'_>,
    mesh: &Mesh,
    meshes: &[MeshDef],
    materials: &crate::MaterialSet,
) {
    report.vertices = mesh.vertex_count() as u64;
    report.triangles = mesh.face_count() as u64;
    report.submeshes = mesh.submeshes.len() as u64;
    report.meshes = meshes.len() as u64;
    report.nodes = root.count("nodes") as u64;
    report.materials = materials.materials.len() as u64;
    report.textures = materials.textures.len() as u64;
    for primitive in meshes.iter().flat_map(|mesh| &mesh.primitives) {
        report.primitives += 1;
        report.stored_vertices += primitive.vertex_count;
        report.stored_triangles += primitive.triangle_count();
    }
}
