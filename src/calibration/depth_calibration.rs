//! The depth sensor's part of a calibration: lens, correction, and the remaining error and noise,
//! by distance.

use crate::calibration::result::verdict::{Grade, Verdict};
use crate::estimation::depth_error::{ComparedTile, held_out_residuals};
use crate::estimation::rgbd::RgbdEstimate;
use crate::geometry::depth_camera::DepthCamera;

/// A calibrated depth sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthCalibration {
    /// Lens, meaning of its readings, and correction.
    pub camera: DepthCamera,
    /// The value that means no reading, besides 0 for metric depth.
    pub invalid: Option<u16>,
    /// Standard deviation of each lens parameter; 0 for a given one.
    pub lens_std: Vec<f64>,
    /// The mean error on flat surfaces, by distance, nearest first.
    pub bias: Vec<DepthBias>,
    /// The noise of single readings.
    pub noise: DepthNoise,
    /// How much later its images are taken than color's, if the board's motion determines it.
    pub time_offset: Option<ExposureDelay>,
}

/// How much later a sensor's images are taken than those in the same frame set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureDelay {
    /// In seconds.
    pub seconds: f64,
    /// Its standard deviation, in seconds.
    pub std_s: f64,
}

/// The mean error of depth in one range of distances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthBias {
    /// From this distance, in meters.
    pub from_m: f64,
    /// To this one.
    pub to_m: f64,
    /// As the device reports depth: measured − true, in meters.
    pub before_m: f64,
    /// After a correction that was fitted to other views, in meters.
    pub after_m: f64,
    /// Root mean square of the residuals over the patches, in meters.
    pub rms_after_m: f64,
    /// Patches of the board with a residual.
    pub patches: u32,
}

/// σ(z) = constant + quadratic · z².
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DepthNoise {
    /// In meters.
    pub constant_m: f64,
    /// In 1/m.
    pub quadratic_per_m: f64,
}

impl DepthNoise {
    /// Standard deviation of one reading at `z_m`, in meters.
    pub fn at(self, z_m: f64) -> f64 {
        self.constant_m + self.quadratic_per_m * z_m * z_m
    }

    /// Least squares with both coefficients nonnegative.
    fn of(views: &[Vec<ComparedTile>]) -> Self {
        let pairs = || {
            views.iter().flatten().map(|compared| {
                (compared.plane.powi(-2), compared.tile.reading_std * compared.plane.powi(-2))
            })
        };
        let (mut n, mut q, mut qq, mut s, mut qs) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (z2, std) in pairs() {
            (n, q, qq, s, qs) = (n + 1.0, q + z2, qq + z2 * z2, s + std, qs + z2 * std);
        }
        let determinant = n * qq - q * q;
        let (constant, quadratic) =
            ((qq * s - q * qs) / determinant, (n * qs - q * s) / determinant);
        if !(determinant > 0.0) || quadratic < 0.0 {
            return Self { constant_m: s / f64::max(n, 1.0), quadratic_per_m: 0.0 };
        }
        if constant < 0.0 {
            return Self { constant_m: 0.0, quadratic_per_m: qs / qq };
        }
        Self { constant_m: constant, quadratic_per_m: quadratic }
    }
}

impl DepthCalibration {
    /// The depth sensor's part of an estimate.
    pub fn of(estimate: &RgbdEstimate, invalid: Option<u16>) -> Self {
        let std = |k: usize| estimate.depth_covariance[(k, k)].max(0.0).sqrt();
        Self {
            camera: estimate.depth.clone(),
            invalid,
            lens_std: (0..estimate.depth_covariance.nrows()).map(std).collect(),
            bias: bias(estimate),
            noise: DepthNoise::of(&estimate.compared),
            time_offset: estimate
                .time_offset
                .map(|offset| ExposureDelay { seconds: offset.seconds, std_s: offset.std_s }),
        }
    }
}

/// Ranges of distance grow by this factor.
const RANGE_RATIO: f64 = 1.25;

fn bias(estimate: &RgbdEstimate) -> Vec<DepthBias> {
    let uncorrected = |compared: &ComparedTile| compared.tile.inverse_depth - compared.plane;
    let after = match &estimate.depth.correction {
        Some(correction) => held_out_residuals(&estimate.compared, correction, estimate.smoothness),
        None => None,
    };
    let after = after.unwrap_or_else(|| {
        estimate.compared.iter().map(|view| view.iter().map(uncorrected).collect()).collect()
    });
    let mut bins: std::collections::BTreeMap<i32, (Vec<f64>, Vec<f64>)> =
        std::collections::BTreeMap::new();
    for (compared, after) in estimate.compared.iter().flatten().zip(after.iter().flatten()) {
        let bin = bins.entry((-compared.plane.ln() / RANGE_RATIO.ln()).floor() as i32).or_default();
        bin.0.push(1.0 / compared.tile.inverse_depth - 1.0 / compared.plane);
        bin.1.push(1.0 / (compared.plane + after) - 1.0 / compared.plane);
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let rms =
        |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    bins.into_iter()
        .map(|(bin, (before, after))| DepthBias {
            from_m: RANGE_RATIO.powi(bin),
            to_m: RANGE_RATIO.powi(bin + 1),
            before_m: mean(&before),
            after_m: mean(&after),
            rms_after_m: rms(&after),
            patches: before.len() as u32,
        })
        .collect()
}

/// A mean error in a range of distances is reported if it exceeds this fraction of a reading's
/// noise.
const REPORTED_NOISE_FRACTION: f64 = 0.3;

/// The verdict with the findings about depth.
pub fn judge_depth(
    verdict: Verdict,
    depth: &DepthCalibration,
    without_depth: usize,
    views: usize,
) -> Verdict {
    let Verdict { mut grade, mut reasons } = verdict;
    let mut add = |worse: Grade, reason: String| {
        grade = grade.min(worse);
        reasons.push(reason);
    };
    for axis in 0..2 {
        let (value, std) = (depth.camera.lens.parameters()[axis], depth.lens_std[axis]);
        if std > 0.005 * value {
            let name = ["fx", "fy"][axis];
            let percent = 100.0 * std / value;
            add(
                Grade::Usable,
                format!(
                    "the depth camera's {name} is uncertain by {percent:.1} % (estimated by planes alone): tilt the board more, at different distances"
                ),
            );
        }
    }
    for range in &depth.bias {
        let noise = depth.noise.at(0.5 * (range.from_m + range.to_m));
        if range.after_m.abs() > REPORTED_NOISE_FRACTION * noise && range.patches >= 30 {
            let (from, to, left) = (range.from_m, range.to_m, 1000.0 * range.after_m);
            add(
                Grade::Usable,
                format!(
                    "depth is still off by {left:.1} mm on average from {from:.2} to {to:.2} m: add views there, over all of the image"
                ),
            );
        }
    }
    if 2 * without_depth > views {
        add(
            Grade::Usable,
            format!(
                "the depth camera did not see the board in {without_depth} of {views} views: keep it within the depth image and its range"
            ),
        );
    }
    Verdict { grade, reasons }
}
