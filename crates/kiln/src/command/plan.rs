//! `kiln plan`: the stage graph, for people, for programs, for Ninja.

use std::fmt::Write as _;

use super::args::GraphArgs;
use super::{build, data, ninja, write_if_new};
use crate::exit::Exit;
use crate::graph::Graph;

pub(super) fn run(args: &GraphArgs) -> Exit {
    let mut of = args.plan.build(&args.pipeline);
    of.assets.clone_from(&args.part.assets);
    of.with.clone_from(&args.part.with);
    let graph = match of.graph(&args.program) {
        Ok(graph) => graph,
        Err(error) => return build::failed(&error),
    };
    let text = if args.json {
        serde_json::to_string_pretty(&graph).expect("invariant: a graph is plain data") + "\n"
    } else if args.ninja {
        ninja::file(&graph, args, &of.cache_folder())
    } else {
        table(&graph)
    };
    match &args.output {
        Some(path) => write_if_new(path, text.as_bytes()).map_or_else(|exit| exit, |()| Exit::Done),
        None => data(&text),
    }
}

/// A row for each stage.
fn table(graph: &Graph) -> String {
    let mut rows = vec![["asset", "stage", "kind", "class", "after", "gives"].map(String::from)];
    for asset in &graph.assets {
        for stage in &asset.stages {
            rows.push([
                asset.input.clone(),
                stage.id.clone(),
                stage.kind.clone(),
                stage.class.into(),
                stage.upstream.join(", "),
                stage.outputs.join(", "),
            ]);
        }
        rows.push([
            asset.input.clone(),
            "-".into(),
            "write".into(),
            "cpu".into(),
            asset.after.clone(),
            asset.output.clone(),
        ]);
    }
    let mut widths = [0; 6];
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut out = String::new();
    for row in &rows {
        let mut line = String::new();
        for (cell, width) in row.iter().zip(widths) {
            let _ = write!(line, "{cell:<width$}  ");
        }
        let _ = writeln!(out, "{}", line.trim_end());
    }
    let stages: usize = graph.assets.iter().map(|asset| asset.stages.len()).sum();
    let _ = writeln!(out, "{} assets, {stages} stages", graph.assets.len());
    out
}
