//! From a face and barycentric coordinates to a colour.

use glam::{Vec2, Vec3, Vec4};
use kiln_asset::{AlphaMode, MapRole, Material, Raster, Sampler};
use kiln_geom::colour::{linear_to_srgb_f32, srgb_to_linear};
use kiln_geom::math;

use super::apply_maps::{self, Lights, bend, bitangent, decode_normal};
use super::{Frame, Mip, Mode, RenderOptions, codes, is_front, mix};
use crate::scene::{Scene, Shading};
use crate::texture::MipChain;

/// Linear grey of faces without a material in [`Mode::Shaded`] and [`Mode::Material`], where they are matt; in all others they are
/// white, as glTF's default material.
const CLAY: f32 = 0.42;

/// A material with its pictures filtered.
struct Look<'a> {
    material: Option<&'a Material>,
    base_color: Option<Map<'a>>,
    metallic_roughness: Option<Map<'a>>,
    normal: Option<Map<'a>>,
    occlusion: Option<Map<'a>>,
    emissive: Option<Map<'a>>,
    double_sided: bool,
}

struct Map<'a> {
    chain: MipChain<'a>,
    sampler: Sampler,
    uv: &'a [Vec2],
}

/// All that shading needs beside the frame.
pub(super) struct Surface<'a> {
    scene: Scene<'a>,
    mode: Mode,
    background: [u8; 3],
    normal_map: bool,
    mip: Mip,
    shading: Option<Shading>,
    /// `[submesh_count]`
    looks: Vec<Look<'a>>,
}

impl<'a> Surface<'a> {
    pub(super) fn new(scene: &Scene<'a>, options: &RenderOptions) -> Surface<'a> {
        let RenderOptions { mode, background, normal_map, mip, .. } = *options;
        let has_normals = !matches!(mode, Mode::Flat | Mode::Silhouette);
        let map = |material: Option<&Material>, role: MapRole, wanted: bool| {
            let reference = material.filter(|_| wanted)?.map(role)?;
            let (picture, uv) = (scene.picture(reference)?, scene.uv(reference.uv_set)?);
            let chain = match mip {
                Mip::PerFace => MipChain::whole(picture),
                Mip::Fixed(level) => {
                    // The level is that of base colour: a map of another size has texels as fine at another level.
                    let base = material.and_then(|m| m.base_color).and_then(|base| scene.picture(base));
                    let side = |picture: &Raster| picture.width.max(picture.height) as f32;
                    let shift = match base {
                        Some(base) if mode == Mode::Material => math::log2(side(picture) / side(base)).round(),
                        _ => 0.0,
                    };
                    MipChain::only(picture, (level as f32 + shift).max(0.0) as u32)
                }
            };
            Some(Map { chain, sampler: scene.materials.textures[reference.texture.index()].sampler, uv })
        };
        let look = |submesh: usize| {
            let material = scene.material(kiln_asset::SubmeshId(submesh as u32));
            let masked = material.is_some_and(|m| m.alpha_mode == AlphaMode::Mask);
            let whole = mode == Mode::Material;
            Look {
                material,
                base_color: map(
                    material,
                    MapRole::BaseColor,
                    masked || whole || matches!(mode, Mode::Flat | Mode::Lit | Mode::Shaded),
                ),
                metallic_roughness: map(material, MapRole::MetallicRoughness, whole),
                normal: map(material, MapRole::Normal, normal_map && has_normals),
                occlusion: map(material, MapRole::Occlusion, whole),
                emissive: map(material, MapRole::Emissive, whole || mode == Mode::Shaded),
                double_sided: material.is_some_and(|m| m.double_sided),
            }
        };
        Surface {
            scene: *scene,
            mode,
            background: if mode == Mode::Silhouette { [0; 3] } else { background },
            normal_map,
            mip,
            shading: has_normals.then(|| Shading::new(scene.mesh)),
            looks: (0..scene.mesh.submeshes.len()).map(look).collect(),
        }
    }

    fn look(&self, face: u32) -> &Look<'a> {
        &self.looks[self.scene.mesh.face_submesh[face as usize].index()]
    }

    pub(super) fn is_double_sided(&self, face: u32) -> bool {
        self.look(face).double_sided
    }

    pub(super) fn is_masked(&self, face: u32) -> bool {
        self.look(face).material.is_some_and(|m| m.alpha_mode == AlphaMode::Mask)
    }

    /// Whether a masked material keeps the sample.
    pub(super) fn is_opaque_at(&self, frame: &Frame<'_>, face: u32, bary: [f32; 3]) -> bool {
        let Some(material) = self.look(face).material else { return true };
        self.base(frame, face, bary, texel_codes).w / 255.0 >= material.alpha_cutoff
    }

    /// The background in the space in which samples are averaged.
    pub(super) fn background(&self) -> Vec3 {
        match self.mode {
            Mode::Shaded | Mode::Material => Vec3::from(self.background.map(srgb_to_linear)),
            _ => codes(self.background),
        }
    }

