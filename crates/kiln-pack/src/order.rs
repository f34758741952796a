//! In which order vertices and triangles are packed.
//!
//! A layout or a codec may ask for another order than the mesh's; then positions, triangles and all attributes stay as they are, bit for bit,
//! and stand elsewhere:
//! ```text
//! sliding window    vertices and triangles by when they vanish, the last to go first (kiln_lod::sliding_window)
//! shared vertices   coarse levels' vertices first, in order of first use by triangles in cache order, level by level; for the codec
//!                   in order of first use by the finest level, which all levels' triangles follow nearly enough to code well
//! tree layouts      vertices as the octree's leaves lie, depth first
//! meshopt codec     triangles in the order of strips, vertices in order of first use: what its predictors expect
//! otherwise         the mesh's order
//! ```

use std::borrow::Cow;

use bytemuck::cast_slice;
use kiln_asset::{Mesh, SubmeshId};

use crate::PackError;

/// Levels as they are packed.
pub(crate) struct Packed<'a> {
    /// The finest.
    pub(crate) finest: Cow<'a, Mesh>,
    /// For each of its vertices the one of the level that came in; empty if all stay in place.
    pub(crate) order: Vec<u32>,
    /// The others, finest first.
    pub(crate) coarser: Vec<Coarser<'a>>,
}

/// A level beside the finest.
pub(crate) enum Coarser<'a> {
    /// With vertices of its own.
    Own(Box<Cow<'a, Mesh>>),
    /// Over the first vertices of the finest.
    Shared {
        /// How many.
        vertices: usize,
        /// Its triangles, by submesh.
        triangles: Vec<[u32; 3]>,
        /// `[submesh_count]`, how many each has.
        counts: Vec<u32>,
    },
}

/// `meshes`, finest first, as they came.
pub(crate) fn as_they_are<'a>(meshes: &[&'a Mesh]) -> Packed<'a> {
    let coarser = meshes[1..].iter().map(|mesh| Coarser::Own(Box::new(Cow::Borrowed(*mesh)))).collect();
    Packed { finest: Cow::Borrowed(meshes[0]), order: Vec::new(), coarser }
}

/// As [`as_they_are`], the finest one's vertices in the order `order` (new vertex to old, each once).
pub(crate) fn by_leaves<'a>(meshes: &[&'a Mesh], order: Vec<u32>) -> Packed<'a> {
    let places = places(&order);
    let triangles = meshes[0].triangles.iter().map(|t| t.map(|v| places[v as usize])).collect();
    let finest = Cow::Owned(rebuilt(meshes[0], &order, triangles));
    Packed { finest, order, ..as_they_are(meshes) }
}

/// In the order that compresses best: triangles in the order of strips, vertices in order of first use.
pub(crate) fn for_codec<'a>(meshes: &[&'a Mesh]) -> Packed<'a> {
    let mut ordered = meshes.iter().map(|mesh| {
        let triangles = reuse_order(mesh, For::Codec);
        let order = first_use(&triangles, mesh.vertex_count());
        let places = places(&order);
        let triangles = triangles.into_iter().map(|t| t.map(|v| places[v as usize])).collect();
        (Cow::Owned(rebuilt(mesh, &order, triangles)), order)
    });
    let (finest, order) = ordered.next().expect("invariant: there is a level");
    Packed { finest, order, coarser: ordered.map(|(mesh, _)| Coarser::Own(Box::new(mesh))).collect() }
}

/// The inverse of an order.
pub(crate) fn places(order: &[u32]) -> Vec<u32> {
    let mut places = vec![0; order.len()];
    order.iter().zip(0..).for_each(|(old, new)| places[*old as usize] = new);
    places
}

fn rebuilt(mesh: &Mesh, order: &[u32], triangles: Vec<[u32; 3]>) -> Mesh {
    let raw = mesh.gather(order, triangles, mesh.face_submesh.clone());
    Mesh::new(raw).expect("invariant: the same vertices and triangles in another order")
}

/// What an order of triangles is for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum For {
    /// The vertex cache of a GPU.
    Cache,
    /// Few bytes; a few percent worse for caches.
    Codec,
}

/// The triangles of each submesh in an order that reuses vertices soon.
fn reuse_order(mesh: &Mesh, what: For) -> Vec<[u32; 3]> {
    let mut triangles = Vec::with_capacity(mesh.face_count());
    for submesh in 0..mesh.submeshes.len() {
        let own = &mesh.triangles[mesh.submesh_faces(SubmeshId(submesh as u32))];
        if own.is_empty() {
            continue;
        }
        let ordered = match what {
            For::Cache => meshopt::optimize_vertex_cache(cast_slice(own), mesh.vertex_count()),
            For::Codec => meshopt::optimize_vertex_cache_strip(cast_slice(own), mesh.vertex_count()),
        };
        triangles.extend_from_slice(cast_slice::<u32, [u32; 3]>(&ordered));
    }
    triangles
}

