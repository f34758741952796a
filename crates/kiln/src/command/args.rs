//! What may be typed. Nothing below the command layer sees a flag.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use kiln_pack::Detail;
use kiln_pipeline::language::Length;

/// The offline LOD baker: a TOML pipeline merges, simplifies, unwraps, bakes and packs a model, and redoes only what changed.
#[derive(Parser, Debug)]
#[command(name = "kiln", version, after_help = AFTER_HELP, max_term_width = 120)]
pub(crate) struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
}

const AFTER_HELP: &str = "\
Output for people goes to standard error, data to standard output.
Exit codes: 0 done, 1 a budget or threshold missed or --deny warnings, 2 failed, 64 bad usage.

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
    /// Measure how far two models, or levels of containers, are apart: pictures, surfaces, borders
    Compare(CompareArgs),
    /// Show what the importer sees in a model and would change, or what this machine offers
    Doctor(DoctorArgs),
    /// Print every stage kind with its keys, types and defaults; or run one stage of one asset (`kiln stage run`)
    Stage(StageArgs),
    /// Print the stage graph: every stage of every asset with the command that runs it, for other schedulers and for Ninja
    Plan(GraphArgs),
    /// Print a CMake module with the function kiln_bake()
    CmakeModule,
    /// Look after a cache: what lies in it, what may go, whether it is whole
    Cache(CacheArgs),
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

/// What part of a pipeline, and which caches beside the own one.
#[derive(Args, Debug, Clone)]
pub(crate) struct PartArgs {
    /// This model alone, as `kiln plan` names it; may be repeated
    #[arg(long = "asset", value_name = "INPUT")]
    pub(crate) assets: Vec<String>,
    /// A cache folder that is read where the own one lacks something, and never written; may be repeated
    #[arg(long, value_name = "DIR")]
    pub(crate) with: Vec<PathBuf>,
}

/// A cache that others share.
#[derive(Args, Debug, Clone)]
pub(crate) struct RemoteArgs {
    /// A cache that others share: a folder, s3://, gs://, az://, http://; `off` for none [default: KILN_REMOTE, else the configuration]
    #[arg(long, value_name = "URL")]
    pub(crate) remote: Option<String>,
    /// Take from the remote, or take and send [default: KILN_REMOTE_MODE, else the configuration, else read]
    #[arg(long, value_enum, value_name = "MODE")]
    pub(crate) remote_mode: Option<RemoteModeArg>,
}

/// Where stages run.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ExecutorArg {
    /// In this process
    #[default]
    Local,
    /// As Slurm job arrays; the cache must be a folder that all nodes see, [slurm] of the configuration says the rest
    Slurm,
}

/// `kiln build`.
#[derive(Args, Debug)]
pub(crate) struct BuildArgs {
    /// Pipeline files
    #[arg(required = true, value_name = "PIPELINE")]
    pub(crate) pipelines: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) plan: PlanArgs,
    #[command(flatten)]
    pub(crate) part: PartArgs,
    /// Where stages run
    #[arg(long, value_enum, default_value_t, value_name = "EXECUTOR", conflicts_with_all = ["verify", "watch"])]
    pub(crate) on: ExecutorArg,
    /// With `--on slurm`: assets an array element [default: the configuration's, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) batch: Option<u32>,
    /// How many stages run at once [default: the number of cores]
    #[arg(long, short, value_name = "N")]
    pub(crate) jobs: Option<usize>,
    /// Say for each stage why it runs
    #[arg(long)]
    pub(crate) explain: bool,
    /// Say what would run, and run nothing; with --json also each asset's pipeline with all defaults filled in
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Go on with other assets when one fails
    #[arg(long)]
    pub(crate) keep_going: bool,
    /// Write what the outputs depend on as a GCC-style depfile, for Ninja, Make and CMake; written only if it differs
    #[arg(long, value_name = "FILE", conflicts_with = "dry_run")]
    pub(crate) depfile: Option<PathBuf>,
    /// Build twice in scratch caches, on different numbers of threads, and fail if a stage gave other bytes for the same inputs. With
    /// --remote: build, recompute a sample of what the remote gave (`check` of the configuration, 5 %), and fail if a record lied
    #[arg(long, conflicts_with_all = ["dry_run", "depfile", "debug_images"])]
    pub(crate) verify: bool,
    /// Build again whenever something changes that the build looked at; Ctrl-C ends it
    #[arg(long, conflicts_with_all = ["dry_run", "verify", "json"])]
    pub(crate) watch: bool,
    /// Draw into DIR what stages see of textures: borders and the edges that cross them for `texture-border`, regions and views for
    /// metrics that look from views
    #[arg(long, value_name = "DIR")]
    pub(crate) debug_images: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) remote: RemoteArgs,
    /// `warnings`: exit 1 when anything was repaired or replaced
    #[arg(long, value_name = "WHAT", value_parser = ["warnings"])]
    pub(crate) deny: Option<String>,
    /// Print the report as JSON on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// What a build may do with the remote.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RemoteModeArg {
    /// Take what it has: for people
    Read,
    /// Take what it has, send what ran: for CI
    Write,
}

