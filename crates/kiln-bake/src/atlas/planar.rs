//! The last rung of the ladder: flat projections of small clusters, packed on shelves. It cannot fail on shape.
//!
//! ```text
//! for each unassigned face, largest first:
//!     cluster <- faces reached over uncut edges whose normal is within 40 degrees of the seed's
//! for each cluster: project along its seed's normal
//!     while two of its faces overlap: split it between the two (each face goes to the nearer, counted in faces)
//! scale every chart to its surface area and density factor; lay it flat; sort by height
//! bisect the density: fill shelves from left to right; keep the largest at which all shelves fit, or that which was asked
//! ```
//! A single face is its own isometry and overlaps nothing, so the splitting ends. Charts are more and coarser than
//! `uvunwrap`'s, and shelves waste more of the sheet.

use std::collections::VecDeque;

use glam::{DVec2, DVec3, Vec2};

use super::check::overlaps;
use super::surface::edges;
use super::{Stop, UnwrapError, UnwrapInput, UnwrapOutput, Unwrapper, Watch};

/// Cosine of the widest angle between a face and its cluster's seed: 40 degrees, so that no face loses more than a quarter
/// of its area by projection.
const CLUSTER_COSINE: f64 = 0.766_044_443_118_978;

/// Halvings of the density interval; the density is then exact to 1e-6.
const BISECTIONS: usize = 24;

/// Planar charts over clusters of faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Planar;

/// No neighbour.
const NONE: u32 = u32::MAX;

struct Chart {
    faces: Vec<u32>,
    /// `[faces.len()]`, least corner at the origin, surface units.
    corners: Vec<[DVec2; 3]>,
    extent: DVec2,
}

impl Unwrapper for Planar {
    fn name(&self) -> &str {
        "planar"
    }

    fn unwrap(&self, input: &UnwrapInput, watch: &Watch<'_>) -> Result<UnwrapOutput, UnwrapError> {
        let neighbours = neighbours(input);
        let mut charts = Vec::new();
        let mut done = 0;
        for cluster in clusters(input, &neighbours) {
            watch.progress(0.9 * done as f32 / input.triangles.len() as f32, "flattening clusters");
            done += cluster.len();
            flatten(input, &neighbours, cluster, &mut charts, watch)?;
        }
        watch.progress(0.9, "packing charts");
        let (density, origins) = pack(&charts, input)?;
        let mut output = UnwrapOutput {
            corners: vec![[Vec2::ZERO; 3]; input.triangles.len()],
            charts: vec![UnwrapOutput::UNPLACED; input.triangles.len()],
        };
        for (id, (chart, origin)) in charts.iter().zip(&origins).enumerate() {
            for (face, corners) in chart.faces.iter().zip(&chart.corners) {
                output.corners[*face as usize] = corners.map(|p| (p * density + *origin).as_vec2());
                output.charts[*face as usize] = id as u32;
            }
        }
        Ok(output)
    }
}

/// Twice the area along the normal of each face.
fn area_normal(input: &UnwrapInput, face: u32) -> DVec3 {
    let [a, b, c] = input.triangles[face as usize].map(|p| input.positions[p as usize].as_dvec3());
    (b - a).cross(c - a)
}

/// `[face_count] x 3`: the face across each edge, if the edge is uncut, has two faces, and both wind alike.
pub(super) fn neighbours(input: &UnwrapInput) -> Vec<[u32; 3]> {
    let mut neighbours = vec![[NONE; 3]; input.triangles.len()];
    for edge in edges(&input.triangles).chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let [(_, _, f, i), (_, _, g, j)] = *edge else { continue };
        let alike = input.triangles[f][i] != input.triangles[g][j];
        if f != g && alike && !input.cuts[f][i] && !input.cuts[g][j] {
            neighbours[f][i] = g as u32;
            neighbours[g][j] = f as u32;
        }
    }
    neighbours
}

fn clusters(input: &UnwrapInput, neighbours: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let normals: Vec<DVec3> = (0..input.triangles.len() as u32).map(|f| area_normal(input, f)).collect();
    let mut seeds: Vec<u32> = (0..normals.len() as u32).collect();
    let size = |f: u32| normals[f as usize].length();
    seeds.sort_by(|a, b| size(*b).total_cmp(&size(*a)).then(a.cmp(b)));
    let mut taken = vec![false; normals.len()];
    let mut clusters = Vec::new();
    for seed in seeds {
        if std::mem::replace(&mut taken[seed as usize], true) {
            continue;
        }
        let axis = normals[seed as usize].normalize();
        let mut cluster = vec![seed];
        let mut next = 0;
        while let Some(face) = cluster.get(next).copied() {
            next += 1;
            for other in neighbours[face as usize] {
                let near = |o: u32| normals[o as usize].dot(axis) >= CLUSTER_COSINE * size(o);
                if other != NONE && !taken[other as usize] && near(other) {
                    taken[other as usize] = true;
                    cluster.push(other);
                }
            }
        }
        clusters.push(cluster);
    }
    clusters
}

