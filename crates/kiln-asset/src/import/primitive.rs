//! Meshes and primitives: which accessors they may use, and their contents in the mesh's own space, checked and repaired.

use glam::{DVec3, Vec2, Vec3, Vec4};

use super::accessor::{Accessor, Component, Reader};
use super::draco::{self, DracoDef};
use super::error::Defects;
use super::json::Object;
use super::material::{UvSlots, UvTransform, note_extensions};
use super::report::{Notes, RepairKind};
use super::source::Bytes;
use crate::mesh::AttributeSet;

/// How triangles follow from indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Triangles,
    Strip,
    Fan,
}

/// A mesh of the file.
pub(super) struct MeshDef {
    pub(super) name: String,
    pub(super) primitives: Vec<PrimitiveDef>,
}

/// A primitive whose accessors suit their use.
pub(super) struct PrimitiveDef {
    path: String,
    /// The submesh's name, where an export of kiln's wrote it down; else empty.
    pub(super) name: String,
    mode: Mode,
    pub(super) indices: Option<usize>,
    /// Accessors by [`Semantic`].
    pub(super) attributes: [Option<usize>; SEMANTICS.len()],
    /// What is done to each set of UVs.
    uv_transforms: [Option<UvTransform>; 2],
    /// Where the contents are compressed.
    pub(super) draco: Option<DracoDef>,
    pub(super) material: Option<usize>,
    /// Vertices stored.
    pub(super) vertex_count: u64,
    /// Replaced elements in all of its accessors: each use of a sparse accessor reads them again.
    pub(super) replaced_count: u64,
    /// Corners: indices, or vertices where there are none.
    corner_count: u64,
}

impl PrimitiveDef {
    /// Vertices that its triangles can use at most.
    pub(super) fn used_vertices_at_most(&self) -> u64 {
        self.vertex_count.min(self.corner_count)
    }

    pub(super) fn triangle_count(&self) -> u64 {
        match self.mode {
            Mode::Triangles => self.corner_count / 3,
            Mode::Strip | Mode::Fan => self.corner_count.saturating_sub(2),
        }
    }

    /// From now on it has three corners for every triangle that it had.
    pub(super) fn unroll(&mut self) {
        self.corner_count = 3 * self.triangle_count();
        self.mode = Mode::Triangles;
    }
}

#[derive(Clone, Copy)]
enum Semantic {
    Position,
    Normal,
    Tangent,
    Uv0,
    Uv1,
    Color,
    Joints,
    Weights,
    Importance,
}

/// A component type, normalised or not.
pub(super) type Number = (Component, bool);

/// What an accessor may be in one use.
#[derive(Clone, Copy)]
pub(super) struct Rule {
    shapes: &'static [&'static str],
    core: &'static [Number],
    /// What `KHR_mesh_quantization` adds.
    quantized: &'static [Number],
}

pub(super) const fn rule(
    shapes: &'static [&'static str],
    core: &'static [Number],
    quantized: &'static [Number],
) -> Rule {
    Rule { shapes, core, quantized }
}

pub(super) const FLOAT: &[Number] = &[(Component::F32, false)];
const UNIT: &[Number] = &[(Component::F32, false), (Component::U8, true), (Component::U16, true)];
const SMALL: &[Number] = &[(Component::U8, false), (Component::U16, false)];
const WIDTHS: &[Number] = &[(Component::U8, false), (Component::U16, false), (Component::U32, false)];
pub(super) const SIGNED: &[Number] = &[(Component::I8, true), (Component::I16, true)];
const ANY: &[Number] = &[
    (Component::I8, false),
    (Component::I8, true),
    (Component::U8, false),
    (Component::U8, true),
    (Component::I16, false),
    (Component::I16, true),
    (Component::U16, false),
    (Component::U16, true),
];

