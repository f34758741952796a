//! Instances into one mesh: every placed primitive becomes a submesh in object space.

use glam::{DMat3, DMat4, DVec3, Vec2, Vec3, Vec4};

use super::error::Defects;
use super::primitive::{MeshDef, Primitive};
use super::report::{ImportReport, Notes, RepairKind};
use super::scene::{Names, Placement};
use crate::ids::{MaterialId, SubmeshId};
use crate::material::{MapRole, Material};
use crate::mesh::{AttributeSet, RawMesh, Submesh};

/// Joins the placed primitives. `contents[mesh][primitive]`: `None` where it was not read.
pub(super) fn flatten(
    placements: &[Placement],
    meshes: &[MeshDef],
    contents: &[Vec<Option<Primitive>>],
    materials: &[Material],
    report: &mut ImportReport,
    defects: &mut Defects,
    notes: &mut Notes,
) -> RawMesh {
    let placed = || placements.iter().flat_map(|p| contents[p.mesh].iter().flatten());
    let mut builder = Builder::new(placed().fold(AttributeSet::default(), |sum, p| union(sum, p.attributes)));
    let mut names = Names::new();
    for placement in placements {
        let def = &meshes[placement.mesh];
        let transform = Transform::new(placement.object_from_mesh);
        report.instances += 1;
        report.mirrored_instances += transform.mirrors as u64;
        for (k, primitive) in contents[placement.mesh].iter().enumerate() {
            let Some(primitive) = primitive.as_ref().filter(|p| !p.triangles.is_empty()) else { continue };
            let material = primitive.material.map(|m| &materials[m]);
            let name = names.unique(wished_name(placement, def, k, material));
            if let Some(material) = material {
                note_uv_sets(material, &primitive.attributes, &name, notes);
            }
            if !builder.append(primitive, &transform, name) {
                defects
                    .invalid(format!("nodes[{}]", placement.node), "places a vertex beyond what a 32-bit float holds");
            }
        }
    }
    report.degenerate_triangles = degenerate_count(&builder.raw);
    builder.finish()
}

/// See [`Names`] for the rule.
fn wished_name(placement: &Placement, mesh: &MeshDef, primitive: usize, material: Option<&Material>) -> String {
    if let Some(name) = mesh.primitives.get(primitive).map(|def| def.name.trim()).filter(|name| !name.is_empty()) {
        return name.to_owned();
    }
    let base = match (placement.name.trim(), mesh.name.trim()) {
        ("", "") => format!("mesh{}", placement.mesh),
        ("", name) | (name, _) => name.to_owned(),
    };
    if mesh.primitives.len() < 2 {
        return base;
    }
    match material.map_or("", |material| material.name.trim()) {
        "" => format!("{base}/{primitive}"),
        material => format!("{base}/{material}"),
    }
}

fn note_uv_sets(material: &Material, attributes: &AttributeSet, name: &str, notes: &mut Notes) {
    let absent = |set: u32| if set == 0 { !attributes.uv0 } else { !attributes.uv1 };
    let lacks = MapRole::ALL.iter().filter_map(|role| material.map(*role)).any(|map| absent(map.uv_set));
    notes.repair(RepairKind::UvSetAbsent, lacks as u64, || format!("submesh `{name}`"));
}

fn union(a: AttributeSet, b: AttributeSet) -> AttributeSet {
    AttributeSet {
        normals: a.normals || b.normals,
        tangents: a.tangents || b.tangents,
        uv0: a.uv0 || b.uv0,
        uv1: a.uv1 || b.uv1,
        colors: a.colors || b.colors,
        skin: a.skin || b.skin,
        importance: a.importance || b.importance,
    }
}

fn degenerate_count(raw: &RawMesh) -> u64 {
    let key = |v: u32| raw.positions[v as usize].to_array().map(|c| (c + 0.0).to_bits());
    let flat = |[a, b, c]: &&[u32; 3]| {
        let [a, b, c] = [key(*a), key(*b), key(*c)];
        a == b || b == c || c == a
    };
    raw.triangles.iter().filter(flat).count() as u64
}

/// An affine map and what follows from it for directions.
struct Transform {
    /// `None` for the identity, which keeps every bit.
    object_from_mesh: Option<DMat4>,
    /// Cofactor matrix times the determinant's sign: takes normals like the inverse transpose does, but exists for flat maps too.
    normals: DMat3,
    mirrors: bool,
}

impl Transform {
    fn new(object_from_mesh: DMat4) -> Transform {
        let linear = DMat3::from_mat4(object_from_mesh);
        let cofactors = DMat3::from_cols(
            linear.y_axis.cross(linear.z_axis),
            linear.z_axis.cross(linear.x_axis),
            linear.x_axis.cross(linear.y_axis),
        );
        let mirrors = linear.determinant() < 0.0;
        Transform {
            object_from_mesh: (object_from_mesh != DMat4::IDENTITY).then_some(object_from_mesh),
            normals: if mirrors { cofactors * -1.0 } else { cofactors },
            mirrors,
        }
    }

    fn position(&self, p: Vec3) -> Vec3 {
        self.object_from_mesh.map_or(p, |m| m.transform_point3(p.as_dvec3()).as_vec3())
    }

    fn normal(&self, n: Vec3) -> Vec3 {
        if self.object_from_mesh.is_none() {
            return n;
        }
        unit(self.normals * n.as_dvec3()).unwrap_or(n)
    }

    fn tangent(&self, t: Vec4) -> Vec4 {
        let Some(m) = self.object_from_mesh else { return t };
        let direction = unit(m.transform_vector3(t.truncate().as_dvec3())).unwrap_or(t.truncate());
        // Mirroring turns cross(n, t) over against the mirrored bitangent.
        direction.extend(if self.mirrors { -t.w } else { t.w })
    }

