//! Picks in trees beside naive twins and a plain copy: milliseconds on all threads, and what the buffers cost.
//!
//! `cargo run --release -p kiln-bench --bin pick_tree -- MODEL... [--runs N] [--size]`
//!
//! Every way writes all positions (three floats) of a level of as many triangles as each twentieth of the model's; the quickest of
//! `--runs` runs at each (machines are noisy), then the middle, least and greatest over the twenty. Vertices stand in the tree's order, but for the last rows. The
//! twins have nodes of 80 bytes in the order of a walk: one walks up from the leaf, one comes down from the root and finds the vertex'
//! octant. All ways are compared bit for bit first. `--size` prints instead how near the number of triangles comes to what s_level 1 to
//! 1000 asks for, by the paper's estimate and by the exact counts, and bytes.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_asset::Mesh;
use kiln_bench::rows::Page;
use kiln_bench::{middle, model, name, positions_only, timed};
use kiln_format::layout::{CompactNode, CompactTreeView, TreeHeader, TreeLeafView};
use kiln_lod::cluster_tree::{ClusterTree, TreeLeafBuffers, TreeOptions};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_runtime::tree::{Compact, Resolved, Runs, TreeLeaf, draw_list};
use rayon::prelude::*;

fn main() -> ExitCode {
    let (mut models, mut runs, mut size) = (Vec::new(), 5usize, false);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--runs" => runs = args.next().and_then(|v| v.parse().ok()).unwrap_or(runs).max(1),
            "--size" => size = true,
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: pick_tree MODEL... [--runs N] [--size]");
        return ExitCode::from(64);
    }
    let mut page = Page::new(None);
    match size {
        true => page.head(&[
            "model",
            ":triangles",
            ":build s",
            ":nodes / vertices",
            ":rows",
            ":columns",
            ":tree + leaf, bytes / triangle",
            ":compact, bytes / triangle",
            ":estimate off, %",
            ":at s_level",
            ":exact off, %",
        ]),
        false => page.head(&["model, way", ":ms", ":least", ":greatest", ":/ copy", ":walk up / it", ":descent / it"]),
    }
    for path in &models {
        let done = if size { sizes(path, &mut page) } else { compare(path, runs, &mut page) };
        if let Err(message) = done {
            eprintln!("{}: {message}", path.display());
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn points_of(path: &Path) -> Result<Mesh, String> {
    positions_only(&merge(&model(path)?.mesh, &MergeOptions::default()).0)
}

fn sizes(path: &Path, page: &mut Page) -> Result<(), String> {
    let mesh = points_of(path)?;
    let (tree, seconds) = timed(|| ClusterTree::new(&mesh, &TreeOptions::default()));
    let faces = f64::from(tree.faces_at(u32::MAX));
    let off = |reached: u32, wanted: u32| 100.0 * f64::from(reached.abs_diff(wanted)) / faces;
    let (mut paper, mut exact) = ((0.0f64, 0), 0.0f64);
    for s in 1..=1000 {
        let wanted = tree.faces_of_s_level(s);
        let estimate = off(tree.faces_at(tree.threshold_at(tree.paper_estimate(wanted))), wanted);
        if estimate > paper.0 {
            paper = (estimate, s);
        }
        exact = exact.max(off(tree.threshold_for(wanted).triangles, wanted));
    }
    let vertices = mesh.vertex_count() as f64;
    let (columns, bytes) = match TreeLeafBuffers::new(&tree, &mesh) {
        Ok(buffers) => {
            let bytes = 16.0 * (buffers.tree.len() + buffers.leaf.len()) as f64;
            (buffers.columns.to_string(), format!("{:.1}", bytes / faces))
        }
        Err(error) => (error.to_string(), "-".into()),
    };
    page.row(&[
        name(path),
        mesh.face_count().to_string(),
        format!("{seconds:.2}"),
        format!("{:.3}", f64::from(tree.node_count()) / vertices),
        tree.rows().to_string(),
        columns,
        bytes,
        format!("{:.1}", (16.0 * f64::from(tree.node_count()) + 4.0 * vertices) / faces),
        format!("{:.2}", paper.0),
        paper.1.to_string(),
        format!("{exact:.4}"),
    ]);
    Ok(())
}

/// A mesh's tree in both layouts.
struct Built {
    mesh: Mesh,
    tree: ClusterTree,
    buffers: TreeLeafBuffers,
    nodes: Vec<CompactNode>,
    positions: Vec<[f32; 3]>,
}

impl Built {
    fn new(mesh: Mesh) -> Result<Built, String> {
        let tree = ClusterTree::new(&mesh, &TreeOptions::default());
        let buffers = TreeLeafBuffers::new(&tree, &mesh).map_err(|e| e.to_string())?;
        let nodes = tree.nodes().iter().map(|n| CompactNode { position: n.position, parent: n.parent }).collect();
        let positions = mesh.positions.iter().map(|p| p.to_array()).collect();
        Ok(Built { mesh, tree, buffers, nodes, positions })
    }

    /// The same with vertices in the tree's order.
    fn in_order(&self) -> Result<Built, String> {
        let order = self.tree.vertex_order(&self.mesh);
        let mut new_index = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(old, new)| new_index[*old as usize] = new);
        let triangles = self.mesh.triangles.iter().map(|t| t.map(|v| new_index[v as usize])).collect();
        let raw = self.mesh.gather(&order, triangles, self.mesh.face_submesh.clone());
        Built::new(Mesh::new(raw).map_err(|e| e.to_string())?)
    }

    fn header(&self) -> TreeHeader {
        let (nodes, vertices) = (self.tree.node_count(), self.positions.len() as u32);
        let (rows, columns, width) = (self.tree.rows(), self.buffers.columns, self.buffers.width);
        TreeHeader { nodes, vertices, rows, columns, width, checkpoints: 0, reserved: [0; 10] }
    }

    fn tree_leaf(&self) -> TreeLeaf<'_> {
        let (row_starts, face_counts) = (self.tree.row_starts(), self.tree.face_counts());
        let (tree, leaf) = (&self.buffers.tree[..], &self.buffers.leaf[..]);
        TreeLeaf::new(TreeLeafView { header: self.header(), checkpoints: &[], row_starts, face_counts, tree, leaf })
    }

    fn compact(&self) -> Compact<'_> {
        let (row_starts, face_counts) = (self.tree.row_starts(), self.tree.face_counts());
        let (header, nodes, terminals) = (self.header(), &self.nodes[..], self.tree.terminals());
        let view = CompactTreeView { header, checkpoints: &[], row_starts, face_counts, nodes, terminals };
        Compact::new(view, &self.positions)
    }
}

