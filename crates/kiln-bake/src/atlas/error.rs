//! Why there is no layout.

use serde::{Deserialize, Serialize};

use super::{AtlasOptions, Stop};

/// Why an unwrapper made no layout.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnwrapError {
    /// The charts do not fit one sheet.
    #[error("{charts} charts do not fit one sheet of {size} texels with {padding} texels of padding")]
    DoesNotFit {
        /// Number of charts.
        charts: u32,
        /// Texels.
        size: u32,
        /// Texels.
        padding: u32,
    },
    /// The unwrapper refused the surface.
    #[error("{0}")]
    Refused(String),
    /// The worker program failed, ran out of time or memory, or sent bytes that are no reply. Never cached.
    #[error("{0}")]
    Worker(String),
    /// The run was told to end. Never cached, and no other unwrapper is tried.
    #[error("{0}")]
    Stopped(#[from] Stop),
}

/// Why a level got no atlas.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AtlasError {
    /// Invalid: the size is out of range.
    #[error("atlas size {size} is outside {} to {} texels", AtlasOptions::SIZE_MIN, AtlasOptions::SIZE_MAX)]
    Size {
        /// What was asked.
        size: u32,
    },
    /// Invalid: the padding leaves no room.
    #[error("atlas padding {padding} is more than a quarter of the size {size}; use at most {}", size / 4)]
    Padding {
        /// What was asked, texels.
        padding: u32,
        /// The sheet's size, texels.
        size: u32,
    },
    /// Invalid: no sheet, or more than UVs can tell apart.
    #[error(
        "{sheets} sheets of {size} texels: 1 to {} of that size can lie side by side",
        AtlasOptions::most_sheets(*size)
    )]
    Sheets {
        /// What was asked.
        sheets: u32,
        /// The sheets' size, texels.
        size: u32,
    },
    /// Invalid: a density factor out of range.
    #[error("texel density factor {factor} is outside {} to {}", AtlasOptions::DENSITY_MIN, AtlasOptions::DENSITY_MAX)]
    Density {
        /// What was asked.
        factor: f32,
    },
    /// Invalid: density factors for another number of submeshes.
    #[error("{found} texel density factors for {submeshes} submeshes")]
    Densities {
        /// How many there are.
        found: usize,
        /// How many there must be, if any.
        submeshes: usize,
    },
    /// Invalid: there is nothing to unwrap.
    #[error("no face of the mesh has an area: there is nothing to unwrap ({faces} faces, {degenerate} degenerate)")]
    Empty {
        /// Faces of the mesh.
        faces: usize,
        /// Those without area.
        degenerate: usize,
    },
    /// The run was told to end: cancelled, or out of time. Never cached.
    #[error("{}", stopped(.stop, .unwrapper))]
    Stopped {
        /// Why.
        stop: Stop,
        /// The unwrapper that was at work.
        unwrapper: String,
    },
    /// No unwrapper on the ladder gave a layout that passes the checks.
    #[error("no valid atlas: {}{}", list_attempts(.attempts), advice(.attempts))]
    Failed {
        /// What each one said, in the order in which they were tried.
        attempts: Vec<FailedAttempt>,
    },
}

/// An unwrapper that was tried and set aside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedAttempt {
    /// Its name.
    pub unwrapper: String,
    /// Why its result was not taken.
    pub reason: String,
    /// Whether the charts were too many for the sheet.
    pub does_not_fit: bool,
}

pub(super) fn list_attempts(attempts: &[FailedAttempt]) -> String {
    attempts.iter().map(|a| format!("{}: {}", a.unwrapper, a.reason)).collect::<Vec<_>>().join("; ")
}

fn advice(attempts: &[FailedAttempt]) -> &'static str {
    if attempts.iter().any(|a| a.does_not_fit) {
        "; give the atlas a larger size or a smaller padding, or spread its submeshes over more sheets"
    } else if attempts.iter().any(|a| a.unwrapper != "planar") && !attempts.iter().any(|a| a.unwrapper == "planar") {
        "; use unwrapper = \"auto\", which falls back to planar charts"
    } else {
        ""
    }
}

fn stopped(stop: &Stop, unwrapper: &str) -> String {
    match stop {
        Stop::Cancelled => stop.to_string(),
        Stop::TimeLimit { seconds } => {
            let other = if unwrapper == "xatlas" { "\"uvunwrap\" or \"auto\"" } else { "\"xatlas\"" };
            let faster = if unwrapper == "planar" { "" } else { ", \"planar\" (coarse charts, fast)" };
            format!(
                "no atlas within {seconds} s ({unwrapper} was at work): raise time-limit (0 is none), give it fewer faces, or use \
                 unwrapper = {other}{faster}"
            )
        }
    }
}