/// What core glTF 2.0 (3.7.2.1) and the quantisation extension allow for each attribute, in the order of [`Semantic`].
const SEMANTICS: [Rule; 9] = [
    rule(&["VEC3"], FLOAT, ANY),
    rule(&["VEC3"], FLOAT, SIGNED),
    rule(&["VEC4"], FLOAT, SIGNED),
    rule(&["VEC2"], UNIT, ANY),
    rule(&["VEC2"], UNIT, ANY),
    rule(&["VEC3", "VEC4"], UNIT, &[]),
    rule(&["VEC4"], SMALL, &[]),
    rule(&["VEC4"], UNIT, &[]),
    rule(&["SCALAR"], UNIT, &[]),
];
const INDEX: Rule = rule(&["SCALAR"], WIDTHS, &[]);

/// kiln's own attribute: how dear a vertex is to a simplifier.
const IMPORTANCE: &str = "_KILN_WEIGHT";

/// The attributes' names in the order of [`Semantic`]; which UV sets are read, the material decides.
fn names(slots: &UvSlots) -> [String; SEMANTICS.len()] {
    let [uv0, uv1] = slots.0.map(|slot| format!("TEXCOORD_{}", slot.set));
    [
        "POSITION".into(),
        "NORMAL".into(),
        "TANGENT".into(),
        uv0,
        uv1,
        "COLOR_0".into(),
        "JOINTS_0".into(),
        "WEIGHTS_0".into(),
        IMPORTANCE.into(),
    ]
}

const QUANTIZATION: &str = "KHR_mesh_quantization";

/// What primitives are judged against.
pub(super) struct Context<'a> {
    pub(super) accessors: &'a [Option<Accessor>],
    pub(super) view_count: usize,
    /// `[material_count]`.
    pub(super) uv_slots: &'a [UvSlots],
    /// `KHR_mesh_quantization` is in use.
    pub(super) quantized: bool,
}

/// The meshes; defective primitives are left out, each with its defects noted.
pub(super) fn read_meshes(
    root: &Object<'_>,
    context: &Context<'_>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Vec<MeshDef> {
    let mut out = Vec::new();
    for mesh in root.objects("meshes", defects) {
        let Some(mesh) = mesh else {
            out.push(MeshDef { name: String::new(), primitives: Vec::new() });
            continue;
        };
        note_extensions(&mesh, &[], defects, notes);
        let name = mesh.string("name", defects).unwrap_or_default().to_owned();
        if mesh.count("primitives") == 0 {
            defects.invalid(mesh.path_of("primitives"), "is missing or empty");
        }
        let primitives = mesh.objects("primitives", defects);
        let primitives =
            primitives.iter().filter_map(|p| read_primitive(p.as_ref()?, context, defects, notes)).collect();
        out.push(MeshDef { name, primitives });
    }
    out
}

fn read_primitive(
    object: &Object<'_>,
    context: &Context<'_>,
    defects: &mut Defects,
    notes: &mut Notes,
) -> Option<PrimitiveDef> {
    note_extensions(object, &[draco::EXTENSION], defects, notes);
    notes.not_carried("morph targets", object.count("targets") as u64);
    let mode = read_mode(object, defects);
    let material = match object.has("material") {
        true => Some(object.index("material", "materials", context.uv_slots.len(), defects)?),
        false => None,
    };
    let list = object.need_object("attributes", defects)?;
    let slots = material.map_or(UvSlots::default(), |material| context.uv_slots[material]);
    let names = names(&slots);
    for name in list.keys().filter(|name| names.iter().all(|known| known != name)) {
        notes.not_carried(&format!("attribute {name}"), 1);
        list.index(name, "accessors", context.accessors.len(), defects);
    }
    let draco = draco::read(object, &names, context.view_count, defects)?;
    let mut attributes = [None; SEMANTICS.len()];
    let mut vertex_count = None;
    let mut replaced_count = 0u64;
    let mut whole = true;
    for (semantic, (slot, name)) in attributes.iter_mut().zip(&names).enumerate() {
        if !list.has(name) {
            continue;
        }
        let stands_in = draco.as_ref().is_some_and(|draco| draco.has(semantic));
        let Some((index, accessor)) = usable(&list, name, SEMANTICS[semantic], context, stands_in, defects) else {
            whole = false;
            continue;
        };
        *slot = Some(index);
        replaced_count = replaced_count.saturating_add(accessor.replaced_count());
        let count = *vertex_count.get_or_insert(accessor.count);
        if count != accessor.count {
            let message = format!("{} elements, but the first attribute has {count}", accessor.count);
            defects.invalid(list.path_of(name), message);
            whole = false;
        }
    }
    if !list.has("POSITION") {
        defects.invalid(list.path_of("POSITION"), "is missing");
        return None;
    }
    if attributes[Semantic::Joints as usize].is_some() != attributes[Semantic::Weights as usize].is_some() && whole {
        defects.invalid(list.path.clone(), "JOINTS_0 and WEIGHTS_0 come only together");
    }
    let mut corner_count = vertex_count;
    let mut indices = None;
    if object.has("indices") {
        let (index, accessor) = usable(object, "indices", INDEX, context, draco.is_some(), defects)?;
        indices = Some(index);
        replaced_count = replaced_count.saturating_add(accessor.replaced_count());
        corner_count = Some(accessor.count);
    }
    if !whole {
        return None;
    }
    Some(PrimitiveDef {
        path: object.path.clone(),
        name: object.extra("submesh").unwrap_or_default().to_owned(),
        mode: mode?,
        indices,
        attributes,
        uv_transforms: slots.0.map(|slot| slot.transform),
        draco,
        material,
        vertex_count: vertex_count?,
        replaced_count,
        corner_count: corner_count?,
    })
}