/// A node as trees are written at first.
struct TwinNode {
    parent: Option<usize>,
    children: [Option<std::num::NonZeroU32>; 8],
    middle: [f64; 3],
    rank: u32,
    position: [f32; 3],
}

/// The naive twins' octree: nodes in the order of a walk, the root first.
struct Twin {
    nodes: Vec<TwinNode>,
    /// `[vertex_count]`.
    terminals: Vec<usize>,
}

fn octant(place: [f32; 3], middle: [f64; 3]) -> usize {
    (0..3).map(|k| usize::from(f64::from(place[k]) >= middle[k]) << k).sum()
}

impl Twin {
    /// `built`: vertices in the tree's order, so that nodes are first met in the order of a walk.
    fn new(built: &Built) -> Twin {
        let ranked = built.tree.nodes();
        let mut boxes = vec![([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]); ranked.len()];
        for (terminal, place) in built.tree.terminals().iter().zip(&built.positions) {
            let (lo, hi) = &mut boxes[*terminal as usize];
            (0..3).for_each(|k| (lo[k], hi[k]) = (lo[k].min(place[k]), hi[k].max(place[k])));
        }
        for rank in (1..ranked.len()).rev() {
            let below = boxes[rank];
            let (lo, hi) = &mut boxes[ranked[rank].parent as usize];
            (0..3).for_each(|k| (lo[k], hi[k]) = (lo[k].min(below.0[k]), hi[k].max(below.1[k])));
        }
        let mut twin = Twin { nodes: Vec::new(), terminals: Vec::new() };
        let mut place_of = vec![usize::MAX; ranked.len()];
        let mut path = Vec::new();
        for terminal in built.tree.terminals() {
            let mut rank = *terminal;
            while place_of[rank as usize] == usize::MAX {
                path.push(rank);
                if rank == 0 {
                    break;
                }
                rank = ranked[rank as usize].parent;
            }
            for rank in path.drain(..).rev() {
                let node = &ranked[rank as usize];
                let (lo, hi) = boxes[rank as usize];
                let middle = [0, 1, 2].map(|k| 0.5 * (f64::from(lo[k]) + f64::from(hi[k])));
                let (me, parent) = (twin.nodes.len(), (rank > 0).then(|| place_of[node.parent as usize]));
                if let Some(parent) = parent {
                    let slot = octant(node.position, twin.nodes[parent].middle);
                    twin.nodes[parent].children[slot] = std::num::NonZeroU32::new(me as u32);
                }
                place_of[rank as usize] = me;
                twin.nodes.push(TwinNode { parent, children: [None; 8], middle, rank, position: node.position });
            }
            twin.terminals.push(place_of[*terminal as usize]);
        }
        twin
    }

