//! What is drawn of a frame, and how.

use std::sync::Arc;

use image::RgbImage;

use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::key_frames::shared_points;
use crate::geometry::pixel::Pixel;
use crate::imaging::decode;
use crate::imaging::draw::{self, Pen};
use crate::imaging::frame::{PixelFormat, SensorKind};
use crate::imaging::remap::{Interpolation, PixelMap};
use crate::pipeline::live_frame::{FrameDetection, LiveFrame};
use crate::pipeline::preview::error::PreviewError;
use crate::pipeline::preview::maps::CalibrationMaps;
use crate::pipeline::preview::registered::shaded_depth;

const JPEG_QUALITY: u8 = 85;
/// At most this many features are drawn; more would hide the image.
const MOST_DRAWN: usize = 300;

/// A frame as a JPEG file.
pub type EncodedFrame = Arc<[u8]>;

/// What is drawn of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drawing {
    /// Whose image.
    pub sensor: SensorKind,
    /// With the corners that were found.
    pub overlay: bool,
    /// With the board at its suggested pose.
    pub guidance: bool,
    /// Undistorted with the current calibration.
    pub undistorted: bool,
    /// Rectified as one image of a stereo pair, with the current calibration of its rig.
    pub rectified: bool,
    /// The free scaling parameter of an undistorted or rectified image: at 0, all pixels shown are
    /// valid, at 1, the whole source image is visible.
    pub alpha: f64,
    /// Depth mapped into the color image, or color into the depth image.
    pub registered: bool,
}

impl Drawing {
    /// Whether the suggested pose is drawn: it is known in the unchanged color image only.
    fn has_guidance(&self) -> bool {
        let plain = !self.undistorted && !self.rectified && !self.registered;
        self.guidance && self.sensor == SensorKind::Color && plain
    }
}

/// The state of a camera at the time of a frame, as far as a drawing needs it.
#[derive(Debug)]
pub(super) struct DrawnScene<'a> {
    pub(super) camera: &'a str,
    /// The sensors that have given an image since it came.
    pub(super) sensors: &'a [SensorKind],
    pub(super) calibration: Option<&'a str>,
    /// That of its rig.
    pub(super) rig_calibration: Option<&'a str>,
    /// The outline of the board at its suggested pose.
    pub(super) outline_px: &'a [Pixel],
    /// The last key frame of a session without a target.
    pub(super) key_frame: Option<&'a SceneImage>,
}

/// Draws and encodes one frame.
///
/// # Errors
/// [`PreviewError`].
pub(super) fn encoded(
    live: &LiveFrame,
    drawing: Drawing,
    scene: &DrawnScene<'_>,
    maps: &CalibrationMaps,
) -> Result<EncodedFrame, PreviewError> {
    let Drawing { sensor, overlay, .. } = drawing;
    let frame = live
        .frame_set
        .frame(sensor)
        .ok_or_else(|| PreviewError::no_image_of(sensor, scene.camera, scene.sensors))?;
    if drawing.registered {
        let registration = maps.registration(scene.camera, scene.calibration)?;
        let image = match sensor {
            SensorKind::Depth => registration.depth_in_color(&live.frame_set, overlay)?,
            _ => registration.color_in_depth(&live.frame_set)?,
        };
        return Ok(decode::encode_jpeg_rgb(&image, JPEG_QUALITY).into());
    }
    let map = image_map(drawing, scene, maps)?;
    let mapped = |image: RgbImage| match &map {
        Some(map) => {
            map.rgb(&image, Interpolation::Bilinear).ok_or(PreviewError::OtherSize { sensor })
        }
        None => Ok(image),
    };
    if sensor == SensorKind::Depth {
        let image = mapped(shaded_depth(&live.frame_set)?)?;
        return Ok(decode::encode_jpeg_rgb(&image, JPEG_QUALITY).into());
    }
    let detection = live.detection.as_ref().filter(|_| overlay && sensor == SensorKind::Color);
    let seen = detection.and_then(FrameDetection::board);
    let features = detection.and_then(FrameDetection::scene);
    let outline_px = if drawing.has_guidance() { scene.outline_px } else { &[] };
    let is_plain = seen.is_none() && features.is_none() && outline_px.is_empty() && map.is_none();
    if is_plain && frame.format == PixelFormat::Jpeg {
        return Ok(Arc::clone(&frame.bytes));
    }
    let mut image = decode::rgb(frame)?;
    let pen = Pen::fitting(&image, draw::SUGGESTED);
    draw::draw_polygon(&mut image, outline_px, Pen { width_px: 2.0 * pen.width_px, ..pen });
    if let Some(detection) = seen {
        let corners: Vec<Pixel> = detection.corners.iter().map(|corner| corner.pixel).collect();
        draw::draw_corners(&mut image, &corners);
    }
    if let Some(features) = features {
        draw_scene(&mut image, features, scene.key_frame);
    }
    Ok(decode::encode_jpeg_rgb(&mapped(image)?, JPEG_QUALITY).into())
}

/// Draws the features that an image shares with the last key frame: a line from the position in the
/// key frame to the position in the image. Without a key frame, draws all features.
fn draw_scene(image: &mut RgbImage, features: &SceneImage, key_frame: Option<&SceneImage>) {
    let pen = Pen::fitting(image, draw::FOUND);
    let radius_px = 1.5 * pen.width_px;
    let Some(key_frame) = key_frame else {
        for pixel in features.pixels().take(MOST_DRAWN) {
            draw::draw_ring(image, pixel, radius_px, pen);
        }
        return;
    };
    let thin = Pen { width_px: 0.6 * pen.width_px, ..pen };
    for pair in shared_points(key_frame, features).into_iter().take(MOST_DRAWN) {
        draw::draw_line(image, pair.first.into(), pair.second.into(), thin);
        draw::draw_ring(image, pair.second.into(), radius_px, pen);
    }
}

/// The map that the image is drawn through, if any.
fn image_map(
    drawing: Drawing,
    scene: &DrawnScene<'_>,
    maps: &CalibrationMaps,
) -> Result<Option<Arc<PixelMap>>, PreviewError> {
    let Drawing { sensor, undistorted, rectified, alpha, .. } = drawing;
    if rectified {
        let ids = [scene.rig_calibration, scene.calibration];
        return maps.rectification(scene.camera, ids, (sensor, alpha)).map(Some);
    }
    match undistorted {
        true => {
            let ids = [scene.calibration, scene.rig_calibration];
            maps.undistortion(scene.camera, ids, (sensor, alpha)).map(Some)
        }
        false => Ok(None),
    }
}
