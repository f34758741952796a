//! From hits to texels: every map's value at each sample of a bin, then the filter.
//!
//! Values are averaged as what they mean: light in linear units, normals as vectors in the texel's own frame, numbers by the sample
//! that weighs most. Only samples of the texel's own chart count: the chart that weighs most among its samples.

use glam::Vec3;
use kiln_asset::{DeepRaster, ExtraMap, MapRole, Mesh, Precision, Raster};
use kiln_geom::colour::{linear_to_srgb, unorm8};
use kiln_geom::raster::Rect;

use crate::dilation::TexelKind;
use crate::occlusion::{Occluder, Openness};

use super::maps::RoleSource;
use super::materials::Groups;
use super::options::{BakeError, BakeOptions, Depth, NormalSpace, OcclusionSource, Picture};
use super::resolve::{HitPoint, Needs, TangentFrame, mix3};

/// A map to be written.
pub(crate) struct Planned<'a> {
    pub(crate) what: What,
    /// What it reads of the source's pictures.
    pub(crate) source: Option<RoleSource<'a>>,
}

/// What a map shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum What {
    Role(MapRole),
    Extra(ExtraMap),
}

/// How a map's values are averaged and written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// RGB linear light, written as sRGB in 8 bits.
    Colour,
    /// Numbers as they are.
    Linear,
    /// A unit vector.
    Normal,
    /// A name: never averaged.
    Number,
}

impl What {
    pub(crate) fn kind(self) -> Kind {
        match self {
            What::Role(MapRole::Normal) | What::Extra(ExtraMap::ObjectNormal | ExtraMap::BentNormal) => Kind::Normal,
            What::Role(role) if role.is_srgb() => Kind::Colour,
            What::Extra(ExtraMap::ObjectId | ExtraMap::MaterialId) => Kind::Number,
            _ => Kind::Linear,
        }
    }

    /// How finely a map of this kind is written; `None`: 8 bits.
    fn precision(self, depth: Depth) -> Option<Precision> {
        match (self, depth) {
            (What::Role(_), Depth::Eight) => None,
            (
                What::Extra(
                    ExtraMap::Height
                    | ExtraMap::Position
                    | ExtraMap::Curvature
                    | ExtraMap::ObjectId
                    | ExtraMap::MaterialId,
                ),
                _,
            )
            | (_, Depth::Float) => Some(Precision::Float),
            (_, Depth::Eight | Depth::Sixteen) => Some(Precision::Unorm16),
        }
    }

    /// An empty picture for it.
    pub(crate) fn picture(self, size: u32, depth: Depth) -> Picture {
        match self.precision(depth) {
            None => Picture::Plain(Raster::filled(size, size, [0; 4])),
            Some(precision) => Picture::Deep(DeepRaster::filled(size, size, precision, [0.0; 4])),
        }
    }

    /// How texels that nothing was baked into are filled.
    pub(crate) fn filling(self, depth: Depth) -> TexelKind {
        match self.kind() {
            Kind::Colour if self.precision(depth).is_none() => TexelKind::Srgb,
            Kind::Colour | Kind::Linear => TexelKind::Linear,
            Kind::Normal if self.halved(depth) => TexelKind::Normal,
            Kind::Normal => TexelKind::Vector,
            Kind::Number => TexelKind::Nearest,
        }
    }

    /// Whether it is made of rays from the high surface.
    pub(crate) fn looks_out(self, options: &BakeOptions) -> bool {
        match self {
            What::Extra(ExtraMap::AmbientOcclusion | ExtraMap::BentNormal) => true,
            What::Role(MapRole::Occlusion) => options.occlusion != OcclusionSource::Source,
            _ => false,
        }
    }

    /// Whether unit vectors are written as `(v + 1) / 2`.
    pub(crate) fn halved(self, depth: Depth) -> bool {
        match self {
            What::Role(role) => role == MapRole::Normal,
            What::Extra(_) => self.precision(depth) == Some(Precision::Unorm16),
        }
    }
}