    fn up(&self, vertex: usize, own: [f32; 3], threshold: u32) -> [f32; 3] {
        let mut node = &self.nodes[self.terminals[vertex]];
        if node.rank < threshold {
            return own;
        }
        while let Some(parent) = node.parent.map(|parent| &self.nodes[parent])
            && parent.rank >= threshold
        {
            node = parent;
        }
        node.position
    }

    fn down(&self, own: [f32; 3], threshold: u32) -> [f32; 3] {
        let mut node = &self.nodes[0];
        while node.rank < threshold {
            match node.children[octant(own, node.middle)] {
                Some(child) => node = &self.nodes[child.get() as usize],
                None => return own,
            }
        }
        node.position
    }
}

/// A way to pick all vertices at a threshold.
type Way<'a> = (&'static str, Box<dyn FnMut(u32, &mut [[f32; 3]]) + 'a>);

/// `work` on all threads: first vertex of a part, and its places.
fn spread(out: &mut [[f32; 3]], work: impl Fn(usize, &mut [[f32; 3]]) + Sync) {
    let part = out.len().div_ceil(8 * rayon::current_num_threads()).max(1);
    out.par_chunks_mut(part).enumerate().for_each(|(i, out)| work(i * part, out));
}

fn ways<'a>(built: &'a Built, twin: &'a Twin, shuffled: bool) -> Vec<Way<'a>> {
    let (paper, compact, positions) = (built.tree_leaf(), built.compact(), &built.positions[..]);
    let mut resolved = Resolved::new();
    let mut ways: Vec<Way<'a>> = vec![
        (
            "tree and leaf buffers",
            Box::new(move |t, out| spread(out, |first, out| paper.pick_at(t, first..first + out.len(), out))),
        ),
        (
            "compact, walk",
            Box::new(move |t, out| spread(out, |first, out| compact.pick(t, first..first + out.len(), out))),
        ),
        (
            "compact, resolved",
            Box::new(move |t, out| {
                resolved.resolve(&compact, t);
                spread(out, |first, out| resolved.pick(&compact, first..first + out.len(), out));
            }),
        ),
    ];
    if shuffled {
        return ways;
    }
    if let Some(runs) = Runs::new(&compact) {
        ways.push((
            "compact, runs",
            Box::new(move |t, out| spread(out, |first, out| runs.pick(positions, t, first..first + out.len(), out))),
        ));
    }
    ways.push((
        "naive walk up",
        Box::new(move |t, out| {
            spread(out, |first, out| {
                out.iter_mut().zip(first..).for_each(|(out, v)| *out = twin.up(v, positions[v], t));
            });
        }),
    ));
    ways.push((
        "naive descent",
        Box::new(move |t, out| {
            spread(out, |first, out| {
                out.iter_mut().zip(&positions[first..]).for_each(|(out, own)| *out = twin.down(*own, t));
            });
        }),
    ));
    ways
}

