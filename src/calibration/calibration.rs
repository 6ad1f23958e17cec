//! The result: an immutable calibration with its uncertainty, checks and verdict.

use crate::calibration::depth_calibration::DepthCalibration;
use crate::geometry::board::Chessboard;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// A finished calibration of one camera, or of a rig of cameras. Never changed once made: a new
/// solve is a new calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Sortable by time.
    pub id: String,
    /// The camera's name, or the rig's; `None` for a solve outside a daemon.
    pub camera: Option<String>,
    /// The session it came from; `None` outside a daemon.
    pub session: Option<String>,
    /// UTC, nanoseconds since the Unix epoch.
    pub created_at_ns: i64,
    /// The board; `None` where correspondences were given without one.
    pub target: Option<Chessboard>,
    /// The picture sensor's calibration.
    pub color: Option<SensorCalibration>,
    /// The infrared sensor's calibration.
    pub infrared: Option<SensorCalibration>,
    /// The calibration of a stereo depth camera's right infrared sensor.
    pub infrared2: Option<SensorCalibration>,
    /// The depth sensor's calibration.
    pub depth: Option<DepthCalibration>,
    /// The cameras of a rig, in its order; empty for one camera.
    pub cameras: Vec<RigCamera>,
    /// Where the sensors are relative to each other; empty for one sensor.
    pub extrinsics: Vec<Extrinsics>,
    /// How well it did beyond the views it was fitted to.
    pub checks: Checks,
    /// How far to trust it.
    pub verdict: Verdict,
}

impl Calibration {
    /// Its picture sensors with their names, in the order of documents: `color`, `infrared`,
    /// `infrared2`, or a rig's cameras.
    pub fn picture_sensors(&self) -> impl Iterator<Item = (&str, &SensorCalibration)> {
        let own =
            [("color", &self.color), ("infrared", &self.infrared), ("infrared2", &self.infrared2)];
        let own = own.into_iter().filter_map(|(name, sensor)| Some((name, sensor.as_ref()?)));
        own.chain(self.cameras.iter().map(|camera| (camera.name.as_str(), &camera.sensor)))
    }
}

/// A camera of a rig, calibrated together with the others.
#[derive(Debug, Clone, PartialEq)]
pub struct RigCamera {
    /// Its name in the configuration.
    pub name: String,
    /// Its picture sensor.
    pub sensor: SensorCalibration,
}

/// One picture sensor: its lens and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorCalibration {
    /// The size of the images it holds for.
    pub image_size: ImageSize,
    /// The lens.
    pub lens: Lens,
    /// Standard deviation of each lens parameter, in the order of [`Lens::parameter_names`]; 0 for
    /// a fixed one.
    pub lens_std: Vec<f64>,
    /// Covariance of the lens parameters, row by row in the same order; empty where it is not
    /// known.
    pub lens_covariance: Vec<Vec<f64>>,
    /// Root mean square over the used corners of the 2-D reprojection error, in pixels.
    pub rms_px: f64,
    /// Predicted 1-σ reprojection uncertainty over the image.
    pub uncertainty_px: ProjectionUncertainty,
    /// Every view that was offered, in order.
    pub views: Vec<CalibratedView>,
    /// Lens models that were compared, when the choice was left to the solve; empty otherwise.
    pub compared: Vec<ComparedLens>,
    /// How far the board was bowed at its middle along its x and its y, in meters, where that was
    /// estimated.
    pub board_warp_m: Option<[f64; 2]>,
}

/// Predicted 1-σ uncertainty of a projected pixel, after the best compensating camera motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ProjectionUncertainty {
    /// At the image's center.
    pub center: f64,
    /// The median over the image.
    pub median: f64,
    /// The worst of the image.
    pub worst: f64,
}

/// One view of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedView {
    /// Its path or sequence number.
    pub name: String,
    /// Whether it took part in the estimate.
    pub used: bool,
    /// Why not.
    pub reason: Option<String>,
    /// Its own reprojection error; `None` for a view without a pose.
    pub rms_px: Option<f64>,
    /// Where the board was; `None` for a view without a pose.
    pub camera_from_board: Option<Pose>,
}

/// Where one sensor is relative to another.
#[derive(Debug, Clone, PartialEq)]
pub struct Extrinsics {
    /// What it maps, as in `color_from_depth`.
    pub name: String,
    /// The pose of that name.
    pub target_from_source: Pose,
    /// Standard deviation of the rotation about each axis, in radians.
    pub rotation_std: [f64; 3],
    /// Standard deviation of the translation, in meters.
    pub translation_std_m: [f64; 3],
}

/// One lens model of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparedLens {
    /// The model's name.
    pub model: crate::geometry::lens::LensModel,
    /// Error on views that were not fitted to.
    pub held_out_rms_px: f64,
}

/// How a calibration does beyond the views it was fitted to. A figure that could not be computed is
/// `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Checks {
    /// Projection difference between two disjoint halves, over what their uncertainties predict:
    /// about 1 when the model is right.
    pub split_half_ratio: Option<f64>,
    /// Error on views that were not fitted to.
    pub held_out_rms_px: Option<f64>,
    /// Part of the corners that was not used.
    pub outlier_fraction: f64,
    /// Part of the image in which corners were seen, 0 to 1.
    pub coverage: f64,
}

/// How far to trust a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// Not to be used.
    Poor,
    /// With the reasons in mind.
    Usable,
    /// As it is.
    Good,
}

impl Grade {
    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Poor => "poor",
            Self::Usable => "usable",
            Self::Good => "good",
        }
    }
}

/// A grade with its reasons, each one that a person can act on.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The grade.
    pub grade: Grade,
    /// Why it is no better; empty for a spotless one.
    pub reasons: Vec<String>,
}
