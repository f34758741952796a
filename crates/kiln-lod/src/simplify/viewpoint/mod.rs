//! Viewpoint-driven simplification: what goes first is what viewers would miss least.
//!
//! **Problem.** A metric of shape does not know what is seen: it keeps hidden faces and lets a painted eye go. In: a mesh, views around it, and
//! regions of its textures (or each face as a region). Out: a collapse sequence in the order of what the views lose. Must not change: the
//! rules of legality, and what a sequence is.
//!
//! **Method.** A view is worth a number that depends on how many pixels each region has in it (formula). A collapse costs the
//! sum over views of how much that number changes. Both directions of an edge are candidates.
//! ```text
//! project each point once for each view; everything after that is whole numbers                           (screen)
//! layers  <- for each view and pixel the depth-sorted fragments (depth, face, region)                     (layers)
//! price   <- a collapse redraws its star: drop the star's fragments, insert the new ones, take the nearest; the pixel counts
//!            that change are the candidate's deltas                                                       (price)
//! order   <- the cheapest first, looked at again when it comes to the front                               (order)
//! ```
//! A graphics device may price the candidates that a sequence starts with (gpu): same pixel counts, same sequence.
//! Regions come from [`segmentation`] by way of [`regions`], views from [`cameras`]; [`collapse_by_views`] puts a coarse pre-pass by
//! quadrics in front where one is asked for, and [`pictures`] shows people what the metric sees.
//!
//! Where views see no difference, hidden faces above all, the quadric metric decides: the root of its cost, as a share of 1/1024 of a
//! pixel's share of a view; then the lower id. Texture borders on top add their surcharge in full, as the thesis' c_e + w A. The importance of the vertex that goes
//! multiplies the sum. The log's `error` is the quadric metric's, as for its own sequences.
//!
//! **Departures.** The thesis draws a viewport around the edges next to a collapse and takes all other costs to be what they were, which
//! they are not: they change by overlap on the screen, with the totals of regions, and for mutual information in all views. Here the cost at
//! which a collapse is done is the cost of drawing everything again at that moment, exactly in pixel counts (the tests do draw
//! everything again, `twin`). The thesis' own way is [`Update::Published`]. Logarithms are natural ones throughout.
//!
//! **Limits.** Candidates that have become cheaper are not looked for, so the order is greedy up to that. Hubs of more than 64 faces offer
//! their 8 geometrically cheapest targets. Free placement is not offered. What lies between two pixel centres is not seen: a model of far
//! more triangles than pixels is ordered by geometry until its faces are as large as pixels.
//!
//! **Sources.** C. Gonzalez, PhD thesis, Universitat Jaume I 2010, chapter 5; P. Castelló, M. Sbert, M. Chover, M. Feixas,
//! Viewpoint-based simplification using f-divergences, Information Sciences 178(11), 2008, doi:10.1016/j.ins.2008.01.011.

pub mod cameras;
mod formula;
mod gpu;
mod layers;
pub mod options;
mod order;
pub mod pictures;
mod prepass;
mod price;
pub mod regions;
mod scene;
mod screen;
pub mod segmentation;
mod study;
mod twin;

use std::sync::Mutex;

use kiln_asset::{Mesh, UvLayout};
use kiln_gpu::{Gpu, GpuError};

use super::metric::bordered::Bordered;
use super::metric::quadric::{Forms, QuadricMetric, QuadricRest};
use super::rest::{MetricRest, Rest};
use super::working::Working;
use super::{CollapseSequence, SimplifyOptions, TextureBorders};
use crate::topology::Topology;
use formula::Formula;
use order::Order;
use screen::Screens;

pub use cameras::{Cameras, View, views};
pub use formula::{Delta, Measure};
pub use gpu::{Device, DevicePrice};
pub use options::{ViewKind, ViewOptions};
pub use prepass::collapse_by_views;
pub use regions::{RegionMap, Regions, RegionsReport};
pub use segmentation::SegmentationOptions;
pub use study::{Stars, Study};

/// Width and height of a view by default, pixels.
pub const SIZE: u32 = 256;
/// Most pixels across a view.
pub const SIZE_LIMIT: u32 = 1024;
/// Most views.
pub const VIEW_LIMIT: usize = 256;
/// Most fragments in all views together: 1.5 GiB.
pub const FRAGMENT_LIMIT: u64 = 1 << 27;

/// Which candidates are priced again after a collapse.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Update {
    /// All that come to the front of the queue, so that no collapse is done at a cost of the past.
    #[default]
    Exact,
    /// Those on edges at the neighbours of the kept point, as published (figure 5.5), and no others.
    Published,
}

/// How views are valued.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewpointOptions {
    /// What a view is worth.
    pub measure: Measure,
    /// Order of the generalised form, above 0; 1 is Shannon's. Unitless.
    pub alpha: f64,
    /// Which candidates are priced again.
    pub update: Update,
}

impl Default for ViewpointOptions {
    fn default() -> Self {
        ViewpointOptions { measure: Measure::Entropy, alpha: 1.0, update: Update::Exact }
    }
}

/// Why views cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub enum ViewpointError {
    /// Alpha is not a number above 0.
    Alpha(f64),
    /// There are no views, or more than [`VIEW_LIMIT`].
    Views(usize),
    /// Views differ in size, or are empty, or wider than [`SIZE_LIMIT`].
    Size(u32),
    /// What the regions lack, with the submesh.
    Regions(usize, &'static str),
    /// More than [`FRAGMENT_LIMIT`] fragments.
    Fragments(u64),
}

