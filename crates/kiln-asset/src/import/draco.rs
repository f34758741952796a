//! Draco-compressed primitives: `KHR_draco_mesh_compression`.
//!
//! One buffer view holds the triangles and some attributes of a primitive; the accessors say what comes out and have no data of
//! their own. Each view is decoded once, into buffers to which the accessors then refer, so that nothing behind this page knows.
//! The decoder is given the counts that the accessors promise as its limits, and these are within the import's.
//!
//! **Source.** *KHR_draco_mesh_compression*, Khronos glTF extension registry, 2018.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointIndex};

use super::accessor::{Accessor, Component, View};
use super::error::Defects;
use super::json::Object;
use super::primitive::{MeshDef, PrimitiveDef};
use super::source::Bytes;

pub(super) const EXTENSION: &str = "KHR_draco_mesh_compression";

/// A primitive's compressed data.
#[derive(Clone, Debug)]
pub(super) struct DracoDef {
    path: String,
    view: usize,
    /// (index of the attribute in the primitive's table, the decoder's id for it).
    ids: Vec<(usize, u32)>,
}

impl DracoDef {
    /// Whether an attribute of the primitive's table is among the compressed ones.
    pub(super) fn has(&self, semantic: usize) -> bool {
        self.ids.iter().any(|(of, _)| *of == semantic)
    }
}

/// The extension of a primitive with attributes named `names`: `Some(None)` where there is none, `None` where it is defective.
pub(super) fn read(
    primitive: &Object<'_>,
    names: &[String],
    view_count: usize,
    defects: &mut Defects,
) -> Option<Option<DracoDef>> {
    let Some(extensions) = primitive.object("extensions", defects).filter(|e| e.has(EXTENSION)) else {
        return Some(None);
    };
    let object = extensions.object(EXTENSION, defects)?;
    let view = object.need_index("bufferView", "bufferViews", view_count, defects);
    let attributes = object.need_object("attributes", defects)?;
    if !primitive.has("indices") {
        defects.invalid(primitive.path_of("indices"), format!("is missing, but {EXTENSION} needs it"));
        return None;
    }
    let before = defects.count();
    let mut ids = Vec::new();
    for (semantic, name) in names.iter().enumerate().filter(|(_, name)| attributes.has(name)) {
        let id = attributes.unsigned(name, defects);
        match id.map(u32::try_from) {
            Some(Ok(id)) => ids.push((semantic, id)),
            Some(Err(_)) => defects.invalid(attributes.path_of(name), "is no id of 32 bits"),
            None => {}
        }
    }
    (defects.count() == before).then_some(())?;
    Some(Some(DracoDef { path: object.path.clone(), view: view?, ids }))
}

/// Decodes what the primitives need: their accessors then refer to buffers behind `buffers`.
pub(super) fn decode_primitives(
    meshes: &mut [MeshDef],
    placed: &[bool],
    views: &[Option<View>],
    accessors: &mut Vec<Option<Accessor>>,
    buffers: &mut Vec<Bytes<'_>>,
    defects: &mut Defects,
) {
    let mut decoded: BTreeMap<usize, Option<Mesh>> = BTreeMap::new();
    for (mesh, placed) in meshes.iter_mut().zip(placed) {
        for primitive in mesh.primitives.iter_mut().filter(|_| *placed) {
            let Some(def) = primitive.draco.clone() else { continue };
            let known = decoded.entry(def.view).or_insert_with(|| {
                let result = view_bytes(def.view, views, buffers).map(|bytes| decode(bytes, primitive)).transpose();
                result.unwrap_or_else(|message| {
                    defects.invalid(def.path.clone(), message);
                    None
                })
            });
            if let Some(mesh) = known {
                replace(primitive, &def, mesh, accessors, buffers, defects);
            }
        }
    }
}

