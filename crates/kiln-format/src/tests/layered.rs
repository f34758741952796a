//! What came with version 1.2: layouts, shared vertices, codecs. A model of five points, small enough to know every answer.
//!
//! ```text
//! points      vertices   window: goes to   tree: terminal node
//! (0, 0, 0)   0          stays             1
//! (1, 0, 0)   1          stays             2
//! (0, 1, 0)   2          stays             1
//! (1, 1, 0)   3, 4       point of 1, LOD 2 3
//! (2, 1, .5)  5          point of 4, LOD 1 3
//! ```

use std::borrow::Cow;

use super::model::tiny;
use super::rules::{codes_of, edit, edit_entry, offset_of};
use crate::layout::*;
use crate::prelude::*;
use crate::record::*;
use crate::{
    AlignedBytes, Code, Container, Content, ErrorKind, Kind, LevelContent, Packing, PrivateSection, Semantic, check,
    write,
};

const POSITIONS: [[f32; 3]; 6] =
    [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 1.0, 0.5]];
const UVS: [[f32; 2]; 6] = [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5], [0.75, 0.75], [1.0, 0.5]];
const INDICES: [u32; 9] = [0, 1, 2, 2, 1, 3, 4, 1, 5];
const PARENTS: [u32; 6] = [0, 1, 2, 1, 1, 4];
const STARTS: [u32; 1] = [0b10_1111];
const ROW_STARTS: [u32; 5] = [0, 1, 3, 3, 4];
const FACE_COUNTS: [u32; 5] = [0, 0, 1, 2, 3];
const TERMINALS: [u32; 6] = [1, 2, 1, 3, 3, 3];
const REFERENCES: [u32; 10] = [0, 1, 2, 3, 4, 1, 5, 0, 1, 2];
const CORNERS: [u8; 12] = [0, 1, 2, 1, 3, 2, 1, 2, 0, 0, 1, 2];

const fn node(position: [f32; 3], parent: u32) -> CompactNode {
    CompactNode { position, parent }
}
const NODES: [CompactNode; 4] =
    [node([0.75, 0.5, 0.0], 0), node([0.0, 0.5, 0.0], 0), node([1.25, 0.5, 0.25], 0), node([1.5, 1.0, 0.25], 2)];

const fn checkpoint(detail: u32, vertices: u32, triangles: u32, error: f32, level: u32) -> Checkpoint {
    Checkpoint { detail, vertices, triangles, error, level, reserved: [0; 3] }
}
const WINDOW_CHECKPOINTS: [Checkpoint; 3] =
    [checkpoint(0, 6, 3, 0.0, 0), checkpoint(1, 5, 2, 0.25, 1), checkpoint(2, 3, 1, 0.5, 2)];
const TREE_CHECKPOINTS: [Checkpoint; 4] = [
    checkpoint(4, 6, 3, 0.0, 0),
    checkpoint(3, 4, 2, 0.25, NONE),
    checkpoint(2, 3, 1, 0.25, NONE),
    checkpoint(0, 1, 0, 1.0, NONE),
];

const SPHERES: [[f32; 4]; 2] = [[0.5, 0.5, 0.0, 0.7072], [1.5, 0.5, 0.25, 0.75]];
const CONE: [f32; 4] = [0.0, 0.0, 1.0, 1.0];

/// Everything of a layered model that is not constant.
pub(super) struct Layered {
    tree: Vec<[f32; 4]>,
    leaf: Vec<[f32; 4]>,
    clusters: Vec<ClusterRecord>,
    groups: Vec<GroupRecord>,
    mip: Vec<u8>,
}

pub(super) fn layered() -> Layered {
    let texel = |n: usize, q| [NODES[n].position[0], NODES[n].position[1], NODES[n].position[2], q];
    let (root, one, two, three) = (texel(0, 1.0), texel(1, 0.5), texel(2, 1.0), texel(3, 1.0));
    let zero = [0.0; 4];
    // Two columns and an empty one; column 1 skips row 2.
    let tree = [[root, root, zero], [one, two, zero], [zero, three, zero], [zero, three, zero]].concat();
    let pointer = |v: usize| [0.0, 3.0, 4.0, 10.0][TERMINALS[v] as usize];
    let leaf = |v: usize| [POSITIONS[v][0], POSITIONS[v][1], POSITIONS[v][2], pointer(v)];
    let cluster = |first: [u32; 4], submesh, group, made_by, level| ClusterRecord {
        first_reference: first[0],
        vertex_count: first[1],
        first_triangle: first[2],
        triangle_count: first[3],
        submesh,
        group,
        made_by,
        level,
        sphere: SPHERES[submesh as usize],
        cone: CONE,
    };
    let group = |n: u32, sphere: usize, error, level| GroupRecord {
        sphere: SPHERES[sphere],
        error,
        first_cluster: n,
        cluster_count: 1,
        level,
    };
    Layered {
        tree,
        leaf: (0..6).map(leaf).collect(),
        clusters: vec![
            cluster([0, 4, 0, 2], 0, 0, NONE, 0),
            cluster([4, 3, 2, 1], 1, 1, NONE, 0),
            cluster([7, 3, 3, 1], 0, 2, 0, 1),
        ],
        groups: vec![group(0, 0, 0.5, 0), group(1, 1, f32::MAX, 0), group(2, 0, f32::MAX, 1)],
        mip: (0..129 * 4).map(|i| (i / 16) as u8).collect(),
    }
}

