//! The error of depth on a board that color sees, before and after correction, as numbers and as an
//! image.

use serde::Serialize;

use crate::calibration::plane_error::{BoardInDepthImage, mean_and_rms_m, plane_error};
use crate::calibration::result::Calibration;
use crate::calibration::sensor::SensorId;
use crate::calibration::view::{FrameFacts, View};
use crate::cli::Failure;
use crate::detection::board_detection::DetectOptions;
use crate::detection::finder::TargetFinder;
use crate::estimation::board_pose::board_poses;
use crate::geometry::depth_camera::DepthCamera;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::decode::luma;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::draw::error_drawing::draw_errors;
use crate::imaging::frame::Frame;
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;

/// Measures the error of depth relative to the board's plane, as found in color images.
pub struct PlaneErrors {
    board: Target,
    color: Lens,
    color_size: ImageSize,
    color_from_depth: Pose,
    depth: DepthCamera,
    invalid: Option<u16>,
    finder: TargetFinder,
    image: GrayImage,
}

/// The measured depth minus that of the board's plane, in meters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OffPlane {
    mean_m: f64,
    rms_m: f64,
}

/// The errors of one image, uncorrected and corrected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BeforeAndAfter {
    before: OffPlane,
    after: OffPlane,
}

impl BeforeAndAfter {
    /// The root mean squares, in meters.
    pub fn rms_m(&self) -> [f64; 2] {
        [self.before.rms_m, self.after.rms_m]
    }
}

impl PlaneErrors {
    /// For the camera of `calibration` and its board.
    ///
    /// # Errors
    /// For a calibration without a board, color, depth or the pose between them.
    pub fn new(calibration: &Calibration) -> Result<Self, Failure> {
        let [target, source] = [SensorKind::Color, SensorKind::Depth].map(SensorId::own);
        let stated = calibration.pose(&target, &source);
        let sensors = calibration.color().zip(calibration.depth()).zip(stated);
        let board = calibration.target.and_then(|target| target.board());
        let parts = board.zip(sensors);
        let (board, ((color, depth), color_from_depth)) = parts.ok_or_else(|| {
            Failure::failed(
                "--errors needs a board calibration of color and depth: make one with `plumb calibrate`",
            )
        })?;
        Ok(Self {
            board,
            color: color.lens,
            color_size: color.image_size,
            color_from_depth: color_from_depth.target_from_source,
            depth: depth.camera.clone(),
            invalid: depth.invalid,
            finder: TargetFinder::new(&board),
            image: GrayImage::default(),
        })
    }

    /// The error of `image` on the board, as numbers and as an image; `None` where `color` does not
    /// show the board, or depth has no readings on it.
    ///
    /// # Errors
    /// For a color image that cannot be read, or is of another size than the calibration's.
    pub fn of(
        &mut self,
        color: &Frame,
        image: &DepthImage,
    ) -> Result<Option<(BeforeAndAfter, image::RgbImage)>, String> {
        luma(color, &mut self.image).map_err(|error| format!("its color image: {error}"))?;
        let image_size = self.image.size();
        if image_size != self.color_size {
            let expected = self.color_size;
            return Err(format!(
                "its color image is {image_size}, the calibration is of {expected}; record at that size"
            ));
        }
        let Ok(detection) = self.finder.find(self.image.view(), &DetectOptions::default()) else {
            return Ok(None);
        };
        let frame = FrameFacts {
            sequence: 0,
            name: None,
            host_time_ns: 0,
            device_time_ns: None,
            image_size,
        };
        let view = View { number: 0, frame, detection }.to_board_view(&self.board);
        let poses = board_poses(&self.color, &view).unwrap_or_default();
        let Some(pose) = poses.first() else { return Ok(None) };
        let errors = plane_error(&BoardInDepthImage {
            camera: &self.depth,
            color_from_depth: &self.color_from_depth,
            board: &self.board,
            color_from_board: &pose.camera_from_board,
            image,
            invalid: self.invalid,
        });
        let [before, after] =
            [&errors.before_m, &errors.after_m].map(|errors| mean_and_rms_m(errors));
        Ok(before.zip(after).and_then(|(before, after)| {
            let [first, second] =
                [("before", before), ("after", after)].map(|(when, [_, rms_m])| label(when, rms_m));
            let both = [errors.before_m.as_slice(), errors.after_m.as_slice()];
            let off = |[mean_m, rms_m]: [f64; 2]| OffPlane { mean_m, rms_m };
            let drawn = draw_errors(both, errors.size, [&first, &second])?;
            Some((BeforeAndAfter { before: off(before), after: off(after) }, drawn))
        }))
    }
}

/// The label above the drawing of the errors, where `when` is before or after correction.
fn label(when: &str, rms_m: f64) -> String {
    format!("{when} {:.2} mm rms", 1e3 * rms_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::draw::lettering::can_write;

    #[test]
    fn labels_have_all_their_letters() {
        assert!(["before", "after"].iter().all(|when| can_write(&label(when, 0.00123))));
    }
}
