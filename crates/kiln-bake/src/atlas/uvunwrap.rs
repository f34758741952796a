//! The built-in unwrapper: an adapter over the crate `uvunwrap` (pure Rust, bit-identical on any thread count and any CPU).
//!
//! The crate is asked to stop between the charts that it flattens and between its trials at packing them. It grows
//! all charts in one go, tests one chart for overlaps in one go, and packs one trial in one go: the limit of time is late by as
//! much. The test is what can be long: it takes boxes on a grid, and thousands of needles that lie askew in one chart share most
//! cells (hubs of such needles are cut before they get here).

use std::sync::OnceLock;

use glam::Vec2;
use uvunwrap::{Density, Error, MeshInput, Options, Packing, Progress, Stage, generate_with_progress};

use super::surface::Groups;
use super::{Stop, UnwrapError, UnwrapInput, UnwrapOutput, Unwrapper, Watch};

/// Parts that do not hang together above which charts are packed in rows instead of by shape. Packing by shape tries every
/// place for every chart: for 8,000 leaves minutes instead of a second, for a machine of 2,672 charts 28 s instead of 8 s, and
/// 23.1 % of the sheet instead of 22.8 %; for a helmet of 82 parts 9 s instead of 3 s, but 43 % instead of 38 %.
const FAST_PARTS: u32 = 100;

/// `uvunwrap` with its two limits on charts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uvunwrap {
    name: &'static str,
    /// Largest angle between a face's normal and its chart's mean, degrees. Wider: fewer seams, more stretch.
    max_chart_angle: f32,
    /// Largest ratio of a face's share of texels and its share of surface, either way, unitless.
    max_area_distortion: f32,
}

impl Uvunwrap {
    /// The crate's own limits: 70 degrees, factor 4.
    pub const STANDARD: Uvunwrap = Uvunwrap { name: "uvunwrap", max_chart_angle: 70.0, max_area_distortion: 4.0 };
    /// Flatter charts for surfaces on which the standard ones fail: 40 degrees, factor 2.
    pub const STRICT: Uvunwrap = Uvunwrap { name: "uvunwrap-strict", max_chart_angle: 40.0, max_area_distortion: 2.0 };
}

impl Default for Uvunwrap {
    fn default() -> Self {
        Uvunwrap::STANDARD
    }
}

impl Unwrapper for Uvunwrap {
    fn name(&self) -> &str {
        self.name
    }

    fn unwrap(&self, input: &UnwrapInput, watch: &Watch<'_>) -> Result<UnwrapOutput, UnwrapError> {
        let groups = Group::of(input);
        let meshes: Vec<MeshInput<'_>> = groups.iter().map(Group::mesh).collect();
        let packing = if parts(input) > FAST_PARTS { Packing::Fast } else { Packing::Shape };
        let density = match input.density {
            None => Density::Auto { page_size: input.size },
            Some(density) => Density::Fixed { texels_per_unit: density as f32, page_size: Some(input.size) },
        };
        let options = Options {
            packing,
            max_chart_angle: self.max_chart_angle,
            max_area_distortion: self.max_area_distortion,
            density,
            // The crate keeps this much around each chart, so twice as much between two and once to the edge.
            padding: input.padding.div_ceil(2),
            ..Options::default()
        };
        let does_not_fit = |charts| UnwrapError::DoesNotFit { charts, size: input.size, padding: input.padding };
        watch.go_on()?;
        let stopped = OnceLock::new();
        let told = |progress: Progress| tell(watch, progress, &stopped);
        let atlas = generate_with_progress(&meshes, &options, told).map_err(|error| match (error, stopped.get()) {
            (Error::Cancelled, Some(stop)) => UnwrapError::Stopped(*stop),
            (Error::AtlasTooLarge { .. } | Error::ChartTooLarge { .. }, _) => does_not_fit(0),
            (error, _) => UnwrapError::Refused(error.to_string()),
        })?;
        if atlas.page_count > 1 {
            return Err(does_not_fit(atlas.chart_count));
        }
        if atlas.meshes.len() != groups.len() {
            let (found, sent) = (atlas.meshes.len(), groups.len());
            return Err(UnwrapError::Refused(format!("{found} meshes came out of {sent}")));
        }
        let texels = Vec2::new(atlas.width as f32, atlas.height as f32);
        let faces = input.triangles.len();
        let mut output =
            UnwrapOutput { corners: vec![[Vec2::ZERO; 3]; faces], charts: vec![UnwrapOutput::UNPLACED; faces] };
        for (group, mesh) in groups.iter().zip(&atlas.meshes) {
            let vertex = |v: u32| &mesh.vertices[v as usize];
            for (face, t) in group.faces.iter().zip(mesh.indices.chunks_exact(3)) {
                output.corners[*face as usize] = [t[0], t[1], t[2]].map(|v| Vec2::from_array(vertex(v).uv) * texels);
                output.charts[*face as usize] = vertex(t[0]).chart.unwrap_or(UnwrapOutput::UNPLACED);
            }
        }
        Ok(output)
    }
}