impl Layered {
    pub(super) fn layouts(&self) -> Layouts<'_> {
        let tree_header = |columns, width| TreeHeader {
            nodes: 4,
            vertices: 6,
            rows: 4,
            columns,
            width,
            checkpoints: 4,
            reserved: [0; 10],
        };
        Layouts {
            window: Some(WindowView {
                header: WindowHeader {
                    vertices: 6,
                    triangles: 3,
                    collapses: 2,
                    base_vertices: 3,
                    checkpoints: 3,
                    flags: WINDOW_HAS_STARTS,
                    reserved: [0; 10],
                },
                checkpoints: &WINDOW_CHECKPOINTS,
                parents: &PARENTS,
                starts: &STARTS,
            }),
            tree_leaf: Some(TreeLeafView {
                header: tree_header(2, 3),
                checkpoints: &TREE_CHECKPOINTS,
                row_starts: &ROW_STARTS,
                face_counts: &FACE_COUNTS,
                tree: &self.tree,
                leaf: &self.leaf,
            }),
            compact_tree: Some(CompactTreeView {
                header: tree_header(0, 0),
                checkpoints: &TREE_CHECKPOINTS,
                row_starts: &ROW_STARTS,
                face_counts: &FACE_COUNTS,
                nodes: &NODES,
                terminals: &TERMINALS,
            }),
            clusters: Some(ClusterView {
                header: ClusterHeader {
                    clusters: 3,
                    groups: 3,
                    levels: 2,
                    references: 10,
                    triangles: 4,
                    vertices: 6,
                    reserved: [0; 10],
                },
                clusters: &self.clusters,
                groups: &self.groups,
                references: &REFERENCES,
                corners: &CORNERS,
            }),
        }
    }

    /// Three levels over the same vertices, all layouts, the tiny model's texture.
    pub(super) fn content(&self, packing: Packing) -> Content<'_> {
        let level = |vertices: usize, indices: &'static [u32], second: u32, error| LevelContent {
            error,
            error_kind: ErrorKind::Sampled,
            arrays: vec![
                (Semantic::Positions, bytemuck::cast_slice(&POSITIONS[..vertices])),
                (Semantic::Uv0, bytemuck::cast_slice(&UVS[..vertices])),
            ],
            indices,
            index_counts: vec![indices.len() as u32 - second, second],
            shares_vertices: vertices < 6,
        };
        let levels =
            vec![level(6, &INDICES, 3, 0.0), level(5, &INDICES[..6], 0, 0.25), level(3, &INDICES[..3], 0, 0.5)];
        let model = tiny();
        let mut content = model.content();
        content.textures[0].mips = vec![Cow::Borrowed(&self.mip)];
        let textures = core::mem::take(&mut content.textures);
        let textures = textures.into_iter().map(|texture| crate::TextureContent {
            name: texture.name,
            mips: vec![Cow::Borrowed(&self.mip[..])],
            format: texture.format,
            channels: texture.channels,
            extra: texture.extra,
            width: texture.width,
            height: texture.height,
        });
        Content {
            source_triangles: content.source_triangles,
            layout: content.layout,
            levels,
            submeshes: content.submeshes.clone(),
            materials: content.materials.clone(),
            textures: textures.collect(),
            provenance: content.provenance.clone(),
            layouts: self.layouts(),
            packing,
            private: Vec::new(),
        }
    }

    pub(super) fn bytes(&self, packing: Packing) -> Vec<u8> {
        write(&self.content(packing)).expect("valid")
    }
}

/// All that a container lends, as bytes.
pub(super) fn lent(container: &Container<'_>) -> Vec<Vec<u8>> {
    use bytemuck::{bytes_of, cast_slice};
    let mut out = Vec::new();
    for lod in 0..container.level_records().len() {
        let Some(level) = container.level(lod) else { continue };
        out.push(cast_slice(level.positions()).to_vec());
        out.extend(level.uv0().map(|uvs| cast_slice(uvs).to_vec()));
        out.push(level.indices().bytes().to_vec());
    }
    for texture in 0..container.textures().len() {
        out.extend((0..container.mips(texture).len()).filter_map(|k| Some(container.mip(texture, k)?.to_vec())));
    }
    let layouts = container.layouts();
    if let Some(w) = layouts.window {
        let parts: [&[u8]; 4] =
            [bytes_of(&w.header), cast_slice(w.checkpoints), cast_slice(w.parents), cast_slice(w.starts)];
        out.push(parts.concat());
    }
    if let Some(t) = layouts.tree_leaf {
        let parts: [&[u8]; 4] =
            [cast_slice(t.row_starts), cast_slice(t.face_counts), cast_slice(t.tree), cast_slice(t.leaf)];
        out.push(parts.concat());
    }
    if let Some(t) = layouts.compact_tree {
        let parts: [&[u8]; 4] =
            [cast_slice(t.row_starts), cast_slice(t.face_counts), cast_slice(t.nodes), cast_slice(t.terminals)];
        out.push(parts.concat());
    }
    if let Some(c) = layouts.clusters {
        out.push([cast_slice(c.clusters), cast_slice(c.groups), cast_slice(c.references), c.corners].concat());
    }
    out
}

