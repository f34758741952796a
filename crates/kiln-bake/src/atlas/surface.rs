//! The surface that unwrappers see: distinct places at unit scale, faces with an area, cuts along hard edges.

use std::collections::{HashMap, HashSet};

use glam::{DVec3, Vec3};
use kiln_asset::{FaceId, Mesh};

use super::{AtlasOptions, UnwrapInput};

/// Least altitude of a face that gets a chart, as a share of the bounding box's diagonal (unitless). Below it the face is
/// thinner than a hundredth of a texel on any sheet and its shape drowns in the rounding of 32-bit UVs. `uvunwrap` draws its
/// own line at 1e-6; ours lies above, so that a face which passes here is never left out there.
const ALTITUDE_MIN: f64 = 2e-6;

/// Cosine of the angle between the normals of two wedges beyond which their edge is hard: 30 degrees.
const HARD_COSINE: f32 = 0.866_025_4;

/// Least cosine between the normals of two faces that are taken for neighbours at an edge of more than two: 60 degrees.
const PAIR_COSINE: f64 = 0.5;

/// Most faces at one edge among which pairs are sought: the search is quadratic, and beyond this the edge is no surface.
const PAIRED_FACES_MAX: usize = 64;

/// Cosine between the normals of two faces below which they lie back to back: 172 degrees. No chart crosses such an edge.
const FOLD_COSINE: f64 = -0.99;

/// Most faces around one place that may share a chart. `uvunwrap` looks for overlaps by boxes on a grid, and the boxes of a hub's
/// spokes cover most of it: the time grows with the third power. 2,000 spokes take 0.8 s; 50,000 had not ended after six minutes.
const HUB_FACES_MAX: usize = 2048;

/// Faces of each part of a hub that has more. 50,000 spokes take 22 s in parts of 64, 6 s in these.
const HUB_PART_FACES: usize = 16;

/// A mesh made ready for unwrapping.
pub(super) struct Surface {
    /// What unwrappers get.
    pub input: UnwrapInput,
    /// `[input.triangles.len()]`, the mesh's face behind each of the input's, ascending.
    pub faces: Vec<FaceId>,
    /// Hard edges among the cuts.
    pub hard_edges: u32,
}

impl Surface {
    /// The surface of `faces` (ascending, each with an area). Its scale is that of the whole mesh, so that sheets compare.
    pub(super) fn of(mesh: &Mesh, options: &AtlasOptions, faces: Vec<FaceId>) -> Surface {
        let points = unit_points(mesh);
        let triangles: Vec<[u32; 3]> = faces.iter().map(|f| mesh.face_points(*f).map(|p| p.0)).collect();
        let (places, triangles) = fans(&points, &triangles);
        let positions = distinct(&places);
        let (groups, scales) = groups(mesh, options, &faces);
        let (mut cuts, hard_edges) = cuts(mesh, &faces, &triangles);
        if scales.len() > 1 {
            cut_between(&groups, &triangles, &mut cuts);
        }
        cut_hubs(&triangles, positions.len(), &mut cuts);
        // Several sheets lie side by side: no chart may touch the edge between them.
        let padding = if options.sheets > 1 { options.padding.max(1) } else { options.padding };
        let size = options.size;
        let input = UnwrapInput { positions, triangles, cuts, groups, scales, density: None, size, padding };
        Surface { input, faces, hard_edges }
    }
}

/// `[faces.len()]`, the group of each face, and `[group_count]`, the density factor of each: faces of one factor are one group.
fn groups(mesh: &Mesh, options: &AtlasOptions, faces: &[FaceId]) -> (Vec<u32>, Vec<f32>) {
    let mut scales: Vec<f32> = Vec::new();
    let mut of_submesh = vec![u32::MAX; mesh.submeshes.len()];
    let groups = faces
        .iter()
        .map(|f| {
            let submesh = mesh.face_submesh[f.index()].index();
            if of_submesh[submesh] == u32::MAX {
                let factor = options.density(submesh);
                let known = scales.iter().position(|scale| *scale == factor);
                of_submesh[submesh] = known.unwrap_or(scales.len()) as u32;
                if known.is_none() {
                    scales.push(factor);
                }
            }
            of_submesh[submesh]
        })
        .collect();
    (groups, scales)
}

/// Cuts every edge between faces of different groups.
fn cut_between(groups: &[u32], triangles: &[[u32; 3]], cuts: &mut [[bool; 3]]) {
    for edge in edges(triangles).chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if edge.iter().any(|(_, _, f, _)| groups[*f] != groups[edge[0].2]) {
            edge.iter().for_each(|(_, _, f, k)| cuts[*f][*k] = true);
        }
    }
}

