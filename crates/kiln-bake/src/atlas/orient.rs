//! Turns charts the right way round: counter-clockwise in the picture, as the surface is seen from outside.
//!
//! V points down in glTF, so counter-clockwise in the picture is a negative area in (u, v). Charts that are not mirrored
//! have tangent frames of sign +1 all over, and normal maps look alike on all of them.

use glam::Vec2;

use super::{AtlasDefect, UnwrapInput, UnwrapOutput};

/// `charts` with every chart's area negative in (u, v): the whole sheet is flipped in V where most of the area is positive,
/// and single charts that still are mirrored are flipped in U inside their own box (the check sees whether they then touch
/// another).
///
/// # Errors
/// The output has other faces than the input, values that are no numbers, or faces without a chart.
pub(super) fn orient(mut charts: UnwrapOutput, input: &UnwrapInput) -> Result<UnwrapOutput, AtlasDefect> {
    let faces = input.triangles.len();
    if charts.corners.len() != faces || charts.charts.len() != faces {
        return Err(AtlasDefect::Malformed { expected: faces, found: charts.corners.len().min(charts.charts.len()) });
    }
    let unusable =
        |f: &usize| charts.charts[*f] as usize >= faces || !charts.corners[*f].iter().all(|uv| uv.is_finite());
    let unplaced: Vec<_> = (0..faces).filter(unusable).collect();
    if let Some(first) = unplaced.first() {
        return Err(AtlasDefect::Unplaced { count: unplaced.len(), input_face: *first });
    }
    if chart_areas(&charts).iter().sum::<f64>() > 0.0 {
        // About the sheet's middle, so that the space kept to its edges stays.
        for uv in charts.corners.as_flattened_mut() {
            uv.y = input.size as f32 - uv.y;
        }
    }
    let areas = chart_areas(&charts);
    let mut spans = vec![(f32::INFINITY, f32::NEG_INFINITY); areas.len()];
    for (corners, chart) in charts.corners.iter().zip(&charts.charts) {
        let (lo, hi) = &mut spans[*chart as usize];
        for uv in corners {
            (*lo, *hi) = (lo.min(uv.x), hi.max(uv.x));
        }
    }
    for (corners, chart) in charts.corners.iter_mut().zip(&charts.charts) {
        if areas[*chart as usize] > 0.0 {
            let (lo, hi) = spans[*chart as usize];
            for uv in corners {
                *uv = Vec2::new(lo + hi - uv.x, uv.y);
            }
        }
    }
    Ok(charts)
}

/// Signed area of each chart in (u, v), square texels.
fn chart_areas(charts: &UnwrapOutput) -> Vec<f64> {
    let count = charts.charts.iter().max().map_or(0, |c| *c as usize + 1);
    let mut areas = vec![0.0; count];
    for (corners, chart) in charts.corners.iter().zip(&charts.charts) {
        areas[*chart as usize] += signed_area(corners.map(|uv| uv.as_dvec2()));
    }
    areas
}

/// Signed area of a triangle: positive where it turns from +u to +v.
pub(super) fn signed_area([a, b, c]: [glam::DVec2; 3]) -> f64 {
    0.5 * (b - a).perp_dot(c - a)
}
