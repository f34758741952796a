//! Container bytes back to asset values: geometry bit for bit, textures as their largest mip, blocks decoded.

use std::sync::Arc;

use kiln_asset::{
    AlphaMode, ExtraImage, ExtraMap, Filter, ImageFormat, ImageId, ImageInfo, Level, LodSet, MapRole, Material,
    MaterialId, MaterialSet, Mesh, Raster, RawMesh, Sampler, Submesh, SubmeshId, Texture, TextureId, TextureRef,
    UvLayout, Wrap,
};
use kiln_format::{
    AlignedBytes, Channel, Container, Extra, LevelView, SlotRecord, TextureFormat, TextureRecord, record::NONE,
};

use crate::PackError;
use crate::pack::attribute_set;
use crate::picture::{self, Picture};
use crate::textures::format_extra;

/// The levels, materials and pictures of a container, in 8 bits a channel as drawing them needs. `images[i]` of the material set
/// is `rasters[i]`; deep pictures are rounded, and extras, which 8 bits cannot hold, are left out ([`unpack_pictures`] has them).
///
/// Geometry equals what was packed bit for bit. Points are welded anew within each submesh; error forms are gone, and textures
/// and images are numbered by the container.
///
/// # Errors
/// Bytes that are no sound container, and UV transforms, which materials here cannot say.
pub fn unpack(bytes: &[u8]) -> Result<(LodSet, MaterialSet, Vec<Raster>), PackError> {
    let (levels, set, pictures) = unpack_pictures(bytes)?;
    let (set, rasters) = in_eight_bits(set, pictures);
    Ok((levels, set, rasters))
}

/// The levels, materials, extras and pictures of a container, as deep as they are. `images[i]` of the material set is
/// `pictures[i]`. What came in raw texels packs into the same bytes again.
///
/// # Errors
/// As for [`unpack`].
pub fn unpack_pictures(bytes: &[u8]) -> Result<(LodSet, MaterialSet, Vec<Picture>), PackError> {
    let aligned = AlignedBytes::copy_of(bytes);
    unpack_container(&Container::open(&aligned)?)
}

/// Without extras and their images; every picture in 8 bits, colours in sRGB.
fn in_eight_bits(mut set: MaterialSet, pictures: Vec<Picture>) -> (MaterialSet, Vec<Raster>) {
    let mut colours = vec![false; pictures.len()];
    for material in &set.materials {
        for role in MapRole::ALL.into_iter().filter(|role| role.is_srgb()) {
            let image = material.map(role).map(|used| set.textures[used.texture.index()].image);
            image.into_iter().for_each(|image| colours[image.index()] = true);
        }
    }
    let dropped: Vec<ImageId> = std::mem::take(&mut set.extras).iter().map(|extra| extra.image).collect();
    let (mut rasters, mut numbers, mut infos) = (Vec::new(), vec![ImageId(u32::MAX); pictures.len()], Vec::new());
    for (number, (picture, mut info)) in pictures.into_iter().zip(set.images).enumerate() {
        if dropped.contains(&ImageId(number as u32)) {
            continue;
        }
        let deep = matches!(picture, Picture::Deep(_));
        let raster = picture.to_raster(colours[number]);
        drop(picture);
        let raster = Arc::unwrap_or_clone(raster);
        if deep {
            info.format = ImageFormat::Raster;
            info.hash = *blake3::hash(&raster.to_blob()).as_bytes();
        }
        numbers[number] = ImageId(rasters.len() as u32);
        rasters.push(raster);
        infos.push(info);
    }
    set.images = infos;
    // Textures of materials never name the image of an extra: each texture of a container has one or the other use.
    set.textures.iter_mut().for_each(|texture| texture.image = numbers[texture.image.index()]);
    (set, rasters)
}

/// [`unpack_pictures`] of an open container, which must have all its levels and mips at hand.
///
/// # Errors
/// As for [`unpack`].
pub fn unpack_container(container: &Container<'_>) -> Result<(LodSet, MaterialSet, Vec<Picture>), PackError> {
    let (materials, pictures) = materials(container)?;
    let submeshes: Vec<Submesh> = container
        .submeshes()
        .iter()
        .map(|record| Submesh {
            name: container.string(record.name).to_string(),
            material: (record.material != NONE).then_some(MaterialId(record.material)),
            attributes: attribute_set(record.attributes),
            source_triangles: record.source_triangles,
        })
        .collect();
    let mut levels = Vec::new();
    for lod in 0..container.level_records().len() {
        let view = container.level(lod).ok_or_else(|| absent("levels", lod))?;
        let mesh = Mesh::new(raw_mesh(&view, &submeshes)).map_err(|error| PackError::Mesh { level: lod, error })?;
        levels.push(Level { mesh, error: view.record.error, quadrics: Vec::new() });
    }
    let header = container.level_header();
    let layout = (header.has_layout == 1).then_some(UvLayout {
        size: header.layout_size,
        padding: header.layout_padding,
        chart_count: header.layout_charts,
        sheets: container.level_records().first().map_or(1, |level| level.layout_sheets.max(1)),
    });
    Ok((LodSet { levels, layout, source_triangles: header.source_triangles }, materials, pictures))
}

fn absent(what: &str, number: usize) -> PackError {
    PackError::Unsupported(format!("{what}[{number}] is not in the bytes at hand"))
}

