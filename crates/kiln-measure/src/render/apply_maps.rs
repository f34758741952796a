//! A material's maps as light: twin of `shaders/apply_maps.wgsl`.
//!
//! Function by function the shader's formulas. MikkTSpace: normal and tangent come interpolated, not brought to unit length,
//! bitangent = w cross(normal, tangent); green is up. BRDF: GGX, height-correlated Smith, Schlick's Fresnel, Lambert. Light is
//! given as what a white matt surface that faces it sends back.
//!
//! Sources: glTF 2.0 specification, appendix B.3; B. Walter et al., Microfacet Models for Refraction through Rough Surfaces, EGSR
//! 2007, doi:10.2312/EGWR/EGSR07/195-206 (GGX); E. Heitz, Understanding the Masking-Shadowing Function, JCGT 3(2), 2014,
//! equation 99 (Smith); C. Schlick, CGF 13(3), 1994, doi:10.1111/1467-8659.1330233, equation 15.

use glam::Vec3;

/// Least perceptual roughness: smoother is a mirror of a light without size.
const ROUGHNESS_MIN: f32 = 0.045;

/// One directional light and a sky, fixed to the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lights {
    /// Unit vector towards the light, object space.
    pub towards: Vec3,
    /// Linear RGB of the light.
    pub light: Vec3,
    /// Linear RGB of what comes from above (+Y).
    pub sky: Vec3,
    /// Linear RGB of what comes from below.
    pub ground: Vec3,
}

impl Lights {
    /// The lights of every comparison: from the upper right front of the object (+X, +Y, +Z) at `(0.48, 0.6, 0.64)`, 0.7; a sky
    /// of 0.3, ground of 0.1. A white matt surface has at most 0.97.
    pub const OBJECT: Lights = Lights {
        towards: Vec3::new(0.48, 0.6, 0.64),
        light: Vec3::splat(0.7),
        sky: Vec3::splat(0.3),
        ground: Vec3::splat(0.1),
    };
}

/// What a material is at one place, factors and maps multiplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Linear base colour.
    pub base: Vec3,
    /// 0: dielectric, 1: metal.
    pub metallic: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// 1: nothing hides the sky.
    pub open: f32,
    /// Linear RGB that it sends out by itself.
    pub emissive: Vec3,
}

/// The vector of a normal map's texel (`[0, 1]`), x and y scaled; z computed where the map has `two_channels` (BC5, RG8). Not of
/// unit length.
pub fn decode_normal(texel: Vec3, scale: f32, two_channels: bool) -> Vec3 {
    let mut n = 2.0 * texel - 1.0;
    if two_channels {
        n.z = (1.0 - n.x * n.x - n.y * n.y).max(0.0).sqrt();
    }
    n * Vec3::new(scale, scale, 1.0)
}

/// The bitangent of interpolated vectors: w cross(normal, tangent).
pub fn bitangent(normal: Vec3, tangent: Vec3, w: f32) -> Vec3 {
    w.signum() * normal.cross(tangent)
}

/// From tangent space to the space of `normal`, `tangent` and `bitangent`, all as they are; not of unit length.
pub fn bend(n: Vec3, normal: Vec3, tangent: Vec3, bitangent: Vec3) -> Vec3 {
    n.x * tangent + n.y * bitangent + n.z * normal
}

/// Linear light that leaves the surface towards the eye; `normal` and `to_eye` are unit vectors.
pub fn shade(s: &Surface, normal: Vec3, to_eye: Vec3, lights: &Lights) -> Vec3 {
    let diffuse = s.base * (1.0 - s.metallic);
    let f0 = Vec3::splat(0.04).lerp(s.base, s.metallic);
    let from_light = brdf(diffuse, f0, s.roughness, normal, to_eye, lights.towards) * lights.light;
    let around = lights.ground.lerp(lights.sky, 0.5 + 0.5 * normal.y);
    from_light + (diffuse + f0) * around * s.open + s.emissive
}

