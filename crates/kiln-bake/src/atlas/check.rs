//! Post-conditions of an atlas, measured on the mesh alone: nothing here trusts an unwrapper.
//!
//! A chart is what hangs together in the sheet: faces that share a (point, UV). Overlap is decided by geometry, not by texel
//! centres, so it is found between them too: two faces overlap if no line separates them to within [`OVERLAP_DEPTH`].
//! Padding is counted in whole empty texels between the texels that charts touch, in the chessboard metric (a diagonal step
//! is one step), by fronts that grow from all charts at once until two meet.
//!
//! Every sheet is measured by itself. A `u` of sheet `s` is rounded to `2^-24` times the power of two above `s`, so faces there
//! may lose an area that was thinner than that; on the first sheet, where nothing of the kind happens, none may.

use glam::{DVec2, Vec2};
use kiln_asset::{FaceId, Mesh, UvLayout};

use super::face_list;
use super::orient::signed_area;
use super::surface::{Groups, chartable};

/// Depth up to which two faces may dip into each other, texels: above the rounding of 32-bit UVs on the largest sheet
/// (5e-4), far below what any filter sees.
pub const OVERLAP_DEPTH: f64 = 1.0 / 64.0;

/// How far a face must reach into a texel to touch it, texels; the same rounding.
const TOUCH_DEPTH: f64 = 1.0 / 256.0;

/// Altitude below which a face's winding is noise, texels.
const THIN: f64 = 1.0 / 256.0;

/// Altitude below which a face may lose its area on a sheet beyond the first, texels: several times the rounding there.
const LOST: f64 = 1.0 / 64.0;

/// No more overlapping pairs are listed than this.
const OVERLAPS_LISTED: usize = 1000;

/// A broken promise of an atlas.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AtlasDefect {
    /// The mesh has no `atlas_uv`.
    #[error("the mesh has no atlas UVs")]
    NoUvs,
    /// An unwrapper's answer has another number of faces than the question.
    #[error("{found} faces came back for {expected}")]
    Malformed {
        /// Faces sent.
        expected: usize,
        /// Faces received.
        found: usize,
    },
    /// Faces got no chart.
    #[error("{count} faces were not placed, the first is {input_face} of those sent")]
    Unplaced {
        /// How many.
        count: usize,
        /// Index among the faces that were sent to the unwrapper.
        input_face: usize,
    },
    /// Faces lie outside the sheet.
    #[error("faces outside the sheet: {}", face_list(.0))]
    Outside(Vec<FaceId>),
    /// Faces lie on another sheet than the first face of their submesh.
    #[error("faces on another sheet than the rest of their submesh: {}", face_list(.0))]
    Scattered(Vec<FaceId>),
    /// Faces with an area on the surface have none on the sheet.
    #[error("faces without area on the sheet: {}", face_list(.0))]
    Collapsed(Vec<FaceId>),
    /// Faces wind the wrong way: mirrored, or folded over their chart.
    #[error("mirrored faces: {}", face_list(.0))]
    Mirrored(Vec<FaceId>),
    /// Faces overlap.
    #[error("{} pairs of faces overlap, the first are {} and {}", .0.len(), .0[0].0, .0[0].1)]
    Overlap(Vec<(FaceId, FaceId)>),
    /// Charts come too near each other.
    #[error("{found} texels between two charts, {expected} asked")]
    Padding {
        /// Least empty space asked, texels.
        expected: u32,
        /// Least empty space found, texels.
        found: u32,
    },
    /// A chart comes too near the sheet's edge.
    #[error("{found} texels between a chart and the sheet's edge, {expected} asked")]
    Edge {
        /// Least empty space asked, texels.
        expected: u32,
        /// Least empty space found, texels.
        found: u32,
    },
}

/// What [`check`] measured; the fields are those of [`super::AtlasReport`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measure {
    /// Charts with an area.
    pub charts: u32,
    /// Charts of less than one texel's area.
    pub tiny_charts: u32,
    /// Share of the sheets inside charts, `[0, 1]`.
    pub coverage: f64,
    /// Least empty space between two charts, texels.
    pub padding: Option<u32>,
    /// Least empty space to the sheet's edge, texels.
    pub edge: u32,
    /// Texels per object unit.
    pub texels_per_unit: f64,
    /// `[submesh_count]`, texels per object unit of each; 0 for those without an area.
    pub of_submesh: Vec<f64>,
    /// L2 texture stretch, 1 at best.
    pub stretch: f64,
    /// Longest by shortest extent of a surface circle on the sheet, area-weighted mean.
    pub anisotropy: f64,
}

