//! Continuous layouts: how near their triangle counts come to what is asked, what they cost, and how far they are from the source.
//!
//! `cargo run --release -p kiln-bench --bin continuous -- MODEL... [--plot FILE.svg] [--picture FILE.png] [--out FILE.md]`
//!
//! Models without texture coordinates are welded to one vertex a point, positions only, as the papers count; textured ones keep their
//! vertices. Each layout is made as the stages make it: half-edge collapses by the quadric metric to exhaustion for the window, the
//! octree over the model's points, the cluster DAG over its triangles.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use glam::Vec3;
use kiln_asset::{MaterialSet, Mesh};
use kiln_bench::plot::{Plot, Series};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{model, name, positions_only};
use kiln_lod::cluster_dag::{ClusterDag, ClusterDagOptions};
use kiln_lod::cluster_tree::{ClusterTree, RLevel, Representative, TreeLeafBuffers, TreeOptions};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{CollapseSequence, Placement, SimplifyOptions, collapse, simplify};
use kiln_lod::sliding_window::SlidingWindow;
use kiln_measure::SurfaceReference;
use kiln_measure::camera::{Camera, bounding_sphere};
use kiln_measure::render::{Mode, RenderOptions, render};
use kiln_measure::scene::Scene;
use kiln_measure::sheet::{Tile, encode_png, sheet};

/// Sample points a side for the distances.
const SAMPLES: usize = 500_000;
/// Shares of the triangles at which the layouts are compared; the discrete chain has these levels beside the whole.
const SHARES: [f64; 4] = [0.5, 0.25, 0.1, 0.01];

struct Arguments {
    models: Vec<PathBuf>,
    plot: Option<PathBuf>,
    picture: Option<PathBuf>,
    out: Option<PathBuf>,
}

fn main() -> ExitCode {
    let mut given = Arguments { models: Vec::new(), plot: None, picture: None, out: None };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--plot" => given.plot = args.next().map(PathBuf::from),
            "--picture" => given.picture = args.next().map(PathBuf::from),
            "--out" => given.out = args.next().map(PathBuf::from),
            _ => given.models.push(PathBuf::from(arg)),
        }
    }
    if given.models.is_empty() {
        eprintln!("usage: continuous MODEL... [--plot FILE.svg] [--picture FILE.png] [--out FILE.md]");
        return ExitCode::from(64);
    }
    match run(&given) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// A model and what was made of it.
struct Made {
    name: String,
    mesh: Mesh,
    /// Bytes of one vertex with all its attributes.
    vertex: u64,
    sequence: CollapseSequence,
    window: SlidingWindow,
    trees: [ClusterTree; 2],
    dag: ClusterDag,
}

impl Made {
    fn new(path: &Path) -> Result<Made, String> {
        let failed = |e: String| format!("{}: {e}", path.display());
        let (merged, _) = merge(&model(path).map_err(failed)?.mesh, &MergeOptions::default());
        let mesh = if merged.uv0.is_none() { positions_only(&merged).map_err(failed)? } else { merged };
        eprintln!("{}: {} triangles", name(path), mesh.face_count());
        let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
        let window = SlidingWindow::new(&mesh, &sequence, 0).map_err(|e| failed(e.to_string()))?;
        let tree = |representative| ClusterTree::new(&mesh, &TreeOptions { representative });
        let trees = [tree(Representative::Mean), tree(Representative::Quadric)];
        let dag = ClusterDag::new(&mesh, &ClusterDagOptions::default()).map_err(|e| failed(e.to_string()))?;
        let optional = [
            12 * mesh.normals.is_some() as u64,
            16 * mesh.tangents.is_some() as u64,
            8 * mesh.uv0.is_some() as u64,
            8 * mesh.uv1.is_some() as u64,
            16 * mesh.colors.is_some() as u64,
        ];
        let vertex = 12 + optional.iter().sum::<u64>();
        Ok(Made { name: name(path), mesh, vertex, sequence, window, trees, dag })
    }
}