/// Everything that values are worked out from.
pub(crate) struct Evaluator<'a> {
    pub(crate) high: &'a Mesh,
    pub(crate) low: &'a Mesh,
    pub(crate) high_normals: &'a [Vec3],
    pub(crate) low_normals: &'a [Vec3],
    /// `[low vertex_count]`; empty where no tangent-space map is asked for.
    pub(crate) low_tangents: &'a [glam::Vec4],
    pub(crate) groups: &'a Groups,
    pub(crate) maps: &'a [Planned<'a>],
    /// `[high vertex_count]`; empty where no map shows it.
    pub(crate) curvature: &'a [f32],
    /// Where a map looks out from the high surface.
    pub(crate) occluder: Option<Occluder<'a>>,
    pub(crate) options: &'a BakeOptions,
}

impl Evaluator<'_> {
    /// What of a hit the maps read.
    pub(crate) fn needs(&self) -> Needs {
        Needs {
            steps: self.maps.iter().any(|m| m.source.as_ref().is_some_and(RoleSource::reads_pictures)),
            height: self.maps.iter().any(|m| m.what == What::Extra(ExtraMap::Height)),
        }
    }

    /// The values of a map at hits, by column; vectors in `[-1, 1]`.
    #[inline]
    pub(crate) fn each(&self, map: &Planned<'_>, row: &Row, put: impl FnMut(usize, [f32; 4])) {
        let one = |value: f32| [value, value, value, 1.0];
        match (map.what, &map.source) {
            (What::Extra(ExtraMap::AmbientOcclusion), _) => row.open(put, |_, open| one(open.share)),
            (What::Extra(ExtraMap::BentNormal), _) => row.open(put, |_, open| open.bent.extend(1.0).to_array()),
            (What::Role(MapRole::Occlusion), Some(source)) => match self.options.occlusion {
                OcclusionSource::Source => row.hits(put, |hit| self.role(source, hit)),
                OcclusionSource::Rays => row.open(put, |_, open| one(open.share)),
                OcclusionSource::Both => row.open(put, |hit, open| one(open.share * self.role(source, hit)[0])),
            },
            (What::Role(MapRole::Normal), Some(source)) => match self.options.space {
                NormalSpace::Object => {
                    row.hits(put, |hit| source.normal(hit, self.high_normals).extend(1.0).to_array());
                }
                NormalSpace::Tangent => row.hits(put, |hit| {
                    self.frame(hit).encode(source.normal(hit, self.high_normals)).extend(1.0).to_array()
                }),
            },
            (What::Role(_), Some(source)) => row.hits(put, |hit| self.role(source, hit)),
            (What::Extra(extra), source) => row.hits(put, |hit| self.extra(extra, source.as_ref(), hit)),
            // Every role has a source.
            (What::Role(_), None) => row.hits(put, |_| [0.0, 0.0, 0.0, 1.0]),
        }
    }

    /// How open the high surface is at each hit of a row. `place`: the row's first sample. The samples of a texel share its rays.
    pub(crate) fn look_out(&self, occluder: &Occluder<'_>, place: [u32; 2], row: &mut Row) {
        let (size, samples) = (self.options.size, self.options.samples);
        row.open.clear();
        row.open.extend(row.hits.iter().map(|(column, hit)| {
            let (x, y) = (place[0] + column, place[1]);
            let seed = (y / samples).wrapping_mul(size).wrapping_add(x / samples);
            let part = [(y % samples) * samples + x % samples, samples * samples];
            occluder.part_at(self.place(hit), self.geometric(hit), hit.high as u32, seed, part)
        }));
    }

    fn role(&self, source: &RoleSource<'_>, hit: &HitPoint) -> [f32; 4] {
        let submesh = self.low.face_submesh[hit.low].index();
        source.value(hit, self.groups.materials[self.groups.of_submesh[submesh]])
    }

    fn extra(&self, extra: ExtraMap, source: Option<&RoleSource<'_>>, hit: &HitPoint) -> [f32; 4] {
        let one = |value: f32| [value, value, value, 1.0];
        let submesh = self.high.face_submesh[hit.high];
        match extra {
            ExtraMap::Height => one(hit.height),
            ExtraMap::Position => self.place(hit).extend(1.0).to_array(),
            ExtraMap::ObjectNormal => self.geometric(hit).extend(1.0).to_array(),
            ExtraMap::ObjectId => one(submesh.0 as f32),
            ExtraMap::MaterialId => {
                let material = self.high.submeshes[submesh.index()].material;
                one(material.map_or(-1.0, |m| m.0 as f32))
            }
            ExtraMap::Opacity => one(source.map_or(1.0, |s| s.opacity(hit))),
            ExtraMap::Coverage => one(1.0),
            ExtraMap::Curvature => {
                let corners =
                    self.high.triangles[hit.high].map(|v| self.curvature.get(v as usize).copied().unwrap_or(0.0));
                one(corners.iter().zip(hit.high_bary).map(|(c, w)| c * w).sum())
            }
            // Of the row's openness.
            ExtraMap::AmbientOcclusion | ExtraMap::BentNormal => one(0.0),
        }
    }

    /// The place on the high surface.
    fn place(&self, hit: &HitPoint) -> Vec3 {
        mix3(self.high.face_positions(kiln_asset::FaceId(hit.high as u32)), hit.high_bary)
    }

    /// The high mesh's interpolated normal, without its maps, towards the line.
    fn geometric(&self, hit: &HitPoint) -> Vec3 {
        let corners = self.high.triangles[hit.high].map(|v| self.high_normals[v as usize]);
        let turn = if hit.turned { -1.0 } else { 1.0 };
        turn * mix3(corners, hit.high_bary).normalize_or_zero()
    }

    fn frame(&self, hit: &HitPoint) -> TangentFrame {
        let corners = self.low.triangles[hit.low].map(|v| v as usize);
        TangentFrame::new(corners.map(|v| self.low_normals[v]), corners.map(|v| self.low_tangents[v]), hit.low_bary)
    }
}

