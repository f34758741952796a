//! Free placement: after a cut, each kept point of a patch or an open border goes to where its error form is least.
//!
//! **Problem.** Half-edge collapses leave every kept point at a place of the source, though its form, the sum of all planes that
//! fell to it, is least somewhere else: half of the error is in that. Moving a point may not tear, flip or smear anything.
//!
//! **Method.** Once a level, not once a collapse: the order of collapses hardly changes, the log stays free of places, and a level
//! costs one pass over its points, in order.
//! ```text
//! for each point that took in another and lies inside a patch or on an open border:
//!     place <- least of its form + a little pull towards where it is
//!     skip it if that is farther than its farthest neighbour, or a face would turn, or a UV triangle would flip
//!     each wedge: attributes at the nearest place of its own faces (barycentric, clamped)
//! ```
//! Seams and boundaries stay: such a point has one place and two sides of attributes. Borders do not: the planes that stand on
//! them hold their course.
//!
//! **Departures.** Garland and Heckbert solve at every collapse; solving afterwards is meshoptimizer's way. The attributes follow
//! González (thesis 3.5), who solves in one triangle of the point's star.
//!
//! **Sources.** M. Garland, P. Heckbert, SIGGRAPH 1997, doi:10.1145/258734.258849. C. González, PhD thesis, Universitat Jaume I
//! 2010, section 3.5. A. Kapoulkine, meshoptimizer, `meshopt_simplifyWithUpdate`, 2025.

use glam::{DVec3, Vec2, Vec3, Vec4};
use kiln_asset::{Mesh, PointId, RawMesh};
use kiln_geom::triangle::closest_point;

use super::quadric::Quadric;
use crate::topology::{PointKind, Topology};

/// Share of a form's area that pulls the point to its old place: decides flat and straight places, where the form says nothing.
/// A hundred times less lets points of nearly flat patches wander to the guard, a hundred times more costs 2 % of the error.
const PULL: f64 = 1e-4;

/// `level` with its points placed. `forms`: `[point_count]`, each about its point's place; `None` where the point must stay.
/// `turn_cosine`: of the most that a face may turn.
///
/// Bunny to 10 %, mean and greatest distance in 1e-5 of the diagonal: 28.5 and 277 without it, 20.4 and 278 with borders left
/// where they are, 20.4 and 201 with borders.
pub(super) fn place(level: &Mesh, forms: &[Option<Quadric>], turn_cosine: f64) -> Mesh {
    let topology = Topology::new(level);
    let mut raw = level.clone().into_raw();
    let mut wedges = Vec::new();
    for (p, form) in forms.iter().enumerate() {
        let free = matches!(topology.kinds[p], PointKind::Manifold | PointKind::Border);
        let Some(form) = form.filter(|_| free) else { continue };
        let star = topology.star(PointId(p as u32));
        let Some(moved) = target(&raw, star, &form, turn_cosine) else { continue };
        wedges.clear();
        for corner in star {
            let (f, k) = (*corner as usize / 3, *corner as usize % 3);
            let wedge = raw.triangles[f][k];
            if !wedges.iter().any(|w: &Wedge| w.vertex == wedge) {
                wedges.push(Wedge::at(&raw, star, wedge, moved));
            }
        }
        if flips_uvs(&raw, star, &wedges) {
            continue;
        }
        wedges.iter().for_each(|wedge| wedge.write(&mut raw, moved.as_vec3()));
    }
    Mesh::new(raw).expect("invariant: the same indices, finite attributes")
}

fn position(raw: &RawMesh, vertex: u32) -> DVec3 {
    raw.positions[vertex as usize].as_dvec3()
}

/// The place where the form is least, if the point may go there.
fn target(raw: &RawMesh, star: &[u32], form: &Quadric, turn_cosine: f64) -> Option<DVec3> {
    let first = *star.first()?;
    let old = position(raw, raw.triangles[first as usize / 3][first as usize % 3]);
    let step = form.least(PULL * form.weight)?;
    let new = (old + step).as_vec3().as_dvec3();
    let mut reach = 0.0_f64;
    for corner in star {
        let (f, k) = (*corner as usize / 3, *corner as usize % 3);
        let [a, b] = [(k + 1) % 3, (k + 2) % 3].map(|k| position(raw, raw.triangles[f][k]));
        reach = reach.max((a - old).length_squared()).max((b - old).length_squared());
        let side = b - a;
        let (before, after) = (side.cross(old - a), side.cross(new - a));
        if before.dot(after) <= turn_cosine * (before.length_squared() * after.length_squared()).sqrt() {
            return None;
        }
    }
    (new.is_finite() && step.length_squared() <= reach).then_some(new)
}

