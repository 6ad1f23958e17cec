//! The search for a board in frame sets, for `plumb detect` and `plumb calibrate`.

use std::time::Instant;

use crate::calibration::view::FrameFacts;
use crate::cli::board_check::BoardCheck;
use crate::cli::sources::{SourcedFrames, Unreadable};
use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::finder::{RECOGNIZED_EVERY, TargetFinder};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::decode::luma;
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;
use crate::imaging::stated_camera::states_rotation;

/// An image that was searched for the board.
#[derive(Debug)]
pub struct SearchedImage {
    /// Its path; for a frame of a recording, with its number.
    pub path: String,
    /// The recording it is part of.
    pub recording: Option<String>,
    /// Size, times and sequence number of its frame.
    pub frame: FrameFacts,
    /// The board found in it, or why there is none.
    pub answer: Result<Detection, NoBoard>,
    /// Whether its file states a rotation, which is not applied.
    pub states_rotation: bool,
    /// The image itself, if the stated board is to be compared with it.
    pub compared: Option<GrayImage>,
    /// Duration of the search, the fastest of all repeats, in milliseconds; without decoding.
    pub elapsed_ms: f64,
}

/// A function that searches for `target` in the image of a frame set, `repeat` times. Its buffers
/// are reused. Images that `check` needs are kept.
pub fn searcher<'a>(
    target: &Target,
    options: DetectOptions,
    repeat: u32,
    check: Option<&'a BoardCheck>,
) -> impl FnMut(Result<SourcedFrames, Unreadable>) -> Result<SearchedImage, Unreadable> + use<'a> {
    let (mut finder, mut image) = (TargetFinder::new(target), GrayImage::default());
    move |frames| {
        let frames = frames?;
        let path = frames.path();
        read_luma(&frames, &mut image)?;
        let frame = frame_facts(&frames, image.size());
        // Of a recording's frames, which threads share, those with certain numbers, so that the
        // answer does not depend on the threads.
        let names_others = frames.recording.is_none()
            || frame.sequence.is_multiple_of(u64::from(RECOGNIZED_EVERY));
        let mut search = || {
            let started = Instant::now();
            let answer = if names_others {
                finder.find(image.view(), &options)
            } else {
                finder.find_unnamed(image.view(), &options)
            };
            (answer, started.elapsed().as_secs_f64() * 1000.0)
        };
        let (answer, mut elapsed_ms) = search();
        for _ in 1..repeat {
            elapsed_ms = elapsed_ms.min(search().1);
        }
        let color = frames.image_of(SensorKind::Color);
        let states_rotation = color.is_ok_and(|frame| states_rotation(&frame.bytes));
        let recording = frames.recording;
        let compared = check.filter(|_| answer.is_ok()).and_then(|check| check.copy(&image));
        Ok(SearchedImage { path, recording, frame, answer, states_rotation, compared, elapsed_ms })
    }
}

/// The facts about the image of a frame set.
pub(super) fn frame_facts(frames: &SourcedFrames, image_size: ImageSize) -> FrameFacts {
    FrameFacts {
        sequence: frames.set.sequence,
        name: frames.set.name.clone(),
        host_time_ns: frames.set.host_time.utc_ns,
        device_time_ns: frames.set.device_time.map(|time| time.monotonic_ns),
        image_size,
    }
}

/// The luma of the color image, or else of the infrared one.
pub(super) fn read_luma(frames: &SourcedFrames, image: &mut GrayImage) -> Result<(), Unreadable> {
    let unreadable = |reason: String| {
        let path = frames.path();
        Unreadable::new(path.clone(), format!("{path}: {reason}"))
    };
    let frame = frames
        .image_of(SensorKind::Color)
        .map_err(|reason| Unreadable { lacks_color: true, ..unreadable(reason) })?;
    luma(frame, image).map_err(|error| unreadable(error.to_string()))
}

/// Warns if `rotated` of the images state a rotation: other programs apply it, and the calibration
/// is not valid for the images as they read them.
pub(super) fn warn_of_rotation(rotated: usize, images: usize) {
    if rotated > 0 {
        tracing::warn!(
            "{rotated} of {images} images have an EXIF rotation, which is not applied: to use this calibration, read them with cv2.IMREAD_IGNORE_ORIENTATION"
        );
    }
}

#[cfg(test)]
mod tests {
    use image::ImageFormat;

    use super::*;
    use crate::cli::sources::FrameSets;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::imaging::stated_camera::tests::with_orientation;

    #[test]
    fn a_rotation_that_a_photograph_states_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let mut plain = std::io::Cursor::new(Vec::new());
        image::GrayImage::new(64, 48).write_to(&mut plain, ImageFormat::Jpeg).unwrap();
        let plain = plain.into_inner();
        let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
        let target = Target::Chessboard(board);
        let mut search = searcher(&target, DetectOptions::default(), 1, None);
        for (orientation, expected) in [(1, false), (6, true)] {
            let exif = [b"Exif\0\0".as_slice(), &with_orientation(orientation)].concat();
            let length = (2 + exif.len() as u16).to_be_bytes();
            let file = [&plain[..2], &[0xff, 0xe1], &length, &exif, &plain[2..]].concat();
            let path = folder.path().join("photograph.jpg");
            std::fs::write(&path, file).unwrap();
            let mut frames = FrameSets::new(std::iter::once(path.display().to_string()));
            let image = search(frames.next().unwrap()).unwrap();
            assert_eq!(image.states_rotation, expected, "{orientation}");
            assert_eq!(image.frame.image_size, ImageSize::new(64, 48));
        }
    }
}
