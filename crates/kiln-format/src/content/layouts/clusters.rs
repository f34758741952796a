//! Cluster DAGs.

use super::{Check, Findings, Finest};
use crate::error::Code;
use crate::layout::{ClusterRecord, ClusterView, GroupRecord, MAX_CLUSTER_TRIANGLES, MAX_CLUSTER_VERTICES};
use crate::prelude::*;
use crate::record::NONE;

/// What a sphere may miss of what it holds: this share of its radius, and [`SPHERE_PLACE`] of the greatest coordinate.
pub(super) const SPHERE_RADIUS: f64 = 1e-4;
/// Some roundings of an f32.
pub(super) const SPHERE_PLACE: f64 = 1e-6;

impl Check<'_, '_> {
    pub(super) fn clusters(&self, view: &ClusterView<'_>, finest: &Finest<'_>, out: &mut Findings<'_>) -> Option<()> {
        let header = &view.header;
        out.count("vertices", header.vertices, finest.vertices())?;
        if self.strict {
            out.zero("reserved", bytemuck::bytes_of(&header.reserved))?;
        }
        ranges(view, out)?;
        groups(view, out)?;
        let submeshes = self.tables.submeshes.len() as u32;
        for (n, cluster) in view.clusters.iter().enumerate() {
            corners(view, n, cluster, submeshes, finest.vertices(), out)?;
            made_by(view, n, cluster, out)?;
            cluster_spheres(view, n, cluster, finest, out)?;
        }
        roots(view, out)?;
        triangles(view, finest, out)
    }
}

/// References, corners, clusters and groups follow each other.
fn ranges(view: &ClusterView<'_>, out: &mut Findings<'_>) -> Option<()> {
    let (mut reference, mut triangle) = (0u64, 0u64);
    for (n, c) in view.clusters.iter().enumerate() {
        let at = |field: &str| format!("clusters[{n}].{field}");
        if (c.first_reference as u64, c.first_triangle as u64) != (reference, triangle) {
            let expected = format!("reference {reference} and triangle {triangle}");
            let found = format!("{} and {}", c.first_reference, c.first_triangle);
            out.fail(Code::ClusterRanges, at("first_reference"), expected, found)?;
        }
        out.within(&at("vertex_count"), c.vertex_count, 1, MAX_CLUSTER_VERTICES)?;
        out.within(&at("triangle_count"), c.triangle_count, 1, MAX_CLUSTER_TRIANGLES)?;
        reference += c.vertex_count as u64;
        triangle += c.triangle_count as u64;
        let numbers: &[f32] = bytemuck::cast_slice(bytemuck::bytes_of(c)).get(8..).unwrap_or(&[]);
        out.finite(&at("sphere"), numbers)?;
    }
    let (references, triangles) = (view.header.references as u64, view.header.triangles as u64);
    if (reference, triangle) != (references, triangles) {
        let expected = format!("{reference} references and {triangle} triangles");
        out.fail(Code::ClusterRanges, "header", expected, format!("{references} and {triangles}"))?;
    }
    Some(())
}

/// Groups tile the clusters and stand by level, none left out.
fn groups(view: &ClusterView<'_>, out: &mut Findings<'_>) -> Option<()> {
    let (mut cluster, mut level) = (0u64, 0u32);
    for (n, group) in view.groups.iter().enumerate() {
        let at = |field: &str| format!("groups[{n}].{field}");
        if group.first_cluster as u64 != cluster || group.cluster_count == 0 {
            let found = format!("{} from {}", group.cluster_count, group.first_cluster);
            out.fail(Code::ClusterRanges, at("first_cluster"), format!("one or more from {cluster}"), found)?;
        }
        cluster += group.cluster_count as u64;
        let next = if n == 0 { 0..=0 } else { level..=level.saturating_add(1) };
        if !next.contains(&group.level) {
            out.fail(Code::ClusterRanges, at("level"), format!("{next:?}"), group.level)?;
        }
        level = group.level;
        out.finite(&at("sphere"), &group.sphere)?;
        out.finite(&at("error"), &[group.error])?;
        if group.error < 0.0 {
            out.fail(Code::ClusterErrors, at("error"), "0 or more", group.error)?;
        }
    }
    let levels = view.groups.last().map_or(0, |group| group.level + 1);
    if cluster != view.clusters.len() as u64 || view.header.levels != levels {
        let expected = format!("{cluster} clusters on {levels} levels");
        out.fail(
            Code::ClusterRanges,
            "header",
            expected,
            format!("{} on {}", view.clusters.len(), view.header.levels),
        )?;
    }
    Some(())
}

