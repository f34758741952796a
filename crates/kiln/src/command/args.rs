//! What may be typed. Nothing below the command layer sees a flag.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

/// The offline LOD baker: a TOML pipeline merges, simplifies, unwraps, bakes and packs a model, and redoes only what changed.
#[derive(Parser, Debug)]
#[command(name = "kiln", version, about, after_help = AFTER_HELP, max_term_width = 120)]
pub(crate) struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
}

const AFTER_HELP: &str = "\
Output for people goes to standard error, data to standard output.
Exit codes: 0 done, 1 finished with a budget missed or --deny warnings, 2 failed, 64 bad usage.

Start here:  kiln build pipelines/quickstart.toml     then run it again: nothing is left to do.
With a model of your own:  kiln init MODEL";

/// The commands.
#[derive(Subcommand, Debug)]
pub(crate) enum Command {
    /// Write a commented pipeline for a model, with levels and sizes that fit it
    Init(InitArgs),
    /// Build pipelines: run the stages that are stale, write the containers that differ
    Build(BuildArgs),
    /// Say why an output would be built again, or that it would not
    Why(WhyArgs),
    /// Show what is in a container
    Inspect(InspectArgs),
    /// Check every byte and promise of a container; with a code for each finding
    Check(CheckArgs),
    /// Write one level of a container, or all of them, as GLB
    Export(ExportArgs),
    /// Show what the importer sees in a model and would change, or what this machine offers
    Doctor(DoctorArgs),
    /// Print every stage kind with its keys, types and defaults
    Stage(StageArgs),
}

/// `kiln init`.
#[derive(Args, Debug)]
pub(crate) struct InitArgs {
    /// A model
    pub(crate) model: PathBuf,
    /// The pipeline to write, `-` for standard output [default: the model's name with .toml, in this folder]
    #[arg(short, long, value_name = "PIPELINE")]
    pub(crate) output: Option<PathBuf>,
}

/// Where GPU passes run.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum BackendArg {
    /// A hardware GPU where there is one, else the CPU twin
    #[default]
    Auto,
    /// A GPU, software adapters included; an error where there is none
    Gpu,
    /// The CPU twin: the same bytes on every machine of one numeric class
    Cpu,
}

/// What `build` and `why` share: which pipelines, with which settings.
#[derive(Args, Debug, Clone)]
pub(crate) struct PlanArgs {
    /// Set a pipeline key, such as asset.input=MODEL or stage.lods.levels='[{keep=0.1}]'; paths are relative to this folder
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) sets: Vec<String>,
    /// Where GPU passes run
    #[arg(long, value_enum, default_value_t)]
    pub(crate) backend: BackendArg,
    /// The cache's folder [default: .kiln beside the pipeline]
    #[arg(long, value_name = "DIR")]
    pub(crate) cache: Option<PathBuf>,
}

/// `kiln build`.
#[derive(Args, Debug)]
pub(crate) struct BuildArgs {
    /// Pipeline files
    #[arg(required = true, value_name = "PIPELINE")]
    pub(crate) pipelines: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) plan: PlanArgs,
    /// How many stages run at once [default: the number of cores]
    #[arg(long, short, value_name = "N")]
    pub(crate) jobs: Option<usize>,
    /// Say for each stage why it runs
    #[arg(long)]
    pub(crate) explain: bool,
    /// Say what would run, and run nothing
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Go on with other assets when one fails
    #[arg(long)]
    pub(crate) keep_going: bool,
    /// `warnings`: exit 1 when anything was repaired or replaced
    #[arg(long, value_name = "WHAT", value_parser = ["warnings"])]
    pub(crate) deny: Option<String>,
    /// Print the report as JSON on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// `kiln why`.
#[derive(Args, Debug)]
pub(crate) struct WhyArgs {
    /// An output that a pipeline builds
    pub(crate) output: PathBuf,
    /// The pipeline [default: the one that last built OUTPUT, by the caches beside and above it]
    #[arg(long, value_name = "PIPELINE")]
    pub(crate) pipeline: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) plan: PlanArgs,
    /// Print the reasons as JSON on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// `kiln inspect`.
#[derive(Args, Debug)]
pub(crate) struct InspectArgs {
    /// A container
    pub(crate) file: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// `kiln check`.
#[derive(Args, Debug)]
pub(crate) struct CheckArgs {
    /// A container
    pub(crate) file: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// `kiln export`.
#[derive(Args, Debug)]
pub(crate) struct ExportArgs {
    /// A container
    pub(crate) file: PathBuf,
    /// Which level, 0 = finest
    #[arg(long, value_name = "N", conflicts_with = "all", default_value_t = 0)]
    pub(crate) level: usize,
    /// All levels in one file, joined by MSFT_lod
    #[arg(long)]
    pub(crate) all: bool,
    /// The GLB to write
    #[arg(short, long, value_name = "OUT.glb")]
    pub(crate) output: PathBuf,
}

/// `kiln doctor`.
#[derive(Args, Debug)]
pub(crate) struct DoctorArgs {
    /// A model; without one, this machine is looked at
    pub(crate) model: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// `kiln stage`.
#[derive(Args, Debug)]
pub(crate) struct StageArgs {
    /// One kind only
    pub(crate) kind: Option<String>,
}