fn compare(path: &Path, runs: usize, page: &mut Page) -> Result<(), String> {
    let original = Built::new(points_of(path)?)?;
    let built = original.in_order()?;
    let twin = Twin::new(&built);
    let triangles = built.mesh.face_count() as u64;
    let thresholds: Vec<u32> =
        (1..=20).map(|i| built.tree.threshold_for((triangles * i / 20) as u32).threshold).collect();
    let mut out = vec![[0.0f32; 3]; built.positions.len()];
    let (_, copy, _) = time(&thresholds, runs, &mut out, &mut |_, out| {
        spread(out, |first, out| out.copy_from_slice(&built.positions[first..first + out.len()]));
    });
    let mut rows = Vec::new();
    for (built, order) in [(&built, ""), (&original, ", in the model's order")] {
        for (way, mut pick) in ways(built, &twin, !order.is_empty()) {
            for t in &thresholds {
                pick(*t, &mut out);
                let place = |v: u32| {
                    built.tree.pick(v, *t).map_or(built.positions[v as usize], |n| built.nodes[n as usize].position)
                };
                if !(0..out.len() as u32).step_by(7).all(|v| out[v as usize] == place(v)) {
                    return Err(format!("{way} picks wrong at {t}"));
                }
            }
            rows.push((format!("{way}{order}"), time(&thresholds, runs, &mut out, &mut pick)));
        }
    }
    let of = |wanted: &str| rows.iter().find(|(way, _)| way == wanted).map_or(f64::NAN, |(_, t)| t.1);
    let (up, down) = (of("naive walk up"), of("naive descent"));
    page.row(&[format!("{}, copy of {} vertices", name(path), out.len()), format!("{:.3}", 1e3 * copy)]);
    for (way, (least, seconds, most)) in &rows {
        page.row(&[
            way.clone(),
            format!("{:.3}", 1e3 * seconds),
            format!("{:.3}", 1e3 * least),
            format!("{:.3}", 1e3 * most),
            format!("{:.2}", seconds / copy),
            format!("{:.2}", up / seconds),
            format!("{:.2}", down / seconds),
        ]);
    }
    let mut deaths = vec![0; built.mesh.face_count()];
    let (_, dying) = timed(|| built.compact().deaths(&built.mesh.triangles, &mut deaths));
    let mut list = vec![[0; 3]; deaths.len()];
    let mut listing: Vec<f64> = Vec::new();
    for t in &thresholds {
        listing.push(timed(|| draw_list(&built.mesh.triangles, &deaths, *t, &mut list)).1);
    }
    page.row(&["deaths once, one thread".into(), format!("{:.3}", 1e3 * dying)]);
    page.row(&["draw list, one thread".into(), format!("{:.3}", 1e3 * middle(listing))]);
    Ok(())
}

/// Least, middle and greatest seconds over the thresholds, of the quickest of `runs` runs at each.
fn time(
    thresholds: &[u32],
    runs: usize,
    out: &mut [[f32; 3]],
    pick: &mut dyn FnMut(u32, &mut [[f32; 3]]),
) -> (f64, f64, f64) {
    let mut seconds: Vec<f64> = Vec::new();
    for t in thresholds {
        seconds.push((0..runs).map(|_| timed(|| pick(*t, out)).1).fold(f64::INFINITY, f64::min));
    }
    let least = seconds.iter().copied().fold(f64::INFINITY, f64::min);
    let most = seconds.iter().copied().fold(0.0, f64::max);
    (least, middle(seconds), most)
}
