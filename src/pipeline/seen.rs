//! A camera's frame set with its detections, on its way to the session.

use std::sync::Arc;
use std::time::Instant;

use crate::calibration::admission::Rejection;
use crate::calibration::session::{CameraFrame, DepthFrame};
use crate::calibration::view::FrameFacts;
use crate::detection::board_detection::Detection;
use crate::geometry::pixel::ImageSize;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::factory::FactorySensor;
use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::pipeline::live_frame::{FrameDetection, NoDetection};
use crate::store::Picture;

/// A frame set that was searched.
#[derive(Debug)]
pub(super) struct SeenFrame {
    pub(super) frame_set: Arc<FrameSet>,
    /// When it was received from its source.
    pub(super) arrived: Instant,
    /// Whether its source waits for it.
    pub(super) waits: bool,
    pub(super) detection: FrameDetection,
    /// The observations of the camera's sensors, the searched one first; empty where the frame set
    /// cannot become a view.
    pub(super) sensors: Vec<SensorObservation>,
}

/// The observation of one sensor in a frame set that may be kept.
#[derive(Debug, Clone)]
pub(super) struct SensorObservation {
    pub(super) sensor: SensorKind,
    pub(super) image_size: ImageSize,
    /// The encoding of the depth readings, where the device states it.
    pub(super) depth_encoding: Option<DepthEncoding>,
    /// The board in it, where it was found; that of the searched sensor is in the frame's
    /// detection.
    pub(super) detection: Option<Detection>,
    pub(super) depth: Option<Arc<DepthImage>>,
    /// Its image as a file.
    pub(super) image: Picture,
}

impl SensorObservation {
    /// A depth image, without loss; `None` for one that cannot be decoded.
    pub(super) fn of_depth(frame: &Frame, depth_encoding: Option<DepthEncoding>) -> Option<Self> {
        let depth = DepthImage::from_frame(frame).ok()?;
        let image = Picture { media_type: "image/png".to_owned(), bytes: depth.to_png() };
        Some(Self {
            sensor: frame.sensor,
            image_size: depth.size(),
            depth_encoding,
            detection: None,
            depth: Some(Arc::new(depth)),
            image,
        })
    }
}

impl SeenFrame {
    /// The session's input from it; `stated` is what the device states about its depth sensor.
    pub(super) fn to_camera_frame(&self, stated: Option<&FactorySensor>) -> CameraFrame {
        let seen = match &self.detection.outcome {
            Ok(content) => Ok(content.clone()),
            Err(NoDetection::NoBoard(reason)) => Err(Rejection::NoBoard(reason.clone())),
            Err(NoDetection::NoImage(missing)) => {
                let name = frame_facts(&self.frame_set).display_name();
                Err(Rejection::NoImage { name, missing: missing.clone() })
            }
            Err(NoDetection::Unreadable { detail }) => {
                Err(Rejection::Unreadable { detail: detail.clone() })
            }
        };
        let depth = self.depth(stated);
        CameraFrame { frame: frame_facts(&self.frame_set), seen, depth }
    }

    fn depth(&self, stated: Option<&FactorySensor>) -> Option<DepthFrame> {
        let depth = self.sensors.iter().find(|of| of.sensor == SensorKind::Depth)?;
        let is_infrared = |of: &&SensorObservation| {
            of.sensor.is_of_depth() && of.image_size == depth.image_size && of.detection.is_some()
        };
        let infrared = self.sensors.iter().find(is_infrared);
        Some(DepthFrame {
            image: depth.depth.clone()?,
            encoding: depth.depth_encoding.unwrap_or(DepthEncoding::ORDINARY),
            factory: stated.and_then(|stated| stated.depth_lens(depth.image_size)),
            infrared: infrared.and_then(|of| of.detection.clone()),
        })
    }

    /// When the host received it, in nanoseconds since the Unix epoch.
    pub(super) fn host_time_ns(&self) -> i64 {
        self.frame_set.host_time.utc_ns
    }
}

/// The frame that boards are searched for in.
pub(super) fn searched_frame(frame_set: &FrameSet) -> Option<&Frame> {
    frame_set.frame(SensorKind::Color).or_else(|| frame_set.frame(SensorKind::Infrared))
}

pub(super) fn frame_facts(frame_set: &FrameSet) -> FrameFacts {
    FrameFacts {
        sequence: frame_set.sequence,
        name: frame_set.name.clone(),
        host_time_ns: frame_set.host_time.utc_ns,
        device_time_ns: frame_set.device_time.map(|time| time.monotonic_ns),
        image_size: searched_frame(frame_set).map_or(ImageSize::new(0, 0), |frame| frame.size),
    }
}