#[test]
fn layouts_and_shared_vertices_are_lent_as_they_were_written() {
    let model = layered();
    let bytes = AlignedBytes::copy_of(&model.bytes(Packing::Raw));
    assert_eq!(check(&bytes).findings, []);
    let container = Container::open(&bytes).expect("sound");
    assert_eq!(container.version(), (1, 2));
    let layouts = container.layouts();
    let window = layouts.window.expect("there");
    assert_eq!(
        (window.parents, window.starts, window.checkpoints),
        (&PARENTS[..], &STARTS[..], &WINDOW_CHECKPOINTS[..])
    );
    let tree = layouts.tree_leaf.expect("there");
    assert_eq!((tree.tree, tree.leaf, tree.row_starts), (&model.tree[..], &model.leaf[..], &ROW_STARTS[..]));
    let compact = layouts.compact_tree.expect("there");
    assert_eq!((compact.nodes, compact.terminals, compact.face_counts), (&NODES[..], &TERMINALS[..], &FACE_COUNTS[..]));
    let clusters = layouts.clusters.expect("there");
    assert_eq!((clusters.clusters, clusters.groups), (&model.clusters[..], &model.groups[..]));
    assert_eq!((clusters.references, clusters.corners), (&REFERENCES[..], &CORNERS[..]));
    // Nothing is copied.
    let range = bytes.as_ptr_range();
    assert!(range.contains(&window.parents.as_ptr().cast()) && range.contains(&tree.leaf.as_ptr().cast()));
    // One VERT, of which the levels have prefixes.
    let kinds: Vec<Kind> = container.sections().map(|s| s.kind).collect();
    assert_eq!(kinds.iter().filter(|kind| **kind == Kind::VERTICES).count(), 1);
    for (lod, count) in [(0, 6), (1, 5), (2, 3)] {
        let level = container.level(lod).expect("at hand");
        assert_eq!((level.positions(), level.uv0()), (&POSITIONS[..count], Some(&UVS[..count])));
        assert_eq!(level.positions().as_ptr(), container.level(0).expect("at hand").positions().as_ptr());
    }
    let payload: Vec<String> = kinds[6..].iter().map(Kind::to_string).collect();
    assert_eq!(payload, ["VERT", "INDX", "MIPT", "INDX", "INDX", "WNDW", "TREE", "LEAF", "CTRE", "CLUS"]);
}

#[test]
fn each_layout_may_stand_alone_and_every_packing_gives_the_same_content() {
    let model = layered();
    let all = model.layouts();
    let alone = [
        Layouts { window: all.window, ..Layouts::default() },
        Layouts { tree_leaf: all.tree_leaf, ..Layouts::default() },
        Layouts { compact_tree: all.compact_tree, ..Layouts::default() },
        Layouts { clusters: all.clusters, ..Layouts::default() },
        Layouts::default(),
        all,
    ];
    for layouts in alone {
        let mut lent_by_packing = [Packing::Raw, Packing::Meshopt, Packing::Zstd].map(|packing| {
            let written = write(&Content { layouts, ..model.content(packing) }).expect("valid");
            let bytes = AlignedBytes::copy_of(&written);
            assert_eq!(check(&bytes).findings, []);
            lent(&Container::open(&bytes).expect("sound"))
        });
        // None of this model's triangles is rotated by the index codec.
        assert_eq!(crate::canonical_indices(&INDICES, 6), INDICES);
        assert_eq!(lent_by_packing[0], lent_by_packing[1]);
        assert_eq!(lent_by_packing[0], lent_by_packing[2]);
        assert!(!core::mem::take(&mut lent_by_packing[0]).is_empty());
    }
}

#[test]
fn a_window_needs_no_starts_where_every_vertex_is_a_point() {
    let model = layered();
    let mut content = model.content(Packing::Raw);
    let header = WindowHeader { flags: 0, collapses: 3, ..model.layouts().window.expect("there").header };
    // Vertex 4 alone goes to 3, which changes nothing but the counting of collapses.
    let checkpoints = [
        checkpoint(0, 6, 3, 0.0, NONE),
        checkpoint(1, 5, 3, 0.25, NONE),
        checkpoint(2, 4, 2, 0.25, 1),
        checkpoint(3, 3, 1, 0.5, 2),
    ];
    let parents = [0, 1, 2, 1, 3, 4];
    let header = WindowHeader { checkpoints: 4, ..header };
    content.layouts = Layouts {
        window: Some(WindowView { header, checkpoints: &checkpoints, parents: &parents, starts: &[] }),
        ..Layouts::default()
    };
    let refused = write(&content).expect_err("vertex 5 goes first, and with it a triangle");
    assert_eq!(refused.code, Code::Checkpoints);
    let checkpoints = [checkpoint(0, 6, 3, 0.0, 0), checkpoint(1, 5, 2, 0.25, 1), checkpoint(3, 3, 1, 0.5, 2)];
    let header = WindowHeader { checkpoints: 3, ..header };
    content.layouts = Layouts {
        window: Some(WindowView { header, checkpoints: &checkpoints, parents: &parents, starts: &[] }),
        ..Layouts::default()
    };
    write(&content).expect("valid");
}

/// What `check` finds after a change of one value of a section, every hash being right again.
fn after<T: bytemuck::Pod>(kind: Kind, at: usize, change: impl FnOnce(&mut T)) -> Vec<Code> {
    codes_of(layered().bytes(Packing::Raw), |bytes| edit::<T>(bytes, kind, at, change))
}

