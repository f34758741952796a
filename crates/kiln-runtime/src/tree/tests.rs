use core::ops::Range;

use kiln_asset::{Mesh, RawMesh, Submesh, SubmeshId};
use kiln_format::layout::{CompactNode, CompactTreeView, TreeHeader, TreeLeafView};
use kiln_lod::cluster_tree::{ClusterTree, TreeLeafBuffers, TreeOptions};
use proptest::prelude::*;

use super::*;

/// A mesh's tree in both layouts, as a container would lend them.
pub(crate) struct Built {
    pub(crate) mesh: Mesh,
    pub(crate) tree: ClusterTree,
    buffers: TreeLeafBuffers,
    nodes: Vec<CompactNode>,
    pub(crate) positions: Vec<[f32; 3]>,
}

impl Built {
    pub(crate) fn new(mesh: Mesh) -> Built {
        let tree = ClusterTree::new(&mesh, &TreeOptions::default());
        let buffers = TreeLeafBuffers::new(&tree, &mesh).unwrap();
        let nodes = tree.nodes().iter().map(|n| CompactNode { position: n.position, parent: n.parent }).collect();
        let positions = mesh.positions.iter().map(|p| p.to_array()).collect();
        Built { mesh, tree, buffers, nodes, positions }
    }

    fn header(&self, columns: u32, width: u32) -> TreeHeader {
        TreeHeader {
            nodes: self.tree.node_count(),
            vertices: self.mesh.vertex_count() as u32,
            rows: self.tree.rows(),
            columns,
            width,
            checkpoints: 0,
            reserved: [0; 10],
        }
    }

    pub(crate) fn tree_leaf(&self) -> TreeLeafView<'_> {
        TreeLeafView {
            header: self.header(self.buffers.columns, self.buffers.width),
            checkpoints: &[],
            row_starts: self.tree.row_starts(),
            face_counts: self.tree.face_counts(),
            tree: &self.buffers.tree,
            leaf: &self.buffers.leaf,
        }
    }

    pub(crate) fn compact(&self) -> CompactTreeView<'_> {
        CompactTreeView {
            header: self.header(0, 0),
            checkpoints: &[],
            row_starts: self.tree.row_starts(),
            face_counts: self.tree.face_counts(),
            nodes: &self.nodes,
            terminals: self.tree.terminals(),
        }
    }

    /// What the tree says, vertex by vertex.
    pub(crate) fn naive(&self, threshold: u32) -> Vec<[f32; 3]> {
        let pick = |v: u32| self.tree.pick(v, threshold);
        let place = |v: u32| pick(v).map_or(self.positions[v as usize], |n| self.nodes[n as usize].position);
        (0..self.positions.len() as u32).map(place).collect()
    }

    /// Triangles of which no two corners pick one node.
    pub(crate) fn alive(&self, threshold: u32) -> Vec<[u32; 3]> {
        let pick = |v: u32| self.tree.pick(v, threshold);
        let same = |a: u32, b: u32| pick(a).is_some() && pick(a) == pick(b);
        let alive = |t: &&[u32; 3]| !(same(t[0], t[1]) || same(t[1], t[2]) || same(t[2], t[0]));
        self.mesh.triangles.iter().filter(alive).copied().collect()
    }
}

pub(crate) fn mesh(places: &[[f32; 3]], triangles: &[[u32; 3]], split: usize) -> Mesh {
    // A vertex is of one submesh only.
    let half = |t: &[u32; 3]| t.iter().all(|v| (*v as usize) < split);
    let mut sorted: Vec<[u32; 3]> = triangles.iter().copied().filter(half).collect();
    let first = sorted.len();
    sorted.extend(triangles.iter().filter(|t| t.iter().all(|v| (*v as usize) >= split)));
    let submesh = |name: &str| Submesh { name: name.into(), ..Default::default() };
    let raw = RawMesh {
        positions: places.iter().map(|p| (*p).into()).collect(),
        face_submesh: (0..sorted.len()).map(|f| SubmeshId(u32::from(f >= first))).collect(),
        triangles: sorted,
        submeshes: vec![submesh("a"), submesh("b")],
        ..Default::default()
    };
    Mesh::new(raw).unwrap()
}

