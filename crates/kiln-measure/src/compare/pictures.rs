//! Drawing a pair of scenes alike, and showing them side by side.

use kiln_asset::Raster;

use super::{CompareOptions, Comparison};
use crate::camera::{Camera, Sphere, bounding_sphere};
use crate::heat::{colour_bar, differences, heat_map, scale_end};
use crate::render::{Mip, Mode, Picture, RenderOptions, render};
use crate::scene::Scene;
use crate::sheet::{Tile, sheet};

/// Two scenes and how each is drawn.
pub(super) struct Pair<'a> {
    scenes: [&'a Scene<'a>; 2],
    options: [RenderOptions; 2],
}

impl<'a> Pair<'a> {
    pub(super) fn new(
        reference: &'a Scene<'a>,
        other: &'a Scene<'a>,
        sphere: Sphere,
        options: &CompareOptions,
    ) -> Pair<'a> {
        let with = |mip: u32| RenderOptions {
            width: options.size,
            height: options.size,
            supersample: options.supersample,
            normal_map: options.normal_maps,
            two_sided: true,
            mip: Mip::Fixed(mip),
            ..RenderOptions::default()
        };
        let [mip, other_mip] = mips(reference, other, sphere, options.size * options.supersample);
        Pair { scenes: [reference, other], options: [with(mip), with(other_mip)] }
    }

    pub(super) fn draw(&self, camera: &Camera, mode: Mode) -> (Picture, Picture) {
        let draw = |k: usize| render(self.scenes[k], camera, &RenderOptions { mode, ..self.options[k] });
        (draw(0), draw(1))
    }
}

/// The mip levels of both, for pictures of `samples` samples a side.
pub(super) fn mips(reference: &Scene<'_>, other: &Scene<'_>, sphere: Sphere, samples: u32) -> [u32; 2] {
    let (own, others) = (reference.texel_density(sphere, samples), other.texel_density(sphere, samples));
    let own_mip = own.or(others).map_or(0.0, |density| density.floor().max(0.0));
    let shift = match (own, others) {
        (Some(own), Some(others)) => (others - own).round(),
        _ => 0.0,
    };
    [own_mip as u32, (own_mip + shift).max(0.0) as u32]
}

/// Original, other and their difference with all maps under the object's own lights, with the difference's scale, for `rows`
/// views from the one with the greatest RMSE over pixels that both cover to the one with the least.
pub fn contact_sheet(reference: &Scene<'_>, other: &Scene<'_>, comparison: &Comparison, rows: usize) -> Raster {
    let options = &comparison.options;
    let (errors, outlines) = (&comparison.material.per_view_both, &comparison.silhouette.per_view_xor);
    let views = spread(errors, rows);
    let sphere = bounding_sphere(&reference.mesh.positions);
    let cameras = Camera::views(options.views, sphere);
    let pair = Pair::new(reference, other, sphere, options);
    let drawn: Vec<(usize, Raster, Raster, Vec<f32>)> = views
        .iter()
        .map(|view| {
            let (seen, other_seen) = pair.draw(&cameras[*view], Mode::Material);
            (*view, seen.to_raster(), other_seen.to_raster(), differences(&seen, &other_seen))
        })
        .collect();
    let greatest = drawn.iter().flat_map(|(.., values)| values).fold(0.0f32, |most, value| most.max(*value));
    let end = scale_end(f64::from(greatest)).min(255.0);
    let rows: Vec<Vec<Tile>> = drawn
        .into_iter()
        .map(|(view, seen, other_seen, values)| {
            let heat = heat_map(options.size, options.size, &values, end);
            let (both, outline) = (100.0 * errors[view] / 255.0, 100.0 * outlines[view]);
            vec![
                Tile { picture: seen, caption: format!("view {view}\n{} triangles", comparison.reference.triangles) },
                Tile { picture: other_seen, caption: format!("other\n{} triangles", comparison.other.triangles) },
                Tile { picture: heat, caption: format!("both {both:.2} %\noutline {outline:.2} %") },
                Tile { picture: colour_bar(options.size, end), caption: "codes".into() },
            ]
        })
        .collect();
    sheet(&rows)
}

/// Up to `count` views in falling order of their error, evenly spread over that order, first and last included.
pub(super) fn spread(errors: &[f64], count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|a, b| errors[*b].total_cmp(&errors[*a]).then(a.cmp(b)));
    let count = count.min(order.len());
    (0..count).map(|k| order[if count == 1 { 0 } else { k * (order.len() - 1) / (count - 1) }]).collect()
}
