//! Models that an optimiser has been at: quantised, compressed and instanced variants hold the same surface and look the same.
//!
//! Needs `KILN_CORPUS`, Node and `npm ci` in `tests/validator`.

use std::path::Path;
use std::process::Command;

use kiln_asset::import::{Folder, ImageLimits, ImportLimits, ImportReport, decode_image, import};
use kiln_asset::{Asset, Raster};
use kiln_measure::camera::{Camera, bounding_sphere};
use kiln_measure::distance::SurfaceReference;
use kiln_measure::image_error::image_error;
use kiln_measure::render::{Picture, RenderOptions, render};
use kiln_measure::scene::Scene;

use crate::space::{Space, corpus, needs, repository};

fn load(path: &Path) -> (Asset, ImportReport) {
    let name = path.file_name().unwrap().to_str().unwrap();
    let folder = Folder(path.parent().unwrap().to_owned());
    import(&folder, name, &ImportLimits::default()).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn pictures(asset: &Asset, cameras: &[Camera]) -> Vec<Picture> {
    let images: Vec<Raster> = (asset.materials.images.iter().zip(&asset.images))
        .map(|(info, bytes)| decode_image(info.format, bytes, &ImageLimits::default()).unwrap())
        .collect();
    let scene = Scene { mesh: &asset.mesh, materials: &asset.materials, images: &images };
    let options = RenderOptions { width: 256, height: 256, two_sided: true, ..RenderOptions::default() };
    cameras.iter().map(|camera| render(&scene, camera, &options)).collect()
}

struct Variant {
    arguments: &'static [&'static str],
    /// Extensions that must be in use, so that the variant tests what it says.
    extensions: &'static [&'static str],
    /// Greatest distance of the surfaces, diagonals. 14 bits of the longest side: half a step in each direction is 5.3e-5.
    distance: f64,
}

const VARIANTS: [Variant; 5] = [
    Variant { arguments: &[], extensions: &["KHR_mesh_quantization"], distance: 6e-5 },
    Variant { arguments: &["-c"], extensions: &["EXT_meshopt_compression", "KHR_mesh_quantization"], distance: 6e-5 },
    Variant {
        arguments: &["-cc", "-ce", "khr", "-vpf", "-vtf"],
        extensions: &["KHR_meshopt_compression"],
        distance: 4e-5,
    },
    // Instances without quantisation: what is left is the matrices of nodes taken apart, 1.5e-7 in the mean.
    Variant { arguments: &["-noq", "-mi"], extensions: &[], distance: 3e-5 },
    Variant { arguments: &["-cf", "-vp", "16"], extensions: &["EXT_meshopt_compression"], distance: 2e-5 },
];

#[test]
fn quantised_and_compressed_variants_are_the_same_surface_and_look_the_same() {
    let program = repository("tests/validator/node_modules/gltfpack/cli.js");
    let Some(program) = needs(program.is_file().then_some(program), "npm ci in tests/validator") else { return };
    let space = Space::new();
    let mut instanced = false;
    for model in ["gltf/Spot.glb", "gltf/Barrel.glb", "gltf/FlightHelmet/FlightHelmet.gltf", "cad/2CylinderEngine.glb"]
    {
        let Some(path) = corpus(model) else { return };
        let (source, _) = load(&path);
        let surface = SurfaceReference::new(&source.mesh, 20_000).unwrap();
        let cameras = Camera::views(4, bounding_sphere(&source.mesh.positions));
        let expected = pictures(&source, &cameras);
        for variant in &VARIANTS {
            let packed = space.path("packed.glb");
            let mut command = Command::new("node");
            command.arg(&program).arg("-i").arg(&path).arg("-o").arg(&packed).args(variant.arguments);
            let said = command.output().unwrap();
            assert!(said.status.success(), "{model} {:?}: {said:?}", variant.arguments);
            let (asset, report) = load(&packed);
            for name in variant.extensions {
                assert!(report.extensions_used.iter().any(|used| used == name), "{model}: {name} is not in use");
            }
            assert!(report.extensions_ignored.is_empty(), "{model}: {:?}", report.extensions_ignored);
            instanced |= report.extensions_used.iter().any(|used| used == "EXT_mesh_gpu_instancing");
            let distances = surface.compare(&asset.mesh).unwrap().in_diagonals();
            let error = image_error(&expected, &pictures(&asset, &cameras)).unwrap();
            eprintln!(
                "{model} {:?}: {} triangles, {:.1e} diagonals apart, {:.2} of 255 apart in pictures",
                variant.arguments,
                asset.mesh.face_count(),
                distances.hausdorff,
                error.rmse_object
            );
            assert!(distances.hausdorff <= variant.distance, "{model} {:?}: {distances:?}", variant.arguments);
            assert!(error.rmse_object < 4.0, "{model} {:?}: {error:?}", variant.arguments);
        }
    }
    assert!(instanced, "no variant used instances");
}