fn view_bytes<'a>(view: usize, views: &[Option<View>], buffers: &'a [Bytes<'_>]) -> Option<&'a [u8]> {
    let view = views[view]?;
    let start = usize::try_from(view.start).ok()?;
    buffers.get(view.buffer)?.get(start..start.checked_add(usize::try_from(view.length).ok()?)?)
}

/// Decodes a stream whose counts must be those that the primitive's accessors promise.
fn decode(bytes: &[u8], primitive: &PrimitiveDef) -> Result<Mesh, String> {
    /// Points that a byte may stand for. Flat grids come near it; beyond it a stream has all its points in one place.
    const GREATEST_RATIO: u64 = 4096;
    /// Bytes of all attributes of a point: five vectors, two UVs, colours and weights as floats.
    const POINT_BYTES: u64 = 128;
    let points = primitive.vertex_count.min((bytes.len() as u64).saturating_mul(GREATEST_RATIO));
    let limits = DecodeLimits::default()
        .with_max_points(points)
        .with_max_faces(primitive.triangle_count())
        .with_max_decoded_bytes(points.saturating_mul(POINT_BYTES));
    // The decoder has not been seen to panic; should it, that is this stream's end and not the build's.
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let mut mesh = Mesh::new();
        let mut buffer = DecoderBuffer::new(bytes).with_limits(limits);
        MeshDecoder::new().decode(&mut buffer, &mut mesh).map(|()| mesh)
    }));
    match outcome {
        Ok(Ok(mesh)) => Ok(mesh),
        Ok(Err(error)) => Err(format!("cannot be decoded: {error}")),
        Err(_) => Err("cannot be decoded: the decoder failed".into()),
    }
}

/// Points the primitive's accessors at the decoded content.
fn replace(
    primitive: &mut PrimitiveDef,
    def: &DracoDef,
    mesh: &Mesh,
    accessors: &mut Vec<Option<Accessor>>,
    buffers: &mut Vec<Bytes<'_>>,
    defects: &mut Defects,
) {
    let mut invalid = |message: String| defects.invalid(def.path.clone(), message);
    if mesh.num_points() as u64 != primitive.vertex_count {
        invalid(format!("decodes to {} vertices, the accessors say {}", mesh.num_points(), primitive.vertex_count));
        return;
    }
    if mesh.num_faces() as u64 != primitive.triangle_count() {
        invalid(format!("decodes to {} triangles, the accessor says {}", mesh.num_faces(), primitive.triangle_count()));
        return;
    }
    primitive.unroll();
    for (semantic, id) in &def.ids {
        // A primitive may compress what it does not list.
        let Some(accessor) = primitive.attributes[*semantic].and_then(|index| accessors[index].as_ref()) else {
            continue;
        };
        let Some(attribute) = mesh.attribute_by_unique_id(*id) else {
            invalid(format!("has no attribute {id}"));
            continue;
        };
        let found = (component(attribute.data_type()), attribute.num_components() as usize);
        if found != (Some(accessor.component), accessor.lanes) {
            invalid(format!(
                "its attribute {id} holds {} of {:?} a vertex, {} says {}",
                attribute.num_components(),
                attribute.data_type(),
                accessor.path,
                accessor.describe()
            ));
            continue;
        }
        let size = accessor.component.size() as usize * accessor.lanes;
        let mut bytes = Vec::with_capacity(size * mesh.num_points());
        for point in 0..mesh.num_points() as u32 {
            let value = attribute.mapped_index(PointIndex(point)).0 as usize;
            let start = value.checked_mul(attribute.byte_stride().max(0) as usize);
            match start.and_then(|start| attribute.buffer().data().get(start..start.checked_add(size)?)) {
                Some(value) => bytes.extend_from_slice(value),
                None => bytes.resize(bytes.len() + size, 0),
            }
        }
        let moved = accessor.moved(buffers.len(), accessor.component);
        buffers.push(Bytes::Shared(bytes.into()));
        primitive.attributes[*semantic] = Some(accessors.len());
        accessors.push(Some(moved));
    }
    let Some(accessor) = primitive.indices.and_then(|index| accessors[index].as_ref()) else { return };
    let corners = mesh.faces().iter().flatten().flat_map(|point| point.0.to_le_bytes()).collect::<Vec<u8>>();
    let moved = accessor.moved(buffers.len(), Component::U32);
    buffers.push(Bytes::Shared(corners.into()));
    primitive.indices = Some(accessors.len());
    accessors.push(Some(moved));
}

fn component(of: DataType) -> Option<Component> {
    Some(match of {
        DataType::Int8 => Component::I8,
        DataType::Uint8 => Component::U8,
        DataType::Int16 => Component::I16,
        DataType::Uint16 => Component::U16,
        DataType::Uint32 => Component::U32,
        DataType::Float32 => Component::F32,
        _ => return None,
    })
}
