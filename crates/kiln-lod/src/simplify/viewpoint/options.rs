//! What can be chosen about simplification by views.

use super::cameras::Cameras;
use super::segmentation::SegmentationOptions;
use super::{Measure, Update, ViewpointOptions};

/// What of a view's picture is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewKind {
    /// Entropy, each face its own region (Castelló et al. 2007).
    PolygonEntropy,
    /// Mutual information of views and faces (Castelló et al. 2008).
    PolygonMutualInformation,
    /// Entropy of the texture regions (González, equations 5.1 and 5.3).
    RegionEntropy,
    /// Mutual information of views and texture regions (González, equations 5.5 and 5.8).
    RegionMutualInformation,
}

impl ViewKind {
    /// Whether it sees texture regions, not faces.
    pub fn sees_regions(self) -> bool {
        matches!(self, ViewKind::RegionEntropy | ViewKind::RegionMutualInformation)
    }
}

/// How to simplify by views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewOptions {
    /// What is measured.
    pub kind: ViewKind,
    /// Order of the generalised entropy or mutual information, unitless, above 0; 1 is Shannon's.
    pub alpha: f64,
    /// Where the views look from.
    pub cameras: Cameras,
    /// Width and height of each item buffer, pixels.
    pub size: u32,
    /// Which costs are found again.
    pub update: Update,
    /// How base colours fall into regions.
    pub segmentation: SegmentationOptions,
    /// Share of the mesh's faces, in `(0, 1]`, to which plain quadrics bring it before the views are asked.
    pub prepass: Option<f64>,
}

impl ViewOptions {
    /// How each view is valued.
    pub(super) fn valued(&self) -> ViewpointOptions {
        let measure = match self.kind {
            ViewKind::PolygonEntropy | ViewKind::RegionEntropy => Measure::Entropy,
            ViewKind::PolygonMutualInformation | ViewKind::RegionMutualInformation => Measure::MutualInformation,
        };
        ViewpointOptions { measure, alpha: self.alpha, update: self.update }
    }
}

impl Default for ViewOptions {
    fn default() -> Self {
        ViewOptions {
            kind: ViewKind::RegionEntropy,
            alpha: 1.0,
            cameras: Cameras::Dodecahedron,
            size: 256,
            update: Update::Exact,
            segmentation: SegmentationOptions::default(),
            prepass: None,
        }
    }
}