/// Tells how far the crate is; false if it shall stop. Its packing does not know how many trials it needs: some 20.
fn tell(watch: &Watch<'_>, progress: Progress, stopped: &OnceLock<Stop>) -> bool {
    let share = progress.done as f32 / progress.total.unwrap_or(20).max(1) as f32;
    let (from, to, doing) = match progress.stage {
        Stage::Segmenting => (0.0, 0.1, "growing charts"),
        Stage::Parameterizing => (0.1, 0.3, "flattening charts"),
        Stage::Packing => (0.3, 0.95, "packing charts"),
        _ => (0.95, 1.0, "placing charts"),
    };
    watch.part(from, to).progress(share, doing);
    match watch.go_on() {
        Ok(()) => true,
        Err(stop) => {
            let _ = stopped.set(stop);
            false
        }
    }
}

/// The faces of one density factor, as the crate takes them: charts never span its meshes, and a mesh has a scale.
struct Group {
    /// Indices into the input's faces.
    faces: Vec<u32>,
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    cuts: Vec<[bool; 3]>,
    scale: f32,
}

impl Group {
    /// One for each of the input's groups; a single one is the input as it stands.
    fn of(input: &UnwrapInput) -> Vec<Group> {
        let all: Vec<[f32; 3]> = input.positions.iter().map(|p| p.to_array()).collect();
        if let [scale] = input.scales[..] {
            let faces = (0..input.triangles.len() as u32).collect();
            let (triangles, cuts) = (input.triangles.clone(), input.cuts.clone());
            return vec![Group { faces, positions: all, triangles, cuts, scale }];
        }
        let mut number = vec![(u32::MAX, 0); all.len()];
        let group = |(group, scale): (usize, &f32)| {
            let group = group as u32;
            let faces: Vec<u32> =
                (0..input.groups.len() as u32).filter(|f| input.groups[*f as usize] == group).collect();
            let mut positions = Vec::new();
            let mut local = |p: u32| {
                let (known, at) = &mut number[p as usize];
                if *known != group {
                    (*known, *at) = (group, positions.len() as u32);
                    positions.push(all[p as usize]);
                }
                *at
            };
            let triangles = faces.iter().map(|f| input.triangles[*f as usize].map(&mut local)).collect();
            let cuts = faces.iter().map(|f| input.cuts[*f as usize]).collect();
            Group { faces, positions, triangles, cuts, scale: *scale }
        };
        input.scales.iter().enumerate().map(group).collect()
    }

    fn mesh(&self) -> MeshInput<'_> {
        let triangles = self.triangles.as_flattened();
        MeshInput { seams: Some(&self.cuts), scale: self.scale, ..MeshInput::new(&self.positions, triangles) }
    }
}

/// Number of parts of the surface that share no point.
fn parts(input: &UnwrapInput) -> u32 {
    let mut points = Groups::new(input.positions.len());
    for [a, b, c] in &input.triangles {
        points.join(*a as usize, *b as usize);
        points.join(*b as usize, *c as usize);
    }
    points.numbers().1
}
