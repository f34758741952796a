//! The pre-pass: quadrics bring a mesh down to where its pixels see its edges, then the views go on.
//!
//! **Problem.** On a mesh of ten triangles a pixel, most collapses change no pixel, and the views choose among them by their
//! tie-breaker, at the price of asking every view. **Method.**
//! ```text
//! coarse <- collapses by plain quadrics until the share of the faces is left
//! level  <- the mesh after them, each point with the form that it has gathered
//! fine   <- collapses of the level by views, to exhaustion
//! log    <- coarse, then fine, with the level's points, wedges and faces renamed to the mesh's
//! ```
//! The log is one collapse sequence like any other: budgets, rules by part and splits do not know where it changes its metric.
//!
//! **Limits.** What quadrics remove stays removed, however visible. Points on chart borders of an atlas stay where the pre-pass leaves
//! them: how far they have moved is known to the first log only.

use kiln_asset::{Mesh, QuadricCoefficients, UvLayout};

use super::cameras::{View, views};
use super::options::ViewOptions;
use super::regions::Regions;
use super::{ViewCondition, ViewpointError, collapse_seen};
use crate::simplify::metric::quadric::Forms;
use crate::simplify::sequence::{Collapse, Replayed, SequenceReport};
use crate::simplify::{
    CollapseSequence, Conditions, MetricKind, SimplifyOptions, TextureBorders, collapse_prepared, points_of,
};
use crate::topology::{PointKind, Topology};

/// The collapse sequence of `mesh` by what views of it see of `regions`, or of its faces where the kind sees no regions. The rest as
/// in [`crate::simplify::collapse_under`]; `options.metric` is not read.
///
/// # Errors
/// The views cannot be used, or `regions` are of another mesh.
pub fn collapse_by_views(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    layout: Option<&UvLayout>,
    options: &SimplifyOptions,
    conditions: &Conditions<'_>,
    how: &ViewOptions,
    regions: &Regions,
) -> Result<CollapseSequence, ViewpointError> {
    // Framed once: the pre-pass moves no picture.
    let cameras = views(how.cameras, how.size, mesh);
    let options = SimplifyOptions { metric: MetricKind::Quadric, ..*options };
    let topology = Topology::new(mesh);
    let mut forms = Forms::new(mesh, &topology, carried, &options);
    let locked = |mesh: &Mesh| match conditions.locked.contains(&true) {
        true => points_of(mesh, conditions.locked),
        false => vec![false; mesh.point_count()],
    };
    let borders = conditions.borders;
    let share = how.prepass.unwrap_or(1.0);
    if share >= 1.0 || options.floor >= share {
        let whole = Fine { mesh, topology: &topology, forms: &forms, layout, locked: &locked(mesh), borders };
        return whole.collapsed(&options, &cameras, how, regions);
    }

    let to_share = SimplifyOptions { floor: share, ..options };
    let mut log = collapse_prepared(mesh, &topology, &forms, layout, &to_share, &locked(mesh), borders);
    let count = log.collapses.len();
    let coarse =
        log.replay_with_heirs(mesh, count).expect("invariant: a prefix of the mesh's own sequence keeps its promises");
    forms.go_to(&log, count);
    let level = &coarse.level;
    let topology = Topology::new(level);
    let quadrics = forms.object_space(&coarse.origin);
    let forms = Forms::new(level, &topology, &quadrics, &options);
    let mut locked = locked(level);
    if layout.is_some() {
        locked.iter_mut().zip(&topology.kinds).for_each(|(locked, kind)| *locked |= *kind != PointKind::Manifold);
    }
    // The floor is a share of the faces that come in.
    let left = level.face_count().max(1) as f64 / mesh.face_count().max(1) as f64;
    let options = SimplifyOptions { floor: (options.floor / left).min(1.0), ..options };
    let fine = Fine { mesh: level, topology: &topology, forms: &forms, layout, locked: &locked, borders };
    append(&mut log, &coarse, &fine.collapsed(&options, &cameras, how, regions)?);
    Ok(log)
}

/// What views collapse.
struct Fine<'a> {
    mesh: &'a Mesh,
    topology: &'a Topology,
    forms: &'a Forms,
    layout: Option<&'a UvLayout>,
    /// `[point_count]`
    locked: &'a [bool],
    borders: Option<&'a TextureBorders>,
}

impl Fine<'_> {
    fn collapsed(
        &self,
        options: &SimplifyOptions,
        cameras: &[View],
        how: &ViewOptions,
        regions: &Regions,
    ) -> Result<CollapseSequence, ViewpointError> {
        let Fine { mesh, topology, forms, layout, locked, borders } = *self;
        let regions = how.kind.sees_regions().then_some(regions);
        let seen = ViewCondition::new(mesh, cameras, regions, how.valued())?;
        Ok(collapse_seen(mesh, (topology, forms), layout, options, locked, (borders, &seen)))
    }
}

