//! Why an action runs, or an output is written: one variant a cause, for people and as JSON.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::hash::ContentHash;

/// The first cause found, in the order of the manifest's fields.
///
/// The JSON form is an object whose member `reason` is the variant's name in kebab-case; it is pinned by tests.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "reason", rename_all = "kebab-case")]
#[non_exhaustive]
pub enum StaleReason {
    /// The cache knows nothing about it: its first build here.
    NoRecord,
    /// What bears this id was another kind of stage.
    StageKindChanged {
        /// Kind in the last build.
        old: String,
        /// Kind now.
        new: String,
    },
    /// The stage's own semantic version was raised (or lowered).
    StageVersionChanged {
        /// Version of the last build.
        old: u32,
        /// Version of this program.
        new: u32,
    },
    /// A crate or library under the stage has another version or other features.
    ForeignVersionChanged {
        /// `name@version+features` of the last build; absent if it is a new one.
        old: Option<String>,
        /// The same of this program; absent if it is used no more.
        new: Option<String>,
    },
    /// The class of machines on which results are bit-identical is another one.
    NumericClassChanged {
        /// Class of the last build.
        old: Option<String>,
        /// Class of this machine.
        new: Option<String>,
    },
    /// Another kind of GPU, driver or shader.
    DeviceClassChanged {
        /// Class of the last build.
        old: Option<String>,
        /// Class of this device.
        new: Option<String>,
    },
    /// A parameter has another value, appeared or went away.
    ParameterChanged {
        /// Name, such as `levels[0].keep`.
        name: String,
        /// Value in the last build; absent if it had none.
        old: Option<String>,
        /// Value now; absent if it has none.
        new: Option<String>,
    },
    /// A file that the action reads has other bytes.
    InputFileChanged {
        /// The file, as the plan or the reading file names it.
        path: String,
        /// Content in the last build.
        old: ContentHash,
        /// Content now.
        new: ContentHash,
    },
    /// A file that the action read is gone.
    InputFileMissing {
        /// The file.
        path: String,
    },
    /// A file that the action looked for in vain, or did not read, is there.
    InputFileAdded {
        /// The file.
        path: String,
    },
    /// An action before it gave other bytes, or the input came or went.
    UpstreamOutputChanged {
        /// The input's name.
        input: String,
        /// The id of the action that gives it, or gave it.
        action: String,
        /// Content in the last build; absent if there was no such input.
        old: Option<ContentHash>,
        /// Content now; absent if there is no such input.
        new: Option<ContentHash>,
    },
    /// The cache entry vanished or was found damaged and moved aside.
    BlobLost {
        /// Which one: `record` or the output's name.
        what: String,
    },
    /// The output file is not there.
    OutputMissing {
        /// The output.
        path: String,
    },
    /// The output file holds other bytes than the build gives.
    OutputDiffers {
        /// The output.
        path: String,
    },
}

impl fmt::Display for StaleReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |value: &Option<String>| value.clone().unwrap_or_else(|| "(none)".into());
        let short = |hash: &Option<ContentHash>| hash.map_or_else(|| "(none)".into(), |hash| hash.short());
        match self {
            StaleReason::NoRecord => write!(f, "first build"),
            StaleReason::StageKindChanged { old, new } => write!(f, "kind of stage {old} -> {new}"),
            StaleReason::StageVersionChanged { old, new } => write!(f, "stage version {old} -> {new}"),
            StaleReason::ForeignVersionChanged { old, new } => {
                write!(f, "library {} -> {}", shown(old), shown(new))
            }
            StaleReason::NumericClassChanged { old, new } => {
                write!(f, "numeric class {} -> {}", shown(old), shown(new))
            }
            StaleReason::DeviceClassChanged { old, new } => write!(f, "device {} -> {}", shown(old), shown(new)),
            StaleReason::ParameterChanged { name, old, new } => {
                write!(f, "{name}: {} -> {}", shown(old), shown(new))
            }
            StaleReason::InputFileChanged { path, old, new } => {
                write!(f, "{path} changed: {} -> {}", old.short(), new.short())
            }
            StaleReason::InputFileMissing { path } => write!(f, "{path} is gone"),
            StaleReason::InputFileAdded { path } => write!(f, "{path} is new"),
            StaleReason::UpstreamOutputChanged { input, action, old, new } => {
                // Ids are long, and most name the asset that this is said of: the stage will do.
                let stage = action.rsplit_once('#').map_or(action.as_str(), |(_, stage)| stage);
                write!(f, "input `{input}` from {stage} changed: {} -> {}", short(old), short(new))
            }
            StaleReason::BlobLost { what } => write!(f, "cache entry lost: {what}"),
            StaleReason::OutputMissing { path } => write!(f, "{path} is missing"),
            StaleReason::OutputDiffers { path } => write!(f, "{path} differs from what the build gives"),
        }
    }
}
