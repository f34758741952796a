//! xatlas as an [`Unwrapper`]: encodes the request, has it run, decodes the reply, mends what overlaps.
//!
//! The stage starts no process; whoever calls it brings a function that does ([`kiln_xatlas::spawn::run_worker`]). What comes
//! back is bytes from outside: decoded with all counts checked, then measured like any other layout.
//!
//! xatlas' own test lets a chart's border cross itself near a point that the crossing edges share: of the bunny's 32 charts
//! at 6,944 faces three cover themselves, by up to a texel. So charts are measured here, and those that overlap are divided
//! between the two faces that do; the parts are told to be different groups, which never share a chart, and xatlas runs
//! again. It knows no cuts: hard edges are chart borders only where it likes them to be.

use glam::{DVec2, Vec2};
use kiln_xatlas::protocol::{Reply, Request};

use super::check::{OVERLAP_DEPTH, overlaps};
use super::planar::{divide, neighbours};
use super::{UnwrapError, UnwrapInput, UnwrapOutput, Unwrapper};

/// Runs of the worker before its overlaps are given up. Two or three are what models need.
const ROUNDS: usize = 8;

/// Runs the worker program once: request in, reply out.
pub type RunWorker<'a> = dyn Fn(&[u8]) -> Result<Vec<u8>, UnwrapError> + 'a;

/// The worker program, behind a function that runs it.
pub struct Xatlas<'a> {
    run: &'a RunWorker<'a>,
}

impl<'a> Xatlas<'a> {
    /// xatlas through `run`.
    pub fn new(run: &'a RunWorker<'a>) -> Xatlas<'a> {
        Xatlas { run }
    }

    fn ask(&self, request: &Request) -> Result<UnwrapOutput, UnwrapError> {
        let reply = (self.run)(&request.encode())?;
        match Reply::decode(&reply, request.triangles.len()).map_err(|e| UnwrapError::Worker(e.to_string()))? {
            Reply::Placed { charts, corners } => {
                let corners = corners.into_iter().map(|corners| corners.map(Vec2::from_array)).collect();
                Ok(UnwrapOutput { corners, charts })
            }
            Reply::DoesNotFit { charts } => {
                Err(UnwrapError::DoesNotFit { charts, size: request.size, padding: request.padding })
            }
            Reply::Refused(text) => Err(UnwrapError::Refused(text)),
        }
    }
}

impl Unwrapper for Xatlas<'_> {
    fn name(&self) -> &str {
        "xatlas"
    }

    fn unwrap(&self, input: &UnwrapInput) -> Result<UnwrapOutput, UnwrapError> {
        let mut request = Request {
            size: input.size,
            padding: input.padding,
            positions: input.positions.iter().map(|p| p.to_array()).collect(),
            triangles: input.triangles.clone(),
            groups: vec![0; input.triangles.len()],
        };
        let neighbours = neighbours(input);
        let mut charts = self.ask(&request)?;
        let mut groups = 1;
        for _ in 1..ROUNDS {
            let parts = overlapping_parts(&charts, &neighbours, input.size);
            if parts.is_empty() {
                break;
            }
            for part in parts {
                part.iter().for_each(|face| request.groups[*face as usize] = groups);
                groups += 1;
            }
            charts = self.ask(&request)?;
        }
        Ok(charts)
    }
}

/// Of each chart that covers itself, both parts: the faces nearer to the one and to the other of its first overlapping pair.
fn overlapping_parts(charts: &UnwrapOutput, neighbours: &[[u32; 3]], size: u32) -> Vec<Vec<u32>> {
    let triangles: Vec<[DVec2; 3]> = charts.corners.iter().map(|c| c.map(|uv| uv.as_dvec2())).collect();
    let mut divided = Vec::new();
    let mut parts = Vec::new();
    for (a, b) in overlaps(&triangles, f64::from(size), OVERLAP_DEPTH) {
        let chart = charts.charts[a as usize];
        if chart == UnwrapOutput::UNPLACED || chart != charts.charts[b as usize] || divided.contains(&chart) {
            continue;
        }
        divided.push(chart);
        let faces: Vec<u32> = (0..charts.charts.len() as u32).filter(|f| charts.charts[*f as usize] == chart).collect();
        let position = |face| faces.binary_search(&face).ok();
        if let (Some(a), Some(b)) = (position(a), position(b)) {
            parts.extend(divide(neighbours, &faces, a, b));
        }
    }
    parts
}
