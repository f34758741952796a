//! Polygons over separate pools of positions, UVs and normals, as OBJ and PLY have them, into primitives of wedges.

use std::collections::HashMap;

use glam::{DMat4, Vec2, Vec3, Vec4};

use super::error::{Defects, ImportError};
use super::picture::Pictures;
use super::polygon::{Cut, MOST_EAR_CORNERS, triangulate};
use super::primitive::{MeshDef, Primitive, repair_normals};
use super::report::{ImportReport, Notes, RepairKind};
use super::scene::Placement;
use super::{Defect, ImportLimits, MOST_IDS, flatten};
use crate::Asset;
use crate::material::Material;
use crate::mesh::{AttributeSet, Mesh};

/// A corner's index where it has none.
pub(super) const NONE: u32 = u32::MAX;

/// What a corner of a polygon refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Corner {
    pub(super) position: u32,
    /// Or [`NONE`].
    pub(super) uv: u32,
    /// Or [`NONE`].
    pub(super) normal: u32,
}

/// A polygon: the corners from `first` to the next polygon's.
pub(super) struct Polygon {
    pub(super) first: usize,
    /// Line or number in the file, for messages.
    pub(super) place: u64,
    /// Which part it belongs to.
    pub(super) part: u32,
}

/// A file's geometry.
#[derive(Default)]
pub(super) struct Soup {
    pub(super) positions: Vec<Vec3>,
    /// Linear RGBA by position, `None` where it has none; as long as `positions`, or empty.
    pub(super) colors: Vec<Option<Vec4>>,
    /// V downwards.
    pub(super) uvs: Vec<Vec2>,
    pub(super) normals: Vec<Vec3>,
    pub(super) corners: Vec<Corner>,
    pub(super) polygons: Vec<Polygon>,
    /// Corners of finished polygons.
    closed: usize,
    triangle_count: u64,
    limits: ImportLimits,
}

/// A submesh to be.
pub(super) struct Part {
    /// The name wished for.
    pub(super) name: String,
    /// Index of its material.
    pub(super) material: Option<usize>,
}

impl Soup {
    /// Corners pushed since the last polygon.
    pub(super) fn open_corners(&self) -> usize {
        self.corners.len() - self.closed
    }

    /// Forgets the corners pushed since the last polygon.
    pub(super) fn drop_open(&mut self) {
        self.corners.truncate(self.closed);
    }

    /// Makes the corners pushed since the last polygon a polygon, but past the limit on triangles, where nothing more is kept.
    pub(super) fn close_polygon(&mut self, place: u64, part: u32) {
        self.triangle_count = self.triangle_count.saturating_add(self.open_corners().saturating_sub(2) as u64);
        if self.triangle_count > self.most_triangles() {
            return self.drop_open();
        }
        self.polygons.push(Polygon { first: self.closed, place, part });
        self.closed = self.corners.len();
    }

    pub(super) fn new(limits: &ImportLimits) -> Soup {
        Soup { limits: *limits, ..Default::default() }
    }

    fn most_triangles(&self) -> u64 {
        self.limits.max_triangles.min(MOST_IDS / 3)
    }

