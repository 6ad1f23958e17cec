//! Searching for a target with markers in frame sets.

use std::path::Path;
use std::time::Instant;

use crate::calibration::view::FrameFacts;
use crate::cli::Failure;
use crate::cli::search::{frame_facts, read_luma};
use crate::cli::sources::{SourcedFrames, Unreadable};
use crate::detection::coded::answer::{NoTarget, TargetDetection};
use crate::detection::coded::detector::TargetDetector;
use crate::document::target_file::target_from_text;
use crate::geometry::target::Target;
use crate::imaging::gray::GrayImage;

/// A picture in which a target was searched for.
#[derive(Debug)]
pub struct TargetSearched {
    /// Its path; for a frame of a recording with its number.
    pub path: String,
    /// The recording it is part of.
    pub recording: Option<String>,
    /// What there is to know about it besides what is seen in it.
    pub frame: FrameFacts,
    /// What is seen in it.
    pub answer: Result<TargetDetection, NoTarget>,
    /// What the search took, the fastest of all repeats, in milliseconds; without decoding.
    pub elapsed_ms: f64,
}

/// The target in a file.
///
/// # Errors
/// When it cannot be read, or is no target that can be used.
pub fn read_target(path: &Path) -> Result<Target, Failure> {
    let name = path.display();
    let text = std::fs::read_to_string(path)
        .map_err(|error| Failure::failed(format!("{name}: {error}")))?;
    target_from_text(&text).map_err(|error| Failure::usage(format!("{name}: {error}")))
}

/// A function that searches with `detector` in the picture of a frame set, `repeat` times over.
pub fn target_searcher(
    mut detector: TargetDetector,
    repeat: u32,
) -> impl FnMut(Result<SourcedFrames, Unreadable>) -> Result<TargetSearched, Unreadable> {
    let mut image = GrayImage::default();
    move |frames| {
        let frames = frames?;
        let path = frames.path();
        read_luma(&frames, &mut image).map_err(|reason| Unreadable {
            reason: format!("{path}: {reason}"),
            path: path.clone(),
        })?;
        let mut search = || {
            let started = Instant::now();
            let answer = detector.find(image.view());
            (answer, started.elapsed().as_secs_f64() * 1000.0)
        };
        let (answer, mut elapsed_ms) = search();
        for _ in 1..repeat {
            elapsed_ms = elapsed_ms.min(search().1);
        }
        let frame = frame_facts(&frames, image.size());
        Ok(TargetSearched { path, recording: frames.recording, frame, answer, elapsed_ms })
    }
}
