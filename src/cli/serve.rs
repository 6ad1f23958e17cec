//! `plumb serve`: the daemon.

use std::path::{Path, PathBuf};

use crate::cli::Failure;
use crate::config::{Config, Overrides};
use crate::daemon;

/// The configuration that is read by default, if it exists.
const DEFAULT_FILE: &str = "plumb.toml";

/// Run the daemon: cameras, calibration sessions, HTTP.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The configuration, TOML [default: plumb.toml in the current folder, if it exists].
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The address to listen on, instead of the configuration's [default: 127.0.0.1:8600].
    #[arg(long, value_name = "ADDR")]
    listen: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// A usage error for an invalid configuration; a failure for an address or a store that cannot be
/// opened.
pub fn run(args: &Args) -> Result<(), Failure> {
    let default_file = Path::new(DEFAULT_FILE);
    let file =
        args.config.clone().or_else(|| default_file.exists().then(|| default_file.to_owned()));
    let overrides = Overrides { listen: args.listen.clone() };
    let config = Config::load(file.as_deref(), &overrides).map_err(Failure::usage)?;
    daemon::run(&config, file, overrides).map_err(Failure::failed)
}