    /// Cuts all polygons and makes a primitive of every part. A polygon's [`Polygon::place`] is named by `place` in the report, by
    /// `path` in a defect.
    pub(super) fn into_primitives(
        self,
        main: &str,
        parts: &[Part],
        place: impl Fn(u64) -> String,
        path: impl Fn(u64) -> String,
        defects: &mut Defects,
        notes: &mut Notes,
    ) -> Vec<Option<Primitive>> {
        let (count, most, limits) = (self.triangle_count, self.most_triangles(), self.limits);
        if count > most {
            defects.invalid(main, format!("{count} triangles, the limit is {most}"));
        }
        if parts.len() as u64 > limits.max_submeshes {
            defects.invalid(main, format!("{} submeshes, the limit is {}", parts.len(), limits.max_submeshes));
        }
        let ends = self.polygons.iter().skip(1).map(|p| p.first).chain([self.closed]);
        let mut by_part: Vec<Vec<Corner>> = parts.iter().map(|_| Vec::new()).collect();
        let mut outline = Vec::new();
        for (polygon, end) in self.polygons.iter().zip(ends) {
            let corners = &self.corners[polygon.first..end];
            outline.clear();
            outline.extend(corners.iter().map(|corner| self.positions[corner.position as usize]));
            let to = &mut by_part[polygon.part as usize];
            match triangulate(&outline, |triangle| to.extend(triangle.map(|k| corners[k as usize]))) {
                Cut::Whole => {}
                Cut::Crossed => notes.repair(RepairKind::PolygonCrossed, 1, || place(polygon.place)),
                Cut::TooLarge => defects.unsupported(
                    path(polygon.place),
                    format!(
                        "a concave polygon of {} corners; more than {MOST_EAR_CORNERS} are read only where convex: \
                         cut it into triangles",
                        corners.len()
                    ),
                ),
            }
        }
        let mut used = vec![false; self.positions.len()];
        self.corners.iter().for_each(|corner| used[corner.position as usize] = true);
        let unused = used.iter().filter(|used| !**used).count();
        notes.repair(RepairKind::VerticesUnused, unused as u64, || "positions".to_owned());
        let mut vertices = 0u64;
        let most = limits.max_vertices.min(MOST_IDS);
        let mut primitives = Vec::with_capacity(parts.len());
        for (part, corners) in parts.iter().zip(&mut by_part) {
            let corners = std::mem::take(corners);
            let primitive = (vertices <= most).then(|| self.primitive(part, &corners, notes));
            vertices += primitive.as_ref().map_or(0, |primitive| primitive.positions.len() as u64);
            primitives.push(primitive);
        }
        if vertices > most {
            defects.invalid(main, format!("more than {most} vertices, which is the limit"));
        }
        primitives
    }

    /// One vertex for every different corner, in the order of their first use. Three corners make a triangle.
    fn primitive(&self, part: &Part, corners: &[Corner], notes: &mut Notes) -> Primitive {
        let mut vertex_of: HashMap<Corner, u32> = HashMap::with_capacity(corners.len() / 4);
        let mut wedges: Vec<Corner> = Vec::new();
        let mut vertex = |corner: &Corner| {
            *vertex_of.entry(*corner).or_insert_with(|| {
                wedges.push(*corner);
                wedges.len() as u32 - 1
            })
        };
        let triangles: Vec<[u32; 3]> =
            corners.chunks_exact(3).map(|c| [vertex(&c[0]), vertex(&c[1]), vertex(&c[2])]).collect();
        drop(vertex_of);
        let path = || format!("submesh `{}`", part.name);
        let positions: Vec<Vec3> = wedges.iter().map(|w| self.positions[w.position as usize]).collect();
        let color = |w: &Corner| self.colors.get(w.position as usize).copied().flatten();
        let attributes = AttributeSet {
            normals: wedges.iter().any(|w| w.normal != NONE),
            uv0: wedges.iter().any(|w| w.uv != NONE),
            colors: wedges.iter().any(|w| color(w).is_some()),
            ..Default::default()
        };
        let mut normals = Vec::new();
        if attributes.normals {
            // What has none has no direction either, and gets one.
            normals = wedges.iter().map(|w| self.normals.get(w.normal as usize).copied().unwrap_or_default()).collect();
            let (lost, off) = repair_normals(&mut normals, &positions, &triangles);
            notes.repair(RepairKind::NormalRebuilt, lost as u64, path);
            notes.repair(RepairKind::NormalScaled, off as u64, path);
        }
        let mut uv0 = Vec::new();
        if attributes.uv0 {
            uv0 = wedges.iter().map(|w| self.uvs.get(w.uv as usize).copied().unwrap_or_default()).collect();
            let absent = wedges.iter().filter(|w| w.uv == NONE).count();
            let lost = uv0.iter().filter(|uv| !uv.is_finite()).count();
            uv0.iter_mut().filter(|uv| !uv.is_finite()).for_each(|uv| *uv = Vec2::ZERO);
            notes.repair(RepairKind::CornerUvAbsent, absent as u64, path);
            notes.repair(RepairKind::UvNotFinite, lost as u64, path);
        }
        let mut colors = Vec::new();
        if attributes.colors {
            colors = wedges.iter().map(|w| color(w).unwrap_or(Vec4::ONE)).collect();
        }
        Primitive {
            material: part.material,
            attributes,
            positions,
            normals,
            tangents: Vec::new(),
            uv0,
            uv1: Vec::new(),
            colors,
            joints: Vec::new(),
            weights: Vec::new(),
            importance: Vec::new(),
            triangles,
        }
    }
}

