//! Someone who looks on: hears how far a run is, and may end it.
//!
//! Nothing here reads a clock, and no answer but "stop" changes what is done: a run that was not stopped gives what it gives
//! when nobody looks.

/// Why a run has to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Stop {
    /// Whoever asked for the result does not want it any more.
    #[error("cancelled")]
    Cancelled,
    /// It took longer than it may.
    #[error("time limit of {seconds} s")]
    TimeLimit {
        /// The limit.
        seconds: u64,
    },
}

/// Hears how far a run is, and may end it.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    progress: &'a (dyn Fn(f32, &str) + Sync),
    stop: &'a (dyn Fn() -> Option<Stop> + Sync),
    /// The part of the whole that is told here.
    low: f32,
    span: f32,
}

impl Watch<'static> {
    /// Nobody looks on.
    pub const NOBODY: Watch<'static> = Watch { progress: &|_, _| (), stop: &|| None, low: 0.0, span: 1.0 };
}

impl<'a> Watch<'a> {
    /// `progress` hears the share that is done, 0 to 1, and what is done now; `stop` is asked often whether to end. Both are
    /// called from any thread.
    pub fn new(progress: &'a (dyn Fn(f32, &str) + Sync), stop: &'a (dyn Fn() -> Option<Stop> + Sync)) -> Watch<'a> {
        Watch { progress, stop, low: 0.0, span: 1.0 }
    }

    /// The same for the part of this one from `low` to `high`.
    pub fn part(&self, low: f32, high: f32) -> Watch<'a> {
        Watch { low: self.low + self.span * low, span: self.span * (high - low), ..*self }
    }

    /// Says how far the part is, 0 to 1.
    pub fn progress(&self, done: f32, doing: &str) {
        (self.progress)(self.low + self.span * done.clamp(0.0, 1.0), doing);
    }

    /// Whether the run shall end.
    ///
    /// # Errors
    /// It shall, and why.
    pub fn go_on(&self) -> Result<(), Stop> {
        (self.stop)().map_or(Ok(()), Err)
    }
}
