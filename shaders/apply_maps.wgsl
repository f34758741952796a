// The maps of a container on its triangles, as an engine draws them. Twin: crates/kiln-measure/src/render/apply_maps.rs
//
// One vertex invocation moves one vertex to clip space and hands on its vectors as they are.
// One fragment invocation reads the five maps of a metallic-roughness material, bends the normal, and gives the light that
// leaves the surface towards the eye under one directional light and a sky: linear, to be written to an sRGB or a float target.
// The functions below the entry points take and return plain values: paste those into an engine's own shader.
//
// Reads:  `frame`     camera and light (object space: what is lit is the object, wherever it stands)
//         `material`  factors and flags
//         `maps`      sampler of all maps; linear, with mips, as the material says
//         `base_color`, `emissive`        sRGB textures (the sampler gives linear light)
//         `metallic_roughness`, `normal`, `occlusion`   linear textures
//         Absent maps: a white texel of 1 x 1; for `normal` leave HAS_NORMAL_MAP out of the flags.
// Vertex: positions, normals, tangents (w: 1 or -1), uv: the container's arrays as they lie there
// Writes: colour 0    linear light, alpha
//
// Normals are those of MikkTSpace (M. Mikkelsen 2008, as bakers and glTF have them): normal and tangent are
// interpolated and NOT brought to unit length, bitangent = w cross(normal, tangent), and only the sum is normalised. +Y is up
// in the picture (green). What was baked against these vectors comes out exactly, and another rule shows seams.
//
// BRDF: glTF 2.0, appendix B.3: GGX (Walter et al. 2007), height-correlated Smith (Heitz 2014), Schlick's Fresnel (1994),
// Lambert. Light is given as what a white matt surface that faces it sends back.

const TWO_CHANNELS: u32 = 1u;     // the normal map has x and y alone (BC5, RG8): z is computed
const HAS_NORMAL_MAP: u32 = 2u;
const MASKED: u32 = 4u;           // texels whose alpha is below the cutoff are holes

struct Frame {
    clip_from_object: mat4x4<f32>,
    eye: vec4<f32>,               // w 1: place of the eye; w 0: unit vector towards an eye infinitely far away
    towards_light: vec4<f32>,     // unit vector
    light: vec4<f32>,             // rgb
    sky: vec4<f32>,               // rgb of what comes from above (+Y)
    ground: vec4<f32>,            // rgb of what comes from below
}

struct Material {
    base_color: vec4<f32>,        // linear
    emissive: vec4<f32>,          // linear rgb
    metallic: f32,
    roughness: f32,
    normal_scale: f32,
    occlusion_strength: f32,
    alpha_cutoff: f32,
    flags: u32,
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> material: Material;
@group(0) @binding(2) var maps: sampler;
@group(0) @binding(3) var base_color: texture_2d<f32>;
@group(0) @binding(4) var metallic_roughness: texture_2d<f32>;
@group(0) @binding(5) var normal_map: texture_2d<f32>;
@group(0) @binding(6) var occlusion: texture_2d<f32>;
@group(0) @binding(7) var emissive: texture_2d<f32>;

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) place: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) tangent: vec4<f32>,
    @location(3) uv: vec2<f32>,
}

@vertex
fn vertex(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) tangent: vec4<f32>,
    @location(3) uv: vec2<f32>,
) -> Corner {
    return Corner(frame.clip_from_object * vec4<f32>(position, 1.0), position, normal, tangent, uv);
}