fn corners(
    view: &ClusterView<'_>,
    n: usize,
    cluster: &ClusterRecord,
    submeshes: u32,
    vertices: u32,
    out: &mut Findings<'_>,
) -> Option<()> {
    let at = |field: &str| format!("clusters[{n}].{field}");
    if let Some(reference) = references(view, cluster).iter().find(|reference| **reference >= vertices) {
        out.fail(Code::ClusterCorners, at("references"), format!("below {vertices}"), reference)?;
    }
    if let Some(corner) = cluster_corners(view, cluster).iter().find(|corner| **corner as u32 >= cluster.vertex_count) {
        out.fail(Code::ClusterCorners, at("corners"), format!("below {}", cluster.vertex_count), corner)?;
    }
    if cluster.submesh >= submeshes {
        out.fail(Code::ClusterCorners, at("submesh"), format!("below {submeshes}"), cluster.submesh)?;
    }
    Some(())
}

/// A cluster's place in the DAG, and that errors do not fall along it.
fn made_by(view: &ClusterView<'_>, n: usize, cluster: &ClusterRecord, out: &mut Findings<'_>) -> Option<()> {
    let at = |field: &str| format!("clusters[{n}].{field}");
    let group = view.groups.get(cluster.group as usize).filter(|group| {
        let first = group.first_cluster as usize;
        (first..first + group.cluster_count as usize).contains(&n) && group.level == cluster.level
    });
    let Some(group) = group else {
        return out.fail(Code::ClusterGroups, at("group"), "the group it stands in, of its level", cluster.group);
    };
    if cluster.made_by == NONE || cluster.level == 0 {
        if (cluster.made_by == NONE) != (cluster.level == 0) {
            let found = format!("made by {} on level {}", cluster.made_by, cluster.level);
            out.fail(Code::ClusterGroups, at("made_by"), "none on level 0, and only there", found)?;
        }
        return Some(());
    }
    let maker = view.groups.get(cluster.made_by as usize).filter(|maker| maker.level < cluster.level);
    let Some(maker) = maker.filter(|_| cluster.made_by < cluster.group) else {
        return out.fail(
            Code::ClusterGroups,
            at("made_by"),
            "a group before its own, of a finer level",
            cluster.made_by,
        );
    };
    if maker.error > group.error || maker.error == f32::MAX {
        let expected = format!("at least {} of group {}, which it replaces", maker.error, cluster.made_by);
        out.fail(Code::ClusterErrors, format!("groups[{}].error", cluster.group), expected, group.error)?;
    }
    if !holds(group.sphere, maker.sphere) {
        let place = format!("groups[{}].sphere", cluster.group);
        let expected = format!("one that holds group {}'s {:?}", cluster.made_by, maker.sphere);
        out.fail(Code::ClusterSpheres, place, expected, format!("{:?}", group.sphere))?;
    }
    Some(())
}

fn cluster_spheres(
    view: &ClusterView<'_>,
    n: usize,
    cluster: &ClusterRecord,
    finest: &Finest<'_>,
    out: &mut Findings<'_>,
) -> Option<()> {
    let group: &GroupRecord = view.groups.get(cluster.group as usize)?;
    if !holds(group.sphere, cluster.sphere) {
        let expected = format!("one that holds cluster {n}'s {:?}", cluster.sphere);
        out.fail(
            Code::ClusterSpheres,
            format!("groups[{}].sphere", cluster.group),
            expected,
            format!("{:?}", group.sphere),
        )?;
    }
    for vertex in references(view, cluster) {
        let [x, y, z] = finest.positions[*vertex as usize];
        if !holds(cluster.sphere, [x, y, z, 0.0]) {
            let found = format!("{:?}", cluster.sphere);
            out.fail(
                Code::ClusterSpheres,
                format!("clusters[{n}].sphere"),
                format!("one that holds vertex {vertex}"),
                found,
            )?;
        }
    }
    Some(())
}