fn read_mode(object: &Object<'_>, defects: &mut Defects) -> Option<Mode> {
    let mode = if object.has("mode") { object.unsigned("mode", defects)? } else { 4 };
    let unsupported = match mode {
        4 => return Some(Mode::Triangles),
        5 => return Some(Mode::Strip),
        6 => return Some(Mode::Fan),
        0 => "POINTS",
        1 => "LINES",
        2 => "LINE_LOOP",
        3 => "LINE_STRIP",
        _ => {
            defects.invalid(object.path_of("mode"), format!("{mode} is no mode of glTF 2.0"));
            return None;
        }
    };
    defects.unsupported(object.path_of("mode"), format!("{unsupported}; only triangles are read"));
    None
}

/// The accessor that `object.key` refers to, if it suits the rule and has data; `stands_in`: compressed data takes its place.
pub(super) fn usable<'a>(
    object: &Object<'_>,
    key: &str,
    rule: Rule,
    context: &Context<'a>,
    stands_in: bool,
    defects: &mut Defects,
) -> Option<(usize, &'a Accessor)> {
    let index = object.index(key, "accessors", context.accessors.len(), defects)?;
    let accessor = context.accessors[index].as_ref()?;
    let path = object.path_of(key);
    let number = (accessor.component, accessor.normalized);
    let allowed = rule.core.contains(&number) || context.quantized && rule.quantized.contains(&number);
    if !rule.shapes.contains(&accessor.shape) || !allowed {
        let names = |(component, normalized): &Number| {
            format!("{}{}", if *normalized { "normalized " } else { "" }, component.name())
        };
        let expected = rule.core.iter().map(names).collect::<Vec<_>>().join(" or ");
        let mut message = format!("expected {} of {expected}, found {}", rule.shapes.join(" or "), accessor.describe());
        if !context.quantized && rule.quantized.contains(&number) {
            message.push_str(&format!(", which only {QUANTIZATION} allows; the file does not say that it uses it"));
        }
        defects.invalid(path, message);
        return None;
    }
    if !accessor.has_data() && !stands_in {
        defects.unsupported(path, format!("{} has neither a buffer view nor replaced elements", accessor.path));
        return None;
    }
    Some((index, accessor))
}

