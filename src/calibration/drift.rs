//! Checks whether a calibration still explains the boards seen now.
//!
//! Each board's pose is fitted with the calibrated lens and the board shape that was measured with
//! it. The residuals of several views, beyond those of the calibration's own views and beyond the
//! board's motion while rows are read, measure how far the lens has changed; the limit is the
//! calibration's own uncertainty. It costs one pose fit for each accepted view of a session.

use nalgebra::{Point3, Vector3};

use crate::calibration::result::ImageCalibration;
use crate::estimation::board_pose::board_poses;
use crate::estimation::measured_board::{MeasuredBoard, RollingShutter};
use crate::estimation::problem::BoardView;
use crate::estimation::relabeled::relabeled;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// Limit of the misfit, in standard deviations of the calibration's own projections.
const LIMIT_SIGMAS: f64 = 3.0;
/// The least limit, in pixels: less cannot be distinguished from the images' own errors.
const LEAST_LIMIT_PX: f64 = 0.1;
/// The number of views whose median misfit decides: a single one may be blurred, or a hand may have
/// bent its board.
const MEDIAN_VIEWS: usize = 5;

/// Compares a calibration with the boards seen since.
#[derive(Debug, Clone)]
pub struct DriftWatch {
    calibration: String,
    image_size: ImageSize,
    lens: Lens,
    board_shape: Option<MeasuredBoard>,
    rolling_shutter: Option<RollingShutter>,
    expected_px: f64,
    limit_px: f64,
    /// Root mean square misfit of each view so far, in pixels.
    misfits_px: Vec<f64>,
    reported: bool,
}

/// A calibration that no longer holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// The calibration's id.
    pub calibration: String,
    /// What has changed and what to do, in words.
    pub reason: String,
    /// The reprojection error of the boards seen, with only their poses fitted and without the
    /// motion that the calibration's own views showed while rows were read, in pixels; `None` if no
    /// boards were compared.
    pub rms_px: Option<f64>,
    /// The calibration's own reprojection error, in pixels.
    pub expected_px: f64,
}

impl DriftWatch {
    /// Watches the image sensor of the calibration with this id.
    pub fn new(calibration: &str, sensor: &ImageCalibration) -> Self {
        let uncertain_px = LIMIT_SIGMAS * sensor.uncertainty_px.median;
        Self {
            calibration: calibration.to_owned(),
            image_size: sensor.image_size,
            lens: sensor.lens,
            board_shape: sensor.board_shape.clone(),
            rolling_shutter: sensor.rolling_shutter,
            expected_px: sensor.rms_px,
            limit_px: uncertain_px.max(LEAST_LIMIT_PX).max(sensor.rms_px),
            misfits_px: Vec::new(),
            reported: false,
        }
    }

    /// Adds a board seen in an image of `size`. Returns the drift once, when it exceeds the limit.
    /// Of a board with several
    /// symmetries `board_from_labels`, a view may label its corners from another end than the
    /// calibration: the labels that fit best count.
    pub fn see(
        &mut self,
        view: &BoardView,
        board_from_labels: &[Pose],
        size: ImageSize,
    ) -> Option<Drift> {
        if self.reported {
            return None;
        }
        if size != self.image_size {
            let reason = format!(
                "images are now {size}, but the calibration is for {}: calibrate again",
                self.image_size
            );
            return Some(self.report(reason, None));
        }
        // A view that determines no pose shows nothing about the lens.
        let of_labels = |board_from_labels: &Pose| {
            let correspondences = relabeled(&view.correspondences, board_from_labels);
            self.misfit_px(BoardView { name: view.name.clone(), correspondences })
        };
        let misfits_px = board_from_labels.iter().filter_map(of_labels);
        self.misfits_px.push(misfits_px.min_by(f64::total_cmp)?);
        if self.misfits_px.len() < MEDIAN_VIEWS {
            return None;
        }
        let mut latest = self.misfits_px[self.misfits_px.len() - MEDIAN_VIEWS..].to_vec();
        latest.sort_by(f64::total_cmp);
        let rms_px = latest[MEDIAN_VIEWS / 2];
        let moved_px = (rms_px.powi(2) - self.expected_px.powi(2)).max(0.0).sqrt();
        if moved_px <= self.limit_px {
            return None;
        }
        let reason = format!(
            "the lens has changed since it was calibrated (refocused, zoomed, knocked?): the reprojection error of the board is {rms_px:.2} px, \
             {:.2} px expected; calibrate again",
            self.expected_px
        );
        Some(self.report(reason, Some(rms_px)))
    }

