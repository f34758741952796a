//! What can be wrong with a model: defects with paths, kept apart in three families.

use std::fmt;

use serde::Serialize;

/// One thing that is wrong, and where.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Defect {
    /// Place in the model: `meshes[2].primitives[0].attributes.POSITION`, `images[3].uri`, or a file's name.
    pub path: String,
    /// What is wrong there: expected and found.
    pub message: String,
}

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path, self.message)
    }
}

/// Why a model was not imported. A model with defects of several families gets the first of them in the order of the
/// variants; the list then names only that family's defects, since the others may follow from them.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImportError {
    /// The model breaks the format's rules or a limit.
    #[error("invalid model: {}", list(.0))]
    Invalid(Vec<Defect>),
    /// The model may be right, but uses something that kiln does not read.
    #[error("unsupported: {}", list(.0))]
    Unsupported(Vec<Defect>),
    /// A file could not be read.
    #[error("cannot read: {}", list(.0))]
    Io(Vec<Defect>),
}

impl ImportError {
    /// All defects of the family, in the order in which they lie in the file; the first 100, then a count.
    pub fn defects(&self) -> &[Defect] {
        match self {
            ImportError::Invalid(list) | ImportError::Unsupported(list) | ImportError::Io(list) => list,
        }
    }

    pub(super) fn invalid(path: impl Into<String>, message: impl Into<String>) -> ImportError {
        ImportError::Invalid(vec![Defect { path: path.into(), message: message.into() }])
    }

    pub(super) fn unsupported(path: impl Into<String>, message: impl Into<String>) -> ImportError {
        ImportError::Unsupported(vec![Defect { path: path.into(), message: message.into() }])
    }
}

fn list(defects: &[Defect]) -> String {
    defects.iter().map(Defect::to_string).collect::<Vec<_>>().join("; ")
}

/// Longest list of defects that is kept for one family; a broken file may have millions.
const DEFECT_LIMIT: usize = 100;

#[derive(Default)]
struct Family {
    kept: Vec<Defect>,
    more: u64,
}

impl Family {
    fn push(&mut self, path: impl Into<String>, message: impl Into<String>) {
        if self.kept.len() < DEFECT_LIMIT {
            self.kept.push(Defect { path: path.into(), message: message.into() });
        } else {
            self.more += 1;
        }
    }

    fn finish(mut self) -> Vec<Defect> {
        if self.more > 0 {
            self.kept.push(Defect { path: "model".into(), message: format!("and {} more", self.more) });
        }
        self.kept
    }
}

/// Collects defects while a model is looked through.
#[derive(Default)]
pub(super) struct Defects {
    invalid: Family,
    unsupported: Family,
    io: Family,
}

impl Defects {
    pub(super) fn invalid(&mut self, path: impl Into<String>, message: impl Into<String>) {
        self.invalid.push(path, message);
    }

    pub(super) fn unsupported(&mut self, path: impl Into<String>, message: impl Into<String>) {
        self.unsupported.push(path, message);
    }

    pub(super) fn io(&mut self, path: impl Into<String>, message: impl Into<String>) {
        self.io.push(path, message);
    }

    /// How many so far, of all families.
    pub(super) fn count(&self) -> u64 {
        [&self.invalid, &self.unsupported, &self.io].iter().map(|family| family.kept.len() as u64 + family.more).sum()
    }

    /// Nothing so far, or the error.
    pub(super) fn check(&mut self) -> Result<(), ImportError> {
        let Defects { invalid, unsupported, io } = std::mem::take(self);
        if !invalid.kept.is_empty() {
            Err(ImportError::Invalid(invalid.finish()))
        } else if !unsupported.kept.is_empty() {
            Err(ImportError::Unsupported(unsupported.finish()))
        } else if !io.kept.is_empty() {
            Err(ImportError::Io(io.finish()))
        } else {
            Ok(())
        }
    }
}
