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
use super::{UnwrapError, UnwrapInput, UnwrapOutput, Unwrapper, Watch};

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

    fn unwrap(&self, input: &UnwrapInput, watch: &Watch<'_>) -> Result<UnwrapOutput, UnwrapError> {
        let mut request = request(input);
        let neighbours = neighbours(input);
        watch.go_on()?;
        watch.progress(0.0, "in the worker");
        let mut charts = self.ask(&request)?;
        let mut groups = input.scales.len() as u32;
        for round in 1..ROUNDS {
            let parts = overlapping_parts(&charts, &neighbours, input.size);
            if parts.is_empty() {
                break;
            }
            for part in parts {
                part.iter().for_each(|face| request.groups[*face as usize] = groups);
                groups += 1;
            }
            watch.go_on()?;
            watch.progress(round as f32 / ROUNDS as f32, "in the worker again, to part charts that overlap");
            charts = self.ask(&request)?;
        }
        Ok(charts)
    }
}

/// The input in the worker's words. Each density factor is a group of its own, its places scaled: xatlas gives every length the
/// same number of texels.
fn request(input: &UnwrapInput) -> Request {
    let mut positions: Vec<[f32; 3]> = input.positions.iter().map(|p| p.to_array()).collect();
    let mut triangles = input.triangles.clone();
    if input.scales[..] != [1.0] {
        let mut number = vec![(u32::MAX, 0); positions.len()];
        let mut scaled = Vec::with_capacity(positions.len());
        for (group, scale) in (0u32..).zip(&input.scales) {
            for (triangle, _) in triangles.iter_mut().zip(&input.groups).filter(|(_, own)| **own == group) {
                *triangle = triangle.map(|p| {
                    let (known, at) = &mut number[p as usize];
                    if *known != group {
                        (*known, *at) = (group, scaled.len() as u32);
                        scaled.push(positions[p as usize].map(|c| c * scale));
                    }
                    *at
                });
            }
        }
        positions = scaled;
    }
    let density = input.density.map_or(0.0, |density| density as f32);
    Request { size: input.size, padding: input.padding, density, positions, triangles, groups: input.groups.clone() }
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