/// Appends `fine`, a sequence of `coarse.level`, to `log`, whose whole replay that level is.
fn append(log: &mut CollapseSequence, coarse: &Replayed, fine: &CollapseSequence) {
    let mut is_gone = vec![false; log.face_count() as usize];
    log.faces.iter().for_each(|f| is_gone[*f as usize] = true);
    let faces: Vec<u32> = (0..log.face_count()).filter(|f| !is_gone[*f as usize]).collect();
    // A vertex of the level is the one of those that came to it that never went.
    let mut has_gone = vec![false; coarse.heirs.len()];
    log.pairs.iter().for_each(|[wedge, _]| has_gone[*wedge as usize] = true);
    let mut vertices = vec![0; coarse.level.vertex_count()];
    for (vertex, heir) in coarse.heirs.iter().enumerate().filter(|(vertex, _)| !has_gone[*vertex]) {
        if let Some(slot) = vertices.get_mut(*heir as usize) {
            *slot = vertex as u32;
        }
    }

    let (first_face, first_pair) = (log.faces.len() as u32, log.pairs.len() as u32);
    let error = log.collapses.last().map_or(0.0, |c| c.error);
    log.collapses.extend(fine.collapses.iter().map(|c| Collapse {
        from: coarse.origin[c.from as usize],
        to: coarse.origin[c.to as usize],
        first_face: first_face + c.first_face,
        first_pair: first_pair + c.first_pair,
        error: c.error.max(error),
    }));
    log.faces.extend(fine.faces.iter().map(|f| faces[*f as usize]));
    log.pairs.extend(fine.pairs.iter().map(|pair| pair.map(|v| vertices[v as usize])));
    log.report = SequenceReport { collapses: log.collapses.len() as u32, ..fine.report.clone() };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use crate::simplify::{Dependencies, collapse};

    fn by_views(mesh: &Mesh, prepass: Option<f64>, options: &SimplifyOptions) -> CollapseSequence {
        let regions = Regions { count: 2, maps: vec![super::super::RegionMap::Whole(1); mesh.submeshes.len()] };
        let views = ViewOptions { prepass, size: 32, ..ViewOptions::default() };
        collapse_by_views(mesh, &[], None, options, &Conditions::default(), &views, &regions).expect("views")
    }

    fn bumps() -> Mesh {
        fixtures::field(24, 20, |x, y| (0.7 * x).sin() * (0.4 * y).cos())
    }

    #[test]
    fn every_prefix_of_a_joined_log_is_the_level_that_its_two_logs_give() {
        let options = SimplifyOptions { floor: 0.1, ..SimplifyOptions::default() };
        for mesh in [bumps(), fixtures::sphere(30, 16)] {
            let joined = by_views(&mesh, Some(0.5), &options);
            let coarse = collapse(&mesh, &[], None, &SimplifyOptions { floor: 0.5, ..options });
            let count = coarse.collapses.len();
            assert!(count > 0 && joined.collapses.len() > count, "{count} of {}", joined.collapses.len());
            assert_eq!(joined.collapses[..count], coarse.collapses);
            let level = coarse.replay(&mesh, count).expect("a level");
            assert!(level.face_count() <= mesh.face_count() / 2 && level.face_count() + 2 > mesh.face_count() / 2);

            let mut last = usize::MAX;
            for k in (0..=joined.collapses.len()).step_by(7).chain([joined.collapses.len()]) {
                let replayed = joined.replay(&mesh, k).expect("a level");
                assert_eq!(replayed.face_count() as u32, joined.faces_after(k));
                assert!(replayed.face_count() <= last);
                last = replayed.face_count();
                assert_eq!(crate::check::degenerate_faces(&replayed), 0);
            }
            assert!(joined.report().at_floor && last <= mesh.face_count() / 10);
            assert_eq!(joined.report().collapses as usize, joined.collapses.len());
            assert_eq!(joined.report().faces_left as usize, last);
            let back = CollapseSequence::from_blob(&joined.to_blob()).expect("sound");
            assert_eq!(back, joined);
            Dependencies::for_cuts(&mesh, &joined).expect("a log of this mesh");
        }
    }

    #[test]
    fn without_a_prepass_or_with_all_of_the_mesh_there_is_one_log() {
        let options = SimplifyOptions::default();
        let mesh = bumps();
        let alone = by_views(&mesh, None, &options);
        assert_eq!(by_views(&mesh, Some(1.0), &options), alone);
        assert_ne!(by_views(&mesh, Some(0.5), &options), alone);
    }

    #[test]
    fn a_floor_above_the_prepass_holds() {
        let options = SimplifyOptions { floor: 0.6, ..SimplifyOptions::default() };
        let mesh = bumps();
        let log = by_views(&mesh, Some(0.3), &options);
        assert!(f64::from(log.report().faces_left) > 0.59 * mesh.face_count() as f64);
    }
}
