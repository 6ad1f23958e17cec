//! The arguments of a search for a target in images.

use std::path::Path;

use crate::cli::Failure;
use crate::cli::in_order::all_cores;
use crate::cli::sources::TopicArgs;
use crate::detection::board_detection::DetectOptions;

/// Which images to search, and for what.
#[derive(Debug, clap::Args)]
pub struct SearchArgs {
    /// Also use images in which only part of the board is seen.
    #[arg(long)]
    pub(super) allow_partial: bool,
    /// Number of images searched in parallel [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) threads: Option<u16>,
    #[command(flatten)]
    pub(super) reading: TopicArgs,
    /// Images, folders of images, quoted globs, or recordings (.mcap, ROS bags).
    #[arg(value_name = "SOURCE")]
    pub(super) sources: Vec<String>,
}

impl SearchArgs {
    pub(super) fn thread_count(&self) -> usize {
        self.threads.map_or_else(all_cores, usize::from)
    }

    pub(super) fn detect_options(&self) -> DetectOptions {
        DetectOptions { allow_partial: self.allow_partial }
    }

    /// # Errors
    /// When a source is not there.
    pub(super) fn check_sources(&self) -> Result<(), Failure> {
        if self.sources.is_empty() {
            return Err(Failure::usage(
                "a SOURCE is missing: give images, a folder of them, a quoted glob or a recording; see --help",
            ));
        }
        check_sources(&self.sources)
    }

    /// The sources, shortened to fit on one line.
    pub(super) fn title(&self) -> String {
        match self.sources.as_slice() {
            [first, _, .., last] => format!("{first} … {last}"),
            few => few.join(" "),
        }
    }
}

/// # Errors
/// When one of `sources` is not there.
pub(super) fn check_sources(sources: &[String]) -> Result<(), Failure> {
    sources.iter().try_for_each(|source| check_there(source))
}

/// A mistyped source must be reported, even if images from other sources could be read.
fn check_there(source: &str) -> Result<(), Failure> {
    let is_glob = source.contains(['*', '?', '[']);
    if Path::new(source).exists() || is_glob {
        return Ok(());
    }
    Err(Failure::failed(format!("{source}: there is no such file or folder; check the path")))
}