impl std::fmt::Display for ViewpointError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ViewpointError::Alpha(alpha) => write!(f, "alpha is {alpha}: give a number above 0"),
            ViewpointError::Views(count) => write!(f, "{count} views: give 1 to {VIEW_LIMIT}"),
            ViewpointError::Size(size) => {
                write!(f, "a view of {size} pixels: give 1 to {SIZE_LIMIT}, the same for all")
            }
            ViewpointError::Regions(submesh, what) => write!(f, "regions of submesh {submesh}: {what}"),
            ViewpointError::Fragments(count) => write!(
                f,
                "the views see {count} fragments, more than {FRAGMENT_LIMIT}: use fewer or smaller views, or simplify first"
            ),
        }
    }
}

impl std::error::Error for ViewpointError {}

/// Views of a mesh, checked: what [`super::Conditions::views`] takes.
pub struct ViewCondition<'a> {
    screens: Screens<'a>,
    formula: Formula,
    options: ViewpointOptions,
    /// What the first prices come from, if not the CPU.
    gpu: Option<&'a Gpu>,
    trouble: Mutex<Option<GpuError>>,
}

impl<'a> ViewCondition<'a> {
    /// Views of `mesh`. `regions`: of its textures, or `None` if every face shall be a region.
    ///
    /// # Errors
    /// [`ViewpointError`].
    pub fn new(
        mesh: &Mesh,
        views: &[View],
        regions: Option<&'a Regions>,
        options: ViewpointOptions,
    ) -> Result<ViewCondition<'a>, ViewpointError> {
        if !(options.alpha > 0.0 && options.alpha.is_finite()) {
            return Err(ViewpointError::Alpha(options.alpha));
        }
        if views.is_empty() || views.len() > VIEW_LIMIT {
            return Err(ViewpointError::Views(views.len()));
        }
        let size = views[0].size;
        if let Some(view) = views.iter().find(|v| v.size != size || !(1..=SIZE_LIMIT).contains(&v.size)) {
            return Err(ViewpointError::Size(view.size));
        }
        if let Some(regions) = regions {
            check_regions(mesh, regions)?;
        }
        let screens = Screens::new(mesh, &super::metric::quadric::places(mesh), views, regions);
        let fragments = screens.fragments(mesh, FRAGMENT_LIMIT);
        if fragments > FRAGMENT_LIMIT {
            return Err(ViewpointError::Fragments(fragments));
        }
        let formula = Formula::new(options.measure, options.alpha, screens.pixels(), views.len());
        Ok(ViewCondition { screens, formula, options, gpu: None, trouble: Mutex::new(None) })
    }
}

/// Every submesh has a map, whose ids are regions and whose picture is whole.
fn check_regions(mesh: &Mesh, regions: &Regions) -> Result<(), ViewpointError> {
    if regions.count == 0 {
        return Err(ViewpointError::Regions(0, "no region at all, not even the background"));
    }
    for submesh in 0..mesh.submeshes.len() {
        let lacks = |what| Err(ViewpointError::Regions(submesh, what));
        match regions.maps.get(submesh) {
            None => return lacks("no map"),
            Some(RegionMap::Whole(region)) if *region >= regions.count => return lacks("an id beyond their number"),
            Some(RegionMap::Whole(_)) => {}
            Some(RegionMap::Picture { width, height, ids, set, .. }) => {
                if ids.is_empty() || ids.len() as u64 != u64::from(*width) * u64::from(*height) {
                    return lacks("a picture whose size and texels differ");
                }
                if ids.iter().any(|id| *id >= regions.count) {
                    return lacks("an id beyond their number");
                }
                if *set > 1 {
                    return lacks("a UV set beyond the second");
                }
            }
        }
    }
    Ok(())
}

/// The collapse sequence of `mesh` by what `condition`, made for it, sees; the rest as for [`super::collapse_under`].
/// `locked`: empty, or `[point_count]`.
///
/// # Panics
/// If `condition` was made for a mesh of fewer points or faces.
pub(super) fn collapse_seen(
    mesh: &Mesh,
    (topology, forms): (&Topology, &Forms),
    layout: Option<&UvLayout>,
    options: &SimplifyOptions,
    locked: &[bool],
    (borders, condition): (Option<&TextureBorders>, &ViewCondition<'_>),
) -> CollapseSequence {
    let (work, metric) = prepared(mesh, (topology, forms), layout, options, locked);
    // Inside the pool, so that no step waits for a thread from outside to be let in.
    let run = |_: &rayon::Scope<'_>| match borders {
        None => Order::new(mesh, work, metric, options, condition).run(),
        Some(borders) => {
            let metric = Bordered::new(metric, mesh, borders, &work);
            Order::new(mesh, work, metric, options, condition).run()
        }
    };
    rayon::scope(run)
}

/// A mesh as one part, with the quadric metric. The parameters as for [`collapse_seen`].
fn prepared<'a>(
    mesh: &'a Mesh,
    (topology, forms): (&Topology, &Forms),
    layout: Option<&UvLayout>,
    options: &'a SimplifyOptions,
    locked: &[bool],
) -> (Working<'a>, QuadricMetric) {
    let mut rest = Rest::new(mesh, topology, forms.positions(), options);
    rest.lock(locked);
    let metric = QuadricRest::new(forms.initial(), &mut rest);
    let work = super::regions::whole(&rest, layout);
    let metric = metric.part(&work);
    (work, metric)
}

#[cfg(test)]
mod tests;
