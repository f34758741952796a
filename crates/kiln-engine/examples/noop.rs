//! Times a build without work: `cargo run --release -p kiln-engine --example noop -- ASSETS FOLDER`.
//!
//! Makes ASSETS inputs of 4 KiB in 100 folders under FOLDER, builds three small actions for each, and prints the milliseconds of
//! the first build, of builds that look at everything, and of the check by stats alone.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{env, fs, io};

use kiln_engine::{
    Action, BuildOptions, ContentHash, Context, Engine, Group, Look, Memory, NoObserver, Outputs, Plan, Source, Target,
};

fn plan(root: &Path, assets: usize) -> Plan {
    let mut plan = Plan { root: root.to_owned(), ..Plan::default() };
    for asset in 0..assets {
        let copy = |context: &Context<'_>| Ok(Outputs::new().with("x", context.input("x")?.to_vec()));
        let mut source = Source::file(input(asset));
        for stage in ["import", "simplify", "pack"] {
            let action = Action::new(format!("{asset}#{stage}"), stage, 1, copy).input("x", source);
            plan.actions.push(action.param("keep", 0.25).param("metric", "quadric").param("stage", stage));
            source = Source::output(plan.actions.len() - 1, "x");
        }
        let path = format!("out/{:02}/{asset}.kiln", asset % 100);
        plan.targets.push(Target { path, action: plan.actions.len() - 1, output: "x".into() });
    }
    plan
}

fn input(asset: usize) -> String {
    format!("in/{:02}/{asset}.bin", asset % 100)
}

fn timed<T>(what: &str, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let value = work();
    eprintln!("{what:>40} {:>10.2} ms", start.elapsed().as_secs_f64() * 1e3);
    value
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = env::args().skip(1);
    let (Some(assets), Some(root)) = (arguments.next(), arguments.next()) else { return Err("ASSETS FOLDER".into()) };
    let (assets, root): (usize, PathBuf) = (assets.parse()?, root.into());
    for asset in 0..assets {
        let path = root.join(input(asset));
        fs::create_dir_all(path.parent().unwrap_or(&root))?;
        let mut bytes = vec![0; 4096];
        bytes[..8].copy_from_slice(&(asset as u64).to_le_bytes());
        if !path.exists() {
            fs::write(path, bytes)?;
        }
    }
    // As if the files had been there for long: the example waits for no clock.
    let options = BuildOptions { clock_granularity: Duration::ZERO, ..BuildOptions::default() };
    let key = ContentHash::of(b"example");
    for round in ["first build", "second build", "third build"] {
        let mut engine = timed("open", || Engine::open(root.join(".kiln"), "noop"));
        let look = timed("look", || engine.look(&root, &key, &options));
        if look == Look::Fresh {
            eprintln!("{:>40}", "(all fresh)");
            continue;
        }
        let plan = timed("plan", || plan(&root, assets));
        let report = timed(round, || engine.build(&plan, &options, &NoObserver))?;
        if !report.succeeded() {
            return Err(io::Error::other("the build failed").into());
        }
        let group = |asset: usize| Group {
            name: asset.to_string(),
            actions: (3 * asset..3 * asset + 3).collect(),
            targets: vec![asset],
            brief: "3".into(),
            note: Vec::new(),
        };
        let memory =
            Memory { key, files: vec![], folders: vec!["in".into()], groups: (0..assets).map(group).collect() };
        timed("remember", || engine.remember(&plan, &report, &memory))?;
    }
    Ok(())
}