    /// A pixel's code from the mean of its samples.
    pub(super) fn encode(&self, mean: Vec3) -> Vec3 {
        let code = match self.mode {
            Mode::Shaded | Mode::Material => {
                Vec3::from(mean.clamp(Vec3::ZERO, Vec3::ONE).to_array().map(linear_to_srgb_f32)) * 255.0
            }
            _ => mean,
        };
        code.clamp(Vec3::ZERO, Vec3::splat(255.0))
    }

    /// The colour of a sample, in the space in which samples are averaged.
    pub(super) fn colour(&self, frame: &Frame<'_>, face: u32, bary: [f32; 3]) -> Vec3 {
        match self.mode {
            Mode::Silhouette => Vec3::splat(255.0),
            Mode::Flat => self.base(frame, face, bary, texel_codes).truncate(),
            Mode::Normals => (self.normal(frame, face, bary) + 1.0) * 127.5,
            Mode::Lit => {
                let eye = frame.camera.towards_eye(self.place(face, bary)).as_vec3();
                let light = 0.15 + 0.85 * self.normal(frame, face, bary).dot(eye).abs();
                self.base(frame, face, bary, texel_codes).truncate() * light
            }
            Mode::Shaded => self.shaded(frame, face, bary),
            Mode::Material => self.lit_material(frame, face, bary),
        }
    }

    fn place(&self, face: u32, bary: [f32; 3]) -> glam::DVec3 {
        let mesh = self.scene.mesh;
        mix(bary, mesh.triangles[face as usize].map(|v| mesh.positions[v as usize]))
    }

    /// Lights fixed to the camera: key from the upper left, fill from the right, sky from above.
    fn shaded(&self, frame: &Frame<'_>, face: u32, bary: [f32; 3]) -> Vec3 {
        let camera = frame.camera;
        let in_view =
            |x: f64, y: f64, z: f64| (x * camera.right + y * camera.up + z * camera.back).normalize().as_vec3();
        let (key, fill, above) = (in_view(-0.5, 0.7, 0.6), in_view(0.8, 0.1, 0.5), in_view(0.0, 1.0, 0.0));
        let eye = camera.towards_eye(self.place(face, bary)).as_vec3();
        let mut n = self.normal(frame, face, bary);
        if frame.corners(face).is_some_and(|corners| !is_front(&corners)) {
            n = -n;
        }
        let look = self.look(face);
        let base = match look.material {
            Some(_) => self.base(frame, face, bary, texel_light).truncate(),
            None => Vec3::splat(CLAY) * self.base(frame, face, bary, texel_light).truncate(),
        };
        let diffuse =
            0.85 * n.dot(key).max(0.0) + 0.25 * n.dot(fill).max(0.0) + 0.12 + 0.10 * (0.5 + 0.5 * n.dot(above));
        let highlight = |light: Vec3| math::pow(n.dot((light + eye).normalize_or_zero()).max(0.0), 40.0);
        let specular = 0.18 * highlight(key) + 0.05 * highlight(fill);
        base * diffuse + specular + self.emissive(frame, face, bary)
    }

    /// Light sent out by itself, linear.
    fn emissive(&self, frame: &Frame<'_>, face: u32, bary: [f32; 3]) -> Vec3 {
        let look = self.look(face);
        let Some(material) = look.material else { return Vec3::ZERO };
        let factor = Vec3::from(material.emissive_factor);
        match &look.emissive {
            Some(map) => factor * self.read(map, frame, face, bary, texel_light).truncate(),
            None => factor,
        }
    }

    /// All maps under the object's own lights, each sample no lighter than a screen.
    fn lit_material(&self, frame: &Frame<'_>, face: u32, bary: [f32; 3]) -> Vec3 {
        let look = self.look(face);
        let base = self.base(frame, face, bary, texel_light).truncate();
        let read = |map: &Option<Map<'_>>| match map {
            Some(map) => self.read(map, frame, face, bary, texel_codes).truncate() / 255.0,
            None => Vec3::ONE,
        };
        let surface = match look.material {
            Some(material) => {
                let rough_metal = read(&look.metallic_roughness);
                apply_maps::Surface {
                    base,
                    metallic: material.metallic_factor * rough_metal.z,
                    roughness: material.roughness_factor * rough_metal.y,
                    open: 1.0 + material.occlusion_strength * (read(&look.occlusion).x - 1.0),
                    emissive: self.emissive(frame, face, bary),
                }
            }
            None => {
                let base = CLAY * base;
                apply_maps::Surface { base, metallic: 0.0, roughness: 1.0, open: 1.0, emissive: Vec3::ZERO }
            }
        };
        let mut normal = self.normal(frame, face, bary);
        if frame.corners(face).is_some_and(|corners| !is_front(&corners)) {
            normal = -normal;
        }
        let eye = frame.camera.towards_eye(self.place(face, bary)).as_vec3();
        apply_maps::shade(&surface, normal, eye, &Lights::OBJECT).clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Base colour: map times factor times vertex colour, `decode` deciding the space of all three.
    fn base(&self, frame: &Frame<'_>, face: u32, bary: [f32; 3], decode: fn([u8; 4]) -> Vec4) -> Vec4 {
        let look = self.look(face);
        let texel = match &look.base_color {
            Some(map) => self.read(map, frame, face, bary, decode),
            None => decode([255; 4]),
        };
        let factor = look.material.map_or(Vec4::ONE, |m| Vec4::from(m.base_color_factor));
        let colour = match &self.scene.mesh.colors {
            Some(colors) => {
                let [a, b, c] = self.scene.mesh.triangles[face as usize].map(|v| colors[v as usize]);
                bary[0] * a + bary[1] * b + bary[2] * c
            }
            None => Vec4::ONE,
        };
        texel * factor * colour
    }

