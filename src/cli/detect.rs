//! `plumb detect`: which pictures show the board, and where its corners are.

use serde::Serialize;

pub use crate::cli::detect_args::Args;
use crate::cli::detect_args::{Unread, paths};
use crate::cli::in_order::{all_cores, in_order};
use crate::cli::search::{Looked, searcher};
use crate::cli::sources::FrameSets;
use crate::cli::target_search::read_target;
use crate::cli::{Failure, detect_target, output};
use crate::detection::board_detection::DetectOptions;
use crate::geometry::board::BoardSize;
use crate::geometry::target::Target;

/// What the command prints for an image.
#[derive(Debug, Serialize)]
struct ImageLine {
    path: String,
    width: Option<u32>,
    height: Option<u32>,
    found: bool,
    partial: bool,
    cols: u32,
    rows: u32,
    corners: Vec<[f64; 2]>,
    indices: Vec<[i32; 2]>,
    orientation_ambiguous: bool,
    /// Of part of a board: whether its indices count from the board's first corner, or only among
    /// themselves.
    position_known: bool,
    reason: Option<String>,
    elapsed_ms: f64,
}

/// Runs the command.
///
/// # Errors
/// When images could not be read, after all others have been searched.
pub fn run(args: &Args) -> Result<(), Failure> {
    match (args.board, &args.target) {
        (Some(board), _) => detect_boards(args, board),
        (None, Some(file)) => match read_target(file)? {
            Target::Chessboard(board) => detect_boards(args, board.size),
            target => detect_target::run(args, target),
        },
        (None, None) => Err(Failure::usage("give --board or --target")),
    }
}

fn detect_boards(args: &Args, board: BoardSize) -> Result<(), Failure> {
    let options = DetectOptions { allow_partial: args.allow_partial };
    let mut unread = Unread::default();
    in_order(
        FrameSets::new(paths(&args.paths)).reading(&args.reading),
        args.threads.map_or_else(all_cores, usize::from),
        || searcher(board, options, args.repeat),
        |looked| {
            let line = match looked {
                Ok(looked) => ImageLine::of(board, looked),
                Err(unreadable) => {
                    unread.count(&unreadable.reason);
                    ImageLine {
                        reason: Some(unreadable.reason),
                        ..ImageLine::nothing(board, unreadable.path)
                    }
                }
            };
            print(args, board, &line)
        },
    )?;
    unread.into_result()
}

impl ImageLine {
    fn of(board: BoardSize, looked: Looked) -> Self {
        let size = looked.frame.image_size;
        let nothing = Self {
            width: Some(size.width),
            height: Some(size.height),
            elapsed_ms: looked.elapsed_ms,
            ..Self::nothing(board, looked.path)
        };
        match looked.answer {
            Err(no_board) => Self { reason: Some(no_board.to_string()), ..nothing },
            Ok(detection) => Self {
                found: true,
                partial: detection.partial,
                corners: detection
                    .corners
                    .iter()
                    .map(|corner| [corner.pixel.x, corner.pixel.y])
                    .collect(),
                indices: detection
                    .corners
                    .iter()
                    .map(|corner| [corner.index.col, corner.index.row])
                    .collect(),
                orientation_ambiguous: detection.orientation_ambiguous,
                position_known: detection.position_known,
                ..nothing
            },
        }
    }

    fn nothing(board: BoardSize, path: String) -> Self {
        Self {
            path,
            width: None,
            height: None,
            found: false,
            partial: false,
            cols: board.cols,
            rows: board.rows,
            corners: Vec::new(),
            indices: Vec::new(),
            orientation_ambiguous: board.orientation_ambiguous(),
            position_known: false,
            reason: None,
            elapsed_ms: 0.0,
        }
    }
}

fn print(args: &Args, board: BoardSize, line: &ImageLine) -> Result<(), Failure> {
    if args.json {
        return output::print_json(line);
    }
    let ImageLine { path, corners, reason, elapsed_ms, .. } = line;
    let part = if line.partial { "part of a" } else { "a" };
    output::print_line(&match reason {
        // A reason that is about the file names it.
        Some(reason) if line.width.is_none() => reason.clone(),
        Some(reason) => format!("{path}: no board: {reason}"),
        None => {
            format!("{path}: {part} {board} board, {} corners, {elapsed_ms:.2} ms", corners.len())
        }
    })
}
