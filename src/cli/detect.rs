//! `plumb detect`: finds the images with the board, and its corners.

use serde::Serialize;

use crate::cli::board_check::BoardCheck;
pub use crate::cli::detect_args::Args;
use crate::cli::detect_args::{Unread, paths};
use crate::cli::in_order::{all_cores, in_order};
use crate::cli::search::{SearchedImage, searcher};
use crate::cli::sources::FrameSets;
use crate::cli::{Failure, output, recognize};
use crate::detection::board_detection::{BoardMarkers, DetectOptions, Detection};
use crate::geometry::target::Target;

/// The output for one image.
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
    /// For part of a board: whether its indices count from the board's first corner, or are only
    /// relative to each other.
    position_known: bool,
    reason: Option<String>,
    elapsed_ms: f64,
    /// For a board with markers.
    #[serde(flatten)]
    coded: Option<CodedLine>,
}

/// The additional output for a board with markers.
#[derive(Debug, Serialize)]
struct CodedLine {
    kind: &'static str,
    ids: Vec<u32>,
    std_px: Vec<f64>,
    /// How many markers were read.
    markers: usize,
    /// For a ChArUco board with an even number of rows: whether its layout is the legacy one.
    legacy: Option<bool>,
    /// For an AprilGrid: the width of the black border around a tag's payload, in cells.
    border_bits: Option<u32>,
    inverted: bool,
}

/// The side of a square, which does not affect where a board is found.
const ANY_SQUARE_M: f64 = 0.025;

/// Runs the command.
///
/// # Errors
/// When images could not be read, after all others have been searched.
pub fn run(args: &Args) -> Result<(), Failure> {
    if args.target.is_auto() {
        return recognize::run(args);
    }
    let target = args.target.read(ANY_SQUARE_M)?;
    let options = DetectOptions { allow_partial: args.allow_partial };
    let (mut unread, check) = (Unread::default(), BoardCheck::of(&target));
    in_order(
        FrameSets::new(paths(&args.paths)).reading(&args.reading),
        args.threads.map_or_else(all_cores, usize::from),
        || searcher(&target, options, args.repeat, Some(&check)),
        |image| {
            check.take(image.as_ref().ok().and_then(|image| image.compared.as_ref()));
            unread.count(image.as_ref().err());
            let line = match image {
                Ok(image) => ImageLine::of(&target, image),
                Err(unreadable) => ImageLine {
                    reason: Some(unreadable.reason),
                    ..ImageLine::nothing(&target, unreadable.path)
                },
            };
            print(args, &target, &line)
        },
    )?;
    check.warn();
    unread.into_result()
}

impl ImageLine {
    fn of(target: &Target, image: SearchedImage) -> Self {
        let size = image.frame.image_size;
        let nothing = Self {
            width: Some(size.width),
            height: Some(size.height),
            elapsed_ms: image.elapsed_ms,
            ..Self::nothing(target, image.path)
        };
        match image.answer {
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
                coded: CodedLine::of(target, &detection),
                ..nothing
            },
        }
    }

    fn nothing(target: &Target, path: String) -> Self {
        let size = target.lattice();
        Self {
            path,
            width: None,
            height: None,
            found: false,
            partial: false,
            cols: size.cols,
            rows: size.rows,
            corners: Vec::new(),
            indices: Vec::new(),
            orientation_ambiguous: target.orientation_ambiguous(),
            position_known: false,
            reason: None,
            elapsed_ms: 0.0,
            coded: None,
        }
    }
}

impl CodedLine {
    fn of(target: &Target, detection: &Detection) -> Option<Self> {
        let BoardMarkers { read, legacy, border_bits, inverted } = detection.markers?;
        Some(Self {
            kind: target.kind(),
            ids: detection.corner_ids(target)?,
            std_px: detection.corners.iter().map(|corner| corner.std_px).collect(),
            markers: read,
            legacy,
            border_bits,
            inverted,
        })
    }

    /// Its most important properties, in readable form.
    fn notes(&self) -> String {
        let mut notes = format!(" by {} markers", self.markers);
        if self.legacy == Some(true) {
            notes.push_str(", legacy layout");
        }
        if self.inverted {
            notes.push_str(", black and white inverted");
        }
        notes
    }
}

fn print(args: &Args, target: &Target, line: &ImageLine) -> Result<(), Failure> {
    if args.json {
        return output::print_json(line);
    }
    let ImageLine { path, corners, reason, elapsed_ms, .. } = line;
    let part = if line.partial { "part of a" } else { "a" };
    output::print_line(&match reason {
        // A reason that concerns the file already names it.
        Some(reason) if line.width.is_none() => reason.clone(),
        Some(reason) => format!("{path}: no board: {reason}"),
        None => {
            let (name, notes) = match &line.coded {
                Some(coded) => (target.to_string(), coded.notes()),
                None => (format!("{} board", target.lattice()), String::new()),
            };
            format!("{path}: {part} {name}, {} corners{notes}, {elapsed_ms:.2} ms", corners.len())
        }
    })
}