/// The hits of one row of samples.
#[derive(Default)]
pub(crate) struct Row {
    /// Columns and hits.
    pub(crate) hits: Vec<(u32, HitPoint)>,
    /// `[hits]`; empty where no map shows it.
    pub(crate) open: Vec<Openness>,
}

impl Row {
    #[inline]
    fn hits(&self, mut put: impl FnMut(usize, [f32; 4]), value: impl Fn(&HitPoint) -> [f32; 4]) {
        self.hits.iter().for_each(|(column, hit)| put(*column as usize, value(hit)));
    }

    #[inline]
    fn open(&self, mut put: impl FnMut(usize, [f32; 4]), value: impl Fn(&HitPoint, &Openness) -> [f32; 4]) {
        let all = self.hits.iter().zip(&self.open);
        all.for_each(|((column, hit), open)| put(*column as usize, value(hit, open)));
    }
}

/// The samples of a bin, evaluated.
pub(crate) struct Samples<'a> {
    pub(crate) rect: Rect,
    /// `[rows x columns]` low face + 1.
    pub(crate) owners: &'a [u32],
    /// `[rows x columns]` high face + 1.
    pub(crate) winners: &'a [u32],
    /// `[maps][rows x columns]`.
    pub(crate) values: &'a [Vec<[f32; 4]>],
    /// `[face_count]` of the low mesh.
    pub(crate) charts: &'a [u32],
}

/// What the filter says of one texel.
pub(crate) struct Texel {
    /// Chart + 1, 0 = none of the texel's own samples lies in one.
    pub(crate) chart: u32,
    /// Sum of the weights of the chart's samples with a hit, and of all samples.
    pub(crate) weight: [f32; 2],
}

