//! The project's own chores, as `cargo xtask NAME`; `cargo xtask` lists them.

mod baked;
mod continuous;
mod corpus;
mod farm;
mod fuzz;
mod long;
mod pictures;
mod remote;
mod tidy;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use xtask::fixtures;

const HELP: &str = "\
cargo xtask NAME

  tidy                 layering, shader twins, fixture table, default dependencies, machine paths
  fixtures [--check]   write fixtures/ from their generator, or check that they are what it gives
  fixtures --families DIR
                       write the malformed and the awkward models that the tests make into DIR
  fixtures --seeds     write fuzz/seeds and fuzz/siblings
  corpus [NAME...]     build real models end to end (needs KILN_CORPUS); --out FILE writes the table
  baked                bake real models and compare them with their sources; writes docs/results/bake.md
  pictures ...         render models and containers side by side
  long [PART]          what takes longer than CI allows: corpus, continuous, kills, noop, remote, farm, fuzz; logs go to docs/results/";

fn main() -> ExitCode {
    let mut args = std::env::args().skip(1);
    let name = args.next().unwrap_or_default();
    let args: Vec<String> = args.collect();
    let root = root();
    let result = match name.as_str() {
        "tidy" => tidy::run(&root),
        "fixtures" if args.iter().any(|a| a == "--check") => fixtures::check(&root),
        "fixtures" if args.first().is_some_and(|a| a == "--families") => match args.get(1) {
            Some(folder) => fixtures::families::run(Path::new(folder)),
            None => Err("fixtures --families DIR: the folder is missing".into()),
        },
        "fixtures" if args.first().is_some_and(|a| a == "--seeds") => fixtures::families::seeds::run(&root),
        "fixtures" => fixtures::run(&root),
        "corpus" => corpus::run(&root, &args),
        "baked" => baked::run(&root),
        "pictures" => pictures::run(&args),
        "long" => long::run(&root, &args),
        _ => Err(HELP.into()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// The repository's root: two folders above this package.
fn root() -> PathBuf {
    let package = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    package.ancestors().nth(2).map(PathBuf::from).unwrap_or(package)
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_tree_is_tidy() {
        crate::tidy::run(&crate::root()).unwrap();
    }
}
