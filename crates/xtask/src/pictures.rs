//! Side by side: the source model, a level of its container without maps, and the same level with its maps.

use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec3;
use kiln_asset::import::{Folder, ImageLimits, ImportLimits, decode_image, import};
use kiln_asset::{MaterialSet, Mesh, Raster};
use kiln_geom::math::{cos, sin};
use kiln_measure::camera::{Camera, bounding_sphere};
use kiln_measure::render::{Mode, RenderOptions, render};
use kiln_measure::scene::Scene;
use kiln_measure::sheet::{Tile, encode_png, sheet};

const HELP: &str = "cargo xtask pictures OUT.png MODEL CONTAINER [--size PIXELS] [--level N] [--view YAW,PITCH]...";

/// Renders the sheet: a row a view (degrees; yaw turns the camera to the right around the model, pitch lifts it).
pub(crate) fn run(args: &[String]) -> Result<(), String> {
    let mut paths = Vec::new();
    let mut views = Vec::new();
    let (mut size, mut level) = (400_u32, 0_usize);
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or_else(|| format!("{arg} needs a value\n{HELP}"));
        match arg.as_str() {
            "--size" => size = value()?.parse().map_err(|_| HELP)?,
            "--level" => level = value()?.parse().map_err(|_| HELP)?,
            "--view" => {
                let (yaw, pitch) = value()?.split_once(',').ok_or(HELP)?;
                views.push((yaw.parse::<f32>().map_err(|_| HELP)?, pitch.parse::<f32>().map_err(|_| HELP)?));
            }
            _ => paths.push(PathBuf::from(arg)),
        }
    }
    let [out, model, container] = paths.as_slice() else { return Err(HELP.into()) };
    if views.is_empty() {
        views = vec![(15.0, 18.0), (150.0, 10.0)];
    }

    let (source, source_materials, source_images) = load_model(model)?;
    let bytes = fs::read(container).map_err(|e| format!("{}: {e}", container.display()))?;
    let (levels, materials, images) = kiln_pack::unpack(&bytes).map_err(|e| format!("{}: {e}", container.display()))?;
    let low = &levels.levels.get(level).ok_or_else(|| format!("there is no level {level}"))?.mesh;
    let bare = MaterialSet::default();
    let sphere = bounding_sphere(&source.positions);
    let options = |normal_map| RenderOptions {
        width: size,
        height: size,
        supersample: 3,
        background: [52, 54, 58],
        mode: Mode::Shaded,
        normal_map,
        ..RenderOptions::default()
    };
    let mut rows = Vec::new();
    for (yaw, pitch) in views {
        let (yaw, pitch) = (yaw.to_radians(), pitch.to_radians());
        let direction = Vec3::new(sin(yaw) * cos(pitch), sin(pitch), cos(yaw) * cos(pitch));
        let camera = Camera::perspective(direction, sphere, 30.0);
        let tile = |mesh: &Mesh, materials: &MaterialSet, images: &[Raster], normal_map, what: &str| {
            let scene = Scene { mesh, materials, images };
            let picture = render(&scene, &camera, &options(normal_map)).to_raster();
            Tile { picture, caption: format!("{what}: {} triangles", mesh.face_count()) }
        };
        rows.push(vec![
            tile(&source, &source_materials, &source_images, true, "source"),
            tile(low, &bare, &[], false, "low, no maps"),
            tile(low, &materials, &images, true, "low, baked maps"),
        ]);
    }
    let png = encode_png(&sheet(&rows)).map_err(|e| e.to_string())?;
    fs::write(out, png).map_err(|e| format!("{}: {e}", out.display()))
}

fn load_model(model: &Path) -> Result<(Mesh, MaterialSet, Vec<Raster>), String> {
    let folder = model.parent().unwrap_or(Path::new(".")).to_path_buf();
    let name = model.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (asset, _) = import(&Folder(folder), &name, &ImportLimits::default()).map_err(|e| e.to_string())?;
    let decode = |(info, bytes): (&kiln_asset::ImageInfo, &std::sync::Arc<[u8]>)| {
        decode_image(info.format, bytes, &ImageLimits::default()).map_err(|e| e.to_string())
    };
    let images = asset.materials.images.iter().zip(&asset.images).map(decode).collect::<Result<Vec<_>, _>>()?;
    let mut mesh = asset.mesh;
    if mesh.normals.is_none() || mesh.submeshes.iter().any(|s| !s.attributes.normals) {
        mesh = kiln_lod::normals::rebuild(&mesh, 30.0);
    }
    if mesh.tangents.is_none() && mesh.uv0.is_some() {
        use kiln_bake::tangents::{UvSource, mikktspace};
        mesh = mikktspace(&mesh, UvSource::Uv0).map_err(|e| e.to_string())?;
    }
    Ok((mesh, asset.materials, images))
}