/// Vertices in order of first use, unused ones last.
fn first_use(triangles: &[[u32; 3]], count: usize) -> Vec<u32> {
    let (mut order, mut seen) = (Vec::with_capacity(count), vec![false; count]);
    for v in triangles.iter().flatten().copied().chain(0..count as u32) {
        if !std::mem::replace(&mut seen[v as usize], true) {
            order.push(v);
        }
    }
    order
}

/// `meshes`, finest first, over the finest one's vertices: coarse levels' first, or in the finest level's order of first use.
///
/// # Errors
/// A level with a vertex that the finest has not.
pub(crate) fn shared<'a>(meshes: &[&'a Mesh], what: For) -> Result<Packed<'a>, PackError> {
    let finest = meshes[0];
    let mut levels: Vec<Vec<[u32; 3]>> = Vec::with_capacity(meshes.len());
    for (level, mesh) in meshes.iter().enumerate() {
        let heirs = found_in(mesh, finest).ok_or_else(|| PackError::Levels {
            level,
            message: "its vertices are not those of level 0, so they cannot be shared".into(),
        })?;
        levels.push(reuse_order(mesh, what).iter().map(|t| t.map(|v| heirs[v as usize])).collect());
    }
    let order = match what {
        For::Codec => first_use(&levels[0], finest.vertex_count()),
        For::Cache => first_use(&levels.iter().rev().flatten().copied().collect::<Vec<_>>(), finest.vertex_count()),
    };
    let places = places(&order);
    levels.iter_mut().flatten().flatten().for_each(|v| *v = places[*v as usize]);
    let mut levels = levels.into_iter();
    let triangles = levels.next().expect("invariant: there is a level");
    let finest = Cow::Owned(rebuilt(finest, &order, triangles));
    let coarser = levels.zip(&meshes[1..]).map(|(triangles, mesh)| {
        let vertices = triangles.iter().flatten().max().map_or(0, |v| *v as usize + 1);
        Coarser::Shared { vertices, triangles, counts: submesh_counts(mesh) }
    });
    let coarser = coarser.collect();
    Ok(Packed { finest, order, coarser })
}

/// `[submesh_count]`, triangles of each submesh.
pub(crate) fn submesh_counts(mesh: &Mesh) -> Vec<u32> {
    let count = |submesh: usize| mesh.submesh_faces(SubmeshId(submesh as u32)).len() as u32;
    (0..mesh.submeshes.len()).map(count).collect()
}

/// For each vertex of `level` one of `finest` that is the same in all attributes: levels keep the order of their vertices, so one walk
/// along both finds them. `None` if some is missing.
fn found_in(level: &Mesh, finest: &Mesh) -> Option<Vec<u32>> {
    let (own, theirs) = (attributes(level), attributes(finest));
    if own.iter().zip(&theirs).any(|(a, b)| a.is_some() != b.is_some()) {
        return None;
    }
    fn element<'a>((size, bytes): &(usize, &'a [u8]), v: usize) -> &'a [u8] {
        &bytes[v * size..(v + 1) * size]
    }
    let pairs: Vec<_> = own.iter().flatten().zip(theirs.iter().flatten()).collect();
    let equal = |v: usize, w: usize| pairs.iter().all(|(a, b)| element(a, v) == element(b, w));
    let mut found = Vec::with_capacity(level.vertex_count());
    let mut w = 0;
    for v in 0..level.vertex_count() {
        while w < finest.vertex_count() && !equal(v, w) {
            w += 1;
        }
        if w == finest.vertex_count() {
            return None;
        }
        found.push(w as u32);
        w += 1;
    }
    Some(found)
}

/// Element size and bytes of each attribute.
fn attributes(mesh: &Mesh) -> [Option<(usize, &[u8])>; 8] {
    fn of<T: bytemuck::Pod>(values: &[T]) -> (usize, &[u8]) {
        (size_of::<T>(), cast_slice(values))
    }
    [
        Some(of(&mesh.positions)),
        mesh.normals.as_deref().map(of),
        mesh.tangents.as_deref().map(of),
        mesh.uv0.as_deref().map(of),
        mesh.uv1.as_deref().map(of),
        mesh.colors.as_deref().map(of),
        mesh.joints.as_deref().map(of),
        mesh.weights.as_deref().map(of),
    ]
}