#[test]
fn window_rules() {
    let header = |change: fn(&mut WindowHeader)| after(Kind::WINDOW, 0, change);
    assert!(header(|h| h.vertices = 5).contains(&Code::LayoutCount));
    assert_eq!(header(|h| h.vertices = 600), [Code::LayoutLength]);
    assert_eq!(header(|h| h.checkpoints = u32::MAX), [Code::LayoutLength]);
    assert_eq!(header(|h| h.triangles = 2), [Code::LayoutCount]);
    assert_eq!(header(|h| h.collapses = 7), [Code::LayoutCount]);
    assert_eq!(header(|h| h.collapses = 1), [Code::Checkpoints]);
    assert_eq!(header(|h| h.base_vertices = 4), [Code::Points]);
    assert_eq!(header(|h| h.base_vertices = 2), [Code::Points]);
    assert_eq!(header(|h| h.base_vertices = 7), [Code::LayoutCount]);
    assert_eq!(header(|h| h.flags = 0), [Code::LayoutLength]);
    assert_eq!(header(|h| h.flags = 3), [Code::Reserved]);
    assert_eq!(header(|h| h.reserved[9] = 1), [Code::Reserved]);
    let checkpoint = |k: usize, change: fn(&mut Checkpoint)| after(Kind::WINDOW, 64 + 32 * k, change);
    for (k, change) in [
        (0, (|c| c.detail = 1) as fn(&mut Checkpoint)),
        (1, |c| c.detail = 2),
        (1, |c| c.detail = 0),
        (1, |c| c.vertices = 4),
        (1, |c| c.triangles = 1),
        (1, |c| c.triangles = 4),
        (1, |c| c.error = -1.0),
        (1, |c| c.error = 2.0),
        (1, |c| c.level = 0),
        (1, |c| c.level = 3),
        (2, |c| c.level = 1),
    ] {
        assert_eq!(checkpoint(k, change), [Code::Checkpoints], "checkpoint {k}");
    }
    assert_eq!(checkpoint(1, |c| c.error = f32::NAN), [Code::NotFinite]);
    assert_eq!(checkpoint(1, |c| c.reserved[2] = 1), [Code::Reserved]);
    let parent = |v: usize, to: u32| after::<u32>(Kind::WINDOW, 256 + 4 * v, |parent| *parent = to);
    assert_eq!(parent(0, 1), [Code::Parents]);
    assert_eq!(parent(2, 0), [Code::Parents]);
    assert_eq!(parent(3, 3), [Code::Parents]);
    assert_eq!(parent(4, 3), [Code::Parents]);
    // The other wedge of the point goes to another point.
    assert_eq!(parent(4, 2), [Code::Parents]);
    assert_eq!(parent(5, u32::MAX), [Code::Parents]);
    // To the other wedge of the same point: as good.
    assert_eq!(parent(5, 3), []);
    // Vertex 5 to point 0: its triangle lives until LOD 2 then.
    assert_eq!(parent(5, 0), [Code::Checkpoints]);
    let starts = |bits: u32| after::<u32>(Kind::WINDOW, 512, |starts| *starts = bits);
    assert_eq!(starts(0b10_1110), [Code::Points]);
    assert_eq!(starts(0b110_1111), [Code::Points]);
    assert_eq!(starts(0b11_1111), [Code::Points]);
    assert_eq!(after::<u8>(Kind::WINDOW, 255, |byte| *byte = 1), [Code::Padding]);
    // The first two triangles trade places: the one that vanishes stands first.
    let order = codes_of(layered().bytes(Packing::Raw), |bytes| {
        let fine = fine_indices(bytes);
        bytes[fine..fine + 12].rotate_left(6);
    });
    assert_eq!(order, [Code::Vanishing]);
    // A triangle of two wedges of one point is dead from the start, and has no area for the trees either.
    let model = layered();
    let all = model.layouts();
    for (layouts, code) in [
        (Layouts { window: all.window, ..Layouts::default() }, Code::Vanishing),
        (Layouts { compact_tree: all.compact_tree, ..Layouts::default() }, Code::FaceCounts),
    ] {
        let mut content = Content { layouts, ..model.content(Packing::Raw) };
        content.levels[0].indices = &[0, 1, 2, 2, 1, 3, 4, 1, 3];
        assert_eq!(write(&content).map(|_| ()).map_err(|e| e.code), Err(code));
    }
}

/// Where level 0's indices lie: the last INDX.
fn fine_indices(bytes: &[u8]) -> usize {
    let container_bytes = AlignedBytes::copy_of(bytes);
    let container = Container::open(&container_bytes).expect("sound");
    container.sections().filter(|s| s.kind == Kind::INDICES).last().expect("there").entry.offset as usize
}

