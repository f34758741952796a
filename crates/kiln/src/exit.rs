//! The one table from what happened to the process' exit code.

use std::process::ExitCode;

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Exit {
    /// All done, every budget met.
    Done,
    /// Finished, but a budget was missed, or a warning was denied, or a check found something.
    Short,
    /// Failed: invalid or unsupported input, or the system refused.
    Failed,
    /// The command line or a `--set` makes no sense.
    Usage,
}

impl Exit {
    /// Its number.
    pub fn code(self) -> u8 {
        match self {
            Exit::Done => 0,
            Exit::Short => 1,
            Exit::Failed => 2,
            Exit::Usage => 64,
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(exit.code())
    }
}
