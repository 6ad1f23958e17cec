//! `plumb detect --target auto`: which board with markers each image shows.

use std::time::Instant;

use serde::Serialize;

use crate::cli::detect_args::{Args, Unread, paths};
use crate::cli::in_order::{all_cores, in_order};
use crate::cli::search::read_luma;
use crate::cli::sources::{FrameSets, SourcedFrames, Unreadable};
use crate::cli::{Failure, output};
use crate::detection::coded::recognition::{RecognizedBoard, recognize};
use crate::geometry::target::Target;
use crate::imaging::gray::GrayImage;

/// What is printed for an image.
#[derive(Debug, Serialize)]
struct RecognizedLine {
    path: String,
    found: bool,
    target: Option<RecognizedTarget>,
    /// Corners that were seen.
    corners: usize,
    /// Some of the board is not seen.
    partial: bool,
    inverted: bool,
    reason: Option<String>,
    elapsed_ms: f64,
    #[serde(skip)]
    name: String,
}

/// A target without its lengths, which an image does not show.
#[derive(Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum RecognizedTarget {
    Charuco {
        cols: u32,
        rows: u32,
        dictionary: &'static str,
        first_id: u32,
        /// Of a board with an even number of rows.
        legacy: Option<bool>,
        /// `marker_m` over `square_m`.
        marker_ratio: f64,
    },
    AprilGrid {
        cols: u32,
        rows: u32,
        family: &'static str,
        first_id: u32,
        border_bits: Option<u32>,
        spacing: f64,
    },
}

/// Runs the command.
///
/// # Errors
/// When images could not be read, after all others have been searched.
pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let mut unread = Unread::default();
    in_order(
        FrameSets::new(paths(&args.paths)).reading(&args.reading),
        args.threads.map_or_else(all_cores, usize::from),
        || {
            let mut image = GrayImage::default();
            move |frames| recognized(frames, &mut image)
        },
        |line| {
            let line = line.unwrap_or_else(|unreadable| {
                unread.count(&unreadable.reason);
                RecognizedLine::none(unreadable.path, unreadable.reason, 0.0)
            });
            print(args, &line)
        },
    )?;
    unread.into_result()
}

fn recognized(
    frames: Result<SourcedFrames, Unreadable>,
    image: &mut GrayImage,
) -> Result<RecognizedLine, Unreadable> {
    let frames = frames?;
    let path = frames.path();
    read_luma(&frames, image)
        .map_err(|reason| Unreadable { reason: format!("{path}: {reason}"), path: path.clone() })?;
    let started = Instant::now();
    let board = recognize(image.view());
    let elapsed_ms = started.elapsed().as_secs_f64() * 1000.0;
    let reason = "no ChArUco board and no AprilGrid recognized; show most of it, flat and not too small (a plain chessboard has no markers: give --board)";
    Ok(match board {
        Some(board) => RecognizedLine::of(path, &board, elapsed_ms),
        None => RecognizedLine::none(path, reason.to_owned(), elapsed_ms),
    })
}

impl RecognizedLine {
    fn of(path: String, board: &RecognizedBoard, elapsed_ms: f64) -> Self {
        let detection = &board.detection;
        Self {
            path,
            found: true,
            target: RecognizedTarget::of(&board.target),
            corners: detection.corners.len(),
            partial: detection.partial,
            inverted: detection.markers.inverted,
            reason: None,
            elapsed_ms,
            name: board.to_string(),
        }
    }

    fn none(path: String, reason: String, elapsed_ms: f64) -> Self {
        Self {
            path,
            found: false,
            target: None,
            corners: 0,
            partial: false,
            inverted: false,
            reason: Some(reason),
            elapsed_ms,
            name: String::new(),
        }
    }
}

impl RecognizedTarget {
    fn of(target: &Target) -> Option<Self> {
        let hundredths = |ratio: f64| (ratio * 100.0).round() / 100.0;
        match target {
            Target::Chessboard(_) => None,
            Target::Charuco(board) => Some(Self::Charuco {
                cols: board.cols,
                rows: board.rows,
                dictionary: board.dictionary.name(),
                first_id: board.first_id,
                legacy: board.legacy,
                marker_ratio: hundredths(board.marker_m / board.square_m),
            }),
            Target::AprilGrid(grid) => Some(Self::AprilGrid {
                cols: grid.cols,
                rows: grid.rows,
                family: grid.family.family().unwrap_or(grid.family.name()),
                first_id: grid.first_id,
                border_bits: grid.border_bits,
                spacing: hundredths(grid.spacing),
            }),
        }
    }
}

fn print(args: &Args, line: &RecognizedLine) -> Result<(), Failure> {
    if args.json {
        return output::print_json(line);
    }
    let RecognizedLine { path, name, corners, .. } = line;
    output::print_line(&match &line.reason {
        Some(reason) => format!("{path}: {reason}"),
        None => format!("{path}: {name}; {corners} corners seen"),
    })
}
