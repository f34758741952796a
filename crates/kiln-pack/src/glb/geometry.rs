//! A level's mesh as glTF primitives.

use std::collections::BTreeMap;

use bytemuck::{Pod, cast_slice};
use glam::{Vec2, Vec3, Vec4};
use kiln_asset::{AttributeSet, Level, MapRole, MaterialSet, Mesh, SubmeshId};

use super::{ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, ExportReport, FLOAT, UNSIGNED_INT, UNSIGNED_SHORT, Writer, json};

impl Writer {
    /// The node of a level; its mesh is added.
    pub(super) fn level(&mut self, lod: usize, level: &Level, materials: &MaterialSet) -> json::Node {
        let mesh = &level.mesh;
        let mut primitives = Vec::new();
        for number in 0..mesh.submeshes.len() {
            match self.primitive(mesh, number, materials) {
                Some(primitive) => primitives.push(primitive),
                None => self.report.empty_submeshes += 1,
            }
        }
        if mesh.joints.is_some() && !self.report.notes.iter().any(|note| note.starts_with("joints")) {
            self.report.notes.push("joints and weights were left out: there is no skeleton".into());
        }
        let name = format!("lod{lod}");
        let number = (!primitives.is_empty()).then(|| {
            self.root.meshes.push(json::Mesh { name: name.clone(), primitives });
            self.root.meshes.len() as u32 - 1
        });
        json::Node { name, mesh: number, extensions: None, extras: None }
    }

