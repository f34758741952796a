//! Which foreign code stands under each stage, by name and locked version: a part of every fingerprint.

macro_rules! version {
    ($name:literal, $variable:literal) => {
        concat!($name, "@", env!(concat!("KILN_VERSION_", $variable)))
    };
}

/// KTX2 of Basis Universal.
pub(crate) const BASISU: &str = version!("basisu", "BASISU");
/// BC7.
pub(crate) const BC7F: &str = version!("ctt-bc7f", "CTT_BC7F");
/// Draco.
pub(crate) const DRACO: &str = version!("draco-core", "DRACO_CORE");
/// OpenEXR.
pub(crate) const EXR: &str = version!("exr", "EXR");
/// Vectors.
pub(crate) const GLAM: &str = version!("glam", "GLAM");
/// PNG, JPEG, WebP, TIFF and TGA.
pub(crate) const IMAGE: &str = version!("image", "IMAGE");
/// Transcendental functions.
pub(crate) const LIBM: &str = version!("libm", "LIBM");
/// Decoders of compressed buffer views.
pub(crate) const MESHOPT: &str = version!("meshopt", "MESHOPT");
/// The BVH's builder.
pub(crate) const OBVHS: &str = version!("obvhs", "OBVHS");
/// JSON.
pub(crate) const SERDE_JSON: &str = version!("serde_json", "SERDE_JSON");
/// The built-in unwrapper.
pub(crate) const UVUNWRAP: &str = version!("uvunwrap", "UVUNWRAP");
/// Tangents.
pub(crate) const MIKKTSPACE: &str = version!("bevy_mikktspace", "BEVY_MIKKTSPACE");
/// The other unwrapper.
pub(crate) const XATLAS: &str = version!("xatlas-rs-v2", "XATLAS_RS_V2");
/// The GPU.
pub(crate) const WGPU: &str = version!("wgpu", "WGPU");
/// Compressed sections.
pub(crate) const ZSTD: &str = version!("zstd-sys", "ZSTD_SYS");

/// The system's picture library, where this build has it.
pub(crate) fn oiio() -> Option<String> {
    kiln_oiio::version().map(|version| format!("openimageio@{version}"))
}

/// Where the results of stages written in Rust alone are bit-identical: IEEE 754 arithmetic without contraction, scalar
/// vectors, `libm`'s functions, little-endian; checked on x86-64, expected on every 64-bit little-endian target.
pub(crate) const NUMERIC_CLASS: &str = "rust-ieee754-le";

/// The classes and crates that a container's provenance names.
pub(crate) fn all() -> [&'static str; 15] {
    [BASISU, MIKKTSPACE, BC7F, DRACO, EXR, GLAM, IMAGE, LIBM, MESHOPT, OBVHS, SERDE_JSON, UVUNWRAP, WGPU, XATLAS, ZSTD]
}

/// Where the results of C++ are bit-identical: its compiler may use the target's maths and instructions.
pub(crate) fn cxx_class() -> String {
    let libc = if cfg!(target_env = "musl") { "musl" } else { "system libc" };
    format!("c++ {} {} {libc}, no contraction", std::env::consts::ARCH, std::env::consts::OS)
}