#[test]
fn tree_rules() {
    for kind in [Kind::TREE, Kind::COMPACT_TREE] {
        let header = |change: fn(&mut TreeHeader)| after(kind, 0, change);
        assert_eq!(header(|h| h.nodes = 70), [Code::LayoutLength]);
        assert_eq!(header(|h| h.rows = u32::MAX), [Code::LayoutLength]);
        assert_eq!(header(|h| h.reserved[0] = 1), [Code::Reserved]);
        assert_eq!(after::<u32>(kind, 192, |row| *row = 1), [Code::TreeRows]);
        let rows = after::<[u32; 5]>(kind, 192, |rows| *rows = [0, 2, 3, 3, 4]);
        assert!(rows == [Code::TreeTexels] || rows == [Code::TreeRows], "{rows:?}");
        assert_eq!(after::<[u32; 5]>(kind, 192, |rows| *rows = [0, 3, 1, 3, 4]), [Code::TreeRows]);
        for t in 0..5 {
            let found = after::<u32>(kind, 256 + 4 * t, |count| *count += 1);
            assert_eq!(found, [Code::FaceCounts], "threshold {t}");
        }
        let checkpoint = |k: usize, change: fn(&mut Checkpoint)| after(kind, 64 + 32 * k, change);
        assert_eq!(checkpoint(0, |c| c.vertices = 5), [Code::Checkpoints]);
        assert_eq!(checkpoint(1, |c| c.vertices = 5), [Code::Checkpoints]);
        assert_eq!(checkpoint(2, |c| c.detail = 1), [Code::Checkpoints]);
        assert_eq!(checkpoint(3, |c| c.detail = 1), [Code::Checkpoints]);
        assert_eq!(checkpoint(2, |c| c.detail = 3), [Code::Checkpoints]);
    }
    let nodes = |n: usize, change: fn(&mut CompactNode)| after(Kind::COMPACT_TREE, 512 + 16 * n, change);
    assert_eq!(nodes(0, |n| n.parent = 1), [Code::TreeRows]);
    assert_eq!(nodes(2, |n| n.parent = 1), [Code::TreeRows]);
    assert_eq!(nodes(3, |n| n.parent = 3), [Code::TreeRows]);
    assert_eq!(nodes(3, |n| n.parent = 1), [Code::FaceCounts]);
    assert_eq!(nodes(3, |n| n.position[1] = f32::INFINITY), [Code::NotFinite]);
    let terminal = |v: usize, to: u32| after::<u32>(Kind::COMPACT_TREE, 768 + 4 * v, |terminal| *terminal = to);
    assert_eq!(terminal(0, 4), [Code::Terminals]);
    assert_eq!(terminal(5, 1), [Code::FaceCounts]);
    // A column's texels: ((column / 3) * 4 + row) * 3 + column % 3.
    let texel = |number: usize, change: fn(&mut [f32; 4])| after(Kind::TREE, 512 + 16 * number, change);
    let is = |found: Vec<Code>, code| assert_eq!(found, [code]);
    is(texel(0, |t| t[0] = 5.0), Code::TreeTexels);
    is(texel(0, |t| t[3] = 0.5), Code::TreeTexels);
    is(texel(3, |t| t[3] = 0.500_000_06), Code::TreeTexels);
    is(texel(3, |t| t[3] = 1.0), Code::TreeTexels);
    is(texel(6, |t| t[3] = 1.0), Code::TreeTexels);
    is(texel(2, |t| t[1] = 1.0), Code::TreeTexels);
    is(texel(7, |t| t[0] = 0.0), Code::TreeTexels);
    is(texel(10, |t| t[3] = f32::NAN), Code::NotFinite);
    let leaf = |v: usize, change: fn(&mut [f32; 4])| after(Kind::LEAF, 16 * v, change);
    is(leaf(1, |l| l[0] = 1.5), Code::Terminals);
    is(leaf(1, |l| l[3] = 3.0), Code::FaceCounts);
    // A filled row, an empty place, a column too far, none at all, between two.
    for pointer in [7.0, 6.0, 5.0, 12.0, -1.0, 4.5, 1e30] {
        assert_eq!(
            codes_of(layered().bytes(Packing::Raw), |b| edit::<[f32; 4]>(b, Kind::LEAF, 16, |l| l[3] = pointer)),
            [Code::Terminals]
        );
    }
    let without = codes_of(layered().bytes(Packing::Raw), |bytes| {
        let number = number_of(bytes, Kind::LEAF);
        edit_entry(bytes, number, |entry| entry.kind = *b"leaf");
    });
    assert_eq!(without, [Code::LayoutLength]);
}

fn number_of(bytes: &[u8], kind: Kind) -> usize {
    let aligned = AlignedBytes::copy_of(bytes);
    let container = Container::open(&aligned).expect("sound");
    container.sections().position(|s| s.kind == kind).expect("there")
}

#[test]
fn a_parent_with_the_numbers_of_its_child_is_told_from_a_filled_row() {
    // Node 2 gets node 3's position: its texel in row 1 equals the filled one below, and q is 1 in both rows.
    let model = layered();
    let mut content = model.content(Packing::Raw);
    let mut tree = model.tree.clone();
    tree[4] = tree[10];
    let mut view = model.layouts().tree_leaf.expect("there");
    view.tree = &tree;
    content.layouts = Layouts { tree_leaf: Some(view), ..Layouts::default() };
    write(&content).expect("valid");
}

