//! xatlas as an [`Unwrapper`]: encodes the request, has it run, decodes the reply.
//!
//! The stage starts no process; whoever calls it brings a function that does ([`kiln_xatlas::spawn::run_worker`]). What comes
//! back is bytes from outside: decoded with all counts checked, then measured like any other layout. xatlas knows no cuts,
//! so hard edges are chart borders only where it likes them to be.

use glam::Vec2;
use kiln_xatlas::protocol::{Reply, Request};

use super::{UnwrapError, UnwrapInput, UnwrapOutput, Unwrapper};

/// The worker program, behind a function that runs it: request in, reply out.
pub struct Xatlas<'a> {
    run: &'a dyn Fn(&[u8]) -> Result<Vec<u8>, UnwrapError>,
}

impl<'a> Xatlas<'a> {
    /// xatlas through `run`.
    pub fn new(run: &'a dyn Fn(&[u8]) -> Result<Vec<u8>, UnwrapError>) -> Xatlas<'a> {
        Xatlas { run }
    }
}

impl Unwrapper for Xatlas<'_> {
    fn name(&self) -> &str {
        "xatlas"
    }

    fn unwrap(&self, input: &UnwrapInput) -> Result<UnwrapOutput, UnwrapError> {
        let request = Request {
            size: input.size,
            padding: input.padding,
            positions: input.positions.iter().map(|p| p.to_array()).collect(),
            triangles: input.triangles.clone(),
        };
        let reply = (self.run)(&request.encode())?;
        match Reply::decode(&reply, input.triangles.len()).map_err(|e| UnwrapError::Worker(e.to_string()))? {
            Reply::Placed { charts, corners } => Ok(UnwrapOutput {
                corners: corners.into_iter().map(|corners| corners.map(Vec2::from_array)).collect(),
                charts,
            }),
            Reply::DoesNotFit { charts } => {
                Err(UnwrapError::DoesNotFit { charts, size: input.size, padding: input.padding })
            }
            Reply::Refused(text) => Err(UnwrapError::Refused(text)),
        }
    }
}