fn run(given: &Arguments) -> Result<(), String> {
    let mut page = Page::new(given.out.clone());
    page.line("# Continuous levels of detail: counts, bytes, distances");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin continuous -- MODEL..."));
    let made: Vec<Made> = given.models.iter().map(|path| Made::new(path)).collect::<Result<_, _>>()?;
    counts(&made, given, &mut page)?;
    storage(&made, &mut page)?;
    distances(&made, &mut page)?;
    if let (Some(path), Some(first)) = (&given.picture, made.first()) {
        picture(first, path)?;
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        page.line("");
        page.line(&format!("![{}: each layout at 25, 5 and 1 % of the triangles](../images/{file})", first.name));
    }
    page.finish()
}

/// A sheet: a row a layout, a column a share.
fn picture(made: &Made, path: &Path) -> Result<(), String> {
    let ordered = made.window.apply(&made.mesh).map_err(|e| e.to_string())?;
    let sphere = bounding_sphere(&made.mesh.positions);
    let camera = Camera::perspective(Vec3::new(0.3, 0.25, 1.0).normalize(), sphere, 30.0);
    let options = RenderOptions {
        width: 320,
        height: 320,
        supersample: 2,
        background: [52, 54, 58],
        mode: Mode::Shaded,
        ..RenderOptions::default()
    };
    let materials = MaterialSet::default();
    let tile = |mesh: Mesh, what: &str| {
        // Facets show what the triangles do.
        let mesh = kiln_lod::normals::rebuild_all(&mesh, 1.0);
        let picture = render(&Scene { mesh: &mesh, materials: &materials, images: &[] }, &camera, &options).to_raster();
        Tile { picture, caption: format!("{what}: {} triangles", mesh.face_count()) }
    };
    let mut rows: Vec<Vec<Tile>> = (0..3).map(|_| Vec::new()).collect();
    for share in [0.25, 0.05, 0.01] {
        let wanted = (share * made.mesh.face_count() as f64) as u32;
        let lod = made.window.lod_of_cut(made.sequence.reach(wanted));
        let window = made.window.level(&ordered, lod).map_err(|e| e.to_string())?;
        let tree = &made.trees[1];
        let octree = tree.level(&made.mesh, tree.threshold_for(wanted).threshold).map_err(|e| e.to_string())?;
        let clusters = made.dag.level(&made.mesh, made.dag.threshold_for(u64::from(wanted)));
        rows[0].push(tile(window, "sliding window"));
        rows[1].push(tile(octree, "octree"));
        rows[2].push(tile(clusters.map_err(|e| e.to_string())?, "clusters"));
    }
    let png = encode_png(&sheet(&rows)).map_err(|e| e.to_string())?;
    std::fs::write(path, png).map_err(|e| format!("{}: {e}", path.display()))
}