pub(crate) fn trouble() -> impl Strategy<Value = Mesh> {
    let grid = || (0i32..6).prop_map(|x| x as f32);
    let place = prop_oneof![
        4 => [grid(), grid(), grid()],
        2 => [-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0],
        1 => (0u32..70).prop_map(|k| [2f32.powi(-(k as i32)), 0.0, 0.0]),
        1 => prop_oneof![Just([1e38f32, -1e38, 3e38]), Just([1e-45, 0.0, -0.0]), Just([-3e38, 1e-30, 1.0])],
    ];
    (1usize..50).prop_flat_map(move |count| {
        let index = 0..count as u32;
        let face = [index.clone(), index.clone(), index];
        (prop::collection::vec(place.clone(), count), prop::collection::vec(face, 0..60), 0..=count)
            .prop_map(|(places, triangles, split)| mesh(&places, &triangles, split))
    })
}

pub(crate) fn bits(places: &[[f32; 3]]) -> Vec<[u32; 3]> {
    places.iter().map(|p| p.map(f32::to_bits)).collect()
}

/// The mesh with its vertices in the tree's order.
fn in_order(mesh: &Mesh) -> Mesh {
    let order = ClusterTree::new(mesh, &TreeOptions::default()).vertex_order(mesh);
    let mut new_index = vec![0; order.len()];
    order.iter().zip(0..).for_each(|(old, new)| new_index[*old as usize] = new);
    let triangles = mesh.triangles.iter().map(|t| t.map(|v| new_index[v as usize])).collect();
    Mesh::new(mesh.gather(&order, triangles, mesh.face_submesh.clone())).unwrap()
}

/// Picks a range of vertices.
type Pick<'a> = dyn Fn(Range<usize>, &mut [[f32; 3]]) + 'a;

