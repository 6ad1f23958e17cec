//! The arguments of `plumb detect`, for any target.

use std::io::{self, BufRead};

use crate::cli::Failure;
use crate::cli::sources::TopicArgs;
use crate::cli::target_args::ShapeArgs;

/// Detect a calibration board (chessboard, ChArUco board or AprilGrid) in each image.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub(super) target: ShapeArgs,
    /// Print a line of JSON for each image, in the order given.
    #[arg(long)]
    pub(super) json: bool,
    /// Also report partially visible boards.
    #[arg(long)]
    pub(super) allow_partial: bool,
    /// Search each image N times; elapsed_ms is the fastest.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) repeat: u32,
    /// Number of images searched in parallel [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) threads: Option<u16>,
    #[command(flatten)]
    pub(super) reading: TopicArgs,
    /// Images, folders of images, quoted globs or recordings; `-` reads paths from standard input,
    /// a line each.
    #[arg(required = true, value_name = "PATH")]
    pub(super) paths: Vec<String>,
}

/// The paths, with `-` replaced by the paths from standard input.
pub(super) fn paths(given: &[String]) -> impl Iterator<Item = String> + Send + '_ {
    given.iter().flat_map(|path| -> Box<dyn Iterator<Item = String> + Send> {
        if path == "-" {
            let lines = io::BufReader::new(io::stdin()).split(b'\n').map_while(Result::ok);
            // A name that is not valid text counts as one image that cannot be read, and the next
            // one follows.
            let name = |line: Vec<u8>| {
                String::from_utf8_lossy(line.strip_suffix(b"\r").unwrap_or(&line)).into_owned()
            };
            Box::new(lines.map(name).filter(|line| !line.is_empty()))
        } else {
            Box::new(std::iter::once(path.clone()))
        }
    })
}

/// The images that could not be read: their number, and the reason of the first.
#[derive(Debug, Default)]
pub(super) struct Unread {
    count: usize,
    first: Option<String>,
}

impl Unread {
    pub(super) fn count(&mut self, reason: &str) {
        self.count += 1;
        self.first.get_or_insert_with(|| reason.to_owned());
    }

    pub(super) fn into_result(self) -> Result<(), Failure> {
        match (self.first, self.count) {
            (None, _) => Ok(()),
            (Some(reason), 1) => Err(Failure::failed(reason)),
            (Some(reason), count) => Err(Failure::failed(format!(
                "{count} images could not be read; the first: {reason}"
            ))),
        }
    }
}