/// Checks `mesh.atlas_uv` against `layout` (its `chart_count` is not read) and measures it.
///
/// # Errors
/// Every kind of defect that was found on the first sheet that has any, once, with the faces that have it.
pub fn check(mesh: &Mesh, layout: &UvLayout) -> Result<Measure, Vec<AtlasDefect>> {
    let Some(uvs) = &mesh.atlas_uv else { return Err(vec![AtlasDefect::NoUvs]) };
    check_on(mesh, layout, &sheets_of(mesh, uvs, layout.sheets)?)
}

/// A face that [`check_on`] shall not see.
pub(super) const UNSEEN: u32 = u32::MAX;

/// [`check`] with the sheet of each face told (`[face_count]`, [`UNSEEN`] for those to leave out) instead of read off its UVs.
pub(super) fn check_on(mesh: &Mesh, layout: &UvLayout, sheets: &[u32]) -> Result<Measure, Vec<AtlasDefect>> {
    let Some(uvs) = &mesh.atlas_uv else { return Err(vec![AtlasDefect::NoUvs]) };
    let size = layout.size;
    let texels = |f: FaceId| {
        let first = DVec2::new(f64::from(sheets[f.index()]), 0.0);
        mesh.triangles[f.index()].map(|v| (uvs[v as usize].as_dvec2() - first) * f64::from(size))
    };
    let mut defects = Vec::new();
    let mut list = |faces: Vec<FaceId>, defect: fn(Vec<FaceId>) -> AtlasDefect| {
        if !faces.is_empty() {
            defects.push(defect(faces));
        }
    };

    let inside = |uv: &DVec2| uv.min_element() >= 0.0 && uv.max_element() <= f64::from(size);
    let seen = |f: &FaceId| sheets[f.index()] != UNSEEN;
    let all = || (0..mesh.face_count() as u32).map(FaceId).filter(seen);
    list(all().filter(|f| !texels(*f).iter().all(inside)).collect(), AtlasDefect::Outside);
    let area = |f: &FaceId| signed_area(texels(*f));
    // A face without area on the surface may have none here, but then it must not cover anything either.
    let covering: Vec<FaceId> = all().filter(|f| area(f) != 0.0).collect();
    let triangles: Vec<[DVec2; 3]> = covering.iter().map(|f| texels(*f)).collect();
    let mut measure = Measure::default();
    measure_stretch(mesh, &covering, &triangles, layout, &mut measure);
    let thin = |f: &FaceId| sheets[f.index()] > 0 && altitude(mesh, *f) * measure.texels_per_unit < LOST;
    let required = chartable(mesh);
    list(required.iter().copied().filter(|f| seen(f) && area(f) == 0.0 && !thin(f)).collect(), AtlasDefect::Collapsed);
    let mirrored = |f: &FaceId| area(f) > 0.5 * THIN * longest_edge(texels(*f));
    list(covering.iter().copied().filter(mirrored).collect(), AtlasDefect::Mirrored);
    if !defects.is_empty() {
        return Err(defects);
    }

    measure.edge = size;
    for sheet in 0..layout.sheets.max(1) {
        let here = |f: &FaceId| sheets[f.index()] == sheet;
        let faces: Vec<FaceId> = covering.iter().copied().filter(here).collect();
        check_sheet(mesh, &faces, &texels, layout, &mut measure)?;
    }
    Ok(measure)
}

/// The sheet of each face.
fn sheets_of(mesh: &Mesh, uvs: &[Vec2], sheets: u32) -> Result<Vec<u32>, Vec<AtlasDefect>> {
    if sheets <= 1 {
        return Ok(vec![0; mesh.face_count()]);
    }
    let of = |t: &[u32; 3]| UvLayout::sheet_of(t.map(|v| uvs[v as usize])).min(sheets - 1);
    let found: Vec<u32> = mesh.triangles.iter().map(of).collect();
    let mut of_submesh = vec![u32::MAX; mesh.submeshes.len()];
    let mut scattered = Vec::new();
    for (face, (submesh, sheet)) in mesh.face_submesh.iter().zip(&found).enumerate() {
        let first = &mut of_submesh[submesh.index()];
        if *first == u32::MAX {
            *first = *sheet;
        }
        if *first != *sheet {
            scattered.push(FaceId(face as u32));
        }
    }
    if scattered.is_empty() { Ok(found) } else { Err(vec![AtlasDefect::Scattered(scattered)]) }
}