/// A primitive's contents in its mesh's space, unused vertices left out.
pub(super) struct Primitive {
    pub(super) material: Option<usize>,
    pub(super) attributes: AttributeSet,
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    pub(super) tangents: Vec<Vec4>,
    pub(super) uv0: Vec<Vec2>,
    pub(super) uv1: Vec<Vec2>,
    pub(super) colors: Vec<Vec4>,
    pub(super) joints: Vec<[u16; 4]>,
    pub(super) weights: Vec<Vec4>,
    pub(super) importance: Vec<f32>,
    /// Into this primitive's own vertices.
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Reads a primitive's contents. `None` where a defect was noted.
pub(super) fn read_contents(
    def: &PrimitiveDef,
    accessors: &[Option<Accessor>],
    buffers: &[Bytes<'_>],
    defects: &mut Defects,
    notes: &mut Notes,
) -> Option<Primitive> {
    let corners = read_corners(def, accessors, buffers, defects)?;
    let mut triangles = triangulate(def.mode, &corners);
    if def.mode == Mode::Triangles {
        notes.repair(RepairKind::IndicesLeftOver, (corners.len() % 3) as u64, || def.path.clone());
    }
    let used = compact(&mut triangles, def.vertex_count);
    notes.repair(RepairKind::VerticesUnused, def.vertex_count - used.len() as u64, || def.path.clone());

    let mut broken = false;
    let mut reader = |semantic: Semantic| {
        let accessor = accessors[def.attributes[semantic as usize]?].as_ref()?;
        let reader = Reader::new(accessor, buffers, defects);
        broken |= reader.is_none();
        reader
    };
    let position = reader(Semantic::Position);
    let normal = reader(Semantic::Normal);
    let tangent = reader(Semantic::Tangent);
    let uv = [reader(Semantic::Uv0), reader(Semantic::Uv1)];
    let color = reader(Semantic::Color);
    let joints = reader(Semantic::Joints);
    let weights = reader(Semantic::Weights);
    let importance = reader(Semantic::Importance);
    if broken {
        return None;
    }
    let mut repairs = Repairs { path: &def.path, notes };
    let positions = read_positions(&position?, &used, &def.path, defects)?;
    let normals = normal.map(|reader| repairs.normals(&reader, &used, &positions, &triangles)).unwrap_or_default();
    let tangents = tangent.map(|reader| repairs.tangents(&reader, &used, &normals)).unwrap_or_default();
    let [uv0, uv1] = [0, 1]
        .map(|k| uv[k].as_ref().map(|reader| repairs.uvs(reader, &used, def.uv_transforms[k], k)).unwrap_or_default());
    let colors = color.map(|reader| repairs.colors(&reader, &used)).unwrap_or_default();
    let weights = weights.map(|reader| repairs.weights(&reader, &used)).unwrap_or_default();
    let importance = importance.map(|reader| repairs.importance(&reader, &used)).unwrap_or_default();
    let joints: Vec<[u16; 4]> = joints
        .map(|reader| used.iter().map(|v| reader.unsigned::<4>(*v).map(|j| j as u16)).collect())
        .unwrap_or_default();
    let attributes = AttributeSet {
        normals: !normals.is_empty(),
        tangents: !tangents.is_empty(),
        uv0: !uv0.is_empty(),
        uv1: !uv1.is_empty(),
        colors: !colors.is_empty(),
        skin: !joints.is_empty(),
        importance: !importance.is_empty(),
    };
    let material = def.material;
    Some(Primitive {
        material,
        attributes,
        positions,
        normals,
        tangents,
        uv0,
        uv1,
        colors,
        joints,
        weights,
        importance,
        triangles,
    })
}

fn read_corners(
    def: &PrimitiveDef,
    accessors: &[Option<Accessor>],
    buffers: &[Bytes<'_>],
    defects: &mut Defects,
) -> Option<Vec<u32>> {
    let Some(index) = def.indices else { return Some((0..def.corner_count as u32).collect()) };
    let accessor = accessors[index].as_ref()?;
    let reader = Reader::new(accessor, buffers, defects)?;
    let restart = accessor.component.greatest();
    let mut corners = Vec::with_capacity(def.corner_count as usize);
    let mut wrong = 0u64;
    for i in 0..def.corner_count as u32 {
        let [vertex] = reader.unsigned::<1>(i);
        if vertex as u64 >= def.vertex_count || vertex == restart {
            if wrong == 0 {
                let message = match vertex == restart {
                    true => format!("index {i} is the restart value {vertex}, which glTF does not allow"),
                    false => format!("index {i} is {vertex}, but there are {} vertices", def.vertex_count),
                };
                defects.invalid(format!("{}.indices", def.path), message);
            }
            wrong += 1;
        }
        corners.push(vertex);
    }
    (wrong == 0).then_some(corners)
}

/// Triangles by glTF 2.0, 3.7.2.1: all of a strip have the winding of its first.
fn triangulate(mode: Mode, corners: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::Triangles => corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
        Mode::Strip => {
            let turn = |(i, c): (usize, &[u32])| if i % 2 == 0 { [c[0], c[1], c[2]] } else { [c[0], c[2], c[1]] };
            corners.windows(3).enumerate().map(turn).collect()
        }
        Mode::Fan => match corners.split_first() {
            Some((hub, rest)) => rest.windows(2).map(|c| [c[0], c[1], *hub]).collect(),
            None => Vec::new(),
        },
    }
}

/// The vertices that `triangles` use, ascending; `triangles` then index into them. Work and memory follow the triangles, not the
/// vertices: many primitives may share one large vertex buffer.
pub(super) fn compact(triangles: &mut [[u32; 3]], vertex_count: u64) -> Vec<u32> {
    /// A table over all vertices pays while there are no more than so many for each triangle.
    const TABLE_VERTICES: u64 = 16;
    if vertex_count <= TABLE_VERTICES * triangles.len() as u64 {
        let mut rank = vec![u32::MAX; vertex_count as usize];
        triangles.iter().flatten().for_each(|v| rank[*v as usize] = 0);
        let used: Vec<u32> = (0..vertex_count as u32).filter(|v| rank[*v as usize] == 0).collect();
        used.iter().enumerate().for_each(|(i, v)| rank[*v as usize] = i as u32);
        triangles.iter_mut().flatten().for_each(|v| *v = rank[*v as usize]);
        return used;
    }
    let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    triangles.iter_mut().flatten().for_each(|v| *v = used.partition_point(|u| *u < *v) as u32);
    used
}

fn read_positions(reader: &Reader<'_>, used: &[u32], path: &str, defects: &mut Defects) -> Option<Vec<Vec3>> {
    let positions: Vec<Vec3> = used.iter().map(|v| Vec3::from_array(reader.floats(*v, 0.0))).collect();
    let mut wrong = positions.iter().zip(used).filter(|(p, _)| !p.is_finite());
    if let Some((position, v)) = wrong.next() {
        let message = format!("vertex {v} lies at {position}, and so do {} more: not finite", wrong.count());
        defects.invalid(format!("{path}.attributes.POSITION"), message);
        return None;
    }
    Some(positions)
}

/// Reads attributes and repairs them by the rules of [`RepairKind`].
struct Repairs<'a> {
    path: &'a str,
    notes: &'a mut Notes,
}

impl Repairs<'_> {
    fn note(&mut self, kind: RepairKind, count: usize, semantic: Semantic) {
        let names = names(&UvSlots::default());
        self.notes.repair(kind, count as u64, || format!("{}.attributes.{}", self.path, names[semantic as usize]));
    }

