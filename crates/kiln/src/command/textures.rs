//! `kiln export --textures`: every texture of a container as a file.

use std::path::Path;

use kiln_asset::Precision;
use kiln_format::{AlignedBytes, Container};
use kiln_oiio::Texels;
use kiln_pack::files::{FileFormat, Planes, texture_file, texture_files, texture_picture};
use kiln_pack::{PackError, Picture};

use super::args::{ExportArgs, FileFormatArg};
use super::{complain, write};
use crate::exit::Exit;
use crate::summary;

/// Writes them, each beside its place and renamed; what cannot be written as asked is refused before the first.
pub(super) fn export(args: &ExportArgs, folder: &Path, bytes: &[u8]) -> Exit {
    if args.mips && args.format != Some(FileFormatArg::Exr) {
        return complain(Exit::Usage, "`--mips` goes with `--format exr`: ktx2 and tx have all mips, png has one");
    }
    if args.normals_down && matches!(args.format, Some(FileFormatArg::Ktx2 | FileFormatArg::Tx)) {
        return complain(Exit::Usage, "`--normals-down` goes with png and exr: ktx2 holds the container's own bytes");
    }
    match write_all(args, folder, bytes) {
        Ok(()) => Exit::Done,
        Err(exit) => exit,
    }
}

fn write_all(args: &ExportArgs, folder: &Path, bytes: &[u8]) -> Result<(), Exit> {
    let fail = |error: PackError| complain(Exit::Failed, &format!("{}: {error}", args.file.display()));
    let aligned = AlignedBytes::copy_of(bytes);
    let container = Container::open(&aligned).map_err(|error| fail(error.into()))?;
    let format = match args.format {
        None => None,
        Some(FileFormatArg::Png) => Some(FileFormat::Png),
        Some(FileFormatArg::Exr) => Some(FileFormat::Exr),
        Some(FileFormatArg::Ktx2) => Some(FileFormat::Ktx2),
        Some(FileFormatArg::Tx) => return tx(args, folder, &container),
    };
    let mut files = texture_files(&container, format).map_err(fail)?;
    files.iter_mut().for_each(|file| file.normals_down = args.normals_down);
    make_folder(folder)?;
    for file in &files {
        let bytes = texture_file(&container, file, args.mips).map_err(fail)?;
        let path = folder.join(file.file_name());
        write(&path, &bytes)?;
        eprintln!("{}: {}", path.display(), summary::bytes(bytes.len() as u64));
    }
    if files.is_empty() {
        eprintln!("note: {} has no textures", args.file.display());
    }
    Ok(())
}

fn make_folder(folder: &Path) -> Result<(), Exit> {
    std::fs::create_dir_all(folder)
        .map_err(|error| complain(Exit::Failed, &format!("cannot make {}: {error}", folder.display())))
}

/// Writes tiled, mip-mapped files by OpenImageIO: TIFF named `.tx` for 8 and 16 bits, EXR for floats; blocks are decoded, 8-bit
/// colours stay sRGB.
fn tx(args: &ExportArgs, folder: &Path, container: &Container<'_>) -> Result<(), Exit> {
    if kiln_oiio::version().is_none() {
        return Err(complain(Exit::Usage, "`--format tx` needs OpenImageIO: build kiln with `--features oiio`"));
    }
    let fail = |error: PackError| complain(Exit::Failed, &format!("{}: {error}", args.file.display()));
    let files = texture_files(container, None).map_err(fail)?;
    make_folder(folder)?;
    for file in &files {
        let (picture, planes) = texture_picture(container, file.texture).map_err(fail)?;
        let (width, height) = picture.size();
        let size = kiln_oiio::Size { width, height, channels: planes.count() as u32 };
        let extension = if file.format == FileFormat::Exr { "exr" } else { "tx" };
        let path = folder.join(format!("{}.{extension}", file.stem));
        let beside = folder.join(format!("{}.{}.part", file.stem, std::process::id()));
        let made = make(&picture, planes, &beside, size);
        let done = made.and_then(|()| std::fs::rename(&beside, &path).map_err(|error| error.to_string()));
        done.map_err(|error| {
            // What was written of it is of no use; that it cannot be removed changes nothing for the caller.
            let _ = std::fs::remove_file(&beside);
            complain(Exit::Failed, &format!("cannot write {}: {error}", path.display()))
        })?;
        eprintln!("{}", path.display());
    }
    Ok(())
}

fn make(picture: &Picture, planes: Planes, path: &Path, size: kiln_oiio::Size) -> Result<(), String> {
    let made = match picture {
        Picture::Plain(raster) => {
            let values: Vec<u8> = raster.texels.iter().flat_map(|t| &t[..planes.count()]).copied().collect();
            kiln_oiio::make_texture(path, size, Texels::Bytes(&values))
        }
        Picture::Deep(deep) => {
            let values = deep.texels.iter().flat_map(|t| &t[..planes.count()]).copied();
            match deep.precision {
                Precision::Unorm16 => {
                    let values: Vec<u16> = values.map(|v| (f64::from(v) * 65_535.0 + 0.5) as u16).collect();
                    kiln_oiio::make_texture(path, size, Texels::Words(&values))
                }
                // The values are those of halves, so floats hold them; the file's are floats too.
                Precision::Half | Precision::Float => {
                    kiln_oiio::make_texture(path, size, Texels::Floats(&values.collect::<Vec<f32>>()))
                }
            }
        }
    };
    made.map_err(|error| error.to_string())
}
