//! Pictures of what a planned collapse sees: textures with their borders, textures with their regions, and the views of the model.

use std::sync::Arc;

use kiln_asset::{BlobError, MaterialSet, Mesh, Raster};
use kiln_lod::simplify::texture_border::debug_picture;
use kiln_lod::simplify::viewpoint::pictures::{segmentation_picture, view_sheet};
use kiln_lod::simplify::viewpoint::{ViewOptions, views};

use super::pack::Pictures;
use super::simplify::{borders, texture_regions, view_options};
use super::{StageError, levels_of};
use crate::language::options::{self, TextureBorder};

/// A picture to look at.
#[derive(Clone, Debug)]
pub struct DebugPicture {
    /// What it shows, fit for a file name.
    pub name: String,
    /// The same with its counts.
    pub caption: String,
    /// The picture.
    pub picture: Raster,
}

/// What a planned collapse can show, from the inputs of its action.
#[derive(Clone, Debug)]
pub struct DebugView {
    /// Index of the action.
    pub action: usize,
    /// Id of the stage.
    pub stage: String,
    texture_border: Option<TextureBorder>,
    views: Option<ViewOptions>,
}

impl DebugView {
    /// What the collapse of a stage can show; `None` if it sees neither textures nor views.
    pub(crate) fn of(action: usize, stage: &str, options: &options::SimplifyOptions) -> Option<DebugView> {
        let (texture_border, views) = (options.texture_border.clone(), view_options(&options.metric));
        let shows = texture_border.is_some() || views.is_some();
        shows.then(|| DebugView { action, stage: stage.to_owned(), texture_border, views })
    }

    /// Whether its pictures are made from materials and images, too.
    pub fn reads_materials(&self) -> bool {
        self.texture_border.is_some() || self.views.is_some_and(|views| views.kind.sees_regions())
    }

    /// The pictures: one for each texture and map with borders, one for each segmented texture, one of all views. `mesh`: bytes of
    /// the action's input `in`; `materials` and `images` likewise, empty where [`DebugView::reads_materials`] says no.
    ///
    /// # Errors
    /// The bytes are damaged.
    pub fn pictures(
        &self,
        mesh: &[u8],
        materials: &[u8],
        images: &[Arc<[u8]>],
    ) -> Result<Vec<DebugPicture>, StageError> {
        let set = levels_of(mesh)?;
        let finest = set.levels.first().ok_or(BlobError::Content("no level".into()))?;
        let materials = match self.reads_materials() {
            true => MaterialSet::from_blob(materials)?,
            false => MaterialSet::default(),
        };
        let source = Source { mesh: &finest.mesh, materials: &materials, images };
        let mut pictures = match &self.texture_border {
            Some(options) => source.borders(options)?,
            None => Vec::new(),
        };
        if let Some(views) = &self.views {
            source.views(views, &mut pictures)?;
        }
        Ok(pictures)
    }
}

/// What pictures are made from.
struct Source<'a> {
    mesh: &'a Mesh,
    materials: &'a MaterialSet,
    images: &'a [Arc<[u8]>],
}

impl Source<'_> {
    fn decoded(&self) -> Pictures<'_> {
        Pictures::new(self.images, self.materials.images.iter().map(|i| i.format).collect())
    }

    fn borders(&self, options: &TextureBorder) -> Result<Vec<DebugPicture>, StageError> {
        let borders = borders(self.mesh, self.materials, self.images, options).map_err(StageError::Picture)?;
        let report = borders.report(self.mesh, self.materials);
        let pictures = self.decoded();
        let show = |index: usize| {
            let (map, counts) = (&borders.maps()[index], &report.pictures[index]);
            let texture = pictures.get(map.image).map_err(StageError::Picture)?;
            let segments = borders.segments(self.mesh, index);
            Ok(DebugPicture {
                name: format!("{index}-{}.{}", safe(&counts.name), counts.map),
                caption: format!(
                    "{} as {}: {} border texels of {} x {}, {} of {} edges in it cross one",
                    counts.name,
                    counts.map,
                    counts.border_texels,
                    counts.width,
                    counts.height,
                    counts.affected_segments,
                    segments.len()
                ),
                picture: debug_picture(&texture, map, &segments),
            })
        };
        (0..borders.maps().len()).map(show).collect()
    }

    fn views(&self, options: &ViewOptions, out: &mut Vec<DebugPicture>) -> Result<(), StageError> {
        let mut regions = None;
        if options.kind.sees_regions() {
            let (found, report) =
                texture_regions(self.mesh, self.materials, self.images, options).map_err(StageError::Picture)?;
            let pictures = self.decoded();
            for (index, counts) in report.pictures.iter().enumerate() {
                let texture = pictures.get(kiln_asset::ImageId(counts.image)).map_err(StageError::Picture)?;
                out.push(DebugPicture {
                    name: format!("{index}-{}.regions", safe(&counts.name)),
                    caption: format!(
                        "{} in material {}: {} regions of {} x {} texels",
                        counts.name, counts.material, counts.regions, counts.width, counts.height
                    ),
                    picture: segmentation_picture(&texture, &found.maps[counts.submesh as usize]),
                });
            }
            regions = Some((found, report.regions));
        }
        let cameras = views(options.cameras, options.size, self.mesh);
        let seen = regions
            .as_ref()
            .map_or_else(|| format!("{} faces", self.mesh.face_count()), |(_, count)| format!("{count} regions"));
        out.push(DebugPicture {
            name: "views".into(),
            caption: format!("{} views of {} x {} pixels on {seen}", cameras.len(), options.size, options.size),
            picture: view_sheet(self.mesh, regions.as_ref().map(|r| &r.0), &cameras),
        });
        Ok(())
    }
}

fn safe(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect()
}