    fn normals(&mut self, reader: &Reader<'_>, used: &[u32], positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
        let mut normals: Vec<Vec3> = used.iter().map(|v| Vec3::from_array(reader.floats(*v, 0.0))).collect();
        let (lost, off) = repair_normals(&mut normals, positions, triangles);
        self.note(RepairKind::NormalRebuilt, lost, Semantic::Normal);
        self.note(RepairKind::NormalScaled, off, Semantic::Normal);
        normals
    }

    fn tangents(&mut self, reader: &Reader<'_>, used: &[u32], normals: &[Vec3]) -> Vec<Vec4> {
        if normals.is_empty() {
            self.note(RepairKind::TangentsDropped, used.len(), Semantic::Tangent);
            return Vec::new();
        }
        let (mut rebuilt, mut signs) = (0, 0);
        let repair = |(v, normal): (&u32, &Vec3)| {
            let [x, y, z, w] = reader.floats(*v, 0.0);
            let mut tangent = Vec3::new(x, y, z);
            let square = tangent.length_squared();
            if !square.is_finite() || square <= 1e-12 {
                rebuilt += 1;
                tangent = normal.any_orthonormal_vector();
            } else if (square - 1.0).abs() > 1e-6 {
                tangent = tangent.normalize_or(Vec3::X);
            }
            let sign = if w.is_sign_negative() && !w.is_nan() && w != 0.0 { -1.0 } else { 1.0 };
            signs += (w != sign) as usize;
            tangent.extend(sign)
        };
        let tangents = used.iter().zip(normals).map(repair).collect();
        self.note(RepairKind::TangentRebuilt, rebuilt, Semantic::Tangent);
        self.note(RepairKind::TangentSign, signs, Semantic::Tangent);
        tangents
    }