/// Every way to pick, at every threshold, against the tree.
fn all_ways_agree(built: &Built) -> Result<(), TestCaseError> {
    let count = built.positions.len();
    let (paper, compact) = (TreeLeaf::new(built.tree_leaf()), Compact::new(built.compact(), &built.positions));
    let runs = Runs::new(&compact);
    let mut resolved = Resolved::new();
    let triangles = &built.mesh.triangles[..];
    let (mut deaths, mut others) = (vec![0; triangles.len()], vec![0; triangles.len()]);
    compact.deaths(triangles, &mut deaths);
    paper.deaths(triangles, &mut others);
    prop_assert_eq!(&deaths, &built.tree.face_deaths(&built.mesh));
    prop_assert_eq!(&deaths, &others);
    for t in 0..=built.tree.node_count() {
        let expected = bits(&built.naive(t));
        let r = paper.scale().r_of(t);
        prop_assert_eq!(paper.scale().threshold_of(r), t);
        let cut = count / 3;
        let halves = [0..cut, cut..count];
        let mut out = vec![[0.0; 3]; count];
        let check = |pick: &Pick<'_>, out: &mut Vec<[f32; 3]>| {
            out.fill([f32::NAN; 3]);
            let (front, back) = out.split_at_mut(cut);
            pick(halves[0].clone(), front);
            pick(halves[1].clone(), back);
            bits(out) == expected
        };
        prop_assert!(check(&|range, out| paper.pick_at(t, range, out), &mut out), "tree and leaf buffers at {}", t);
        prop_assert!(check(&|range, out| compact.pick(t, range, out), &mut out), "walk at {}", t);
        resolved.resolve(&compact, t);
        prop_assert!(check(&|range, out| resolved.pick(&compact, range, out), &mut out), "resolved at {}", t);
        if let Some(runs) = &runs {
            let pick = |range, out: &mut [[f32; 3]]| runs.pick(&built.positions, t, range, out);
            prop_assert!(check(&pick, &mut out), "runs at {}", t);
        }
        for (v, expected) in expected.iter().enumerate() {
            let (place, reads) = paper.counted(r, v);
            prop_assert!(reads <= 3 && place.map(f32::to_bits) == *expected);
        }
        let alive = built.alive(t);
        let mut list = vec![[0; 3]; alive.len()];
        prop_assert_eq!(draw_list(triangles, &deaths, t, &mut list), alive.len());
        prop_assert_eq!(alive_count(&deaths, t), alive.len());
        prop_assert_eq!(&list, &alive);
        prop_assert_eq!(paper.scale().triangles(t) as usize, alive.len());
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn all_ways_pick_the_same_at_every_threshold(mesh in trouble()) {
        all_ways_agree(&Built::new(mesh))?;
    }

    #[test]
    fn in_the_tree_s_order_there_are_runs_and_they_agree(mesh in trouble()) {
        let built = Built::new(in_order(&mesh));
        let compact = Compact::new(built.compact(), &built.positions);
        prop_assert!(Runs::new(&compact).is_some());
        all_ways_agree(&built)?;
    }

    #[test]
    fn between_two_levels_any_r_picks_as_its_threshold_does(mesh in trouble(), row in 0u32..70, fraction in 0.0f32..1.0) {
        let built = Built::new(mesh);
        let paper = TreeLeaf::new(built.tree_leaf());
        let r = RLevel { row, fraction };
        let mut out = vec![[0.0; 3]; built.positions.len()];
        paper.pick(r, 0..out.len(), &mut out);
        prop_assert_eq!(bits(&out), bits(&built.naive(paper.scale().threshold_of(r))));
        for v in 0..out.len() {
            prop_assert!(paper.counted(r, v).1 <= 3);
        }
    }

    #[test]
    fn wrong_numbers_neither_panic_nor_hang(
        words in prop::collection::vec(prop_oneof![0u32..12, any::<u32>()], 60),
        head in [prop_oneof![0u32..9, any::<u32>()], prop_oneof![0u32..9, any::<u32>()], prop_oneof![0u32..9, any::<u32>()]],
        threshold in prop_oneof![0u32..12, any::<u32>()],
    ) {
        let float = |i: usize| if words[i] < 12 { words[i] as f32 } else { f32::from_bits(words[i]) };
        let texels: Vec<[f32; 4]> = (0..15).map(|i| [0, 1, 2, 3].map(|k| float(4 * i + k))).collect();
        let nodes: Vec<CompactNode> =
            (0..15).map(|i| CompactNode { position: [float(4 * i); 3], parent: words[4 * i + 3] }).collect();
        let positions: Vec<[f32; 3]> = (0..17).map(|i| [float(i); 3]).collect();
        let [rows, width, columns] = head;
        let header = TreeHeader { nodes: 15, vertices: 20, rows, columns, width, checkpoints: 0, reserved: [0; 10] };
        let checkpoints = [Checkpoint { detail: words[0], vertices: 0, triangles: words[1], error: float(2), level: 0, reserved: [0; 3] }];
        let (row_starts, face_counts) = (&words[..(rows as usize % 9)], &words[20..36]);
        let paper = TreeLeaf::new(TreeLeafView { header, checkpoints: &checkpoints, row_starts, face_counts, tree: &texels, leaf: &texels });
        let compact = Compact::new(CompactTreeView { header, checkpoints: &checkpoints, row_starts, face_counts, nodes: &nodes, terminals: &words[..20] }, &positions);
        let mut out = [[0.0f32; 4]; 25];
        let scale = paper.scale();
        let r = scale.r_of(threshold);
        scale.threshold_of(r);
        scale.threshold_of(RLevel { row: threshold, fraction: float(5) });
        scale.triangles(threshold);
        scale.within_triangles(threshold);
        scale.within_error(float(6));
        scale.within_pixels(&View { distance: float(7), vertical_fov_radians: 1.0, viewport_height_px: 600.0 }, 1.0);
        paper.pick(r, 0..25, &mut out);
        paper.pick(RLevel { row: threshold, fraction: float(5) }, 0..25, &mut out);
        paper.pick_at(threshold, 3..90, &mut out);
        compact.pick(threshold, 0..25, &mut out);
        compact.pick(threshold, 30..90, &mut out);
        let mut resolved = Resolved::new();
        resolved.resolve(&compact, threshold);
        resolved.pick(&compact, 2..25, &mut out);
        if let Some(runs) = Runs::new(&compact) {
            runs.pick(&positions, threshold, 0..25, &mut out);
            runs.pick(&positions[..4], threshold, 2..25, &mut out);
        }
        let triangles: Vec<[u32; 3]> = words.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        let mut deaths = vec![0; triangles.len()];
        compact.deaths(&triangles, &mut deaths);
        paper.deaths(&triangles, &mut deaths);
        draw_list(&triangles, &deaths, threshold, &mut [[0; 3]; 7]);
    }
}

