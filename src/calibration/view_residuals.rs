//! The reprojection residuals of a stored view, recomputed from its corners and its calibration:
//! the store keeps what was measured and what was estimated, not what follows from both.

use crate::calibration::result::{CalibratedView, ImageCalibration};
use crate::detection::board_detection::{DetectedCorner, Detection, GridIndex};
use crate::estimation::view_motion::read_out_time;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// The residuals, measured minus projected, in pixels, for each corner of `detection` in its order.
/// `view` is the same view in the calibration of `sensor`.
///
/// `None` for a view without a pose, and where a rolling-shutter calibration does not contain the
/// board's motion in this view: without the motion, the residuals would contradict the view's
/// `rms_px`. The solve may have rotated the labels of a symmetric board, and the view does not say
/// so: the residuals are those of the labels that fit best.
pub fn view_residuals(
    detection: &Detection,
    sensor: &ImageCalibration,
    view: &CalibratedView,
    target: Target,
) -> Option<Vec<[f64; 2]>> {
    if sensor.rolling_shutter.is_some() && view.motion.is_none() {
        return None;
    }
    let model = ViewModel { sensor, view, target, camera_from_board: view.camera_from_board? };
    let all = |board_from_labels: &Pose| -> Option<Vec<[f64; 2]>> {
        let corners = detection.corners.iter();
        corners.map(|corner| model.residual(corner, board_from_labels)).collect()
    };
    let square =
        |residuals: &Vec<[f64; 2]>| -> f64 { residuals.iter().flatten().map(|r| r * r).sum() };
    let symmetries = target.symmetries();
    let labelings = symmetries.iter().filter_map(all);
    labelings.min_by(|a, b| square(a).total_cmp(&square(b)))
}

/// What predicts the corners of a view: lens, pose and motion, and the board's shape.
struct ViewModel<'a> {
    sensor: &'a ImageCalibration,
    view: &'a CalibratedView,
    target: Target,
    /// When the image's middle row was read.
    camera_from_board: Pose,
}

impl ViewModel<'_> {
    /// The residual of one corner, with its label rotated.
    fn residual(&self, corner: &DetectedCorner, board_from_labels: &Pose) -> Option<[f64; 2]> {
        let GridIndex { col, row } = corner.index;
        let nominal = *board_from_labels * self.target.corner_at(col, row)?;
        let shape = self.sensor.board_shape.as_ref();
        let offset = shape.and_then(|shape| shape.offset_at(&nominal)).unwrap_or_default();
        let camera_from_board = self.camera_from_board_at(corner.pixel.y);
        let point_in_camera = camera_from_board * (nominal + offset);
        let predicted = self.sensor.lens.pixel_from_point(&point_in_camera)?;
        Some([corner.pixel.x - predicted.x, corner.pixel.y - predicted.y])
    }

    /// The board's pose when row `y` of the image was read.
    fn camera_from_board_at(&self, y: f64) -> Pose {
        let height_px = f64::from(self.sensor.image_size.height);
        self.view.motion.map_or(self.camera_from_board, |motion| {
            motion.camera_from_board_at(&self.camera_from_board, read_out_time(y, height_px))
        })
    }
}
