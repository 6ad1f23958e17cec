//! `plumb detect --target auto`: recognizes the board in each image.

use std::time::Instant;

use serde::Serialize;

use crate::cli::detect_args::{Args, Unread, paths};
use crate::cli::in_order::{all_cores, in_order};
use crate::cli::search::read_luma;
use crate::cli::sources::{FrameSets, SourcedFrames, Unreadable};
use crate::cli::{Failure, output};
use crate::detection::target_in_view::target_in_view;
use crate::document::target_in_view::TargetInViewDocument;
use crate::imaging::gray::GrayImage;

/// The output for one image.
#[derive(Debug, Serialize)]
struct RecognizedLine {
    path: String,
    #[serde(flatten)]
    seen: TargetInViewDocument,
    elapsed_ms: f64,
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
            unread.count(line.as_ref().err());
            let line = line.unwrap_or_else(|unreadable| {
                let seen = TargetInViewDocument {
                    reason: Some(unreadable.reason),
                    ..TargetInViewDocument::from(None)
                };
                RecognizedLine { path: unreadable.path, seen, elapsed_ms: 0.0 }
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
    read_luma(&frames, image)?;
    let started = Instant::now();
    let seen = target_in_view(image.view());
    let elapsed_ms = started.elapsed().as_secs_f64() * 1000.0;
    Ok(RecognizedLine { path, seen: seen.as_ref().into(), elapsed_ms })
}

fn print(args: &Args, line: &RecognizedLine) -> Result<(), Failure> {
    if args.json {
        return output::print_json(line);
    }
    let RecognizedLine { path, seen: TargetInViewDocument { name, corners, reason, .. }, .. } =
        line;
    output::print_line(&match (name, reason) {
        (Some(name), _) => format!("{path}: {name}; {corners} corners seen"),
        (None, reason) => format!("{path}: {}", reason.as_deref().unwrap_or_default()),
    })
}
