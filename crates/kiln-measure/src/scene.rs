//! What is drawn: a mesh, its materials, its decoded pictures.

use glam::{Vec2, Vec3, Vec4};
use kiln_asset::{Material, MaterialSet, Mesh, Raster, SubmeshId, TextureRef};

use crate::camera::Sphere;

/// A mesh to look at, borrowed.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// The triangles.
    pub mesh: &'a Mesh,
    /// What its submeshes refer to.
    pub materials: &'a MaterialSet,
    /// `[materials.images.len()]`, decoded. A texture whose picture is missing here counts as absent.
    pub images: &'a [Raster],
}

impl<'a> Scene<'a> {
    /// The material of a submesh; `None` also where the reference leads nowhere.
    pub fn material(&self, submesh: SubmeshId) -> Option<&'a Material> {
        let material = self.mesh.submeshes.get(submesh.index())?.material?;
        self.materials.materials.get(material.index())
    }

    /// The picture behind a texture reference.
    pub fn picture(&self, reference: TextureRef) -> Option<&'a Raster> {
        let texture = self.materials.textures.get(reference.texture.index())?;
        self.images.get(texture.image.index()).filter(|picture| !picture.texels.is_empty())
    }

    /// A UV set by number; `None` if the mesh lacks it.
    pub(crate) fn uv(&self, set: u32) -> Option<&'a [Vec2]> {
        match set {
            0 => self.mesh.uv0.as_deref(),
            1 => self.mesh.uv1.as_deref(),
            _ => None,
        }
    }

    /// The one mip level that fits a picture of `pixels` a side that frames `sphere`: [`Scene::texel_density`] rounded down, 0
    /// without textures. Reference and others are then filtered alike.
    pub fn mean_mip(&self, sphere: Sphere, pixels: u32) -> u32 {
        self.texel_density(sphere, pixels).map_or(0, |density| density.floor().max(0.0) as u32)
    }

    /// log2 of the base colour's texels a pixel along a line, in a picture of `pixels` a side that frames `sphere`: area-weighted
    /// over the textured triangles; `None` if none has an area.
    pub fn texel_density(&self, sphere: Sphere, pixels: u32) -> Option<f64> {
        let scale = pixels as f64 / 2.0 / sphere.radius.max(f64::MIN_POSITIVE);
        let (mut texels, mut surface) = (0.0, 0.0);
        for (face, triangle) in self.mesh.triangles.iter().enumerate() {
            let reference = self.material(self.mesh.face_submesh[face]).and_then(|m| m.base_color);
            let Some(reference) = reference else { continue };
            let (Some(picture), Some(uv)) = (self.picture(reference), self.uv(reference.uv_set)) else { continue };
            let size = Vec2::new(picture.width as f32, picture.height as f32);
            let [a, b, c] = triangle.map(|v| (uv[v as usize] * size).as_dvec2());
            texels += 0.5 * (b - a).perp_dot(c - a).abs();
            surface += kiln_geom::triangle::area(triangle.map(|v| self.mesh.positions[v as usize])) * scale * scale;
        }
        (surface > 0.0).then(|| 0.5 * kiln_geom::math::log264((texels / surface).max(1e-9)))
    }
}

/// `[vertex_count]`: the mesh's normals; area-weighted ones, joined over equal positions, where its source had none.
pub fn shading_normals(mesh: &Mesh) -> Vec<Vec3> {
    Shading::new(mesh).normals
}

/// The mesh's shading vectors with gaps filled.
pub(crate) struct Shading {
    /// `[vertex_count]`: the mesh's normals, or area-weighted ones where the source had none.
    pub(crate) normals: Vec<Vec3>,
    /// `[vertex_count]`; `None` where they must be taken from the UVs.
    pub(crate) tangents: Option<Vec<Vec4>>,
    /// `[submesh_count]`: whether `tangents` are its own.
    pub(crate) has_tangents: Vec<bool>,
}

impl Shading {
    pub(crate) fn new(mesh: &Mesh) -> Shading {
        // A mesh made without import may leave all flags unset; then what is there counts.
        let real = |flag: fn(&kiln_asset::AttributeSet) -> bool| -> Vec<bool> {
            let none = !mesh.submeshes.iter().any(|s| flag(&s.attributes));
            mesh.submeshes.iter().map(|s| none || flag(&s.attributes)).collect()
        };
        let has_normals = real(|a| a.normals);
        let mut normals = mesh.normals.clone().unwrap_or_default();
        if normals.is_empty() || has_normals.contains(&false) {
            let smooth = smooth_normals(mesh);
            if normals.is_empty() {
                normals = smooth;
            } else {
                for (triangle, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
                    if !has_normals[submesh.index()] {
                        triangle.iter().for_each(|v| normals[*v as usize] = smooth[*v as usize]);
                    }
                }
            }
        }
        Shading { normals, tangents: mesh.tangents.clone(), has_tangents: real(|a| a.tangents) }
    }
}

/// `[vertex_count]`: the sum of the face normals around each position, weighted by area; unit length, or 0 where they cancel.
fn smooth_normals(mesh: &Mesh) -> Vec<Vec3> {
    // Vertices at one position, of whatever submesh, share a normal: runs of equal keys in sorted order.
    let key = |v: &u32| mesh.positions[*v as usize].to_array().map(|c| (c + 0.0).to_bits());
    let mut order: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    order.sort_unstable_by_key(|v| (key(v), *v));
    let mut place = vec![0usize; order.len()];
    let mut count = 0;
    for (i, v) in order.iter().enumerate() {
        if i > 0 && key(v) != key(&order[i - 1]) {
            count += 1;
        }
        place[*v as usize] = count;
    }
    let mut sums = vec![glam::DVec3::ZERO; count + 1];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        let normal = (b - a).cross(c - a);
        triangle.iter().for_each(|v| sums[place[*v as usize]] += normal);
    }
    place.iter().map(|p| sums[*p].normalize_or_zero().as_vec3()).collect()
}