/// Cuts every hub of more than [`HUB_FACES_MAX`] faces off from what lies around it, and into parts of [`HUB_PART_FACES`].
fn cut_hubs(triangles: &[[u32; 3]], places: usize, cuts: &mut [[bool; 3]]) {
    let mut faces_at = vec![0usize; places];
    triangles.as_flattened().iter().for_each(|p| faces_at[*p as usize] += 1);
    for hub in (0..places).filter(|p| faces_at[*p] > HUB_FACES_MAX).map(|p| p as u32) {
        // Each spoke as (far end, face, edge), and each face with its corner at the hub.
        let mut spokes = Vec::with_capacity(2 * faces_at[hub as usize]);
        let mut around = Vec::with_capacity(faces_at[hub as usize]);
        for (f, t) in triangles.iter().enumerate() {
            if let Some(k) = t.iter().position(|p| *p == hub) {
                spokes.extend([(t[(k + 1) % 3], around.len(), k), (t[(k + 2) % 3], around.len(), (k + 2) % 3)]);
                around.push((f, k));
            }
        }
        spokes.sort_unstable();
        let part = runs(&spokes, around.len());
        for spoke in spokes.chunk_by(|a, b| a.0 == b.0) {
            if spoke.iter().any(|(_, i, _)| part[*i] != part[spoke[0].1]) {
                spoke.iter().for_each(|(_, i, edge)| cuts[around[*i].0][*edge] = true);
            }
        }
        around.iter().for_each(|(f, k)| cuts[*f][(k + 1) % 3] = true);
    }
}

/// The part of each of `count` faces around a hub: runs along its spokes (sorted by far end), from the lowest face on.
fn runs(spokes: &[(u32, usize, usize)], count: usize) -> Vec<usize> {
    let mut beside = vec![Vec::new(); count];
    for spoke in spokes.chunk_by(|a, b| a.0 == b.0) {
        for pair in spoke.windows(2) {
            beside[pair[0].1].push(pair[1].1);
            beside[pair[1].1].push(pair[0].1);
        }
    }
    let mut part = vec![usize::MAX; count];
    let mut seen = 0;
    for first in 0..count {
        let mut stack = vec![first];
        while let Some(i) = stack.pop() {
            if part[i] == usize::MAX {
                part[i] = seen / HUB_PART_FACES;
                seen += 1;
                stack.extend(&beside[i]);
            }
        }
    }
    part
}

/// `points` once for every fan of faces that hangs together around one over paired edges, and `triangles` over them: what
/// only touches (both sides of a leaf, the pages of a book) comes apart. An edge of two faces pairs them
/// unless they lie back to back; of several at one edge those with opposite directions are paired, the flattest pair first.
fn fans(points: &[Vec3], triangles: &[[u32; 3]]) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let normal = |f: usize| {
        let [a, b, c] = triangles[f].map(|p| points[p as usize].as_dvec3());
        (b - a).cross(c - a).normalize_or_zero()
    };
    let mut corners = Groups::new(3 * triangles.len());
    let mut join = |(f, i): (usize, usize), (g, j): (usize, usize)| {
        let (far, near) = if triangles[f][i] == triangles[g][j] { (j, (j + 1) % 3) } else { ((j + 1) % 3, j) };
        corners.join(3 * f + i, 3 * g + far);
        corners.join(3 * f + (i + 1) % 3, 3 * g + near);
    };
    for edge in edges(triangles).chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if let [(_, _, f, i), (_, _, g, j)] = *edge {
            if normal(f).dot(normal(g)) > FOLD_COSINE {
                join((f, i), (g, j));
            }
            continue;
        }
        if edge.len() > PAIRED_FACES_MAX {
            continue;
        }
        let (onward, back): (Vec<_>, Vec<_>) = edge.iter().partition(|(low, _, f, k)| triangles[*f][*k] == *low);
        let pair = |a: &(u32, u32, usize, usize), b: &(u32, u32, usize, usize)| {
            (normal(a.2).dot(normal(b.2)), (a.2, a.3), (b.2, b.3))
        };
        let mut pairs: Vec<_> = onward.iter().flat_map(|a| back.iter().map(move |b| pair(a, b))).collect();
        pairs.retain(|(cosine, ..)| *cosine >= PAIR_COSINE);
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut taken = HashSet::new();
        for (_, a, b) in pairs {
            if !taken.contains(&a) && !taken.contains(&b) {
                taken.extend([a, b]);
                join(a, b);
            }
        }
    }
    let (fan, count) = corners.numbers();
    let mut places = vec![Vec3::ZERO; count as usize];
    for (corner, fan) in fan.iter().enumerate() {
        places[*fan as usize] = points[triangles[corner / 3][corner % 3] as usize];
    }
    (places, fan.chunks_exact(3).map(|f| [f[0], f[1], f[2]]).collect())
}

/// Disjoint groups of things numbered from 0 (union-find; the lowest member stands for its group).
pub(super) struct Groups(Vec<u32>);

