//! Simplify: edge collapses on points and wedges, logged once to exhaustion, from which all levels are cut.
//!
//! **Problem.** In: a mesh with points shared along boundaries and seams. Out: levels with fewer triangles, finest first, each
//! with its measured distance to the source. Must not change: submeshes (names, order, materials), charts (attributes never
//! cross a seam), joined borders (no crack), and in a level that keeps all triangles, any bit.
//!
//! **Method.** Half-edge collapse: `from` goes, `to` stays, where it is or where the metric puts it.
//! ```text
//! metric    <- what each collapse costs (metric): planes of the source and the slide of its attributes, or volumes
//! heap      <- for each point its cheapest target that the table of kinds allows
//! while the heap has a point, and more faces than the floor are left:
//!     test the cheapest: link, partners, turn, sliver, UV          (rules)
//!     forbidden: the point's next dearer target; else
//!     collapse: faces at both ends vanish, wedges go to their partners, the metric merges both points; log it
//!     price `to` and its neighbours again
//! large meshes: regions of them, at once, then what is left; one log of all  (regions, rest, log)
//! level     <- the shortest prefix of the log that meets the budget, replayed; free placement moves its points to where their
//!              level lies nearest to its source (fit); then its distance to the source is measured
//! by parts  <- instead of a prefix the closed set of collapses that gives each submesh what its rule grants (parts, cut,
//!              dependencies), continued where that stops short (continuation)
//! ```
//! No crack can open: submeshes share points, and a point of a seam or boundary goes with all its wedges at once, each to the
//! wedge that its own faces have at the other end.
//!
//! **Departures.** Garland and Heckbert place the kept point where the quadric is least at every collapse; under `quadric` it is an
//! end (so that levels are subsets of one vertex buffer), or moves once, after the cut. They weigh border planes by 1000; here lines
//! weigh by the square length of their edges, borders a hundred times that, found on open scans.
//!
//! **Limits.** Points where lines meet and points without a fan never go, so models of many small charts or parts stop early; the
//! report counts what each rule forbade. Attributes never cross a seam whatever their price; creases (wedges that differ in normal
//! only) hold nothing beyond what shading costs: a wedge takes the nearest normal at the kept point.
//!
//! **Sources.** M. Garland, P. Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997,
//! doi:10.1145/258734.258849. C. Gonzalez, PhD thesis, Universitat Jaume I 2010, chapter 3 (boundaries). Link condition: T. Dey
//! et al., "Topology preserving edge contraction", Publ. Inst. Math. 1999.

mod collapse;
mod components;
mod continuation;
pub mod cut;
mod dependencies;
pub mod error;
mod fit;
mod heap;
mod levels;
mod log;
mod metric;
pub mod parts;
mod plane;
mod regions;
mod rest;
pub mod rules;
pub mod sequence;
pub mod texture_border;
mod uv_border;
pub mod viewpoint;
mod working;

use kiln_asset::{Mesh, QuadricCoefficients, UvLayout};

use crate::topology::Topology;
use metric::bordered::Bordered;
use metric::memoryless::MemorylessRest;
use metric::quadric::{Forms, QuadricRest};
use rest::{MetricRest, Rest};

pub use dependencies::Dependencies;
pub use error::surface_error;
pub use levels::{
    Budget, LevelReport, LevelsOptions, Parts, Placement, SAMPLES, SimplifyReport, cut, levels, levels_by_parts,
    simplify,
};
pub(crate) use metric::quadric::Quadric;
pub use sequence::{Collapse, CollapseSequence, SequenceReport};
pub use texture_border::{BorderCost, TextureBorderOptions, TextureBorders};

/// What a collapse costs, and where it puts the point that stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MetricKind {
    /// Planes of the source, remembered (Garland and Heckbert), with the slide of attributes (Hoppe).
    #[default]
    Quadric,
    /// Volume and border of the mesh as it is (Lindstrom and Turk); places points freely.
    Memoryless,
}

/// How to collapse. All are unitless.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimplifyOptions {
    /// What prices collapses.
    pub metric: MetricKind,
    /// Stop when this share of the faces is left; 0 goes on to exhaustion. A twentieth of a percent is below any level that
    /// people ask for and spares nothing worth sparing, so the default is 0.
    pub floor: f64,
    /// How strongly open borders hold their shape, on the square length of their edges.
    pub border_weight: f64,
    /// How strongly boundaries hold theirs; and seams, but for a hundredth of it where attributes have a price, which hold them too.
    pub line_weight: f64,
    /// Share of the square edge length in the cost: orders places without error (flat, straight) by length, and is far below
    /// any error that shows.
    pub length_weight: f64,
    /// Whether texture coordinates, normals and colours have a price.
    pub attributes: bool,
    /// Cosine of the most that a face may turn.
    pub turn_cosine: f64,
    /// Least `2 area / longest edge squared` of a face that is made thinner.
    pub sliver: f64,
    /// When points on boundaries of submeshes may go.
    pub boundary: Boundary,
}

/// When points on boundaries of submeshes may go along them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Boundary {
    /// Whenever they are the cheapest.
    #[default]
    Along,
    /// When nothing else is left.
    Last,
    /// Never.
    Lock,
}