/// `kiln cache`.
#[derive(Args, Debug)]
pub(crate) struct CacheArgs {
    #[command(subcommand)]
    pub(crate) command: CacheCommand,
}

/// What to do with a cache.
#[derive(Subcommand, Debug)]
pub(crate) enum CacheCommand {
    /// Count records and blobs, by kind of stage
    Stats(CachePlace),
    /// Remove what was not used for long, and what is too much; builds may be at work
    Gc(CacheGcArgs),
    /// Read everything; move aside what does not verify (exit 1 if anything)
    Verify(CachePlace),
    /// Print the public key of a secret one that signs records: a file of 64 hexadecimal digits (openssl rand -hex 32)
    Key {
        /// The secret key's file
        file: PathBuf,
    },
}

/// Which cache.
#[derive(Args, Debug)]
pub(crate) struct CachePlace {
    /// The cache's folder [default: .kiln]
    #[arg(long, value_name = "DIR")]
    pub(crate) cache: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// `kiln cache gc`.
#[derive(Args, Debug)]
pub(crate) struct CacheGcArgs {
    #[command(flatten)]
    pub(crate) place: CachePlace,
    /// What may stay, such as 20GB or 512MiB; the longest unused goes first [default: the configuration's]
    #[arg(long, value_name = "SIZE")]
    pub(crate) max_size: Option<String>,
    /// Remove what was not used for so long, such as 30d or 12h [default: the configuration's]
    #[arg(long, value_name = "AGE")]
    pub(crate) max_age: Option<String>,
    /// Keep what the last build of this output read or made; may be repeated
    #[arg(long = "pin", value_name = "OUTPUT")]
    pub(crate) pins: Vec<String>,
    /// Keep it for all outputs in FILE, one a line
    #[arg(long = "pins", value_name = "FILE")]
    pub(crate) pin_lists: Vec<PathBuf>,
    /// Say what would go, and remove nothing
    #[arg(long)]
    pub(crate) dry_run: bool,
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
    /// Which level, 0 = finest; or LAYOUT:TRIANGLES, what an engine draws of sliding-window, tree-leaf, compact-tree or clusters with at
    /// most so many triangles
    #[arg(long, value_name = "N|LAYOUT:TRIANGLES", conflicts_with = "all", default_value = "0")]
    pub(crate) level: Detail,
    /// All levels in one file, joined by MSFT_lod
    #[arg(long)]
    pub(crate) all: bool,
    /// The GLB to write
    #[arg(short, long, value_name = "OUT.glb", required_unless_present_any = ["textures", "trees"])]
    pub(crate) output: Option<PathBuf>,
    /// Write every texture into this folder, as a file named after it
    #[arg(long, value_name = "DIR")]
    pub(crate) textures: Option<PathBuf>,
    /// Write tree and leaf buffers (layout tree-leaf) into this folder as OpenEXR: tree, leaf, counts, and the vertices' attributes
    #[arg(long, value_name = "DIR")]
    pub(crate) trees: Option<PathBuf>,
    /// Format of the textures' files [default: png, and exr for textures of floats]
    #[arg(long, value_enum, requires = "textures")]
    pub(crate) format: Option<FileFormatArg>,
    /// With `--format exr`: all mips, in tiles of 64 x 64
    #[arg(long, requires = "format")]
    pub(crate) mips: bool,
    /// Write normal maps with y down in the picture (green turned), as some engines read them; for png and exr
    #[arg(long, requires = "textures")]
    pub(crate) normals_down: bool,
}

/// Formats of `kiln export --textures`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FileFormatArg {
    /// 8 or 16 bits, mip 0; blocks are decoded
    Png,
    /// Halves or floats, linear; blocks are decoded
    Exr,
    /// All mips as they lie in the container, blocks too
    Ktx2,
    /// Tiled and mip-mapped for renderers, by OpenImageIO (feature `oiio`)
    Tx,
}