    fn triangle(&self, [a, b, c]: [u32; 3]) -> [u32; 3] {
        if self.mirrors { [a, c, b] } else { [a, b, c] }
    }
}

/// Unit length, with the largest part brought to 1 first: scales of 1e-200 have directions too.
fn unit(v: DVec3) -> Option<Vec3> {
    let scaled = v / v.abs().max_element();
    scaled.is_finite().then(|| scaled.normalize().as_vec3())
}

/// The mesh under construction, with every attribute that some submesh has.
struct Builder {
    raw: RawMesh,
}

impl Builder {
    fn new(carried: AttributeSet) -> Builder {
        fn some<T>(carried: bool) -> Option<Vec<T>> {
            carried.then(Vec::new)
        }
        let raw = RawMesh {
            normals: some(carried.normals),
            tangents: some(carried.tangents),
            uv0: some(carried.uv0),
            uv1: some(carried.uv1),
            colors: some(carried.colors),
            joints: some(carried.skin),
            weights: some(carried.skin),
            importance: some(carried.importance),
            ..Default::default()
        };
        Builder { raw }
    }

    /// Adds a placed primitive; false if a position does not stay finite.
    fn append(&mut self, primitive: &Primitive, transform: &Transform, name: String) -> bool {
        /// `values` mapped, or `count` times the neutral value where the primitive lacks the attribute.
        fn extend<T: Copy>(to: &mut Option<Vec<T>>, values: &[T], count: usize, neutral: T, map: impl Fn(T) -> T) {
            let Some(to) = to else { return };
            match values.is_empty() {
                true => to.extend(std::iter::repeat_n(neutral, count)),
                false => to.extend(values.iter().map(|v| map(*v))),
            }
        }
        let raw = &mut self.raw;
        let count = primitive.positions.len();
        let first = raw.positions.len() as u32;
        raw.positions.extend(primitive.positions.iter().map(|p| transform.position(*p)));
        extend(&mut raw.normals, &primitive.normals, count, Vec3::Z, |n| transform.normal(n));
        extend(&mut raw.tangents, &primitive.tangents, count, Vec4::new(1.0, 0.0, 0.0, 1.0), |t| transform.tangent(t));
        extend(&mut raw.uv0, &primitive.uv0, count, Vec2::ZERO, |v| v);
        extend(&mut raw.uv1, &primitive.uv1, count, Vec2::ZERO, |v| v);
        extend(&mut raw.colors, &primitive.colors, count, Vec4::ONE, |v| v);
        extend(&mut raw.joints, &primitive.joints, count, [0; 4], |v| v);
        extend(&mut raw.weights, &primitive.weights, count, Vec4::ZERO, |v| v);
        extend(&mut raw.importance, &primitive.importance, count, 1.0, |v| v);
        let submesh = SubmeshId(raw.submeshes.len() as u32);
        let triangles = primitive.triangles.iter();
        raw.triangles.extend(triangles.map(|t| transform.triangle(*t).map(|v| first + v)));
        raw.face_submesh.extend(std::iter::repeat_n(submesh, primitive.triangles.len()));
        raw.submeshes.push(Submesh {
            name,
            material: primitive.material.map(|m| MaterialId(m as u32)),
            attributes: primitive.attributes,
            source_triangles: primitive.triangles.len() as u32,
        });
        raw.positions[first as usize..].iter().all(|p| p.is_finite())
    }

    fn finish(self) -> RawMesh {
        self.raw
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn a_mirror_flips_winding_and_tangent_sign_and_keeps_normals_outward() {
        let mirror = Transform::new(DMat4::from_scale(DVec3::new(-2.0, 1.0, 1.0)));
        assert_eq!(mirror.triangle([0, 1, 2]), [0, 2, 1]);
        assert_eq!(mirror.normal(Vec3::X), Vec3::NEG_X);
        assert_eq!(mirror.normal(Vec3::Y), Vec3::Y);
        let tangent = mirror.tangent(Vec4::new(1.0, 0.0, 0.0, 1.0));
        assert_eq!(tangent, Vec4::new(-1.0, 0.0, 0.0, -1.0));
        // The bitangent of (n = Y, t = X, w = 1) is -Z, which the mirror leaves alone.
        assert_eq!(tangent.w * mirror.normal(Vec3::Y).cross(tangent.truncate()), Vec3::NEG_Z);
    }

    #[test]
    fn normals_follow_the_inverse_transpose() {
        let m = DMat4::from_scale_rotation_translation(
            DVec3::new(3.0, 0.5, 2.0),
            DQuat::from_xyzw(0.5, 0.5, 0.5, 0.5),
            DVec3::ONE,
        );
        let n = DVec3::new(1.0, 2.0, 3.0).normalize();
        let expected = (DMat3::from_mat4(m).inverse().transpose() * n).normalize().as_vec3();
        let found = Transform::new(m).normal(n.as_vec3());
        assert!((found - expected).length() < 1e-6, "{found} and {expected}");
    }

    #[test]
    fn a_flattening_map_still_has_a_normal() {
        let flat = Transform::new(DMat4::from_scale(DVec3::new(1.0, 0.0, 1.0)));
        assert_eq!(flat.normal(Vec3::new(0.6, 0.8, 0.0)), Vec3::Y);
        assert_eq!(Transform::new(DMat4::from_scale(DVec3::ZERO)).normal(Vec3::X), Vec3::X);
        assert_eq!(Transform::new(DMat4::from_scale(DVec3::splat(1e-150))).normal(Vec3::X), Vec3::X);
    }
}