    fn primitive(&mut self, mesh: &Mesh, number: usize, materials: &MaterialSet) -> Option<json::Primitive> {
        let submesh = &mesh.submeshes[number];
        let faces = &mesh.triangles[mesh.submesh_faces(SubmeshId(number as u32))];
        if faces.is_empty() {
            return None;
        }
        // The vertices in use, ascending, and their new numbers.
        let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let (least, greatest) = (used[0] as usize, used[used.len() - 1] as usize);
        let mut renumbered = vec![0u32; greatest - least + 1];
        for (new, old) in used.iter().enumerate() {
            renumbered[*old as usize - least] = new as u32;
        }
        let indices: Vec<u32> = faces.iter().flatten().map(|old| renumbered[*old as usize - least]).collect();

        let mut attributes = BTreeMap::new();
        let positions = pick(&mesh.positions, &used);
        attributes.insert("POSITION", self.array(&positions, "VEC3"));
        let (lo, hi) = positions.iter().fold((positions[0], positions[0]), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        if let Some(accessor) = self.root.accessors.last_mut() {
            (accessor.min, accessor.max) = (Some(lo.to_array()), Some(hi.to_array()));
        }
        self.other_attributes(mesh, submesh.attributes, &used, &mut attributes);
        let uv_sets = submesh.material.map_or(0, |material| uv_sets(&materials.materials[material.index()]));
        self.uvs(mesh, submesh.attributes, &used, uv_sets, &mut attributes);
        let indices = self.indices(&indices, used.len());
        let material = submesh.material.map(|material| material.0);
        let extras = json::PrimitiveExtras { submesh: submesh.name.clone() };
        Some(json::Primitive { attributes, indices, material, extras })
    }

    fn other_attributes(
        &mut self,
        mesh: &Mesh,
        had: AttributeSet,
        used: &[u32],
        attributes: &mut BTreeMap<&'static str, u32>,
    ) {
        let normals = chosen(&mesh.normals, used, had.normals).map(|n| unit_normals(n, &mut self.report));
        if let Some(normals) = &normals {
            attributes.insert("NORMAL", self.array(normals, "VEC3"));
        }
        // glTF has no tangents without normals.
        if let (Some(normals), Some(tangents)) = (&normals, chosen(&mesh.tangents, used, had.tangents)) {
            let tangents = unit_tangents(tangents, normals, &mut self.report);
            attributes.insert("TANGENT", self.array(&tangents, "VEC4"));
        }
        if let Some(mut colors) = chosen(&mesh.colors, used, had.colors) {
            for color in &mut colors {
                let clamped = color.clamp(Vec4::ZERO, Vec4::ONE);
                self.report.clamped += (clamped != *color) as usize;
                *color = clamped;
            }
            attributes.insert("COLOR_0", self.array(&colors, "VEC4"));
        }
    }

    /// UV sets that the submesh has or its material reads; glTF numbers them without gap.
    fn uvs(
        &mut self,
        mesh: &Mesh,
        had: AttributeSet,
        used: &[u32],
        read: u32,
        attributes: &mut BTreeMap<&'static str, u32>,
    ) {
        let uv0 = chosen(&mesh.uv0, used, had.uv0 || read > 0);
        let uv1 = chosen(&mesh.uv1, used, had.uv1 || read > 1);
        let zeros = || vec![Vec2::ZERO; used.len()];
        let uv1 = if read > 1 { Some(uv1.unwrap_or_else(zeros)) } else { uv1 };
        let uv0 = if read > 0 || uv1.is_some() { Some(uv0.unwrap_or_else(zeros)) } else { uv0 };
        for (name, uv) in [("TEXCOORD_0", uv0), ("TEXCOORD_1", uv1)] {
            if let Some(uv) = uv {
                attributes.insert(name, self.array(&uv, "VEC2"));
            }
        }
    }

    fn array<T: Pod>(&mut self, values: &[T], kind: &'static str) -> u32 {
        let buffer_view = self.view(cast_slice(values), Some(ARRAY_BUFFER));
        self.accessor(json::Accessor {
            buffer_view,
            component_type: FLOAT,
            count: values.len(),
            kind,
            min: None,
            max: None,
        })
    }

    fn indices(&mut self, indices: &[u32], vertices: usize) -> u32 {
        let (buffer_view, component_type) = if vertices <= kiln_format::record::MAX_U16_VERTICES as usize {
            let narrow: Vec<u16> = indices.iter().map(|i| *i as u16).collect();
            (self.view(cast_slice(&narrow), Some(ELEMENT_ARRAY_BUFFER)), UNSIGNED_SHORT)
        } else {
            (self.view(cast_slice(indices), Some(ELEMENT_ARRAY_BUFFER)), UNSIGNED_INT)
        };
        let count = indices.len();
        self.accessor(json::Accessor { buffer_view, component_type, count, kind: "SCALAR", min: None, max: None })
    }

    fn accessor(&mut self, accessor: json::Accessor) -> u32 {
        self.root.accessors.push(accessor);
        self.root.accessors.len() as u32 - 1
    }
}

/// Number of UV sets that a material reads.
fn uv_sets(material: &kiln_asset::Material) -> u32 {
    MapRole::ALL.iter().filter_map(|role| material.map(*role)).map(|used| used.uv_set + 1).max().unwrap_or(0)
}

fn pick<T: Copy>(values: &[T], used: &[u32]) -> Vec<T> {
    used.iter().map(|v| values[*v as usize]).collect()
}

/// The attribute of the vertices in use, if the submesh's source had it or a later stage filled it in: a joined mesh gives
/// submeshes that lack an attribute one neutral value throughout.
fn chosen<T: Copy + PartialEq>(values: &Option<Vec<T>>, used: &[u32], had: bool) -> Option<Vec<T>> {
    let values = pick(values.as_ref()?, used);
    let varies = values.iter().any(|value| *value != values[0]);
    (had || varies).then_some(values)
}

/// The unit vector, unless the length is not worth dividing by. Scaled first, so that squares neither vanish nor overflow.
fn unit(v: Vec3) -> Option<Vec3> {
    let largest = v.abs().max_element();
    if largest < f32::MIN_POSITIVE {
        return None;
    }
    let v = v / largest;
    let unit = v / v.length();
    unit.is_finite().then_some(unit)
}

fn is_unit(v: Vec3) -> bool {
    (v.length_squared() - 1.0).abs() < 1e-5
}

/// Normals as they are where they have unit length, else made so.
fn unit_normals(mut normals: Vec<Vec3>, report: &mut ExportReport) -> Vec<Vec3> {
    for normal in normals.iter_mut().filter(|normal| !is_unit(**normal)) {
        *normal = unit(*normal).unwrap_or_else(|| {
            report.replaced_normals += 1;
            Vec3::Z
        });
    }
    normals
}

/// Tangents of unit length with w = +1 or -1.
fn unit_tangents(mut tangents: Vec<Vec4>, normals: &[Vec3], report: &mut ExportReport) -> Vec<Vec4> {
    for (tangent, normal) in tangents.iter_mut().zip(normals) {
        let mut direction = tangent.truncate();
        if !is_unit(direction) {
            direction = unit(direction).unwrap_or_else(|| {
                report.replaced_tangents += 1;
                normal.any_orthonormal_vector()
            });
        }
        *tangent = direction.extend(if tangent.w < 0.0 { -1.0 } else { 1.0 });
    }
    tangents
}