/// Whether a sphere holds another, within the stated tolerance.
fn holds(outer: [f32; 4], inner: [f32; 4]) -> bool {
    let [outer, inner] = [outer, inner].map(|sphere| sphere.map(f64::from));
    let place = (0..3).fold(0.0f64, |most, k| most.max(outer[k].abs()).max(inner[k].abs()));
    let room = outer[3] * (1.0 + SPHERE_RADIUS) + place * SPHERE_PLACE - inner[3];
    let square = (0..3).map(|k| (outer[k] - inner[k]) * (outer[k] - inner[k])).sum::<f64>();
    outer[3] >= 0.0 && inner[3] >= 0.0 && room >= 0.0 && square <= room * room
}

/// A group that made no cluster is replaced by nothing: it is drawn whatever is allowed.
fn roots(view: &ClusterView<'_>, out: &mut Findings<'_>) -> Option<()> {
    let mut makes = vec![false; view.groups.len()];
    view.clusters.iter().filter(|c| c.made_by != NONE).for_each(|c| makes[c.made_by as usize] = true);
    let wrong = view.groups.iter().zip(makes).position(|(group, makes)| !makes && group.error != f32::MAX);
    match wrong {
        Some(n) => out.fail(Code::ClusterErrors, format!("groups[{n}].error"), f32::MAX, view.groups[n].error),
        None => Some(()),
    }
}

/// Both sets of triangles, sorted, each triangle turned so that it starts with its least rotation.
fn triangles(view: &ClusterView<'_>, finest: &Finest<'_>, out: &mut Findings<'_>) -> Option<()> {
    let count = finest.triangle_count() as usize;
    let mut level: Vec<[u32; 4]> = Vec::with_capacity(count);
    for (submesh, range) in finest.ranges.iter().enumerate() {
        let first = range.first_index as usize / 3;
        let own = first..first + range.index_count as usize / 3;
        level.extend(own.map(|t| turned(submesh as u32, finest.triangle(t))));
    }
    let mut clusters: Vec<[u32; 4]> = Vec::with_capacity(count);
    for cluster in view.clusters.iter().take_while(|cluster| cluster.level == 0) {
        let vertices = references(view, cluster);
        let (own, _) = cluster_corners(view, cluster).as_chunks::<3>();
        clusters.extend(own.iter().map(|t| turned(cluster.submesh, t.map(|corner| vertices[corner as usize]))));
    }
    level.sort_unstable();
    clusters.sort_unstable();
    if level != clusters {
        let differs = level.iter().zip(&clusters).find(|(a, b)| a != b);
        let found = differs.map_or_else(|| format!("{} triangles", clusters.len()), |(_, b)| format!("{b:?}"));
        let expected = differs.map_or_else(|| format!("{} triangles", level.len()), |(a, _)| format!("{a:?}"));
        return out.fail(Code::ClusterTriangles, "level 0 (submesh, corners)", expected, found);
    }
    Some(())
}

fn turned(submesh: u32, [a, b, c]: [u32; 3]) -> [u32; 4] {
    let [a, b, c] = [a, b, c].min([b, c, a]).min([c, a, b]);
    [submesh, a, b, c]
}

fn references<'a>(view: &ClusterView<'a>, cluster: &ClusterRecord) -> &'a [u32] {
    super::slice(view.references, cluster.first_reference, cluster.vertex_count)
}

fn cluster_corners<'a>(view: &ClusterView<'a>, cluster: &ClusterRecord) -> &'a [u8] {
    let first = cluster.first_triangle as usize * 3;
    view.corners.get(first..first + cluster.triangle_count as usize * 3).unwrap_or(&[])
}