/// Asked s_level thousandths of the triangles, 1 to 1000: what the paper's equation 3 gives, and what the exact counts give.
fn counts(made: &[Made], given: &Arguments, page: &mut Page) -> Result<(), String> {
    page.line("");
    page.line("## Triangles that were asked for");
    page.line("");
    page.line(
        "Asked 1 to 1000 thousandths of the triangles of the octree (s_level). *Estimate*: equation 3 of Kanaya et al., who report at most 4.7 %; \
         *exact*: from the count of each threshold, *tie*: the most triangles that vanish at one threshold. Deviations are shares of the \
         model's triangles.",
    );
    page.line("");
    page.head(&["model", ":triangles", ":nodes", ":estimate, mean", ":greatest", ":exact, mean", ":greatest", ":tie"]);
    let mut plot = Plot {
        title: "Deviation from the triangles asked for".into(),
        x: "s_level, thousandths of the model's triangles".into(),
        y: "deviation, % of the model's triangles".into(),
        series: Vec::new(),
    };
    for made in made {
        let tree = &made.trees[0];
        let all = made.mesh.face_count() as f64;
        let off = |found: u32, asked: u32| 100.0 * (f64::from(found) - f64::from(asked)).abs() / all;
        let (mut estimates, mut exact) = (Vec::new(), Vec::new());
        for s in 1..=1000 {
            let asked = tree.faces_of_s_level(s);
            let r: RLevel = tree.paper_estimate(asked);
            estimates.push([f64::from(s), off(tree.faces_at(tree.threshold_at(r)), asked)]);
            exact.push([f64::from(s), off(tree.threshold_for(asked).triangles, asked)]);
        }
        let mean = |list: &[[f64; 2]]| list.iter().map(|p| p[1]).sum::<f64>() / list.len() as f64;
        let most = |list: &[[f64; 2]]| list.iter().map(|p| p[1]).fold(0.0, f64::max);
        let tie = tree.face_counts().windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
        page.row(&[
            made.name.clone(),
            made.mesh.face_count().to_string(),
            tree.nodes().len().to_string(),
            format!("{:.2} %", mean(&estimates)),
            format!("{:.2} %", most(&estimates)),
            format!("{:.4} %", mean(&exact)),
            format!("{:.4} %", most(&exact)),
            tie.to_string(),
        ]);
        let thinned = |list: Vec<[f64; 2]>| list.into_iter().step_by(10).collect();
        plot.series.push(Series { name: format!("{}, estimate", made.name), points: thinned(estimates) });
        plot.series.push(Series { name: format!("{}, exact", made.name), points: thinned(exact) });
    }
    if let Some(path) = &given.plot {
        std::fs::write(path, plot.to_svg()).map_err(|e| format!("{}: {e}", path.display()))?;
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        page.line("");
        page.line(&format!("![Deviation from the triangles asked for](../images/{file})"));
    }
    Ok(())
}

fn storage(made: &[Made], page: &mut Page) -> Result<(), String> {
    page.line("");
    page.line("## Bytes");
    page.line("");
    page.line(
        "Bytes of an input triangle, and the ratio to indexed triangles of the same model (its vertices with all attributes, three 4-byte \
         indices), uncompressed. Published ratios (Ripolles et al., position-only models): Sliding-Tris 1.2, LodStrips 1.9, Progressive \
         Meshes 2.7. *As printed*: chains of what each vertex turns into; a texel for each vertex and for each ancestor in each column. \
         *Tree and leaf*, *compact tree*: with the count of triangles at each threshold. *Clusters*: instead of the index buffer. The discrete \
         chain has all, 50, 25, 10 and 1 %.",
    );
    page.line("");
    page.head(&[
        "model",
        ":vertex",
        ":indexed",
        ":Sliding-Tris as printed",
        ":sliding window",
        ":tree and leaf as printed",
        ":compact tree",
        ":clusters",
        ":discrete, own vertices",
        ":discrete, shared",
    ]);
    let mut chains = Vec::new();
    for made in made {
        let (triangles, vertices) = (made.mesh.face_count() as u64, made.mesh.vertex_count() as u64);
        let own = made.window.storage(made.vertex as u32);
        let tree = &made.trees[0];
        let attributes = (made.vertex - 12) * vertices;
        let printed = TreeLeafBuffers::new(tree, &made.mesh)
            .map(|buffers| 16 * (buffers.tree.len() + buffers.leaf.len()) as u64 + 12 * triangles + attributes);
        let compact = own.indexed + 16 * tree.nodes().len() as u64 + 4 * vertices + 4 * (tree.nodes().len() as u64 + 1);
        let dag = &made.dag;
        let clusters = made.vertex * vertices
            + 4 * dag.references.len() as u64
            + dag.corners.len() as u64
            + 64 * dag.clusters.len() as u64
            + 32 * dag.groups.len() as u64;
        let levels: Vec<Mesh> = SHARES
            .iter()
            .map(|share| {
                let cut = made.sequence.reach((share * triangles as f64) as u32);
                made.sequence.replay(&made.mesh, cut).map_err(|e| e.to_string())
            })
            .collect::<Result<_, _>>()?;
        let indices: u64 = levels.iter().map(|level| 12 * level.face_count() as u64).sum();
        let more: u64 = levels.iter().map(|level| made.vertex * level.vertex_count() as u64).sum();
        let cell =
            |bytes: u64| format!("{:.1} ({:.3})", bytes as f64 / triangles as f64, bytes as f64 / own.indexed as f64);
        page.row(&[
            made.name.clone(),
            made.vertex.to_string(),
            format!("{:.1}", own.indexed as f64 / triangles as f64),
            cell(own.chains),
            cell(own.window),
            printed.map_or_else(|e| e.to_string(), cell),
            cell(compact),
            cell(clusters),
            cell(own.indexed + indices + more),
            cell(own.indexed + indices),
        ]);
        let found = made.window.chains();
        chains.push([
            made.name.clone(),
            made.window.collapses().to_string(),
            found.longest.to_string(),
            format!("{:.2}", found.mean),
            tree.nodes().len().to_string(),
            tree.rows().to_string(),
            dag.levels.to_string(),
            dag.clusters.len().to_string(),
            format!("{:.1}", dag.corners.len() as f64 / 3.0 / dag.clusters.len().max(1) as f64),
        ]);
    }
    page.line("");
    page.line("Chains of the window (published: at most 12 long, 2 on average), the octree, the cluster DAG:");
    page.line("");
    page.head(&[
        "model",
        ":collapses",
        ":longest chain",
        ":mean",
        ":nodes",
        ":rows",
        ":DAG levels",
        ":clusters",
        ":triangles each",
    ]);
    chains.iter().for_each(|row| page.row(row));
    Ok(())
}