/// `kiln compare`.
#[derive(Args, Debug)]
pub(crate) struct CompareArgs {
    /// A model, or FILE.kiln#LEVEL for a level of a container [level 0 without one], or FILE.kiln#LAYOUT:TRIANGLES
    #[arg(value_name = "REFERENCE")]
    pub(crate) reference: PathBuf,
    /// What is held against it, named the same way
    #[arg(value_name = "OTHER")]
    pub(crate) other: PathBuf,
    /// Print all figures as JSON on standard output
    #[arg(long)]
    pub(crate) json: bool,
    /// Write a contact sheet: original, other, difference, from the worst view to the best
    #[arg(long, value_name = "OUT.png")]
    pub(crate) sheet: Option<PathBuf>,
    /// Rows of the sheet
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub(crate) rows: u64,
    /// Views around the reference
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub(crate) views: u64,
    /// Width and height of each picture
    #[arg(long, value_name = "PIXELS", default_value_t = 512, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub(crate) size: u32,
    /// Points on each surface
    #[arg(long, value_name = "N", default_value_t = 500_000, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    pub(crate) samples: u64,
    /// Light the surfaces themselves, without normal maps
    #[arg(long)]
    pub(crate) no_normal_maps: bool,
    /// Exit 1 if the RMSE of the object's pixels, flat or lit, is above this (codes, 0 to 255)
    #[arg(long, value_name = "X", value_parser = finite)]
    pub(crate) max_rmse: Option<f64>,
    /// Exit 1 if a point of either surface lies further from the other: a length such as '0.01 diag' or '2 mm'
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    pub(crate) max_distance: Option<Length>,
    /// Exit 1 if the mean FLIP of the object's pixels, flat or lit, is above this (0 to 1)
    #[arg(long, value_name = "X", value_parser = finite)]
    pub(crate) max_flip: Option<f64>,
    /// Exit 1 if the mean SSIM of the object's pixels, flat or lit, is below this (at most 1)
    #[arg(long, value_name = "X", value_parser = finite)]
    pub(crate) min_ssim: Option<f64>,
    /// Exit 1 if less of the silhouettes is in common: intersection over union (0 to 1)
    #[arg(long, value_name = "X", value_parser = finite)]
    pub(crate) min_iou: Option<f64>,
}

/// A number that a figure can be held against.
fn finite(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| "expected a number, such as 0.05".to_owned())
}

/// A length as pipelines have it.
fn length(text: &str) -> Result<Length, String> {
    Length::parse(text).map_err(|_| "expected a number and a unit, such as '0.01 diag' or '2 mm'".to_owned())
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
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct StageArgs {
    #[command(subcommand)]
    pub(crate) command: Option<StageCommand>,
    /// One kind only
    pub(crate) kind: Option<String>,
}

/// What to do with a stage.
#[derive(Subcommand, Debug)]
pub(crate) enum StageCommand {
    /// Run one stage of one asset: what is before it comes from the cache, what it gives goes there
    Run(StageRunArgs),
}

/// `kiln stage run`.
#[derive(Args, Debug)]
pub(crate) struct StageRunArgs {
    /// The pipeline
    pub(crate) pipeline: PathBuf,
    /// The model, as `kiln plan` names it; needed where the pipeline has several
    #[arg(long, value_name = "INPUT")]
    pub(crate) asset: Option<String>,
    /// The stage, as `kiln plan` names it, such as lods or lods/collapse
    #[arg(long, value_name = "STAGE")]
    pub(crate) stage: String,
    #[command(flatten)]
    pub(crate) plan: PlanArgs,
    /// A cache folder that is read where the own one lacks something, and never written; may be repeated
    #[arg(long, value_name = "DIR")]
    pub(crate) with: Vec<PathBuf>,
    /// Fail where a stage before it would have to run
    #[arg(long)]
    pub(crate) only: bool,
    /// Leave what the stage gives, alone and without times, in this cache folder; what is before it comes from `--with`
    #[arg(long, value_name = "DIR", conflicts_with = "cache")]
    pub(crate) fragment: Option<PathBuf>,
    /// Fail unless kind, version, parameters and machine are those of the plan that gave this digest
    #[arg(long, value_name = "DIGEST")]
    pub(crate) expect: Option<String>,
    /// Write names and hashes of what the stage gives; written only if it differs
    #[arg(long, value_name = "FILE")]
    pub(crate) receipt: Option<PathBuf>,
    /// Write the files that the stage itself read as a GCC-style depfile of the receipt; written only if it differs
    #[arg(long, value_name = "FILE", requires = "receipt")]
    pub(crate) depfile: Option<PathBuf>,
    /// Threads, where a stage before it has to run as well [default: the number of cores]
    #[arg(long, short, value_name = "N")]
    pub(crate) jobs: Option<usize>,
    /// A cache that others share; without this flag none is asked, whatever the configuration says
    #[arg(long, value_name = "URL")]
    pub(crate) remote: Option<String>,
    /// Take from the remote, or take and send
    #[arg(long, value_enum, value_name = "MODE", requires = "remote")]
    pub(crate) remote_mode: Option<RemoteModeArg>,
}

/// `kiln plan`.
#[derive(Args, Debug)]
pub(crate) struct GraphArgs {
    /// The pipeline
    pub(crate) pipeline: PathBuf,
    #[command(flatten)]
    pub(crate) plan: PlanArgs,
    #[command(flatten)]
    pub(crate) part: PartArgs,
    /// Print JSON
    #[arg(long, conflicts_with = "ninja")]
    pub(crate) json: bool,
    /// Print a build.ninja
    #[arg(long)]
    pub(crate) ninja: bool,
    /// Write it into FILE, only if it differs; a build.ninja then makes itself again when the pipeline or its folders change
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// What commands begin with
    #[arg(long, value_name = "PROGRAM", default_value = "kiln")]
    pub(crate) program: String,
    /// GPU stages at a time, in a build.ninja
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) gpus: u32,
}