/// The tent's weights of the samples around a texel, in one direction.
pub(crate) struct Tent {
    samples: u32,
    /// Weights from the first sample within a texel's radius of its centre to the last.
    weights: Vec<f32>,
}

impl Tent {
    pub(crate) fn new(samples: u32) -> Tent {
        if samples == 1 {
            return Tent { samples, weights: vec![1.0] };
        }
        let reach = samples as f32;
        // Sample k lies (k + 1/2) / samples - 1 texels from the centre.
        let weights = (0..2 * samples).map(|k| 1.0 - ((k as f32 + 0.5) / reach - 1.0).abs()).collect();
        Tent { samples, weights }
    }

    /// Visits the samples of a texel with index in `rect` and weight; `own`: inside the texel's square.
    fn each(&self, texel: [u32; 2], rect: Rect, mut visit: impl FnMut(usize, f32, bool)) {
        let width = (rect.x1 - rect.x0) as usize;
        let border = i64::from(if self.samples > 1 { self.samples / 2 } else { 0 });
        let first = |t: u32| i64::from(t * self.samples) - border;
        let inside = |k: usize| (k as i64) >= border && (k as i64) < border + i64::from(self.samples);
        for (ky, wy) in self.weights.iter().enumerate() {
            let y = first(texel[1]) + ky as i64;
            if y < i64::from(rect.y0) || y >= i64::from(rect.y1) {
                continue;
            }
            let row = (y - i64::from(rect.y0)) as usize * width;
            for (kx, wx) in self.weights.iter().enumerate() {
                let x = first(texel[0]) + kx as i64;
                if x < i64::from(rect.x0) || x >= i64::from(rect.x1) {
                    continue;
                }
                visit(row + (x - i64::from(rect.x0)) as usize, wx * wy, inside(kx) && inside(ky));
            }
        }
    }
}

impl Samples<'_> {
    /// Filters one texel: `out` gets one value a map, not yet normalised where it is a vector.
    pub(crate) fn texel(&self, tent: &Tent, texel: [u32; 2], kinds: &[Kind], out: &mut [[f32; 4]]) -> Texel {
        let chart_of = |index: usize| self.charts[self.owners[index] as usize - 1] + 1;
        // The chart with most weight within the texel's square; nearly always the only one.
        let (mut chart, mut own, mut others) = (0, 0.0f32, false);
        tent.each(texel, self.rect, |index, weight, inside| {
            if !inside || self.owners[index] == 0 {
                return;
            }
            let at = chart_of(index);
            if chart == 0 {
                chart = at;
            }
            if at == chart {
                own += weight;
            } else {
                others = true;
            }
        });
        if others {
            chart = self.heaviest(tent, texel);
        }
        let (mut hit, mut all, mut most) = (0.0f32, 0.0f32, 0.0f32);
        out.fill([0.0; 4]);
        if chart == 0 {
            return Texel { chart, weight: [0.0; 2] };
        }
        tent.each(texel, self.rect, |index, weight, _| {
            all += weight;
            if self.winners[index] == 0 || chart_of(index) != chart {
                return;
            }
            hit += weight;
            let heaviest = weight > most;
            most = most.max(weight);
            for ((value, kind), sum) in self.values.iter().zip(kinds).zip(out.iter_mut()) {
                let value = value[index];
                if *kind != Kind::Number {
                    *sum = std::array::from_fn(|c| sum[c] + weight * value[c]);
                } else if heaviest {
                    *sum = value;
                }
            }
        });
        if hit > 0.0 {
            for (sum, kind) in out.iter_mut().zip(kinds) {
                if *kind != Kind::Number {
                    *sum = sum.map(|c| c / hit);
                }
            }
        }
        Texel { chart, weight: [hit, all] }
    }

    fn heaviest(&self, tent: &Tent, texel: [u32; 2]) -> u32 {
        let mut sums: Vec<(u32, f32)> = Vec::new();
        tent.each(texel, self.rect, |index, weight, inside| {
            if !inside || self.owners[index] == 0 {
                return;
            }
            let chart = self.charts[self.owners[index] as usize - 1] + 1;
            match sums.iter_mut().find(|s| s.0 == chart) {
                Some(sum) => sum.1 += weight,
                None => sums.push((chart, weight)),
            }
        });
        sums.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        sums.first().map_or(0, |s| s.0)
    }
}