#[test]
fn cluster_rules() {
    let header = |change: fn(&mut ClusterHeader)| after(Kind::CLUSTERS, 0, change);
    assert_eq!(header(|h| h.clusters = u32::MAX), [Code::LayoutLength]);
    assert_eq!(header(|h| h.levels = 3), [Code::ClusterRanges]);
    assert!(header(|h| h.references = 9).contains(&Code::ClusterRanges));
    assert_eq!(header(|h| h.vertices = 5), [Code::LayoutCount]);
    assert_eq!(header(|h| h.reserved[1] = 1), [Code::Reserved]);
    let cluster = |n: usize, change: fn(&mut ClusterRecord)| after(Kind::CLUSTERS, 256 + 64 * n, change);
    assert_eq!(cluster(1, |c| c.first_reference = 3), [Code::ClusterRanges]);
    assert_eq!(cluster(1, |c| c.triangle_count = 2), [Code::ClusterRanges]);
    assert_eq!(cluster(1, |c| c.triangle_count = 0), [Code::LayoutCount]);
    assert_eq!(cluster(1, |c| c.vertex_count = 257), [Code::LayoutCount]);
    assert_eq!(cluster(1, |c| c.submesh = 2), [Code::ClusterCorners]);
    assert_eq!(cluster(1, |c| c.submesh = 0), [Code::ClusterTriangles]);
    assert_eq!(cluster(1, |c| c.group = 0), [Code::ClusterGroups]);
    assert_eq!(cluster(1, |c| c.group = 9), [Code::ClusterGroups]);
    assert_eq!(cluster(1, |c| c.level = 1), [Code::ClusterGroups]);
    assert_eq!(cluster(1, |c| c.made_by = 0), [Code::ClusterGroups]);
    assert_eq!(cluster(2, |c| c.made_by = NONE), [Code::ClusterGroups]);
    assert_eq!(cluster(2, |c| c.made_by = 2), [Code::ClusterGroups]);
    assert_eq!(cluster(2, |c| c.made_by = 1), [Code::ClusterErrors]);
    assert_eq!(cluster(0, |c| c.sphere[3] = 0.7), [Code::ClusterSpheres]);
    assert_eq!(cluster(0, |c| c.sphere[3] = 0.8), [Code::ClusterSpheres]);
    assert_eq!(cluster(0, |c| c.cone[0] = f32::NAN), [Code::NotFinite]);
    let group = |n: usize, change: fn(&mut GroupRecord)| after(Kind::CLUSTERS, 512 + 32 * n, change);
    assert_eq!(group(0, |g| g.error = f32::MAX), [Code::ClusterErrors]);
    assert_eq!(group(0, |g| g.error = -0.5), [Code::ClusterErrors]);
    assert_eq!(group(1, |g| g.error = 0.5), [Code::ClusterErrors]);
    assert_eq!(group(2, |g| g.error = 0.25), [Code::ClusterErrors]);
    assert_eq!(group(2, |g| g.sphere[0] = 0.75), [Code::ClusterSpheres]);
    assert_eq!(group(1, |g| g.first_cluster = 0), [Code::ClusterRanges]);
    assert_eq!(group(1, |g| g.cluster_count = 2), [Code::ClusterRanges]);
    assert_eq!(group(1, |g| g.level = 2), [Code::ClusterRanges]);
    let reference = |n: usize, to: u32| after::<u32>(Kind::CLUSTERS, 768 + 4 * n, |reference| *reference = to);
    assert_eq!(reference(0, 6), [Code::ClusterCorners]);
    assert_eq!(reference(3, 4), [Code::ClusterTriangles]);
    let corner = |n: usize, to: u8| after::<u8>(Kind::CLUSTERS, 1024 + n, |corner| *corner = to);
    assert_eq!(corner(0, 4), [Code::ClusterCorners]);
    assert_eq!(corner(0, 3), [Code::ClusterTriangles]);
}

#[test]
fn shared_vertices_are_the_first_of_level_0_and_no_more() {
    let array = |number: usize, change: fn(&mut ArrayRecord)| after(Kind::LEVELS, 32 + 3 * 96 + 32 * number, change);
    // Two arrays a level.
    assert_eq!(array(2, |a| a.offset += 256), [Code::Arrays]);
    assert_eq!(array(3, |a| a.length += 8), [Code::Arrays]);
    assert_eq!(array(3, |a| a.semantic = 5), [Code::Arrays]);
    assert_eq!(array(3, |a| a.reserved[0] = 1), [Code::Reserved]);
    let level = |lod: usize, change: fn(&mut LevelRecord)| after(Kind::LEVELS, 32 + 96 * lod, change);
    assert!(level(1, |l| l.vertices = 7).contains(&Code::Arrays));
    assert!(level(1, |l| l.vertices = 4).contains(&Code::Arrays));
    // In the first version of the table each level has all of its section.
    let old = codes_of(layered().bytes(Packing::Raw), |bytes| edit_entry(bytes, 1, |entry| entry.version = 1));
    assert!(old.contains(&Code::Arrays), "{old:?}");
    // The writer refuses what is no prefix.
    let model = layered();
    let mut content = model.content(Packing::Raw);
    content.levels[1].arrays[1].1 = bytemuck::cast_slice(&UVS[1..6]);
    assert_eq!(write(&content).map(|_| ()).map_err(|e| e.code), Err(Code::Arrays));
}

#[test]
fn layouts_stand_behind_geometry_in_their_order() {
    let swapped = codes_of(layered().bytes(Packing::Raw), |bytes| {
        let [a, b] = [Kind::TREE, Kind::COMPACT_TREE].map(|kind| number_of(bytes, kind));
        edit_entry(bytes, a, |entry| entry.kind = *b"CTRE");
        edit_entry(bytes, b, |entry| entry.kind = *b"TREE");
    });
    assert!(swapped.contains(&Code::Order), "{swapped:?}");
}

#[test]
fn a_prefix_offers_a_layout_when_its_section_has_arrived() {
    let bytes = AlignedBytes::copy_of(&layered().bytes(Packing::Raw));
    let end = |kind| {
        let whole = Container::open(&bytes).expect("sound");
        let entry = whole.sections().find(|s| s.kind == kind).expect("there").entry;
        (entry.offset + entry.stored_length) as usize
    };
    let at = |length: usize| {
        let prefix = AlignedBytes::copy_of(&bytes[..length]);
        let container = Container::open_prefix(&prefix).expect("tables are whole");
        let layouts = container.layouts();
        [layouts.window.is_some(), layouts.tree_leaf.is_some(), layouts.clusters.is_some()]
    };
    assert_eq!(at(end(Kind::WINDOW) - 1), [false, false, false]);
    assert_eq!(at(end(Kind::WINDOW)), [true, false, false]);
    assert_eq!(at(end(Kind::TREE)), [true, false, false]);
    assert_eq!(at(end(Kind::LEAF)), [true, true, false]);
    assert_eq!(at(end(Kind::CLUSTERS)), [true, true, true]);
}

