use glam::Vec3;
use kiln_asset::{Mesh, PointId, RawMesh, SubmeshId};
use proptest::prelude::*;

use super::octree::i_level;
use super::*;
use crate::Checkpoint;
use crate::fixtures;
use crate::simplify::error::Surface;

fn mesh(places: &[[f32; 3]], triangles: &[[u32; 3]]) -> Mesh {
    let raw = RawMesh {
        positions: places.iter().map(|p| Vec3::from_array(*p)).collect(),
        triangles: triangles.to_vec(),
        face_submesh: vec![SubmeshId(0); triangles.len()],
        submeshes: vec![Default::default()],
        ..Default::default()
    };
    Mesh::new(raw).unwrap()
}

fn on_a_line(places: &[f32], triangles: &[[u32; 3]]) -> Mesh {
    mesh(&places.iter().map(|x| [*x, 0.0, 0.0]).collect::<Vec<_>>(), triangles)
}

fn by_means(mesh: &Mesh) -> ClusterTree {
    ClusterTree::new(mesh, &TreeOptions { representative: Representative::Mean })
}

/// The page's definition, the slow way: a cell is a list of points.
struct Twin {
    /// By rank: points, row, longest edge.
    cells: Vec<(Vec<u32>, u32, f64)>,
}

impl Twin {
    fn new(mesh: &Mesh) -> Twin {
        let place = |point: u32| {
            let vertex = mesh.points.iter().position(|p| p.0 == point).unwrap();
            mesh.positions[vertex].to_array().map(f64::from)
        };
        let all: Vec<u32> = (0..mesh.point_count() as u32).collect();
        let mut cells = Vec::new();
        let mut waiting = vec![(all, None::<u32>)];
        let mut whole = 0.0;
        while let Some((points, above)) = waiting.pop() {
            let axis = |k: usize| points.iter().map(move |p| place(*p)[k]);
            let lo = [0, 1, 2].map(|k| axis(k).fold(f64::INFINITY, f64::min));
            let hi = [0, 1, 2].map(|k| axis(k).fold(f64::NEG_INFINITY, f64::max));
            let edge = (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max);
            let row = match above {
                None => {
                    whole = edge;
                    0
                }
                Some(_) if points.len() < 2 || edge == 0.0 => continue,
                Some(above) => {
                    (0..400).rfind(|q| whole >= 2f64.powi(*q) * edge).unwrap_or(0).max(above as i32 + 1) as u32
                }
            };
            if row > 63 {
                continue;
            }
            if edge > 0.0 {
                let octant =
                    |p: u32| (0..3).map(|k| usize::from(place(p)[k] >= 0.5 * (lo[k] + hi[k])) << k).sum::<usize>();
                for o in 0..8 {
                    let inside: Vec<u32> = points.iter().copied().filter(|p| octant(*p) == o).collect();
                    if !inside.is_empty() {
                        waiting.push((inside, Some(row)));
                    }
                }
            }
            cells.push((points, row, edge));
        }
        cells.sort_by(|a, b| a.1.cmp(&b.1).then(b.2.total_cmp(&a.2)).then(a.0.iter().min().cmp(&b.0.iter().min())));
        Twin { cells }
    }

    /// The shallowest cell over the point that is not split.
    fn pick(&self, point: u32, threshold: u32) -> Option<u32> {
        let over = |rank: &usize| self.cells[*rank].0.contains(&point);
        (threshold as usize..self.cells.len()).find(over).map(|rank| rank as u32)
    }
}