/// Overlap, padding and charts of one sheet, added to `measure`. `faces`: those that cover something of it.
fn check_sheet(
    mesh: &Mesh,
    faces: &[FaceId],
    texels: &dyn Fn(FaceId) -> [DVec2; 3],
    layout: &UvLayout,
    measure: &mut Measure,
) -> Result<(), Vec<AtlasDefect>> {
    let mut defects = Vec::new();
    let triangles: Vec<[DVec2; 3]> = faces.iter().map(|f| texels(*f)).collect();
    let overlaps = overlaps(&triangles, f64::from(layout.size), OVERLAP_DEPTH);
    if !overlaps.is_empty() {
        let pairs = overlaps.iter().map(|(a, b)| (faces[*a as usize], faces[*b as usize])).collect();
        defects.push(AtlasDefect::Overlap(pairs));
    }
    let charts = charts_of(mesh, faces);
    let count = charts.iter().max().map_or(0, |c| c + 1);
    measure.charts += count;
    let (padding, edge) = clearances(&triangles, &charts, layout.size, layout.padding);
    if let Some(found) = padding.filter(|found| *found < layout.padding) {
        defects.push(AtlasDefect::Padding { expected: layout.padding, found });
    }
    let expected = (layout.padding / 2).max(u32::from(layout.sheets > 1));
    if edge < expected {
        defects.push(AtlasDefect::Edge { expected, found: edge });
    }
    measure.padding = measure.padding.into_iter().chain(padding).min();
    measure.edge = measure.edge.min(edge);
    let mut chart_area = vec![0.0; count as usize];
    for (chart, triangle) in charts.iter().zip(&triangles) {
        chart_area[*chart as usize] += signed_area(*triangle).abs();
    }
    measure.tiny_charts += chart_area.iter().filter(|area| **area < 1.0).count() as u32;
    if defects.is_empty() { Ok(()) } else { Err(defects) }
}

/// Shortest extent of a face on the surface, object units.
fn altitude(mesh: &Mesh, face: FaceId) -> f64 {
    let [a, b, c] = mesh.face_positions(face).map(|p| p.as_dvec3());
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    if longest > 0.0 { (b - a).cross(c - a).length() / longest } else { 0.0 }
}

fn longest_edge([a, b, c]: [DVec2; 3]) -> f64 {
    (b - a).length().max((c - b).length()).max((a - c).length())
}

