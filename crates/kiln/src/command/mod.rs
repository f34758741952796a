//! The command line: what was typed becomes calls of the library, what comes back becomes text and an exit code.

mod args;
mod build;
mod cache;
mod compare;
mod container;
mod diagnostics;
mod doctor;
mod farm;
mod init;
mod ninja;
mod plan;
mod progress;
mod stage;
mod textures;
mod watch;
mod why;

use std::path::Path;
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

use crate::exit::Exit;
use args::{BackendArg, Cli, Command, PlanArgs, RemoteModeArg, StageCommand};

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // A refused write of a usage message has no better place to be told.
            let _ = error.print();
            return match error.kind() {
                ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => Exit::Done,
                _ => Exit::Usage,
            }
            .into();
        }
    };
    match cli.command {
        Command::Init(args) => init::run(&args),
        Command::Build(args) => build::run(&args),
        Command::Why(args) => why::run(&args),
        Command::Inspect(args) => container::inspect(&args),
        Command::Check(args) => container::check(&args),
        Command::Export(args) => container::export(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Cache(args) => cache::run(&args),
        Command::Stage(args) => match &args.command {
            Some(StageCommand::Run(run)) => stage::run(run),
            None => stage::kinds(args.kind.as_deref()),
        },
        Command::Plan(args) => plan::run(&args),
        Command::CmakeModule => data(include_str!("kiln.cmake")),
    }
    .into()
}

/// Data for programs goes to standard output; a reader that went away is no failure.
fn data(text: &str) -> Exit {
    use std::io::Write;
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| if text.ends_with('\n') { Ok(()) } else { out.write_all(b"\n") })
    {
        Ok(()) => Exit::Done,
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Exit::Done,
        Err(error) => complain(Exit::Failed, &format!("cannot write to standard output: {error}")),
    }
}

/// Says what is wrong and gives the exit code that goes with it.
fn complain(exit: Exit, message: &str) -> Exit {
    eprintln!("error: {message}");
    exit
}

/// A file's bytes, or the message.
fn read(path: &Path) -> Result<Vec<u8>, Exit> {
    std::fs::read(path).map_err(|error| complain(Exit::Failed, &format!("cannot read {}: {error}", path.display())))
}

/// Writes a file beside its place and renames it, so that a failure leaves no half of it; or says why not.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Exit> {
    let mut beside = path.to_path_buf().into_os_string();
    beside.push(format!(".{}.part", std::process::id()));
    std::fs::write(&beside, bytes).and_then(|()| std::fs::rename(&beside, path)).map_err(|error| {
        // What was written of it is of no use; that it cannot be removed changes nothing for the caller.
        let _ = std::fs::remove_file(&beside);
        complain(Exit::Failed, &format!("cannot write {}: {error}", path.display()))
    })
}

/// Writes a file only if it would differ; folders are made.
fn write_if_new(path: &Path, bytes: &[u8]) -> Result<(), Exit> {
    if std::fs::read(path).is_ok_and(|there| there == bytes) {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .map_err(|error| complain(Exit::Failed, &format!("cannot create {}: {error}", folder.display())))?;
    }
    write(path, bytes)
}

impl From<BackendArg> for crate::Backend {
    fn from(arg: BackendArg) -> crate::Backend {
        match arg {
            BackendArg::Auto => crate::Backend::Auto,
            BackendArg::Gpu => crate::Backend::Gpu,
            BackendArg::Cpu => crate::Backend::Cpu,
        }
    }
}

impl From<RemoteModeArg> for kiln_engine::RemoteMode {
    fn from(arg: RemoteModeArg) -> kiln_engine::RemoteMode {
        match arg {
            RemoteModeArg::Read => kiln_engine::RemoteMode::Read,
            RemoteModeArg::Write => kiln_engine::RemoteMode::Write,
        }
    }
}

impl PlanArgs {
    /// A build of `pipeline` with these settings.
    fn build(&self, pipeline: &Path) -> crate::Build {
        crate::Build {
            sets: self.sets.clone(),
            backend: self.backend.into(),
            cache: self.cache.clone(),
            ..crate::Build::new(pipeline)
        }
    }
}
