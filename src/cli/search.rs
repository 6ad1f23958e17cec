//! Searches frame sets for a board: what `plumb detect` prints and `plumb calibrate` gathers.

use std::time::Instant;

use crate::calibration::view::FrameFacts;
use crate::cli::sources::{SourcedFrames, Unreadable};
use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::finder::TargetFinder;
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::decode::luma;
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;

/// An image that was searched for the board.
#[derive(Debug)]
pub struct SearchedImage {
    /// Its path; for a frame of a recording with its number.
    pub path: String,
    /// The recording it is part of.
    pub recording: Option<String>,
    /// Size, times and sequence number of its frame.
    pub frame: FrameFacts,
    /// The board found in it, or why there is none.
    pub answer: Result<Detection, NoBoard>,
    /// Duration of the search, the fastest of all repeats, in milliseconds; without decoding.
    pub elapsed_ms: f64,
}

/// A function that searches for `target` in the image of a frame set, `repeat` times over. It keeps
/// its buffers.
pub fn searcher(
    target: &Target,
    options: DetectOptions,
    repeat: u32,
) -> impl FnMut(Result<SourcedFrames, Unreadable>) -> Result<SearchedImage, Unreadable> {
    let (mut finder, mut image) = (TargetFinder::new(target), GrayImage::default());
    move |frames| {
        let frames = frames?;
        let path = frames.path();
        read_luma(&frames, &mut image).map_err(|reason| Unreadable {
            reason: format!("{path}: {reason}"),
            path: path.clone(),
        })?;
        let frame = frame_facts(&frames, image.size());
        let mut search = || {
            let started = Instant::now();
            let answer = finder.find(image.view(), &options);
            (answer, started.elapsed().as_secs_f64() * 1000.0)
        };
        let (answer, mut elapsed_ms) = search();
        for _ in 1..repeat {
            elapsed_ms = elapsed_ms.min(search().1);
        }
        Ok(SearchedImage { path, recording: frames.recording, frame, answer, elapsed_ms })
    }
}

/// What there is to know about the image of a frame set.
pub(super) fn frame_facts(frames: &SourcedFrames, image_size: ImageSize) -> FrameFacts {
    FrameFacts {
        sequence: frames.set.sequence,
        name: frames.set.name.clone(),
        host_time_ns: frames.set.host_time.utc_ns,
        device_time_ns: frames.set.device_time.map(|time| time.monotonic_ns),
        image_size,
    }
}

/// The luma of the color image, else of the infrared one.
pub(super) fn read_luma(frames: &SourcedFrames, image: &mut GrayImage) -> Result<(), String> {
    luma(frames.image_of(SensorKind::Color)?, image).map_err(|error| error.to_string())
}