/// The asset of all parts. `place`s, sums and materials are in the report then.
pub(super) fn finish(
    main: &str,
    parts: Vec<Part>,
    primitives: Vec<Option<Primitive>>,
    pictures: Pictures<'_, '_>,
    mut report: ImportReport,
    mut defects: Defects,
    mut notes: Notes,
) -> Result<(Asset, ImportReport), ImportError> {
    defects.check()?;
    // Each part is a mesh of one primitive that a nameless node places where it is.
    let placement =
        |mesh| Placement { node: mesh, mesh, name: String::new(), object_from_mesh: DMat4::IDENTITY, instances: None };
    let placements: Vec<Placement> = (0..parts.len()).map(placement).collect();
    let meshes: Vec<MeshDef> =
        parts.into_iter().map(|part| MeshDef { name: part.name, primitives: Vec::new() }).collect();
    let contents: Vec<Vec<Option<Primitive>>> = primitives.into_iter().map(|primitive| vec![primitive]).collect();
    let materials: &[Material] = &pictures.set.materials;
    let raw = flatten::flatten(&placements, &meshes, &contents, materials, &mut report, &mut defects, &mut notes);
    drop(contents);
    defects.check()?;
    if raw.triangles.is_empty() {
        return Err(ImportError::invalid(main, "the model holds no triangle"));
    }
    let mesh = Mesh::new(raw).map_err(|error| {
        let defect = |d: crate::MeshDefect| Defect { path: format!("flattened mesh: {}", d.path), message: d.message };
        ImportError::Invalid(error.0.into_iter().map(defect).collect())
    })?;
    report.vertices = mesh.vertex_count() as u64;
    report.triangles = mesh.face_count() as u64;
    report.stored_triangles = report.triangles;
    report.submeshes = mesh.submeshes.len() as u64;
    report.primitives = report.submeshes;
    report.materials = pictures.set.materials.len() as u64;
    report.textures = pictures.set.textures.len() as u64;
    // There are no nodes.
    (report.nodes, report.instances) = (0, 0);
    report.images = pictures.summaries;
    notes.finish(&mut report);
    Ok((Asset { mesh, materials: pictures.set, images: pictures.images }, report))
}

/// Linear RGBA of sRGB codes in `[0, 1]` with linear alpha, clamped; white if it is not finite.
///
/// # Source
/// IEC 61966-2-1:1999.
pub(super) fn linear_from_srgb(code: [f32; 4], path: impl Fn() -> String, notes: &mut Notes) -> Vec4 {
    if code.iter().any(|c| !c.is_finite()) {
        notes.repair(RepairKind::ColorNotFinite, 1, path);
        return Vec4::ONE;
    }
    notes.repair(RepairKind::ColorClamped, code.iter().any(|c| !(0.0..=1.0).contains(c)) as u64, path);
    let [r, g, b, a] = code.map(|c| f64::from(c.clamp(0.0, 1.0)));
    let decode = |c: f64| if c <= 0.04045 { c / 12.92 } else { libm::pow((c + 0.055) / 1.055, 2.4) };
    Vec4::new(decode(r) as f32, decode(g) as f32, decode(b) as f32, a as f32)
}

/// Most different things that are listed by name as not carried; a broken file may name millions.
const MOST_NAMED: usize = 32;

/// Counts what is not carried by names out of the file.
#[derive(Default)]
pub(super) struct Left {
    counts: std::collections::BTreeMap<String, u64>,
    others: u64,
}

impl Left {
    pub(super) fn add(&mut self, name: impl AsRef<str>, count: u64) {
        let name = name.as_ref();
        if let Some(sum) = self.counts.get_mut(name) {
            *sum += count;
        } else if self.counts.len() < MOST_NAMED {
            self.counts.insert(name.to_owned(), count);
        } else {
            self.others += count;
        }
    }

    pub(super) fn finish(self, notes: &mut Notes) {
        self.counts.iter().for_each(|(name, count)| notes.not_carried(name, *count));
        notes.not_carried("other statements", self.others);
    }
}