#[test]
fn tables_are_read_without_a_look_at_the_payload() {
    let sound = layered().bytes(Packing::Raw);
    let mut bytes = AlignedBytes::copy_of(&sound);
    let first = offset_of(&sound, Kind::VERTICES);
    bytes.as_mut_slice()[first..].fill(0xA5);
    let container = Container::open_tables(&bytes).expect("tables are sound");
    assert_eq!(container.validate().map_err(|e| e.code), Err(Code::StoredHash));
    // Wrong, but there, and bounded.
    assert_eq!(container.level(0).expect("offered").positions().len(), 6);
    assert!(container.layouts().window.is_none(), "its counts are nonsense");
    lent(&container);
    let last = bytes.len() - 1;
    let mut bytes = AlignedBytes::copy_of(&sound);
    bytes.as_mut_slice()[last] ^= 1;
    let container = Container::open_tables(&bytes).expect("tables are sound");
    assert_eq!(container.validate().map_err(|e| e.code), Err(Code::StoredHash));
    // A damaged table is found at once.
    let table = offset_of(&sound, Kind::SUBMESHES);
    bytes.as_mut_slice()[table] ^= 1;
    assert_eq!(Container::open_tables(&bytes).err().map(|e| e.code), Some(Code::StoredHash));
}

#[test]
fn files_without_anything_new_are_not_of_the_new_version() {
    let version = |content: &Content<'_>| {
        let bytes = AlignedBytes::copy_of(&write(content).expect("valid"));
        Container::open(&bytes).expect("sound").version()
    };
    let model = layered();
    let mut content = model.content(Packing::Raw);
    assert_eq!(version(&content), (1, 2));
    content.layouts = Layouts::default();
    assert_eq!(version(&content), (1, 2));
    content.levels.truncate(1);
    assert_eq!(version(&content), (1, 0));
    content.packing = Packing::Zstd;
    assert_eq!(version(&content), (1, 2));
    content.textures[0].mips = vec![Cow::Borrowed(&[7, 1, 2, 3])];
    (content.textures[0].width, content.textures[0].height) = (1, 1);
    // The geometry is coded still.
    assert_eq!(version(&content), (1, 2));
}

#[cfg(feature = "codecs")]
pub(super) mod codecs {
    use super::*;
    use crate::canonical_indices;

    /// A bumpy grid: enough vertices and triangles that every codec is worth it.
    fn grid(side: u32) -> (Vec<[f32; 3]>, Vec<[f32; 3]>, Vec<u32>) {
        let height = |x: u32, y: u32| ((x * 7 + y * 13) % 11) as f32 * 0.01;
        let places = (0..side * side).map(|i| [(i % side) as f32, (i / side) as f32, height(i % side, i / side)]);
        let normals = (0..side * side).map(|i| [0.0, ((i % 5) as f32) * 0.1, 1.0]);
        let quads = (0..(side - 1) * (side - 1)).map(|q| q / (side - 1) * side + q % (side - 1));
        let indices = quads.flat_map(|v| [v, v + 1, v + side, v + side, v + 1, v + side + 1]);
        (places.collect(), normals.collect(), indices.collect())
    }

    pub(in crate::tests) fn packed(side: u32, packing: Packing) -> (Vec<u8>, Vec<u32>) {
        let (positions, normals, indices) = grid(side);
        let level = LevelContent {
            error: 0.0,
            error_kind: ErrorKind::Bound,
            arrays: vec![
                (Semantic::Positions, bytemuck::cast_slice(&positions)),
                (Semantic::Normals, bytemuck::cast_slice(&normals)),
            ],
            indices: &indices,
            index_counts: vec![indices.len() as u32],
            shares_vertices: false,
        };
        let submesh = crate::SubmeshContent { name: "all".into(), material: None, attributes: 6, source_triangles: 1 };
        let content = Content { levels: vec![level], submeshes: vec![submesh], packing, ..Content::default() };
        (write(&content).expect("valid"), indices)
    }

    #[test]
    fn geometry_comes_back_bit_for_bit_and_indices_as_decoding_gives_them() {
        for side in [20, 300] {
            let (positions, normals, _) = grid(side);
            let raw = packed(side, Packing::Raw).0.len();
            for packing in [Packing::Raw, Packing::Meshopt, Packing::Zstd] {
                let (bytes, indices) = packed(side, packing);
                let bytes = AlignedBytes::copy_of(&bytes);
                let container = Container::open(&bytes).expect("sound");
                let level = container.level(0).expect("at hand");
                assert_eq!((level.positions(), level.normals()), (&positions[..], Some(&normals[..])));
                let expected = match packing {
                    Packing::Meshopt => canonical_indices(&indices, side * side),
                    _ => indices,
                };
                assert_eq!(level.indices().iter().collect::<Vec<_>>(), expected, "{packing:?}, {side}");
                assert_eq!(level.positions().as_ptr() as usize % 256, 0);
                assert!(packing == Packing::Raw || bytes.len() < raw * 2 / 3, "{packing:?}: {} of {raw}", bytes.len());
                let codecs: Vec<u32> = container.sections().map(|s| s.entry.codec).collect();
                let expected = match packing {
                    Packing::Raw => [0, 0],
                    Packing::Meshopt => [3, 5],
                    Packing::Zstd => [1, 1],
                };
                // The larger grid's stream would shrink to less than a thousandth.
                let expected = if packing == Packing::Meshopt && side > 100 { [3, 4] } else { expected };
                assert_eq!(codecs[codecs.len() - 2..], expected);
            }
        }
    }

    #[test]
    fn canonical_indices_are_the_same_triangles_in_the_same_order() {
        let indices = [5, 3, 1, 1, 3, 5, 0, 1, 2, 2, 1, 3, 7, 7, 7, 4, 6, 6];
        let canonical = canonical_indices(&indices, 8);
        for (a, b) in indices.as_chunks::<3>().0.iter().zip(canonical.as_chunks::<3>().0) {
            let [x, y, z] = *a;
            assert!([[x, y, z], [y, z, x], [z, x, y]].contains(b), "{a:?} became {b:?}");
        }
        // Out of range, or no whole triangles: as they are.
        assert_eq!(canonical_indices(&[0, 1, 9], 3), [0, 1, 9]);
        assert_eq!(canonical_indices(&[0, 1], 3), [0, 1]);
    }