@fragment
fn fragment(corner: Corner, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    // All reads come first: derivatives want every fragment of a quad.
    let base = textureSample(base_color, maps, corner.uv) * material.base_color;
    let rough_metal = textureSample(metallic_roughness, maps, corner.uv);
    let texel = textureSample(normal_map, maps, corner.uv).xyz;
    let open = textureSample(occlusion, maps, corner.uv).r;
    let glow = textureSample(emissive, maps, corner.uv).rgb * material.emissive.rgb;
    if (material.flags & MASKED) != 0u && base.a < material.alpha_cutoff {
        discard;
    }
    var normal = corner.normal;
    if (material.flags & HAS_NORMAL_MAP) != 0u {
        let bent = decode_normal(texel, material.normal_scale, (material.flags & TWO_CHANNELS) != 0u);
        normal = bend(bent, corner.normal, corner.tangent.xyz, corner.tangent.w);
    }
    normal = normalize(normal);
    if !is_front {
        normal = -normal;
    }
    var to_eye = frame.eye.xyz;
    if frame.eye.w != 0.0 {
        to_eye = normalize(frame.eye.xyz - corner.place);
    }
    let surface = Surface(
        base.rgb,
        material.metallic * rough_metal.b,
        material.roughness * rough_metal.g,
        1.0 + material.occlusion_strength * (open - 1.0),
        glow,
    );
    let lights = Lights(frame.towards_light.xyz, frame.light.rgb, frame.sky.rgb, frame.ground.rgb);
    return vec4<f32>(shade(surface, normal, to_eye, lights), base.a);
}

// What a material is at one place, factors and maps multiplied.
struct Surface {
    base: vec3<f32>,              // linear
    metallic: f32,
    roughness: f32,               // perceptual
    open: f32,                    // 1: nothing hides the sky
    emissive: vec3<f32>,          // linear
}

struct Lights {
    towards: vec3<f32>,
    light: vec3<f32>,
    sky: vec3<f32>,
    ground: vec3<f32>,
}

// The vector of a normal map's texel (`[0, 1]`), x and y scaled; not of unit length.
fn decode_normal(texel: vec3<f32>, scale: f32, two_channels: bool) -> vec3<f32> {
    var n = 2.0 * texel - 1.0;
    if two_channels {
        n.z = sqrt(max(0.0, 1.0 - dot(n.xy, n.xy)));
    }
    return n * vec3<f32>(scale, scale, 1.0);
}

// From tangent space to the space of `normal` and `tangent`, both interpolated as they are; not of unit length.
fn bend(n: vec3<f32>, normal: vec3<f32>, tangent: vec3<f32>, w: f32) -> vec3<f32> {
    let bitangent = select(-1.0, 1.0, w >= 0.0) * cross(normal, tangent);
    return n.x * tangent + n.y * bitangent + n.z * normal;
}

// Light that leaves the surface towards the eye; `normal` and `to_eye` are unit vectors.
fn shade(s: Surface, normal: vec3<f32>, to_eye: vec3<f32>, lights: Lights) -> vec3<f32> {
    let diffuse = s.base * (1.0 - s.metallic);
    let f0 = mix(vec3<f32>(0.04), s.base, s.metallic);
    let from_light = brdf(diffuse, f0, s.roughness, normal, to_eye, lights.towards) * lights.light;
    let around = mix(lights.ground, lights.sky, 0.5 + 0.5 * normal.y);
    return from_light + (diffuse + f0) * around * s.open + s.emissive;
}

// pi times BRDF times cosine: 1 for a white matt surface that faces the light.
fn brdf(diffuse: vec3<f32>, f0: vec3<f32>, roughness: f32, n: vec3<f32>, v: vec3<f32>, l: vec3<f32>) -> vec3<f32> {
    let n_l = dot(n, l);
    if n_l <= 0.0 {
        return vec3<f32>(0.0);
    }
    let h = normalize(v + l);
    let n_v = max(dot(n, v), 1e-4);
    let n_h = clamp(dot(n, h), 0.0, 1.0);
    let v_h = clamp(dot(v, h), 0.0, 1.0);
    // Smoother than this is a mirror of a light without size.
    let alpha = max(roughness, 0.045) * max(roughness, 0.045);
    let a2 = alpha * alpha;
    let spread = n_h * n_h * (a2 - 1.0) + 1.0;
    let pi_d = a2 / (spread * spread);
    let visible = 0.5 / (n_l * sqrt(n_v * n_v * (1.0 - a2) + a2) + n_v * sqrt(n_l * n_l * (1.0 - a2) + a2));
    let m = 1.0 - v_h;
    let fresnel = f0 + (1.0 - f0) * (m * m * m * m * m);
    return ((1.0 - fresnel) * diffuse + fresnel * (pi_d * visible)) * n_l;
}
