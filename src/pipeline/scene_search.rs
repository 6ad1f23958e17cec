//! The search for features in a camera's frames, for sessions without a board.

use std::time::Instant;

use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::key_frames::LIVE_FEATURES;
use crate::calibration::session::FrameContent;
use crate::imaging::decode;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat};
use crate::imaging::gray::GrayImage;
use crate::imaging::image_file::{frame_from_file, png_from_luma};
use crate::imaging::no_image::NoImage;
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_frame::{FrameDetection, NoDetection};
use crate::pipeline::seen::{frame_facts, searched_frame};
use crate::store::Picture;

/// The features in a frame set's searched image: the color image, or else the infrared one.
pub(super) fn search_scene(frame_set: &FrameSet) -> FrameDetection {
    let started = Instant::now();
    let outcome = match searched_frame(frame_set) {
        Some(frame) => scene_image(frame_facts(frame_set).display_name(), frame),
        None => Err(NoImage::of(frame_set).into()),
    };
    FrameDetection {
        outcome: outcome.map(FrameContent::Scene),
        elapsed_ms: started.elapsed().as_secs_f64() * 1e3,
        tracked: false,
    }
}

/// The features of a key frame's stored image: the same ones as when it was kept.
pub(super) fn stored_scene(name: String, image: Picture) -> Result<SceneImage, NoDetection> {
    scene_image(name, &frame_from_file(crate::imaging::frame::SensorKind::Color, image.bytes))
}

/// A key frame's image as a file that gives exactly the same features again: the file as it came,
/// or its luma, compressed without loss. `None` for a frame that cannot be decoded.
pub(super) fn key_frame_image(frame: &Frame) -> Option<Picture> {
    let as_it_came = match frame.format {
        PixelFormat::Jpeg => Some("image/jpeg"),
        PixelFormat::Png => Some("image/png"),
        _ => None,
    };
    if let Some(media_type) = as_it_came {
        return Some(Picture { media_type: media_type.to_owned(), bytes: frame.bytes.to_vec() });
    }
    let mut luma = GrayImage::default();
    decode::luma(frame, &mut luma).ok()?;
    Some(Picture { media_type: "image/png".to_owned(), bytes: png_from_luma(luma.view()) })
}

fn scene_image(name: String, frame: &Frame) -> Result<SceneImage, NoDetection> {
    let search = || {
        let mut luma = GrayImage::default();
        decode::luma(frame, &mut luma).map_err(|error| unreadable(error.to_string()))?;
        Ok(SceneImage::with_options(name, luma.view(), &LIVE_FEATURES))
    };
    guarded(search).unwrap_or_else(|fault| Err(unreadable(fault.to_string())))
}

fn unreadable(detail: String) -> NoDetection {
    NoDetection::Unreadable { detail }
}