    /// Root mean square residual of a view at its best pose, in pixels.
    fn misfit_px(&self, mut view: BoardView) -> Option<f64> {
        if let Some(board) = &self.board_shape {
            for corner in &mut view.correspondences {
                *corner = corner.placed_on(board);
            }
        }
        let pose = board_poses(&self.lens, &view).ok()?.into_iter().next()?;
        let middle =
            view.correspondences.iter().map(|c| c.point_in_board.coords).sum::<Vector3<f64>>()
                / view.correspondences.len().max(1) as f64;
        let distance_m = (pose.camera_from_board * Point3::from(middle)).coords.norm();
        let motion_px = self.rolling_shutter.map_or(0.0, |shutter| {
            // Rows are read evenly over the motion, whose rms about its mean is 1/sqrt(12) of it.
            let angle_rad = (shutter.translation_m / distance_m).hypot(shutter.rotation_rad);
            shutter.agreement * self.lens.matrix.fy * angle_rad / 12_f64.sqrt()
        });
        Some((pose.rms_px.powi(2) - motion_px.powi(2)).max(0.0).sqrt())
    }

    fn report(&mut self, reason: String, rms_px: Option<f64>) -> Drift {
        self.reported = true;
        Drift {
            calibration: self.calibration.clone(),
            reason,
            rms_px,
            expected_px: self.expected_px,
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::calibration::result::ProjectionUncertainty;
    use crate::estimation::problem::Correspondence;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::geometry::lens::LensModel;

    const SIZE: ImageSize = ImageSize::new(640, 480);

    fn lens(f: f64, k1: f64) -> Lens {
        Lens::from_parameters(LensModel::Brown, &[f, f, 320.0, 240.0, 0.0, k1, 0.0, 0.0, 0.0, 0.0])
            .unwrap()
    }

    /// How far a board that is bowed by 1 mm is from flat at a point of it, in meters.
    fn bow(point_in_board: &Point3<f64>) -> Vector3<f64> {
        let from_middle = (point_in_board.x - 0.12) / 0.12;
        Vector3::new(0.0, 0.0, 1e-3 * (1.0 - from_middle * from_middle))
    }

    /// A tilted board as `lens` shows it, without noise; a flat one.
    fn view(lens: &Lens, k: usize) -> BoardView {
        uneven_view(lens, k, |_| Vector3::zeros())
    }

    fn uneven_view(lens: &Lens, k: usize, offset_m: fn(&Point3<f64>) -> Vector3<f64>) -> BoardView {
        let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap();
        let rotation = Vector3::new(0.5 - 0.2 * k as f64, 0.1 + 0.15 * k as f64, 0.1);
        let translation = Vector3::new(-0.12 + 0.02 * k as f64, -0.08, 0.4);
        let camera_from_board = Pose::new(UnitQuaternion::from_scaled_axis(rotation), translation);
        let corners = (0..6).flat_map(|row| (0..9).map(move |col| (col, row)));
        let correspondences = corners.map(|(col, row)| {
            let point_in_board = board.corner_in_board(col, row);
            let moved = point_in_board + offset_m(&point_in_board);
            let pixel = lens.pixel_from_point(&(camera_from_board * moved)).unwrap();
            Correspondence { point_in_board, pixel, std_px: 0.05 }
        });
        BoardView { name: k.to_string(), correspondences: correspondences.collect() }
    }

    fn as_labeled() -> [Pose; 1] {
        [Pose::identity()]
    }

    fn watch(lens: Lens) -> DriftWatch {
        DriftWatch::new("c1", &calibration(lens))
    }

    fn calibration(lens: Lens) -> ImageCalibration {
        let uncertainty_px = ProjectionUncertainty { center: 0.02, median: 0.05, worst: 0.3 };
        ImageCalibration {
            image_size: SIZE,
            lens,
            lens_std: Vec::new(),
            lens_covariance: Vec::new(),
            rms_px: 0.06,
            uncertainty_px,
            views: Vec::new(),
            compared: Vec::new(),
            board_warp_m: None,
            board_shape: None,
            rolling_shutter: None,
            scene: None,
        }
    }

    #[test]
    fn the_same_lens_has_not_moved() {
        let mut watch = watch(lens(600.0, -0.1));
        for k in 0..8 {
            assert_eq!(watch.see(&view(&lens(600.0, -0.1), k % 5), &as_labeled(), SIZE), None);
        }
    }

    #[test]
    fn a_refocused_lens_is_reported_once_after_some_views() {
        let mut watch = watch(lens(600.0, -0.1));
        let reports: Vec<Option<Drift>> = (0..8)
            .map(|k| watch.see(&view(&lens(570.0, -0.05), k % 5), &as_labeled(), SIZE))
            .collect();
        assert_eq!(reports.iter().flatten().count(), 1);
        let drift = reports[MEDIAN_VIEWS - 1].as_ref().unwrap();
        assert!(drift.rms_px.unwrap() > 0.2, "{drift:?}");
        assert_eq!((drift.calibration.as_str(), drift.expected_px), ("c1", 0.06));
    }

    /// The calibration's board, measured as `offset_m` says.
    fn measured(lens: &Lens, offset_m: fn(&Point3<f64>) -> Vector3<f64>) -> MeasuredBoard {
        let points: Vec<Point3<f64>> =
            view(lens, 0).correspondences.iter().map(|c| c.point_in_board).collect();
        let offsets_m: Vec<Vector3<f64>> = points.iter().map(offset_m).collect();
        MeasuredBoard {
            std_m: vec![Vector3::repeat(1e-5); points.len()],
            points,
            offsets_m,
            unevenness_m: 5e-4,
            unevenness_std_m: 1e-5,
            bow_m: [1e-3, 0.0],
        }
    }

    #[test]
    fn a_board_that_was_measured_uneven_is_no_drift() {
        let lens = lens(600.0, -0.1);
        let reports = |board_shape: Option<MeasuredBoard>| {
            let mut watch =
                DriftWatch::new("c1", &ImageCalibration { board_shape, ..calibration(lens) });
            let seen = |k: usize| watch.see(&uneven_view(&lens, k % 5, bow), &as_labeled(), SIZE);
            (0..8).filter_map(seen).count()
        };
        assert_eq!(reports(Some(measured(&lens, bow))), 0);
        assert_eq!(reports(None), 1, "taken for a flat one");
    }

    #[test]
    fn a_symmetric_board_that_is_labeled_from_its_other_end_is_no_drift() {
        /// Print that is stretched towards one end.
        fn stretched(point: &Point3<f64>) -> Vector3<f64> {
            Vector3::new(0.02 * point.x * point.x, 0.0, 0.0)
        }
        let lens = lens(600.0, -0.1);
        let far = Vector3::new(0.24, 0.15, 0.0);
        let half_rotation = Pose::from_axis_angle(Vector3::z() * std::f64::consts::PI, far);
        let reports = |board_from_labels: &[Pose]| {
            let board_shape = Some(measured(&lens, stretched));
            let mut watch =
                DriftWatch::new("c1", &ImageCalibration { board_shape, ..calibration(lens) });
            let seen = |k: usize| {
                let view = uneven_view(&lens, k % 5, stretched);
                let correspondences = relabeled(&view.correspondences, &half_rotation);
                watch.see(&BoardView { correspondences, ..view }, board_from_labels, SIZE)
            };
            (0..8).filter_map(seen).count()
        };
        assert_eq!(reports(&[Pose::identity(), half_rotation]), 0);
        assert_eq!(reports(&as_labeled()), 1, "with its labels as they are");
    }

    /// Each row sees the board where it is while that row is read.
    fn moving_view(lens: &Lens, k: usize, motion_m: f64) -> BoardView {
        let mut view = view(lens, k);
        let fy = lens.matrix.fy;
        for corner in &mut view.correspondences {
            let row = corner.pixel.y / f64::from(SIZE.height) - 0.5;
            corner.pixel.x += fy * motion_m / 0.4 * row;
        }
        view
    }

    #[test]
    fn motion_while_rows_are_read_is_no_drift_where_the_calibration_had_it_too() {
        let lens = lens(600.0, -0.1);
        let reports = |rolling_shutter: Option<RollingShutter>| {
            let sensor = ImageCalibration { rolling_shutter, ..calibration(lens) };
            let mut watch = DriftWatch::new("c1", &sensor);
            (0..8)
                .filter_map(|k| watch.see(&moving_view(&lens, k % 5, 4e-3), &as_labeled(), SIZE))
                .count()
        };
        let shutter = RollingShutter { translation_m: 4e-3, rotation_rad: 0.0, agreement: 1.0 };
        assert_eq!(reports(Some(shutter)), 0);
        assert_eq!(reports(None), 1, "taken for a global shutter");
    }

    #[test]
    fn images_of_another_size_are_reported_at_once() {
        let mut watch = watch(lens(600.0, -0.1));
        let drift = watch
            .see(&view(&lens(600.0, -0.1), 0), &as_labeled(), ImageSize::new(1280, 720))
            .unwrap();
        assert!(drift.reason.contains("1280") && drift.rms_px.is_none(), "{drift:?}");
    }
}