fn raw_mesh(view: &LevelView<'_>, submeshes: &[Submesh]) -> RawMesh {
    fn own<A, B: From<A>>(values: Option<&[A]>) -> Option<Vec<B>>
    where
        A: Copy,
    {
        values.map(|values| values.iter().map(|value| B::from(*value)).collect())
    }
    let indices: Vec<u32> = view.indices().iter().collect();
    let mut face_submesh = Vec::with_capacity(indices.len() / 3);
    for (number, range) in view.ranges.iter().enumerate() {
        face_submesh.extend((0..range.index_count / 3).map(|_| SubmeshId(number as u32)));
    }
    RawMesh {
        positions: own(Some(view.positions())).unwrap_or_default(),
        normals: own(view.normals()),
        tangents: own(view.tangents()),
        uv0: own(view.uv0()),
        uv1: own(view.uv1()),
        atlas_uv: None,
        colors: own(view.colors()),
        joints: own(view.joints()),
        weights: own(view.weights()),
        importance: None,
        points: Vec::new(),
        triangles: indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        face_submesh,
        submeshes: submeshes.to_vec(),
    }
}

/// The registered format and channels of a texture.
pub(crate) fn texels_of(record: &TextureRecord) -> Option<(TextureFormat, [Channel; 4])> {
    let mut channels = [Channel::Unused; 4];
    for (channel, number) in channels.iter_mut().zip(record.channels) {
        *channel = Channel::from_number(u32::from(number))?;
    }
    Some((TextureFormat::from_number(record.format)?, channels))
}

/// A mip of a texture, decoded.
///
/// # Errors
/// It is not at hand.
pub(crate) fn mip_picture(container: &Container<'_>, texture: usize, mip: usize) -> Result<Picture, PackError> {
    let record = container.textures().get(texture).ok_or_else(|| absent("textures", texture))?;
    let bytes = container.mip(texture, mip).ok_or_else(|| absent("textures", texture))?;
    let (format, channels) = texels_of(record).ok_or_else(|| absent("textures", texture))?;
    let size = ((record.width >> mip).max(1), (record.height >> mip).max(1));
    Ok(picture::decode(format, channels, size, bytes))
}

fn materials(container: &Container<'_>) -> Result<(MaterialSet, Vec<Picture>), PackError> {
    let (mut set, mut pictures) = (MaterialSet::default(), Vec::new());
    for (number, record) in container.textures().iter().enumerate() {
        let picture = mip_picture(container, number, 0)?;
        let (format, hash) = match &picture {
            Picture::Plain(raster) => (ImageFormat::Raster, blake3::hash(&raster.to_blob())),
            Picture::Deep(deep) => (ImageFormat::Deep, blake3::hash(&deep.to_blob())),
        };
        let name = container.string(record.name).to_string();
        set.images.push(ImageInfo { name, format, hash: *hash.as_bytes() });
        pictures.push(picture);
        let extra = Extra::from_roles(record.roles);
        if let Some(kind) = ExtraMap::ALL.into_iter().find(|kind| Some(format_extra(*kind)) == extra) {
            set.extras.push(ExtraImage { kind, sheet: record.sheet, image: ImageId(number as u32) });
        }
    }
    for (number, record) in container.materials().iter().enumerate() {
        let mut material = Material {
            name: container.string(record.name).to_string(),
            base_color_factor: record.base_color_factor,
            metallic_factor: record.metallic_factor,
            roughness_factor: record.roughness_factor,
            normal_scale: record.normal_scale,
            occlusion_strength: record.occlusion_strength,
            emissive_factor: record.emissive_factor,
            alpha_mode: [AlphaMode::Opaque, AlphaMode::Mask, AlphaMode::Blend][record.alpha_mode.min(2) as usize],
            alpha_cutoff: record.alpha_cutoff,
            double_sided: record.flags & 1 == 1,
            ..Material::default()
        };
        for (role, slot) in MapRole::ALL.into_iter().zip(&record.slots) {
            if slot.texture == NONE {
                continue;
            }
            if (slot.uv_offset, slot.uv_scale, slot.uv_rotation) != ([0.0; 2], [1.0; 2], 0.0) {
                let what = format!("the UV transform of materials[{number}].{}", role.name());
                return Err(PackError::Unsupported(what));
            }
            let texture = Texture { image: ImageId(slot.texture), sampler: sampler(slot) };
            let known = set.textures.iter().position(|t| *t == texture);
            let id = known.unwrap_or_else(|| {
                set.textures.push(texture);
                set.textures.len() - 1
            });
            *material.map_mut(role) = Some(TextureRef { texture: TextureId(id as u32), uv_set: slot.uv_set });
        }
        set.materials.push(material);
    }
    Ok((set, pictures))
}

fn sampler(slot: &SlotRecord) -> Sampler {
    let wrap = |number| [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge][(number as usize).min(2)];
    let filter = |number| if number == 1 { Filter::Linear } else { Filter::Nearest };
    Sampler {
        wrap_u: wrap(slot.wrap_u),
        wrap_v: wrap(slot.wrap_v),
        mag: filter(slot.mag),
        min: filter(slot.min),
        mip: (slot.mip > 0).then(|| filter(slot.mip - 1)),
    }
}
