//! `kiln build --on`: which executor.

use kiln_engine::{Executor, Local, Slurm};

use super::args::{BuildArgs, ExecutorArg};
use crate::config::{Config, ConfigError};

/// The executor that was asked for.
pub(super) fn executor(args: &BuildArgs, config: &Config) -> Result<Box<dyn Executor>, ConfigError> {
    Ok(match args.on {
        ExecutorArg::Local => Box::new(Local),
        ExecutorArg::Slurm => {
            let mut options = config.slurm()?;
            if let Some(batch) = args.batch {
                options.batch = batch as usize;
            }
            Box::new(Slurm { options })
        }
    })
}
