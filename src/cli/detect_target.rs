//! `plumb detect --target`: the corners of a board with markers, each with its id.

use serde::Serialize;

use crate::cli::detect_args::{Args, Unread, paths};
use crate::cli::in_order::{all_cores, in_order};
use crate::cli::sources::FrameSets;
use crate::cli::target_search::{TargetSearched, target_searcher};
use crate::cli::{Failure, output};
use crate::detection::coded::detector::TargetDetector;
use crate::geometry::target::Target;

/// What the command prints for an image.
#[derive(Debug, Default, Serialize)]
struct TargetLine {
    path: String,
    width: Option<u32>,
    height: Option<u32>,
    kind: &'static str,
    found: bool,
    partial: bool,
    corners: Vec<[f64; 2]>,
    ids: Vec<u32>,
    std_px: Vec<f64>,
    /// Markers that were read.
    markers: usize,
    /// Of a ChArUco board with an even number of rows: whether its layout is the legacy one.
    legacy: Option<bool>,
    /// Of an AprilGrid: the cells of black around a tag's payload.
    border_bits: Option<u32>,
    inverted: bool,
    reason: Option<String>,
    elapsed_ms: f64,
}

/// Searches the pictures for a target with markers.
///
/// # Errors
/// When images could not be read, after all others have been searched.
pub fn run(args: &Args, target: Target) -> Result<(), Failure> {
    let Some(_) = TargetDetector::new(target) else {
        return Err(Failure::usage("a target without markers; give --board"));
    };
    let mut unread = Unread::default();
    in_order(
        FrameSets::new(paths(&args.paths)).reading(&args.reading),
        args.threads.map_or_else(all_cores, usize::from),
        || {
            let mut search = TargetDetector::new(target).map(|it| target_searcher(it, args.repeat));
            move |frames| search.as_mut().map(|search| search(frames))
        },
        |searched| {
            let nothing = TargetLine { kind: target.kind(), ..TargetLine::default() };
            let line = match searched {
                Some(Ok(searched)) => nothing.with(searched),
                Some(Err(unreadable)) => {
                    unread.count(&unreadable.reason);
                    TargetLine { path: unreadable.path, reason: Some(unreadable.reason), ..nothing }
                }
                None => return Ok(()),
            };
            print(args, &target, &line)
        },
    )?;
    unread.into_result()
}

impl TargetLine {
    fn with(self, searched: TargetSearched) -> Self {
        let size = searched.frame.image_size;
        let line = Self {
            path: searched.path,
            width: Some(size.width),
            height: Some(size.height),
            elapsed_ms: searched.elapsed_ms,
            ..self
        };
        match searched.answer {
            Err(none) => Self { reason: Some(none.to_string()), ..line },
            Ok(seen) => Self {
                found: true,
                partial: seen.partial,
                corners: seen.corners.iter().map(|it| [it.pixel.x, it.pixel.y]).collect(),
                ids: seen.corners.iter().map(|corner| corner.id).collect(),
                std_px: seen.corners.iter().map(|corner| corner.std_px).collect(),
                markers: seen.markers,
                legacy: seen.legacy,
                border_bits: seen.border_bits,
                inverted: seen.inverted,
                ..line
            },
        }
    }
}

fn print(args: &Args, target: &Target, line: &TargetLine) -> Result<(), Failure> {
    if args.json {
        return output::print_json(line);
    }
    let TargetLine { path, ids, reason, elapsed_ms, .. } = line;
    let part = if line.partial { "part of a" } else { "a" };
    let mut notes = String::new();
    if line.legacy == Some(true) {
        notes.push_str(", legacy layout");
    }
    if line.inverted {
        notes.push_str(", black and white exchanged");
    }
    output::print_line(&match reason {
        // A reason that is about the file names it.
        Some(reason) if line.width.is_none() => reason.clone(),
        Some(reason) => format!("{path}: no board: {reason}"),
        None => format!(
            "{path}: {part} {target}, {} corners by {} markers{notes}, {elapsed_ms:.2} ms",
            ids.len(),
            line.markers
        ),
    })
}