/// One map's rows of a band.
pub(crate) enum Rows<'a> {
    Plain(&'a mut [[u8; 4]]),
    Deep(&'a mut [[f32; 4]]),
}

impl Rows<'_> {
    /// Writes a filtered value. `halved`: unit vectors as `(v + 1) / 2`.
    #[inline]
    pub(crate) fn write(&mut self, index: usize, value: [f32; 4], kind: Kind, halved: bool) {
        let value = if kind == Kind::Normal {
            let unit = Vec3::new(value[0], value[1], value[2]).try_normalize().unwrap_or(Vec3::Z);
            if halved { (0.5 * unit + 0.5).extend(1.0) } else { unit.extend(1.0) }.to_array()
        } else {
            value
        };
        match self {
            Rows::Plain(rows) => {
                let [r, g, b, a] = value;
                let rgb = [r, g, b].map(|c| if kind == Kind::Colour { linear_to_srgb(c) } else { unorm8(c) });
                rows[index] = [rgb[0], rgb[1], rgb[2], unorm8(a)];
            }
            Rows::Deep(rows) => rows[index] = value.map(|c| if c.is_finite() { c } else { 0.0 }),
        }
    }
}

/// Each picture's rows, band by band.
pub(crate) fn bands(pictures: &mut [Picture], texels: usize) -> Vec<Vec<Rows<'_>>> {
    let mut bands: Vec<Vec<Rows<'_>>> = Vec::new();
    for picture in pictures {
        let mut push = |k: usize, rows| {
            if bands.len() <= k {
                bands.push(Vec::new());
            }
            bands[k].push(rows);
        };
        match picture {
            Picture::Plain(raster) => {
                raster.texels.chunks_mut(texels).enumerate().for_each(|(k, rows)| push(k, Rows::Plain(rows)));
            }
            Picture::Deep(raster) => {
                raster.texels.chunks_mut(texels).enumerate().for_each(|(k, rows)| push(k, Rows::Deep(rows)));
            }
        }
    }
    bands
}

/// Options that a bake cannot go by.
pub(crate) fn check_options(options: &BakeOptions, reach: [f32; 2]) -> Result<(), BakeError> {
    let refuse = |name, found: String, expected: String| Err(BakeError::Option { name, found, expected });
    if options.size == 0 || options.size > BakeOptions::SIZE_MAX {
        return refuse("size", options.size.to_string(), format!("1 to {} texels", BakeOptions::SIZE_MAX));
    }
    if ![1, 2, 4, 8].contains(&options.samples) {
        return refuse("samples", options.samples.to_string(), "1, 2, 4 or 8".into());
    }
    if !(1..=4096).contains(&options.rays) {
        return refuse("rays", options.rays.to_string(), "1 to 4096".into());
    }
    if let Some(length) = options.ray_length.filter(|l| !(*l > 0.0 && l.is_finite())) {
        return refuse("ray-length", length.to_string(), "a positive length".into());
    }
    for (name, value) in [("front", reach[0]), ("back", reach[1])] {
        // The negation catches NaN.
        if !(value >= 0.0 && value.is_finite()) {
            return refuse(name, value.to_string(), "a length".into());
        }
    }
    if reach[0] + reach[1] == 0.0 {
        return refuse("front", reach[0].to_string(), "a positive length where back is 0".into());
    }
    Ok(())
}
