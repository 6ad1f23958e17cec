//! The search for the board in a camera's images: an image is decoded to luma, then searched in
//! full, or the board is tracked from the previous frame. Also what each sensor of a frame set
//! gives that may be kept.

use std::sync::Arc;
use std::time::Instant;

use crate::detection::board_detection::DetectOptions;
use crate::detection::finder::TargetFinder;
use crate::detection::tracking::TrackedBoard;
use crate::geometry::target::Target;
use crate::imaging::decode;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::imaging::no_image::NoImage;
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_frame::{FrameDetection, NoDetection};
use crate::pipeline::seen::{SeenFrame, SensorObservation, searched_frame};
use crate::pipeline::view_image::view_image;
use crate::store::Picture;

/// How a frame is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SearchMode {
    /// In full: the result depends on this image alone, and is as accurate as possible.
    Whole,
    /// Where the board was in the previous frame, and in full if it is not there. This takes a
    /// fraction of the time, and the corners are accurate enough to decide whether the frame is
    /// kept.
    Tracked,
}

/// Searches for boards; its buffers are kept from frame to frame.
#[derive(Default)]
pub(super) struct BoardSearch {
    finder: Option<TargetFinder>,
    luma: GrayImage,
}

impl std::fmt::Debug for BoardSearch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BoardSearch").finish_non_exhaustive()
    }
}

impl BoardSearch {
    /// The board in a frame set's searched image.
    pub(super) fn search(
        &mut self,
        frame_set: &FrameSet,
        board: &Target,
        mode: SearchMode,
    ) -> FrameDetection {
        let started = Instant::now();
        let found = match searched_frame(frame_set) {
            Some(frame) => self.search_frame(frame, board, mode),
            None => Err(NoImage::of(frame_set).into()),
        };
        let tracked = found.as_ref().is_ok_and(|found| found.followed);
        FrameDetection {
            outcome: found.map(|found| found.detection.into()),
            elapsed_ms: started.elapsed().as_secs_f64() * 1e3,
            tracked,
        }
    }

    /// Searches every image of a frame set that may be kept. If the board was tracked, its image is
    /// searched again in full; the images of the other sensors are searched or decoded.
    /// `depth_encoding` is what the device states about depth. A sensor whose image is damaged is
    /// left out.
    pub(super) fn observe_all(
        &mut self,
        seen: &mut SeenFrame,
        board: &Target,
        depth_encoding: Option<DepthEncoding>,
    ) {
        let frame_set = Arc::clone(&seen.frame_set);
        if seen.detection.tracked {
            let elapsed_ms = seen.detection.elapsed_ms;
            let detection = self.search(&frame_set, board, SearchMode::Whole);
            seen.detection = FrameDetection { elapsed_ms, ..detection };
        }
        let Some(searched) = searched_frame(&frame_set) else { return };
        seen.sensors = vec![SensorObservation {
            sensor: searched.sensor,
            image_size: searched.size,
            depth_encoding: None,
            detection: None,
            depth: None,
            image: image_of(searched).unwrap_or_else(no_image),
        }];
        let others = frame_set.frames.iter().filter(|frame| frame.sensor != searched.sensor);
        for frame in others {
            let observed = guarded(|| self.observe_sensor(frame, board, depth_encoding));
            match observed {
                Ok(observed) => seen.sensors.extend(observed),
                Err(fault) => {
                    tracing::error!("{}: {fault}", frame.sensor.name());
                    self.finder = None;
                }
            }
        }
    }

    fn observe_sensor(
        &mut self,
        frame: &Frame,
        board: &Target,
        depth_encoding: Option<DepthEncoding>,
    ) -> Option<SensorObservation> {
        let sensor = frame.sensor;
        if sensor == SensorKind::Depth {
            return SensorObservation::of_depth(frame, depth_encoding);
        }
        let image = image_of(frame)?;
        let found = self.search_frame(frame, board, SearchMode::Whole);
        Some(SensorObservation {
            sensor,
            image_size: frame.size,
            depth_encoding: None,
            detection: found.ok().map(|found| found.detection),
            depth: None,
            image,
        })
    }

    fn search_frame(
        &mut self,
        frame: &Frame,
        board: &Target,
        mode: SearchMode,
    ) -> Result<TrackedBoard, NoDetection> {
        guarded(|| self.try_search(frame, board, mode)).unwrap_or_else(|fault| {
            // The finder's state after a panic cannot be trusted.
            self.finder = None;
            Err(unreadable(fault.to_string()))
        })
    }

    fn try_search(
        &mut self,
        frame: &Frame,
        board: &Target,
        mode: SearchMode,
    ) -> Result<TrackedBoard, NoDetection> {
        decode::luma(frame, &mut self.luma).map_err(|error| unreadable(error.to_string()))?;
        let finder = match &mut self.finder {
            Some(finder) if finder.target() == board => finder,
            other => other.insert(TargetFinder::new(board)),
        };
        let (image, options) = (self.luma.view(), DetectOptions::default());
        Ok(match mode {
            SearchMode::Whole => TrackedBoard {
                detection: finder.find_in_sequence(image, &options)?,
                followed: false,
            },
            SearchMode::Tracked => finder.track(image, &options)?,
        })
    }
}

fn unreadable(detail: String) -> NoDetection {
    NoDetection::Unreadable { detail }
}

fn image_of(frame: &Frame) -> Option<Picture> {
    let (media_type, bytes) = view_image(frame)?;
    Some(Picture { media_type: media_type.to_owned(), bytes: bytes.to_vec() })
}

/// The image of a view whose image could not be decoded again: the view is kept for its corners.
fn no_image() -> Picture {
    Picture { media_type: "image/jpeg".to_owned(), bytes: Vec::new() }
}