    /// The UVs of slot `k`.
    fn uvs(&mut self, reader: &Reader<'_>, used: &[u32], transform: Option<UvTransform>, k: usize) -> Vec<Vec2> {
        let mut lost = 0;
        let read = |v: &u32| {
            let uv = Vec2::from_array(reader.floats(*v, 0.0));
            let uv = transform.map_or(uv, |transform| transform.apply(uv));
            lost += !uv.is_finite() as usize;
            if uv.is_finite() { uv } else { Vec2::ZERO }
        };
        let uvs = used.iter().map(read).collect();
        self.note(RepairKind::UvNotFinite, lost, [Semantic::Uv0, Semantic::Uv1][k]);
        uvs
    }

    fn colors(&mut self, reader: &Reader<'_>, used: &[u32]) -> Vec<Vec4> {
        let mut lost = 0;
        let read = |v: &u32| {
            let color = Vec4::from_array(reader.floats(*v, 1.0));
            lost += !color.is_finite() as usize;
            if color.is_finite() { color } else { Vec4::ONE }
        };
        let colors = used.iter().map(read).collect();
        self.note(RepairKind::ColorNotFinite, lost, Semantic::Color);
        colors
    }

    fn weights(&mut self, reader: &Reader<'_>, used: &[u32]) -> Vec<Vec4> {
        let mut lost = 0;
        let read = |v: &u32| {
            let raw: [f32; 4] = reader.floats(*v, 0.0);
            let good = raw.map(|w| if w.is_finite() && w >= 0.0 { w } else { 0.0 });
            lost += (good != raw) as usize;
            Vec4::from_array(good)
        };
        let weights = used.iter().map(read).collect();
        self.note(RepairKind::WeightNotFinite, lost, Semantic::Weights);
        weights
    }

    fn importance(&mut self, reader: &Reader<'_>, used: &[u32]) -> Vec<f32> {
        let mut lost = 0;
        let read = |v: &u32| {
            let [raw] = reader.floats(*v, 0.0);
            let good = raw.is_finite() && raw >= 0.0;
            lost += !good as usize;
            if good { raw } else { 1.0 }
        };
        let importance = used.iter().map(read).collect();
        self.note(RepairKind::ImportanceNotFinite, lost, Semantic::Importance);
        importance
    }
}

/// Gives every normal a direction and unit length. Back: how many had no direction, how many of the others another length.
pub(super) fn repair_normals(normals: &mut [Vec3], positions: &[Vec3], triangles: &[[u32; 3]]) -> (usize, usize) {
    let directed = |n: &Vec3| n.is_finite() && n.length_squared() > 1e-12 && n.length_squared().is_finite();
    let lost = normals.iter().filter(|n| !directed(n)).count();
    if lost > 0 {
        let rebuilt = vertex_normals(positions, triangles);
        normals.iter_mut().zip(rebuilt).filter(|(n, _)| !directed(n)).for_each(|(n, rebuilt)| *n = rebuilt);
    }
    let off = normals.iter().filter(|n| (n.length() - 1.0).abs() > 0.01).count();
    for normal in normals {
        // What is of unit length to rounding keeps its bits.
        if (normal.length_squared() - 1.0).abs() > 1e-6 {
            *normal = normal.normalize_or(Vec3::Y);
        }
    }
    (lost, off)
}

/// `[vertex_count]`: area-weighted mean of the normals of each vertex's own faces; +Y where that has no direction.
fn vertex_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| positions[v as usize].as_dvec3());
        let area = (b - a).cross(c - a);
        triangle.iter().for_each(|v| sums[*v as usize] += area);
    }
    sums.iter().map(|sum| sum.normalize_or(DVec3::Y).as_vec3()).collect()
}