/// pi times BRDF times cosine, from unit vectors: normal, towards the eye, towards the light. 1 for a white matt surface that
/// faces the light.
pub fn brdf(diffuse: Vec3, f0: Vec3, roughness: f32, n: Vec3, v: Vec3, l: Vec3) -> Vec3 {
    let n_l = n.dot(l);
    if n_l <= 0.0 {
        return Vec3::ZERO;
    }
    let h = (v + l).normalize_or_zero();
    let n_v = n.dot(v).max(1e-4);
    let n_h = n.dot(h).clamp(0.0, 1.0);
    let v_h = v.dot(h).clamp(0.0, 1.0);
    let alpha = roughness.max(ROUGHNESS_MIN) * roughness.max(ROUGHNESS_MIN);
    let a2 = alpha * alpha;
    let spread = n_h * n_h * (a2 - 1.0) + 1.0;
    let pi_d = a2 / (spread * spread);
    let visible = 0.5 / (n_l * (n_v * n_v * (1.0 - a2) + a2).sqrt() + n_v * (n_l * n_l * (1.0 - a2) + a2).sqrt());
    let m = 1.0 - v_h;
    let fresnel = f0 + (1.0 - f0) * (m * m * m * m * m);
    ((1.0 - fresnel) * diffuse + fresnel * (pi_d * visible)) * n_l
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_geom::sample::{fibonacci_sphere, hash, unit};

    #[test]
    fn a_matt_white_surface_sends_back_what_reaches_it() {
        for degrees in [0.0f32, 30.0, 80.0] {
            let (s, c) = (kiln_geom::math::sin(degrees.to_radians()), kiln_geom::math::cos(degrees.to_radians()));
            let l = Vec3::new(s, c, 0.0);
            assert!((brdf(Vec3::ONE, Vec3::ZERO, 1.0, Vec3::Y, Vec3::Y, l).y - c).abs() < 0.03, "{degrees}");
        }
        assert_eq!(brdf(Vec3::ONE, Vec3::ONE, 0.3, Vec3::Y, Vec3::Y, -Vec3::Y), Vec3::ZERO);
    }

    #[test]
    fn a_mirror_direction_has_the_known_height() {
        // n = v = l = h: pi D V = pi / (pi alpha^2) / 4, Fresnel = f0.
        for roughness in [0.2f32, 0.5, 1.0] {
            let got = brdf(Vec3::ZERO, Vec3::splat(0.5), roughness, Vec3::Z, Vec3::Z, Vec3::Z).x;
            let expected = 0.5 * 0.25 / roughness.powi(4);
            assert!((got - expected).abs() < 1e-4 * expected, "{got} for {expected}");
        }
        assert!(brdf(Vec3::ZERO, Vec3::ONE, 0.0, Vec3::Z, Vec3::Z, Vec3::Z).is_finite());
    }

    #[test]
    fn light_and_eye_can_be_exchanged_and_no_light_is_made() {
        let directions: Vec<Vec3> = fibonacci_sphere(20_000).into_iter().filter(|d| d.z > 0.0).collect();
        for (k, roughness) in [0.3f32, 0.6, 1.0].into_iter().enumerate() {
            for i in 0..20 {
                let pick = |salt: u64| {
                    let at = (unit(hash(i + 100 * k as u64 + salt)) * directions.len() as f64) as usize;
                    directions[at]
                };
                let (v, l) = (pick(0), pick(1 << 40));
                let f0 = Vec3::new(0.04, 0.5, 1.0);
                let there = brdf(Vec3::splat(0.3), f0, roughness, Vec3::Z, v, l) / l.z;
                let back = brdf(Vec3::splat(0.3), f0, roughness, Vec3::Z, l, v) / v.z;
                assert!((there - back).length() < 1e-3 * there.length().max(1.0), "{v} {l}: {there} {back}");
                // Sent back over the hemisphere: at most all (mean of f cos over directions, times 2 pi / pi).
                let all: Vec3 = directions.iter().map(|l| brdf(Vec3::ZERO, Vec3::ONE, roughness, Vec3::Z, v, *l)).sum();
                let share = all.x * 2.0 / directions.len() as f32;
                // Nearly all of a grazing view's light goes to directions between those summed over.
                assert!(v.z < 0.2 || share < 1.02, "{share} at roughness {roughness} from {v}");
            }
        }
    }

    #[test]
    fn two_channels_give_the_third() {
        let n = Vec3::new(0.6, -0.48, 0.64);
        let texel = 0.5 * n + 0.5;
        for two in [false, true] {
            assert!((decode_normal(texel, 1.0, two) - n).length() < 1e-6);
        }
        assert!((decode_normal(texel.with_z(0.0), 1.0, true) - n).length() < 1e-6);
        assert_eq!(decode_normal(Vec3::new(1.0, 1.0, 0.3), 1.0, true).z, 0.0, "longer than 1: flat");
        assert!((decode_normal(texel, 0.5, true) - n * Vec3::new(0.5, 0.5, 1.0)).length() < 1e-6);
    }

    #[test]
    fn the_frame_is_not_normalised_and_its_hand_is_w() {
        let (normal, tangent) = (Vec3::new(0.0, 0.0, 0.8), Vec3::new(0.5, 0.0, 0.0));
        let up = |w| bend(Vec3::Y, normal, tangent, bitangent(normal, tangent, w));
        assert!((up(1.0) - Vec3::new(0.0, 0.4, 0.0)).length() < 1e-7);
        assert_eq!(up(-0.2), -up(1.0));
        assert_eq!(bend(Vec3::Z, normal, tangent, Vec3::ZERO), normal);
    }

    #[test]
    fn metal_has_no_body_colour_and_hidden_places_no_sky() {
        let lights = Lights { light: Vec3::ZERO, ..Lights::OBJECT };
        let red = Surface { base: Vec3::X, metallic: 1.0, roughness: 1.0, open: 1.0, emissive: Vec3::ZERO };
        assert_eq!(shade(&red, Vec3::Y, Vec3::Y, &lights), Vec3::X * 0.3);
        assert_eq!(shade(&red, -Vec3::Y, Vec3::Y, &lights), Vec3::X * 0.1);
        let hidden = Surface { open: 0.0, emissive: Vec3::splat(0.25), ..red };
        assert_eq!(shade(&hidden, Vec3::Y, Vec3::Y, &lights), Vec3::splat(0.25));
        let matt = Surface { base: Vec3::ONE, metallic: 0.0, ..red };
        let most = shade(&matt, Lights::OBJECT.towards, Lights::OBJECT.towards, &Lights::OBJECT);
        assert!(most.x <= 1.0 && most.x > 0.9, "{most}");
        assert!((Lights::OBJECT.towards.length() - 1.0).abs() < 1e-6);
    }
}