/// Pairs (lower, higher) of `triangles` that no line separates to within `depth`, sorted; the first thousand found. All
/// coordinates in `[0, extent]`; `depth` in the same unit.
///
/// A grid of about one cell a triangle holds each triangle in the cells it touches; pairs that share a cell and a range of rows
/// are tried. Within a cell triangles stand by their first row, so that a cell that holds a whole statue does not try all pairs.
pub(super) fn overlaps(triangles: &[[DVec2; 3]], extent: f64, depth: f64) -> Vec<(u32, u32)> {
    let side = (triangles.len() as f64).sqrt().ceil().clamp(1.0, 1024.0) as u32;
    let cells_from_unit = f64::from(side) / extent;
    let mut entries: Vec<(u32, u32)> = Vec::new();
    for (t, triangle) in triangles.iter().enumerate() {
        touched(triangle.map(|p| p * cells_from_unit), side, 0.0, |y, columns| {
            entries.extend(columns.map(|x| (y * side + x, t as u32)));
        });
    }
    entries.sort_unstable();
    let mut pairs = Vec::new();
    let rows = |t: u32| {
        let [a, b, c] = triangles[t as usize].map(|p| p.y);
        (a.min(b).min(c), a.max(b).max(c))
    };
    let mut sorted: Vec<((f64, f64), u32)> = Vec::new();
    for cell in entries.chunk_by(|a, b| a.0 == b.0) {
        sorted.clear();
        sorted.extend(cell.iter().map(|(_, t)| (rows(*t), *t)));
        sorted.sort_unstable_by(|a, b| a.0.0.total_cmp(&b.0.0).then(a.1.cmp(&b.1)));
        for (i, ((_, last), a)) in sorted.iter().enumerate() {
            // What begins below the last row of `a` is parted from it by a horizontal line.
            for (_, b) in sorted[i + 1..].iter().take_while(|((first, _), _)| first <= last) {
                if shared_depth(&triangles[*a as usize], &triangles[*b as usize]) > depth {
                    pairs.push((*a.min(b), *a.max(b)));
                }
            }
        }
        if pairs.len() >= OVERLAPS_LISTED {
            break;
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The least distance by which one of two triangles must move for a line to part them; zero or less if one does already.
/// Separating axes: the normals of the six edges.
fn shared_depth(a: &[DVec2; 3], b: &[DVec2; 3]) -> f64 {
    let mut least = f64::INFINITY;
    for triangle in [a, b] {
        for k in 0..3 {
            let edge = triangle[(k + 1) % 3] - triangle[k];
            let length = edge.length();
            if length == 0.0 {
                continue;
            }
            let axis = edge.perp() / length;
            let span = |t: &[DVec2; 3]| {
                let along = t.map(|p| p.dot(axis));
                (along[0].min(along[1]).min(along[2]), along[0].max(along[1]).max(along[2]))
            };
            let ((a_low, a_high), (b_low, b_high)) = (span(a), span(b));
            least = least.min(a_high.min(b_high) - a_low.max(b_low));
            if least <= 0.0 {
                return least;
            }
        }
    }
    least
}

/// The chart of each face of `faces`, numbered by first face: faces that share a point at one UV belong together.
fn charts_of(mesh: &Mesh, faces: &[FaceId]) -> Vec<u32> {
    let uvs = mesh.atlas_uv.as_deref().unwrap_or_default();
    let corner = |f: FaceId, k: usize| {
        let v = mesh.triangles[f.index()][k] as usize;
        (mesh.points[v], uvs[v].to_array().map(|c| (c + 0.0).to_bits()))
    };
    let mut corners: Vec<_> = (0..faces.len()).flat_map(|i| (0..3).map(move |k| (corner(faces[i], k), i))).collect();
    corners.sort_unstable();
    let mut charts = Groups::new(faces.len());
    for pair in corners.windows(2) {
        if pair[0].0 == pair[1].0 {
            charts.join(pair[0].1, pair[1].1);
        }
    }
    charts.numbers().0
}

/// Least empty texels between two charts (`None` for a single one) and between a chart and the sheet's edge. Gaps are
/// looked for up to `4 * padding + 16` texels; a wider one counts as that.
fn clearances(triangles: &[[DVec2; 3]], charts: &[u32], size: u32, padding: u32) -> (Option<u32>, u32) {
    const EMPTY: u32 = u32::MAX;
    let width = size as usize;
    let mut owner = vec![EMPTY; width * width];
    let mut edge = size;
    let mut shared = false;
    for (triangle, chart) in triangles.iter().zip(charts) {
        touched(*triangle, size, TOUCH_DEPTH, |y, columns| {
            edge = edge.min(y).min(size - 1 - y).min(*columns.start()).min(size - 1 - columns.end());
            for owner in &mut owner[y as usize * width..][*columns.start() as usize..=*columns.end() as usize] {
                shared |= *owner != EMPTY && *owner != *chart;
                *owner = *chart;
            }
        });
    }
    if charts.iter().max().is_none_or(|last| *last == 0) {
        return (None, edge);
    }
    if shared {
        return (Some(0), edge);
    }
    // Fronts of all charts advance by one texel a round. Where two meet lies a shortest way between two charts: steps of
    // one front + steps of the other + the step between them, less one, are the empty texels on it.
    let limit = 4 * padding + 16;
    let mut front: Vec<u32> = (0..owner.len() as u32).filter(|t| owner[*t as usize] != EMPTY).collect();
    let mut steps = vec![0u16; owner.len()];
    for round in 0..=limit / 2 {
        let mut gap = u32::MAX;
        let mut next = Vec::new();
        for texel in front {
            let own = owner[texel as usize];
            for neighbour in neighbours(texel, size) {
                match owner[neighbour as usize] {
                    EMPTY => next.push((neighbour, own)),
                    other if other != own => gap = gap.min(round + u32::from(steps[neighbour as usize])),
                    _ => {}
                }
            }
        }
        if gap != u32::MAX {
            return (Some(gap), edge);
        }
        front = Vec::with_capacity(next.len());
        for (texel, own) in next {
            if owner[texel as usize] == EMPTY {
                owner[texel as usize] = own;
                steps[texel as usize] = round as u16 + 1;
                front.push(texel);
            }
        }
    }
    (Some(limit), edge)
}

/// The up to eight neighbours of a texel.
fn neighbours(texel: u32, size: u32) -> impl Iterator<Item = u32> {
    let (x, y) = (texel % size, texel / size);
    let range = move |c: u32| c.saturating_sub(1)..=(c + 1).min(size - 1);
    range(y).flat_map(move |y| range(x).map(move |x| y * size + x)).filter(move |t| *t != texel)
}

/// Visits the cells of a `size x size` grid of unit cells that the triangle reaches into by more than `depth`, row by row
/// as (row, columns); what lies outside the grid is moved to its rim. A triangle thinner than `depth` touches at least the
/// cells in its middle.
fn touched(triangle: [DVec2; 3], size: u32, depth: f64, mut visit: impl FnMut(u32, std::ops::RangeInclusive<u32>)) {
    let cells = |low: f64, high: f64| {
        let (first, last) = ((low + depth).floor(), (high - depth).ceil() - 1.0);
        let middle = (0.5 * (low + high)).floor();
        let rim = f64::from(size - 1);
        let (first, last) = if first <= last { (first, last) } else { (middle, middle) };
        (first.clamp(0.0, rim) as u32, last.clamp(0.0, rim) as u32)
    };
    let [a, b, c] = triangle;
    let (first, last) = cells(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
    for row in first..=last {
        // A slab a little smaller than the row, unless the triangle is thinner than what was taken away.
        let slab = (f64::from(row) + depth, f64::from(row + 1) - depth);
        let Some((low, high)) = slab_extent(&triangle, slab.0, slab.1)
            .or_else(|| slab_extent(&triangle, f64::from(row), f64::from(row + 1)))
        else {
            continue;
        };
        let (first, last) = cells(low, high);
        visit(row, first..=last);
    }
}

/// Extent in x of the part of a triangle with `low <= y <= high`.
fn slab_extent(triangle: &[DVec2; 3], low: f64, high: f64) -> Option<(f64, f64)> {
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut add = |x: f64| (least, most) = (least.min(x), most.max(x));
    for k in 0..3 {
        let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
        if (low..=high).contains(&a.y) {
            add(a.x);
        }
        for y in [low, high] {
            if (a.y - y) * (b.y - y) < 0.0 {
                add(a.x + (y - a.y) / (b.y - a.y) * (b.x - a.x));
            }
        }
    }
    (least <= most).then_some((least, most))
}

/// Fills in coverage, density, stretch and anisotropy. `triangles`: the faces in texels of their sheets.
fn measure_stretch(mesh: &Mesh, faces: &[FaceId], triangles: &[[DVec2; 3]], layout: &UvLayout, measure: &mut Measure) {
    let (mut texels, mut surface, mut stretch, mut anisotropy) = (0.0, 0.0, 0.0, 0.0);
    let mut of_submesh = vec![(0.0f64, 0.0f64); mesh.submeshes.len()];
    for (face, uv) in faces.iter().zip(triangles) {
        let [p, q, r] = mesh.face_positions(*face).map(|p| p.as_dvec3());
        let area = 0.5 * (q - p).cross(r - p).length();
        let texel_area = signed_area(*uv);
        texels += texel_area.abs();
        surface += area;
        let of_submesh = &mut of_submesh[mesh.face_submesh[face.index()].index()];
        (of_submesh.0, of_submesh.1) = (of_submesh.0 + texel_area.abs(), of_submesh.1 + area);
        if area == 0.0 {
            continue;
        }
        // Derivatives of the place on the surface by u and v (Sander et al. 2001, section 3).
        let [a, b, c] = uv;
        let by_u = (p * (b.y - c.y) + q * (c.y - a.y) + r * (a.y - b.y)) / (2.0 * texel_area);
        let by_v = (p * (c.x - b.x) + q * (a.x - c.x) + r * (b.x - a.x)) / (2.0 * texel_area);
        let (uu, uv, vv) = (by_u.dot(by_u), by_u.dot(by_v), by_v.dot(by_v));
        let root = ((uu - vv) * (uu - vv) + 4.0 * uv * uv).sqrt();
        stretch += 0.5 * (uu + vv) * area;
        anisotropy += ((uu + vv + root) / (uu + vv - root).max(f64::MIN_POSITIVE)).sqrt().min(1e6) * area;
    }
    let density = |(texels, surface): (f64, f64)| if surface > 0.0 { (texels / surface).sqrt() } else { 0.0 };
    measure.of_submesh = of_submesh.into_iter().map(density).collect();
    if surface > 0.0 && texels > 0.0 {
        let square_size = f64::from(layout.size) * f64::from(layout.size) * f64::from(layout.sheets.max(1));
        measure.coverage = texels / square_size;
        measure.texels_per_unit = (texels / surface).sqrt();
        measure.stretch = (stretch / surface).sqrt() * measure.texels_per_unit;
        measure.anisotropy = anisotropy / surface;
    }
}