pub(crate) fn trouble() -> impl Strategy<Value = Mesh> {
    let grid = |range: std::ops::Range<i32>| range.prop_map(|x| x as f32);
    let place = prop_oneof![
        4 => [grid(0..5), grid(0..5), grid(0..5)],
        2 => [-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0],
        1 => (0u32..40).prop_map(|k| [2f32.powi(-(k as i32)), 0.0, 0.0]),
        1 => prop_oneof![Just([1e38f32, -1e38, 3e38]), Just([1e-45, 0.0, -0.0]), Just([-3e38, 1e-30, 1.0])],
    ];
    (1usize..40).prop_flat_map(move |count| {
        let index = 0..count as u32;
        let face = [index.clone(), index.clone(), index];
        let weld = prop::collection::vec(any::<bool>(), count);
        (prop::collection::vec(place.clone(), count), prop::collection::vec(face, 0..40), weld).prop_map(
            |(places, triangles, alone)| {
                let mut raw = mesh(&places, &triangles).into_raw();
                // Some vertices at one place are points of their own.
                let points = raw.points.iter().max().unwrap().0;
                for (v, _) in alone.iter().enumerate().filter(|(_, alone)| **alone) {
                    raw.points[v] = PointId(points + 1 + v as u32);
                }
                let all: Vec<u32> = (0..raw.positions.len() as u32).collect();
                let (triangles, submesh) = (raw.triangles.clone(), raw.face_submesh.clone());
                Mesh::new(raw.gather(&all, triangles, submesh)).unwrap()
            },
        )
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn the_tree_picks_what_its_definition_says_at_every_threshold(mesh in trouble()) {
        let (tree, twin) = (ClusterTree::new(&mesh, &TreeOptions::default()), Twin::new(&mesh));
        prop_assert_eq!(tree.node_count() as usize, twin.cells.len());
        for (rank, (points, row, _)) in twin.cells.iter().enumerate() {
            prop_assert_eq!(tree.row_of(rank as u32), *row);
            // Inside its cell.
            let inside = |k: usize| {
                let at = |v: &usize| mesh.positions[*v][k];
                let of = (0..mesh.vertex_count()).filter(|v| points.contains(&mesh.points[*v].0)).collect::<Vec<_>>();
                let x = tree.nodes()[rank].position[k];
                of.iter().map(at).fold(f32::INFINITY, f32::min) <= x && x <= of.iter().map(at).fold(f32::NEG_INFINITY, f32::max)
            };
            prop_assert!((0..3).all(inside));
        }
        let deaths = tree.face_deaths(&mesh);
        for t in 0..=tree.node_count() {
            let picks: Vec<Option<u32>> = (0..mesh.vertex_count() as u32).map(|v| tree.pick(v, t)).collect();
            for (v, pick) in picks.iter().enumerate() {
                prop_assert_eq!(*pick, twin.pick(mesh.points[v].0, t), "vertex {} at {}", v, t);
            }
            prop_assert_eq!(&picks, &tree.picks(t));
            let same = |a: u32, b: u32| picks[a as usize].is_some() && picks[a as usize] == picks[b as usize];
            let dead = |f: &[u32; 3]| same(f[0], f[1]) || same(f[1], f[2]) || same(f[2], f[0]);
            let alive: Vec<bool> = mesh.triangles.iter().map(|f| !dead(f)).collect();
            prop_assert_eq!(tree.faces_at(t) as usize, alive.iter().filter(|alive| **alive).count());
            prop_assert!(alive.iter().zip(&deaths).all(|(alive, death)| *alive == (*death < t)));
            let mut different: Vec<(Option<u32>, usize)> =
                picks.iter().enumerate().map(|(v, pick)| (*pick, if pick.is_some() { 0 } else { v })).collect();
            different.sort();
            different.dedup();
            prop_assert_eq!(tree.vertices_at(t) as usize, different.len());
            let level = tree.level(&mesh, t).unwrap();
            prop_assert_eq!(level.face_count(), tree.faces_at(t) as usize);
        }
        prop_assert_eq!(tree.level(&mesh, tree.node_count()).unwrap(), mesh);
    }

    #[test]
    fn every_threshold_has_an_r_level_of_its_own(mesh in trouble()) {
        let tree = by_means(&mesh);
        for rank in 0..tree.node_count() {
            let r = tree.r_level(rank);
            prop_assert_eq!(tree.threshold_at(r), rank + 1);
            prop_assert!(rank == 0 || r.value() > tree.r_level(rank - 1).value());
        }
        for wanted in 0..=mesh.face_count() as u32 + 1 {
            let choice = tree.threshold_for(wanted);
            let off = |t: u32| tree.faces_at(t).abs_diff(wanted);
            let best = (0..=tree.node_count()).map(off).min().unwrap();
            prop_assert_eq!(off(choice.threshold), best);
            prop_assert_eq!(choice.triangles, tree.faces_at(choice.threshold));
            prop_assert_eq!(choice.triangles, tree.faces_at(choice.first));
            prop_assert!(choice.first == 0 || tree.faces_at(choice.first - 1) < choice.triangles);
            prop_assert!(choice.threshold == tree.node_count() || tree.faces_at(choice.threshold + 1) > choice.triangles);
            let tied = (0..=tree.node_count()).map(|t| tree.faces_at(t)).find(|c| *c > choice.triangles && c.abs_diff(wanted) == best);
            prop_assert_eq!(choice.tied, tied);
            let within = tree.threshold_within(wanted);
            prop_assert!(tree.faces_at(within) <= wanted);
            prop_assert!(within == tree.node_count() || tree.faces_at(within + 1) > wanted);
            // The estimate lies between the two integer levels around it.
            let r = tree.paper_estimate(wanted);
            let t = tree.threshold_at(r);
            prop_assert!(tree.row_starts()[r.row as usize] <= t);
            prop_assert!(tree.row_starts().get(r.row as usize + 1).is_none_or(|end| t <= *end));
        }
    }

    #[test]
    fn a_blob_comes_back_and_damage_is_an_error_or_another_tree(mesh in trouble(), place in any::<prop::sample::Index>(), bit in 0u8..8) {
        let tree = ClusterTree::new(&mesh, &TreeOptions::default());
        let blob = tree.to_blob();
        prop_assert_eq!(ClusterTree::from_blob(&blob), Ok(tree));
        prop_assert!(ClusterTree::from_blob(&blob[..place.index(blob.len())]).is_err());
        let mut damaged = blob.clone();
        damaged[place.index(blob.len())] ^= 1 << bit;
        if let Ok(other) = ClusterTree::from_blob(&damaged) {
            prop_assert_eq!(other.to_blob(), damaged);
            for t in 0..=other.node_count() {
                other.picks(t);
                other.vertices_at(t);
                other.threshold_for(other.faces_at(t));
            }
        }
    }

    #[test]
    fn columns_hold_the_paths_and_leaves_point_into_them(mesh in trouble()) {
        let tree = ClusterTree::new(&mesh, &TreeOptions::default());
        let buffers = TreeLeafBuffers::new(&tree, &mesh).unwrap();
        let (width, rows) = (buffers.width, buffers.rows);
        prop_assert_eq!(buffers.tree.len(), (width * rows * buffers.columns.div_ceil(width.max(1))) as usize);
        for (v, leaf) in buffers.leaf.iter().enumerate() {
            prop_assert_eq!(&leaf[..3], &mesh.positions[v].to_array());
            let pointer = leaf[3] as u32;
            let terminal_row = pointer / width % rows;
            prop_assert_eq!(terminal_row, tree.row_of(tree.terminals()[v]));
            // Every row down to its own holds the shallowest node of that row or a lower one.
            for row in 0..=terminal_row {
                let pick = tree.pick(v as u32, tree.row_starts()[row as usize]).unwrap();
                let r = tree.r_level(pick);
                let [x, y, z] = tree.nodes()[pick as usize].position;
                let texel = buffers.tree[(pointer - (terminal_row - row) * width) as usize];
                prop_assert_eq!(texel, [x, y, z, r.k as f32 / r.n as f32]);
            }
        }
    }
}

#[test]
fn levels_are_the_exact_powers_of_two() {
    for (whole, edge, level) in [
        (16.0, 16.0, 0),
        (16.0, 8.0, 1),
        (16.0, 8.0f32.next_up(), 0),
        (16.0, 8.0f32.next_down(), 1),
        (16.0f32.next_down(), 8.0, 0),
        (3.0, 0.75, 2),
        (3e38, 1e-45, 276),
    ] {
        assert_eq!(i_level(f64::from(whole), f64::from(edge)), level, "{whole} over {edge}");
    }
}

#[test]
fn a_planted_line_gives_the_levels_that_were_worked_out_by_hand() {
    // Root 0..16; left {0, 1} of edge 1 skips to level 4; right {12, 16} of edge 4 is of level 2.
    let mesh = on_a_line(&[0.0, 1.0, 12.0, 16.0], &[[0, 1, 2], [0, 2, 3], [1, 2, 3], [0, 1, 3]]);
    let tree = by_means(&mesh);
    assert_eq!(tree.row_starts(), [0, 1, 1, 2, 2, 3]);
    let node = |x: f32, parent| TreeNode { position: [x, 0.0, 0.0], parent };
    assert_eq!(tree.nodes(), [node(7.25, 0), node(14.0, 0), node(0.5, 0)]);
    assert_eq!(tree.terminals(), [2, 2, 1, 1]);
    // Faces 1 and 2 die with the right node, 0 and 3 with the left one.
    assert_eq!(tree.face_deaths(&mesh), [2, 1, 1, 2]);
    assert_eq!(tree.face_counts(), [0, 0, 2, 4]);
    assert_eq!(tree.r_level(1), RLevel { row: 2, k: 1, n: 1 });
    // Numbers at the integer levels: 0, 0, 0, 2, 2, 4.
    assert_eq!(tree.paper_estimate(1), RLevel { row: 2, k: 1, n: 2 });
    assert_eq!(tree.paper_estimate(3), RLevel { row: 4, k: 1, n: 2 });
    assert_eq!(tree.paper_estimate(4), RLevel { row: 5, k: 0, n: 1 });
    assert_eq!(tree.threshold_for(3), ThresholdChoice { threshold: 2, first: 2, triangles: 2, tied: Some(4) });
    assert_eq!(tree.threshold_for(0), ThresholdChoice { threshold: 1, first: 0, triangles: 0, tied: None });
    assert_eq!((1..=1000).map(|s| tree.faces_of_s_level(s)).max(), Some(4));
    let buffers = TreeLeafBuffers::new(&tree, &mesh).unwrap();
    assert_eq!((buffers.width, buffers.rows, buffers.columns), (2, 5, 2));
    let column: Vec<[f32; 2]> = (0..5).map(|row| buffers.tree[2 * row]).map(|t| [t[0], t[3]]).collect();
    assert_eq!(column, [[7.25, 1.0], [0.5, 1.0], [0.5, 1.0], [0.5, 1.0], [0.5, 1.0]]);
    let column: Vec<[f32; 2]> = (0..5).map(|row| buffers.tree[2 * row + 1]).map(|t| [t[0], t[3]]).collect();
    assert_eq!(column, [[7.25, 1.0], [14.0, 1.0], [14.0, 1.0], [0.0, 0.0], [0.0, 0.0]]);
    assert_eq!(buffers.leaf.iter().map(|l| l[3] as u32).collect::<Vec<_>>(), [8, 8, 5, 5]);
}

#[test]
fn no_point_one_point_and_equal_places_are_trees() {
    let none = by_means(&mesh(&[], &[]));
    assert_eq!((none.node_count(), none.rows(), none.face_counts()), (0, 0, &[0][..]));
    assert_eq!(ClusterTree::from_blob(&none.to_blob()).unwrap(), none);
    assert_eq!(TreeLeafBuffers::new(&none, &mesh(&[], &[])).unwrap(), TreeLeafBuffers::default());
    let one = by_means(&mesh(&[[1.0, 2.0, 3.0]], &[]));
    assert_eq!((one.node_count(), one.rows(), one.nodes()[0].position), (1, 1, [1.0, 2.0, 3.0]));
    assert_eq!((one.pick(0, 0), one.pick(0, 1)), (Some(0), None));
    let mut raw = mesh(&[[1.0; 3]; 3], &[[0, 1, 2]]).into_raw();
    raw.points = vec![PointId(0), PointId(1), PointId(2)];
    let equal = by_means(&Mesh::new(raw).unwrap());
    assert_eq!((equal.node_count(), equal.face_counts()), (1, &[0, 1][..]));
}

#[test]
fn rows_end_at_the_container_s_limit() {
    let places: Vec<f32> = (0..140).map(|k| 2f32.powi(k - 120)).collect();
    let mesh = on_a_line(&places, &[]);
    let tree = by_means(&mesh);
    assert_eq!(tree.rows(), MAX_ROWS);
    assert_eq!(ClusterTree::from_blob(&tree.to_blob()).unwrap(), tree);
}

#[test]
fn a_box_keeps_its_corners_where_planes_tell_and_not_by_means() {
    let cube = fixtures::hard_cube(8);
    let corner = |tree: &ClusterTree| {
        // The node over the corner's own terminal.
        let vertex = cube.positions.iter().position(|p| *p == Vec3::ONE).unwrap();
        let [x, y, z] = tree.nodes()[tree.terminals()[vertex] as usize].position;
        Vec3::new(x, y, z).distance(Vec3::ONE)
    };
    let planes = ClusterTree::new(&cube, &TreeOptions::default());
    assert!(corner(&planes) < 0.01, "{}", corner(&planes));
    assert!(corner(&by_means(&cube)) > 0.1);
}

#[test]
fn the_tree_is_the_same_on_any_thread_count() {
    let mesh = fixtures::field(180, 180, |x, y| 3.0 * (0.1 * x).sin() * (0.07 * y).cos());
    let build = || ClusterTree::new(&mesh, &TreeOptions::default()).to_blob();
    let expected = build();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(pool.install(build) == expected);
    }
}

#[test]
fn checkpoints_go_from_all_to_nothing_with_errors_that_do_not_fall() {
    let mesh = fixtures::sphere(48, 24);
    let tree = ClusterTree::new(&mesh, &TreeOptions::default());
    let list = tree.checkpoints(&mesh, &Surface::new(&mesh, 20_000), 12).unwrap();
    let [first, .., last] = &list[..] else { panic!("{list:?}") };
    assert!(list.len() > 8 && list.len() <= 12, "{}", list.len());
    assert_eq!(
        *first,
        Checkpoint {
            detail: tree.node_count(),
            vertices: mesh.vertex_count() as u32,
            triangles: mesh.face_count() as u32,
            error: 0.0
        }
    );
    assert_eq!((last.detail, last.vertices, last.triangles), (0, 1, 0));
    // From the middle to the sphere.
    assert!((last.error - 1.0).abs() < 0.1, "{last:?}");
    for pair in list.windows(2) {
        assert!(
            pair[0].detail > pair[1].detail && pair[0].triangles >= pair[1].triangles && pair[0].error <= pair[1].error
        );
        assert!(pair[0].vertices >= pair[1].vertices);
    }
    assert!(list[2].error > 0.0 && list[2].error < 0.2);
}

#[test]
fn levels_keep_their_wedges_attributes() {
    let cube = fixtures::hard_cube(6);
    let tree = ClusterTree::new(&cube, &TreeOptions::default());
    let level = tree.level(&cube, tree.threshold_for(60).threshold).unwrap();
    assert!(level.face_count() > 20 && level.face_count() < 100);
    let normals = level.normals.as_ref().unwrap();
    for triangle in &level.triangles {
        // A side's normal, and not a mean over an edge.
        let [a, b, c] = triangle.map(|v| normals[v as usize]);
        assert!(a == b && b == c && a.abs().max_element() == 1.0);
    }
}

#[test]
fn the_order_of_vertices_visits_each_node_once() {
    let mesh = fixtures::merged_pair(20, 12);
    let tree = ClusterTree::new(&mesh, &TreeOptions::default());
    let order = tree.vertex_order(&mesh);
    let mut sorted = order.clone();
    sorted.sort_unstable();
    assert!(sorted.iter().zip(0..).all(|(a, b)| *a == b));
    // In each submesh, what picks one node lies together, whatever the threshold.
    let mut submesh = vec![0; mesh.vertex_count()];
    mesh.triangles.iter().zip(&mesh.face_submesh).for_each(|(t, s)| t.iter().for_each(|v| submesh[*v as usize] = s.0));
    for t in 0..=tree.node_count() {
        let mut runs: Vec<(u32, u32)> =
            order.iter().filter_map(|v| tree.pick(*v, t).map(|node| (submesh[*v as usize], node))).collect();
        runs.dedup();
        let count = runs.len();
        runs.sort_unstable();
        runs.dedup();
        assert_eq!(runs.len(), count, "threshold {t}");
    }
}

#[test]
fn more_texels_than_pointers_can_name_are_refused_with_both_numbers() {
    let error = TreeBufferError::TooManyTexels { texels: 20_000_000, columns: 1_000_000, rows: 20 };
    assert!(error.to_string().contains("20000000 texels") && error.to_string().contains("16777216"));
}
