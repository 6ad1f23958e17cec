//! The arguments of `plumb detect`, for any target.

use std::io::{self, BufRead};

use crate::cli::Failure;
use crate::cli::sources::{TopicArgs, Unreadable};
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

/// The images that could not be read, and the frame sets without a color image, beside those that
/// were searched.
#[derive(Debug, Default)]
pub(super) struct Unread {
    searched: usize,
    damaged: UnreadImages,
    without_color: UnreadImages,
}

/// How many they are, and the reason of the first.
#[derive(Debug, Default)]
struct UnreadImages {
    count: usize,
    first: Option<String>,
}

impl Unread {
    /// Counts an image: one that was searched, or why it was not.
    pub(super) fn count(&mut self, unreadable: Option<&Unreadable>) {
        let Some(unreadable) = unreadable else {
            self.searched += 1;
            return;
        };
        let images =
            if unreadable.lacks_color { &mut self.without_color } else { &mut self.damaged };
        images.count += 1;
        images.first.get_or_insert_with(|| unreadable.reason.clone());
    }

    /// Frame sets without a color image are a failure only if there is no other: sensors of one
    /// camera do not start and stop with the same frame.
    pub(super) fn into_result(self) -> Result<(), Failure> {
        let Self { searched, damaged, without_color } = self;
        if let Some(reason) = without_color.first {
            let line = match without_color.count {
                1 => reason,
                count => format!("{count} frame sets have no color image; the first: {reason}"),
            };
            if searched == 0 && damaged.count == 0 {
                return Err(Failure::failed(line));
            }
            tracing::warn!("{line}");
        }
        match (damaged.first, damaged.count) {
            (None, _) => Ok(()),
            (Some(reason), 1) => Err(Failure::failed(reason)),
            (Some(reason), count) => Err(Failure::failed(format!(
                "{count} images could not be read; the first: {reason}"
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_sets_without_color_fail_only_where_there_is_no_other() {
        let missing = Unreadable { lacks_color: true, ..damaged("3: it has only depth") };
        let failure = |images: &[Option<&Unreadable>]| {
            let mut unread = Unread::default();
            images.iter().for_each(|image| unread.count(*image));
            unread.into_result().err().and_then(|failure| failure.line().map(str::to_owned))
        };
        let broken = damaged("4: cut short");
        assert_eq!(failure(&[None, Some(&missing), Some(&missing)]), None);
        assert_eq!(failure(&[None, Some(&missing), Some(&broken)]), Some(broken.reason.clone()));
        assert_eq!(failure(&[Some(&missing)]), Some(missing.reason.clone()));
        let all = failure(&[Some(&missing), Some(&missing)]).unwrap();
        assert_eq!(all, format!("2 frame sets have no color image; the first: {}", missing.reason));
    }

    fn damaged(reason: &str) -> Unreadable {
        Unreadable::new(String::new(), reason.to_owned())
    }
}