fn distances(made: &[Made], page: &mut Page) -> Result<(), String> {
    page.line("");
    page.line("## Mean distance to the source at equal triangle counts");
    page.line("");
    page.line(&format!(
        "In 1e-5 of the diagonal, {SAMPLES} samples a side, in brackets the triangles where they are not those asked for by more than 1 %. Sliding-Tris and \
         the discrete chain by half-edge collapses have the window's levels.",
    ));
    page.line("");
    page.head(&[
        "model",
        ":keep",
        ":triangles",
        ":sliding window",
        ":octree, means",
        ":octree, quadrics",
        ":clusters",
        ":discrete, free placement",
    ]);
    for made in made {
        let reference = SurfaceReference::new(&made.mesh, SAMPLES).ok_or("a model without a surface")?;
        let ordered = made.window.apply(&made.mesh).map_err(|e| e.to_string())?;
        for share in SHARES {
            let wanted = (share * made.mesh.face_count() as f64) as u32;
            let cell = |level: &Mesh| -> String {
                let distance = reference.compare(level).map_or(f64::NAN, |d| 1e5 * d.in_diagonals().mean);
                let faces = level.face_count() as f64;
                let off = (faces - f64::from(wanted)).abs() / f64::from(wanted.max(1));
                if off > 0.01 { format!("{distance:.1} ({faces})") } else { format!("{distance:.1}") }
            };
            let lod = made.window.lod_of_cut(made.sequence.reach(wanted));
            let window = made.window.level(&ordered, lod).map_err(|e| e.to_string())?;
            let tree = |tree: &ClusterTree| {
                tree.level(&made.mesh, tree.threshold_for(wanted).threshold).map_err(|e| e.to_string())
            };
            let clusters = made.dag.level(&made.mesh, made.dag.threshold_for(u64::from(wanted)));
            let free = simplify(&made.mesh, wanted, Placement::Free, &SimplifyOptions::default());
            page.row(&[
                made.name.clone(),
                format!("{} %", 100.0 * share),
                wanted.to_string(),
                cell(&window),
                cell(&tree(&made.trees[0])?),
                cell(&tree(&made.trees[1])?),
                cell(&clusters.map_err(|e| e.to_string())?),
                cell(&free),
            ]);
        }
    }
    Ok(())
}