/// A wedge with its attributes at the new place.
struct Wedge {
    vertex: u32,
    normal: Option<Vec3>,
    tangent: Option<Vec4>,
    uvs: [Option<Vec2>; 3],
    color: Option<Vec4>,
}

impl Wedge {
    /// The attributes of `vertex` at `place`, out of the nearest of its own faces; lower faces win ties.
    fn at(raw: &RawMesh, star: &[u32], vertex: u32, place: DVec3) -> Wedge {
        let mut best: Option<(f64, [u32; 3], [f64; 3])> = None;
        for corner in star {
            let triangle = raw.triangles[*corner as usize / 3];
            if triangle[*corner as usize % 3] != vertex {
                continue;
            }
            let [a, b, c] = triangle.map(|v| position(raw, v));
            let nearest = closest_point(place, a, b, c);
            if best.is_none_or(|best| nearest.distance_squared < best.0) {
                best = Some((nearest.distance_squared, triangle, nearest.bary));
            }
        }
        let (triangle, bary) = best.map_or(([vertex; 3], [1.0, 0.0, 0.0]), |(_, triangle, bary)| (triangle, bary));
        let weight = bary.map(|b| b as f32);
        let mix2 = |values: &Option<Vec<Vec2>>| {
            let values = values.as_ref()?;
            Some((0..3).map(|k| values[triangle[k] as usize] * weight[k]).sum::<Vec2>())
        };
        let mix4 = |values: &Option<Vec<Vec4>>| {
            let values = values.as_ref()?;
            Some((0..3).map(|k| values[triangle[k] as usize] * weight[k]).sum::<Vec4>())
        };
        let normal = raw.normals.as_ref().map(|normals| {
            let mixed: Vec3 = (0..3).map(|k| normals[triangle[k] as usize] * weight[k]).sum();
            mixed.normalize_or(normals[vertex as usize])
        });
        let tangent = raw.tangents.as_ref().map(|tangents| {
            let own = tangents[vertex as usize];
            // Frames of the other hand belong to mirrored charts and say nothing here.
            let same = |k: &usize| tangents[triangle[*k] as usize].w == own.w;
            let mixed: Vec3 = (0..3).filter(same).map(|k| tangents[triangle[k] as usize].truncate() * weight[k]).sum();
            mixed.normalize_or(own.truncate()).extend(own.w)
        });
        let uvs = [mix2(&raw.uv0), mix2(&raw.uv1), mix2(&raw.atlas_uv)];
        Wedge { vertex, normal, tangent, uvs, color: mix4(&raw.colors) }
    }

    fn write(&self, raw: &mut RawMesh, place: Vec3) {
        fn set<T: Copy>(values: &mut Option<Vec<T>>, vertex: u32, value: Option<T>) {
            if let (Some(values), Some(value)) = (values, value) {
                values[vertex as usize] = value;
            }
        }
        raw.positions[self.vertex as usize] = place;
        set(&mut raw.normals, self.vertex, self.normal);
        set(&mut raw.tangents, self.vertex, self.tangent);
        set(&mut raw.uv0, self.vertex, self.uvs[0]);
        set(&mut raw.uv1, self.vertex, self.uvs[1]);
        set(&mut raw.atlas_uv, self.vertex, self.uvs[2]);
        set(&mut raw.colors, self.vertex, self.color);
    }
}

/// Whether a face would change its orientation in the plane of any UV set.
fn flips_uvs(raw: &RawMesh, star: &[u32], wedges: &[Wedge]) -> bool {
    [&raw.uv0, &raw.uv1, &raw.atlas_uv].iter().enumerate().any(|(set, values)| {
        let Some(values) = values else { return false };
        star.iter().any(|corner| {
            let (triangle, k) = (raw.triangles[*corner as usize / 3], *corner as usize % 3);
            let [p, a, b] = [k, (k + 1) % 3, (k + 2) % 3].map(|k| values[triangle[k] as usize].as_dvec2());
            let new = wedges.iter().find(|w| w.vertex == triangle[k]).and_then(|w| w.uvs[set]);
            let Some(new) = new.map(|uv| uv.as_dvec2()) else { return false };
            let (before, after) = ((b - a).perp_dot(p - a), (b - a).perp_dot(new - a));
            before * after < 0.0 || (before != 0.0 && after == 0.0)
        })
    })
}