    fn read(&self, map: &Map<'_>, frame: &Frame<'_>, face: u32, bary: [f32; 3], decode: fn([u8; 4]) -> Vec4) -> Vec4 {
        let [a, b, c] = self.scene.mesh.triangles[face as usize].map(|v| map.uv[v as usize]);
        let uv = bary[0] * a + bary[1] * b + bary[2] * c;
        let lod = match (self.mip, frame.corners(face)) {
            (Mip::PerFace, Some([p, q, r])) => {
                let texels = ((b - a).perp_dot(c - a) * map.chain.texel_count()).abs();
                let samples = ((q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x)).abs() as f32;
                0.5 * math::log2((texels / samples.max(1e-12)).max(1e-12))
            }
            _ => 0.0,
        };
        map.chain.sample(&map.sampler, uv, lod, decode)
    }

    /// The unit normal in object space on the face's front side, bent by the normal map if that is asked for.
    fn normal(&self, frame: &Frame<'_>, face: u32, bary: [f32; 3]) -> Vec3 {
        let mesh = self.scene.mesh;
        let triangle = mesh.triangles[face as usize];
        let [p, q, r] = triangle.map(|v| mesh.positions[v as usize]);
        let flat = || (q.as_dvec3() - p.as_dvec3()).cross(r.as_dvec3() - p.as_dvec3()).normalize_or_zero().as_vec3();
        let Some(shading) = &self.shading else { return flat() };
        let normal = mix(bary, triangle.map(|v| shading.normals[v as usize])).as_vec3();
        let bent = match &self.look(face).normal {
            Some(map) if self.normal_map => {
                let scale = self.look(face).material.map_or(1.0, |m| m.normal_scale);
                let texel = self.read(map, frame, face, bary, texel_codes).truncate() / 255.0;
                let (tangent, bitangent) = self.tangents(shading, face, bary, normal, map.uv);
                bend(decode_normal(texel, scale, false), normal, tangent, bitangent)
            }
            _ => normal,
        };
        bent.try_normalize().unwrap_or_else(flat)
    }

    /// Tangent and bitangent, the latter upwards in the picture (against v). As MikkTSpace wants it, the interpolated vectors
    /// are not brought to unit length: bitangent = w cross(n, t).
    fn tangents(&self, shading: &Shading, face: u32, bary: [f32; 3], normal: Vec3, uv: &[Vec2]) -> (Vec3, Vec3) {
        let mesh = self.scene.mesh;
        let triangle = mesh.triangles[face as usize];
        if let Some(tangents) = &shading.tangents
            && shading.has_tangents[mesh.face_submesh[face as usize].index()]
        {
            let own = triangle.map(|v| tangents[v as usize]);
            let tangent = mix(bary, own.map(Vec4::truncate)).as_vec3();
            let w = bary[0] * own[0].w + bary[1] * own[1].w + bary[2] * own[2].w;
            return (tangent, bitangent(normal, tangent, w));
        }
        // No tangents: directions of constant v and u on the face, made perpendicular to the normal.
        let [p, q, r] = triangle.map(|v| mesh.positions[v as usize]);
        let [a, b, c] = triangle.map(|v| uv[v as usize]);
        let (d1, d2) = (b - a, c - a);
        let sign = if d1.perp_dot(d2) < 0.0 { -1.0 } else { 1.0 };
        let along_u = ((q - p) * d2.y - (r - p) * d1.y) * sign;
        let n = normal.normalize_or_zero();
        let tangent = (along_u - n * n.dot(along_u)).normalize_or_zero();
        // With v down, an unmirrored layout is one where u, -v and n are right-handed: negative area in (u, v).
        (tangent, -sign * n.cross(tangent))
    }
}

/// A texel as codes, alpha too.
#[inline]
fn texel_codes([r, g, b, a]: [u8; 4]) -> Vec4 {
    Vec4::new(f32::from(r), f32::from(g), f32::from(b), f32::from(a))
}

/// An sRGB texel as linear light, alpha in `[0, 1]`.
fn texel_light([r, g, b, a]: [u8; 4]) -> Vec4 {
    Vec4::new(srgb_to_linear(r), srgb_to_linear(g), srgb_to_linear(b), a as f32 / 255.0)
}