/// Figure 6 and table 1: P1 to P3 under Pa (5.633), P4 and P5 under Pb (4.382), P6 under Pc (3.457); the root above.
#[test]
fn the_paper_s_example_picks_as_printed() {
    let (pa, pb, pc, root) =
        ([6.0, 0.0, 0.0, 0.633], [5.0, 0.0, 0.0, 0.382], [4.0, 0.0, 0.0, 0.457], [1.0, 0.0, 0.0, 1.0]);
    // Rows 1 and 2 are skipped.
    let texels = [root, pc, pc, pc, pb, pa];
    let leaf: Vec<[f32; 4]> =
        [5.0, 5.0, 5.0, 4.0, 4.0, 3.0].iter().zip(1..).map(|(texel, p)| [-(p as f32), 0.0, 0.0, *texel]).collect();
    let header = TreeHeader { nodes: 4, vertices: 6, rows: 6, columns: 1, width: 1, checkpoints: 0, reserved: [0; 10] };
    let view = TreeLeafView { header, checkpoints: &[], row_starts: &[], face_counts: &[], tree: &texels, leaf: &leaf };
    let picks = |row: u32, fraction: f32| {
        let mut out = [[0.0; 3]; 6];
        TreeLeaf::new(view).pick(RLevel { row, fraction }, 0..6, &mut out);
        out.map(|p| p[0])
    };
    let (a, b, c, top) = (6.0, 5.0, 4.0, 1.0);
    // The paper's own: r = 4.4, level_l = 6, d = 1.6, case 3, Pa because Pb's 4.382 is not above.
    assert_eq!(picks(4, 0.4), [a, a, a, -4.0, -5.0, -6.0]);
    assert_eq!(picks(4, 0.38), [b, b, b, b, b, -6.0]);
    assert_eq!(picks(5, 0.6), [a, a, a, -4.0, -5.0, -6.0]);
    assert_eq!(picks(5, 0.65), [-1.0, -2.0, -3.0, -4.0, -5.0, -6.0]);
    assert_eq!(picks(6, 0.0), [-1.0, -2.0, -3.0, -4.0, -5.0, -6.0]);
    assert_eq!(picks(3, 0.5), [b, b, b, b, b, -6.0]);
    assert_eq!(picks(3, 0.4), [c; 6]);
    assert_eq!(picks(1, 0.7), [c; 6]);
    assert_eq!(picks(1, 0.0), [c; 6]);
    assert_eq!(picks(0, 0.999), [top; 6]);
    assert_eq!(picks(0, 0.0), [top; 6]);
    for (vertex, row) in (0..6).flat_map(|vertex| (0..8).map(move |row| (vertex, row))) {
        assert!(TreeLeaf::new(view).counted(RLevel { row, fraction: 0.4 }, vertex).1 <= 3);
    }
}

#[test]
fn thresholds_follow_budgets_errors_and_pixels() {
    let checkpoint =
        |detail, triangles, error| Checkpoint { detail, vertices: 0, triangles, error, level: 0, reserved: [0; 3] };
    let checkpoints = [checkpoint(5, 20, 0.0), checkpoint(3, 8, 0.01), checkpoint(1, 2, 0.1), checkpoint(0, 0, 1.0)];
    let scale = Scale { checkpoints: &checkpoints, row_starts: &[0, 1, 3, 5], face_counts: &[0, 2, 2, 8, 14, 20] };
    let budgets = [0, 1, 2, 7, 8, 19, 20, 500].map(|budget| scale.within_triangles(budget));
    assert_eq!(budgets, [0, 0, 2, 2, 3, 4, 5, 5]);
    assert_eq!([-1.0, 0.0, 0.02, 0.1, 9.0].map(|error| scale.within_error(error)), [5, 5, 3, 1, 0]);
    assert_eq!(scale.within_error(f32::NAN), 5);
    // One unit covers 100 pixels at distance 1.
    let view =
        |distance| View { distance, vertical_fov_radians: std::f32::consts::FRAC_PI_2, viewport_height_px: 200.0 };
    assert_eq!([0.0, 0.5, 1.01, 10.1, 200.0].map(|d| scale.within_pixels(&view(d), 1.0)), [5, 5, 3, 1, 0]);
    let r = |row, fraction| RLevel { row, fraction };
    let rs = [0, 1, 2, 3, 4, 5, 99].map(|t| scale.r_of(t));
    assert_eq!(rs, [r(0, 0.0), r(1, 0.0), r(1, 0.5), r(2, 0.0), r(2, 0.5), r(3, 0.0), r(3, 0.0)]);
    assert_eq!([r(0, 0.9), r(1, 0.49), r(2, 0.99), r(9, 0.0)].map(|r| scale.threshold_of(r)), [0, 1, 4, 5]);
}