impl Default for SimplifyOptions {
    fn default() -> Self {
        SimplifyOptions {
            metric: MetricKind::Quadric,
            floor: 0.0,
            border_weight: 100.0,
            line_weight: 1.0,
            length_weight: 1e-6,
            attributes: true,
            turn_cosine: 0.25,
            sliver: 0.02,
            boundary: Boundary::Along,
        }
    }
}

/// The collapse sequence of `mesh` to exhaustion. `carried`: empty, or `[point_count]` forms of an earlier stage, object space.
/// `layout`: the atlas whose chart borders must stay in place.
pub fn collapse(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    layout: Option<&UvLayout>,
    options: &SimplifyOptions,
) -> CollapseSequence {
    collapse_under(mesh, carried, layout, options, &Conditions::default())
}

/// What bears on a sequence beside its options.
#[derive(Clone, Copy, Default)]
pub struct Conditions<'a> {
    /// Empty, or `[submesh_count]`: no face of these submeshes changes.
    pub locked: &'a [bool],
    /// Collapses that would move these borders of textures cost more.
    pub borders: Option<&'a TextureBorders>,
    /// Collapses go in the order of what these views of the mesh lose; the options' metric breaks ties as [`MetricKind::Quadric`].
    pub views: Option<&'a viewpoint::ViewCondition<'a>>,
}

/// As [`collapse`], under conditions.
pub fn collapse_under(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    layout: Option<&UvLayout>,
    options: &SimplifyOptions,
    conditions: &Conditions<'_>,
) -> CollapseSequence {
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, carried, options);
    let locked = if conditions.locked.contains(&true) { points_of(mesh, conditions.locked) } else { Vec::new() };
    if let Some(views) = conditions.views {
        return viewpoint::collapse_seen(
            mesh,
            (&topology, &forms),
            layout,
            options,
            &locked,
            (conditions.borders, views),
        );
    }
    collapse_prepared(mesh, &topology, &forms, layout, options, &locked, conditions.borders)
}

/// The collapse sequence of a patch of a larger mesh by planes, and what each point that took others in gained by it, object space.
/// `carried`: `[point_count]` forms, object space; `fixed`: `[point_count]`, on which faces beyond the patch hang: these points stay
/// where they are, and no edge comes between two of them that was not there, so the larger mesh stays as sound as it is.
pub(crate) fn collapse_patch(
    mesh: &Mesh,
    carried: &[QuadricCoefficients],
    options: &SimplifyOptions,
    fixed: &[bool],
) -> (CollapseSequence, Vec<(u32, QuadricCoefficients)>) {
    let topology = Topology::new(mesh);
    let mut forms = Forms::new(mesh, &topology, carried, options);
    let mut rest = Rest::new(mesh, &topology, forms.positions(), options);
    rest.fix(fixed);
    let metric = QuadricRest::new(forms.initial(), &mut rest);
    let sequence = ordered(rest, metric, None, None);
    forms.go_to(&sequence, sequence.collapses.len());
    (sequence, forms.gained())
}

/// The forms of a mesh before any collapse, `[point_count]`, object space.
pub(crate) fn first_forms(mesh: &Mesh, options: &SimplifyOptions) -> Vec<QuadricCoefficients> {
    let forms = Forms::new(mesh, &Topology::new(mesh), &[], options);
    forms.object_space(&(0..mesh.point_count() as u32).collect::<Vec<_>>())
}

fn collapse_prepared(
    mesh: &Mesh,
    topology: &Topology,
    forms: &Forms,
    layout: Option<&UvLayout>,
    options: &SimplifyOptions,
    locked: &[bool],
    borders: Option<&TextureBorders>,
) -> CollapseSequence {
    let mut rest = Rest::new(mesh, topology, forms.positions(), options);
    rest.lock(locked);
    match options.metric {
        MetricKind::Quadric => {
            let metric = QuadricRest::new(forms.initial(), &mut rest);
            ordered(rest, metric, layout, borders)
        }
        MetricKind::Memoryless => ordered(rest, MemorylessRest::new(mesh), layout, borders),
    }
}

fn ordered<M: MetricRest>(
    rest: Rest<'_>,
    metric: M,
    layout: Option<&UvLayout>,
    borders: Option<&TextureBorders>,
) -> CollapseSequence {
    let (mesh, floor) = (rest.mesh, rest.options.floor);
    if layout.is_none() && borders.is_none() {
        return regions::collapse(rest, metric, floor, regions::GRAIN);
    }
    let work = regions::whole(&rest, layout);
    let metric = metric.part(&work);
    match borders {
        None => regions::collapse_whole(mesh, work, metric, floor),
        Some(borders) => {
            let metric = Bordered::new(metric, mesh, borders, &work);
            regions::collapse_whole(mesh, work, metric, floor)
        }
    }
}

/// `[point_count]`: whether a face of a submesh in `chosen` is at the point.
fn points_of(mesh: &Mesh, chosen: &[bool]) -> Vec<bool> {
    let mut at = vec![false; mesh.point_count()];
    for (triangle, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
        if chosen[submesh.index()] {
            for v in triangle {
                at[mesh.points[*v as usize].index()] = true;
            }
        }
    }
    at
}

#[cfg(test)]
mod parts_tests;
#[cfg(test)]
mod regions_tests;
#[cfg(test)]
mod tests;