    #[test]
    fn decoding_is_the_same_on_any_number_of_threads_and_needs_no_order() {
        let model = layered();
        for packing in [Packing::Meshopt, Packing::Zstd] {
            let bytes = AlignedBytes::copy_of(&model.bytes(packing));
            let lazily = lent(&Container::open_tables(&bytes).expect("sound"));
            for threads in [0, 1, 2, 7] {
                let container = Container::open_tables(&bytes).expect("sound");
                container.decode(threads);
                assert_eq!(lent(&container), lazily, "{threads} threads");
            }
        }
    }

    #[test]
    fn a_raw_length_that_no_stream_reaches_is_refused_before_it_is_allocated() {
        for (packing, kind) in
            [(Packing::Meshopt, Kind::VERTICES), (Packing::Meshopt, Kind::INDICES), (Packing::Zstd, Kind::VERTICES)]
        {
            let (bytes, _) = packed(20, packing);
            let number = number_of(&bytes, kind);
            let found = codes_of(bytes, |b| edit_entry(b, number, |entry| entry.raw_length = 1 << 60));
            assert!(found.contains(&Code::RawLength), "{packing:?} {kind}: {found:?}");
        }
    }

    #[test]
    fn a_wrong_raw_hash_and_a_stream_that_is_none_are_told_apart() {
        for packing in [Packing::Meshopt, Packing::Zstd] {
            let (bytes, _) = packed(20, packing);
            let number = number_of(&bytes, Kind::VERTICES);
            let mut wrong = bytes.clone();
            edit_entry(&mut wrong, number, |entry| entry.raw_hash[0] ^= 1);
            crate::write::seal(&mut wrong);
            assert_eq!(check(&wrong).findings.iter().map(|f| f.code).collect::<Vec<_>>(), [Code::RawHash]);
            let offset = offset_of(&bytes, Kind::VERTICES);
            let garbage = codes_of(bytes, |b| b[offset..offset + 8].fill(0xFF));
            assert_eq!(garbage, [Code::Decode], "{packing:?}");
        }
    }

    #[test]
    fn two_frames_and_frames_with_something_behind_them_are_no_section() {
        let frame = crate::codec::encode_zstd(&[1; 100]).expect("compresses");
        let decode = |stored: &[u8]| crate::codec::decode(crate::codec::ZSTD, stored, 100, &[], 0).map(|b| b.len());
        assert_eq!(decode(&frame), Some(100));
        assert_eq!(decode(&[&frame[..], &[0]].concat()), None);
        let half = crate::codec::encode_zstd(&[1; 50]).expect("compresses");
        assert_eq!(decode(&[half.clone(), half].concat()), None);
        assert_eq!(decode(&[]), None);
    }

    #[test]
    fn a_constant_picture_beyond_the_limit_stays_raw_and_opens() {
        let model = tiny();
        let mut content = model.content();
        content.packing = Packing::Zstd;
        let texture = &mut content.textures[0];
        (texture.width, texture.height) = (2048, 2048);
        texture.mips = vec![Cow::Owned(vec![0; 2048 * 2048 * 4])];
        let bytes = AlignedBytes::copy_of(&write(&content).expect("valid"));
        assert!(bytes.len() > 16 << 20);
        Container::open(&bytes).expect("sound");
    }

    #[test]
    fn private_sections_are_never_coded() {
        let model = tiny();
        let mut content = model.content();
        content.packing = Packing::Zstd;
        let own = PrivateSection {
            kind: Kind(*b"abcd"),
            version: 1,
            required: false,
            payload: true,
            bytes: vec![0; 5000].into(),
        };
        content.private = vec![own];
        let bytes = AlignedBytes::copy_of(&write(&content).expect("valid"));
        let container = Container::open(&bytes).expect("sound");
        let section = container.sections().last().expect("there");
        assert_eq!(container.section_bytes(section.number).map(<[u8]>::len), Some(5000));
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(200))]

        #[test]
        fn any_bytes_are_decoded_to_something_or_refused(
            bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..600),
            head in 0usize..6,
            raw in 0u64..40_000,
            vertices in 0u64..400,
        ) {
            let mut bytes = bytes;
            // Likely heads: an index stream, a vertex stream behind its length, a zstd frame.
            let length = (bytes.len() as u32).saturating_sub(4).to_le_bytes();
            match head {
                0 if !bytes.is_empty() => bytes[0] = 0xE1,
                1 if bytes.len() > 5 => {
                    bytes[..4].copy_from_slice(&length);
                    bytes[4] = 0xA1;
                }
                2 if bytes.len() > 4 => bytes[..4].copy_from_slice(&[0x28, 0xB5, 0x2F, 0xFD]),
                _ => {}
            }
            let array = ArrayRecord { semantic: 1, format: 2, offset: 0, length: vertices * 12, reserved: [0; 2] };
            for codec in [crate::codec::ZSTD, crate::codec::VERTEX, crate::codec::INDEX] {
                for width in [2, 4] {
                    if let Some(out) = crate::codec::decode(codec, &bytes, raw, &[array], width) {
                        proptest::prop_assert_eq!(out.len() as u64, raw);
                        proptest::prop_assert!(raw <= bytes.len() as u64 * 1024);
                    }
                }
            }
        }
    }
}