impl Groups {
    pub(super) fn new(count: usize) -> Groups {
        Groups((0..count as u32).collect())
    }

    fn leader(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    pub(super) fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.leader(a as u32), self.leader(b as u32));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// The group of each, numbered by first member, and how many there are.
    pub(super) fn numbers(mut self) -> (Vec<u32>, u32) {
        let mut numbers = vec![0; self.0.len()];
        let mut count = 0;
        for i in 0..self.0.len() {
            let leader = self.leader(i as u32) as usize;
            if leader == i {
                numbers[i] = count;
                count += 1;
            } else {
                numbers[i] = numbers[leader];
            }
        }
        (numbers, count)
    }
}

/// The faces that must have a chart: three points, no altitude below [`ALTITUDE_MIN`] of the mesh's diagonal.
pub(super) fn chartable(mesh: &Mesh) -> Vec<FaceId> {
    let places = unit_points(mesh);
    let has_area = |f: &FaceId| {
        let points = mesh.face_points(*f);
        let [a, b, c] = points.map(|p| places[p.index()].as_dvec3());
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        let distinct = points[0] != points[1] && points[1] != points[2] && points[2] != points[0];
        distinct && (b - a).cross(c - a).length() > ALTITUDE_MIN * longest
    };
    (0..mesh.face_count() as u32).map(FaceId).filter(has_area).collect()
}

/// `[point_count]`, each point where its first vertex lies, scaled about the box's centre to unit diagonal.
fn unit_points(mesh: &Mesh) -> Vec<Vec3> {
    let mut points = vec![None; mesh.point_count()];
    for (position, point) in mesh.positions.iter().zip(&mesh.points) {
        points[point.index()].get_or_insert(position.as_dvec3());
    }
    let points: Vec<DVec3> = points.into_iter().flatten().collect();
    let Some(first) = points.first() else { return Vec::new() };
    let (lo, hi) = points.iter().fold((*first, *first), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let diagonal = (hi - lo).length();
    let scale = if diagonal > 0.0 { 1.0 / diagonal } else { 1.0 };
    let centre = 0.5 * (lo + hi);
    points.iter().map(|p| ((*p - centre) * scale).as_vec3()).collect()
}

/// `points` with no two bitwise equal: of several at one place all but the first move by a few units in the last place, over
/// a small block of neighbours (some 1e-6 of the diagonal even for thousands).
fn distinct(points: &[Vec3]) -> Vec<Vec3> {
    let bits = |p: Vec3| p.to_array().map(|c| (c + 0.0).to_bits());
    let mut taken: HashSet<[u32; 3]> = HashSet::with_capacity(points.len());
    let mut steps: HashMap<[u32; 3], u32> = HashMap::new();
    points
        .iter()
        .map(|p| {
            let home = bits(*p);
            let mut at = home;
            while !taken.insert(at) {
                let step = steps.entry(home).or_insert(0);
                *step += 1;
                at = [home[0] + *step % 16, home[1] + *step / 16 % 16, home[2] + *step / 256];
            }
            Vec3::from_array(at.map(f32::from_bits))
        })
        .collect()
}

/// `[face_count] x 3` cuts, and how many edges they are: the hard edges, unless more than half of the inner edges are hard
/// (a flat-shaded mesh, where every face would become a chart).
fn cuts(mesh: &Mesh, faces: &[FaceId], triangles: &[[u32; 3]]) -> (Vec<[bool; 3]>, u32) {
    let mut cuts = vec![[false; 3]; faces.len()];
    let Some(normals) = &mesh.normals else { return (cuts, 0) };
    let normal = |face: usize, k: usize| normals[mesh.triangles[faces[face].index()][k % 3] as usize];
    let mut hard = Vec::new();
    let mut inner = 0usize;
    for edge in edges(triangles).chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let [(_, _, f, i), (_, _, g, j)] = *edge else { continue };
        inner += 1;
        let same_way = triangles[f][i] == triangles[g][j];
        let (far, near) = if same_way { (j, j + 1) } else { (j + 1, j) };
        let least = normal(f, i).dot(normal(g, far)).min(normal(f, i + 1).dot(normal(g, near)));
        if least < HARD_COSINE {
            hard.push([(f, i), (g, j)]);
        }
    }
    if 2 * hard.len() > inner {
        return (cuts, 0);
    }
    for (face, k) in hard.iter().flatten() {
        cuts[*face][*k] = true;
    }
    (cuts, hard.len() as u32)
}

/// Every use of an edge as (lower point, higher point, face, corner at which it starts), sorted.
pub(super) fn edges(triangles: &[[u32; 3]]) -> Vec<(u32, u32, usize, usize)> {
    let mut edges = Vec::with_capacity(3 * triangles.len());
    for (f, t) in triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            edges.push((a.min(b), a.max(b), f, k));
        }
    }
    edges.sort_unstable();
    edges
}