/// Projects a cluster (its seed first) and splits it until nothing overlaps.
fn flatten(
    input: &UnwrapInput,
    neighbours: &[[u32; 3]],
    cluster: Vec<u32>,
    charts: &mut Vec<Chart>,
    watch: &Watch<'_>,
) -> Result<(), Stop> {
    let mut rest = vec![cluster];
    while let Some(faces) = rest.pop() {
        watch.go_on()?;
        let chart = project(input, faces);
        let extent = chart.extent.max_element();
        // Half of what the check forgives, were the chart as large as the sheet.
        let depth = extent * 0.5 * super::check::OVERLAP_DEPTH / f64::from(input.size);
        match overlaps(&chart.corners, extent, depth).first() {
            Some((a, b)) => rest.extend(divide(neighbours, &chart.faces, *a as usize, *b as usize)),
            None => charts.push(chart),
        }
    }
    Ok(())
}

fn project(input: &UnwrapInput, faces: Vec<u32>) -> Chart {
    let axis = area_normal(input, faces[0]).normalize();
    let (right, up) = axis.any_orthonormal_pair();
    let place = |p: u32| {
        let p = input.positions[p as usize].as_dvec3();
        DVec2::new(p.dot(right), p.dot(up))
    };
    let mut corners: Vec<[DVec2; 3]> = faces.iter().map(|f| input.triangles[*f as usize].map(place)).collect();
    let surface: f64 = faces.iter().map(|f| area_normal(input, *f).length()).sum();
    let flat: f64 = corners.iter().map(|[a, b, c]| (b - a).perp_dot(c - a).abs()).sum();
    let factor = f64::from(input.scales[input.groups[faces[0] as usize] as usize]);
    let scale = factor * if flat > 0.0 { (surface / flat).sqrt() } else { 1.0 };
    let (lo, hi) = bounds(&corners);
    let lying = (hi - lo).x >= (hi - lo).y;
    for p in corners.as_flattened_mut() {
        let q = (*p - lo) * scale;
        // A quarter turn lays tall charts down; it mirrors nothing.
        *p = if lying { q } else { DVec2::new(q.y, (hi - lo).x * scale - q.x) };
    }
    let extent = bounds(&corners).1;
    Chart { faces, corners, extent }
}

fn bounds(corners: &[[DVec2; 3]]) -> (DVec2, DVec2) {
    let first = corners[0][0];
    corners.as_flattened().iter().fold((first, first), |(lo, hi), p| (lo.min(*p), hi.max(*p)))
}

/// Two parts of `faces`: those nearer to `a` and those nearer to `b` (positions in `faces`), counted in steps over edges.
pub(super) fn divide(neighbours: &[[u32; 3]], faces: &[u32], a: usize, b: usize) -> [Vec<u32>; 2] {
    let mut order: Vec<u32> = (0..faces.len() as u32).collect();
    order.sort_unstable_by_key(|i| faces[*i as usize]);
    let position = |f: u32| order.binary_search_by_key(&f, |i| faces[*i as usize]).ok().map(|at| order[at] as usize);
    let mut side = vec![None; faces.len()];
    (side[a], side[b]) = (Some(0), Some(1));
    let mut queue = VecDeque::from([a, b]);
    let mut parts = [vec![faces[a]], vec![faces[b]]];
    while let Some(at) = queue.pop_front() {
        for next in neighbours[faces[at] as usize].into_iter().filter(|f| *f != NONE).filter_map(position) {
            if side[next].is_none() {
                side[next] = side[at];
                parts[side[at].unwrap_or(0)].push(faces[next]);
                queue.push_back(next);
            }
        }
    }
    parts
}

/// Density (texels per surface unit) and `[charts.len()]` least corners in texels, at the largest density found at which
/// all shelves fit the sheet.
fn pack(charts: &[Chart], input: &UnwrapInput) -> Result<(f64, Vec<DVec2>), UnwrapError> {
    let margin = f64::from(input.padding.div_ceil(2));
    let size = f64::from(input.size);
    let mut order: Vec<usize> = (0..charts.len()).collect();
    let extent = |i: usize| charts[i].extent;
    order.sort_by(|a, b| extent(*b).y.total_cmp(&extent(*a).y).then(a.cmp(b)));
    let place = |density: f64| {
        let mut origins = vec![DVec2::ZERO; charts.len()];
        let (mut x, mut shelf, mut top) = (0.0, 0.0, 0.0);
        for i in &order {
            let cell = (extent(*i) * density).ceil().max(DVec2::ONE) + 2.0 * margin;
            if x + cell.x > size {
                (x, shelf) = (0.0, top);
            }
            if cell.x > size || shelf + cell.y > size {
                return None;
            }
            origins[*i] = DVec2::new(x, shelf) + margin;
            x += cell.x;
            top = f64::max(top, shelf + cell.y);
        }
        Some(origins)
    };
    let longest = order.iter().map(|i| extent(*i).max_element()).fold(0.0, f64::max);
    // Below a hundredth of a texel for the longest chart there is nothing to look at.
    let (mut low, mut high) = (0.01 / longest, size / longest);
    let too_many = UnwrapError::DoesNotFit { charts: charts.len() as u32, size: input.size, padding: input.padding };
    if let Some(density) = input.density {
        return place(density).map(|origins| (density, origins)).ok_or(too_many);
    }
    let mut best = place(low).ok_or(too_many)?;
    for _ in 0..BISECTIONS {
        let middle = (low * high).sqrt();
        match place(middle) {
            Some(origins) => (low, best) = (middle, origins),
            None => high = middle,
        }
    }
    Ok((low, best))
}
