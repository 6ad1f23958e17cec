//! The depth sensor's part of the calibration document.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::depth_calibration::{
    DepthBias, DepthCalibration, DepthNoise, ExposureDelay,
};
use crate::document::error::DocumentError;
use crate::document::image_sensor::image_size;
use crate::document::lens::{LensDocument, LensStdDocument};
use crate::geometry::depth_camera::{DepthCamera, DepthReading};
use crate::geometry::depth_correction::{
    CorrectedQuantity, DepthCorrection, MAX_TERMS, SplineGrid,
};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;

/// A calibrated depth sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DepthDocument {
    /// Width and height of its images, in pixels.
    pub image_size: [u32; 2],
    /// What its numbers are.
    pub kind: DepthKind,
    /// Meters per unit of `depth`; null for disparity.
    pub unit_m: Option<f64>,
    /// For disparity d: 1/z = offset + slope · d, in 1/m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub disparity: Option<DisparityDocument>,
    /// The reading that means none, besides 0 for depth.
    #[serde(default)]
    pub invalid: Option<u16>,
    /// The lens.
    pub lens: LensDocument,
    /// Standard deviation of each lens parameter; 0 for a known one.
    pub lens_std: LensStdDocument,
    /// The correction of its systematic error; null where the device's own depth is as good.
    pub correction: Option<CorrectionDocument>,
    /// Mean errors of flat surfaces.
    pub bias_m: BiasDocument,
    /// Noise of a reading: constant + quadratic · z², in meters.
    pub noise_m: NoiseDocument,
    /// Delay of infrared and depth relative to the color image of the same frame set, in
    /// milliseconds; left out where the board's motion does not determine it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_offset_ms: Option<f64>,
    /// Its standard deviation, in milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_offset_std_ms: Option<f64>,
}

/// What a depth image's numbers are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum DepthKind {
    /// Distances along the optical axis.
    Depth,
    /// Disparities, as a stereo matcher or a Kinect 1 gives them.
    Disparity,
}

/// What disparity means.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DisparityDocument {
    /// In 1/m.
    pub offset: f64,
    /// In 1/m per unit.
    pub slope: f64,
}

/// A correction: x' = x + Σ_k g_k(u, v) · x^k with x = 1/z or z, and g_k a uniform cubic B-spline
/// surface with (cells + 3) nodes along each axis of the image, row by row; without cells one
/// number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CorrectionDocument {
    /// `inverse_depth` or `depth`.
    pub quantity: String,
    /// Cells along x and y; 0 and 0 for a constant.
    pub cells: [u32; 2],
    /// Power by power, the nodes of g_k.
    pub coefficients: Vec<Vec<f64>>,
    /// The nearest and the farthest depth of the fit, in meters; in the sum, x is clamped to this
    /// range.
    pub seen_m: [f64; 2],
}

/// Mean errors of flat surfaces.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct BiasDocument {
    /// By distance, nearest first.
    pub ranges: Vec<BiasRangeDocument>,
}

/// The mean error of depth in one range of distances, measured − true, in meters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BiasRangeDocument {
    /// From this distance.
    pub from: f64,
    /// To this one.
    pub to: f64,
    /// As the device gives it.
    pub before: f64,
    /// After correction, cross-validated: fitted to the other views.
    pub after: f64,
    /// Root mean square over the patches of the residuals.
    pub rms_after: f64,
    /// Patches of the board with a residual.
    pub patches: u32,
}

/// σ(z) = constant + quadratic · z².
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct NoiseDocument {
    /// In meters.
    pub constant: f64,
    /// In 1/m.
    pub quadratic: f64,
}

impl From<&DepthCalibration> for DepthDocument {
    fn from(depth: &DepthCalibration) -> Self {
        let camera = &depth.camera;
        let (kind, unit_m, disparity) = match camera.reading {
            DepthReading::Metric { unit_m } => (DepthKind::Depth, Some(unit_m), None),
            DepthReading::Disparity { offset, slope } => {
                (DepthKind::Disparity, None, Some(DisparityDocument { offset, slope }))
            }
        };
        let range = |bias: &DepthBias| BiasRangeDocument {
            from: bias.from_m,
            to: bias.to_m,
            before: bias.before_m,
            after: bias.after_m,
            rms_after: bias.rms_after_m,
            patches: bias.patches,
        };
        Self {
            image_size: [camera.image_size.width, camera.image_size.height],
            kind,
            unit_m,
            disparity,
            invalid: depth.invalid,
            lens: (&camera.lens).into(),
            lens_std: LensStdDocument::new(camera.lens.model(), &depth.lens_std),
            correction: camera.correction.as_ref().map(CorrectionDocument::from),
            bias_m: BiasDocument { ranges: depth.bias.iter().map(range).collect() },
            noise_m: NoiseDocument {
                constant: depth.noise.constant_m,
                quadratic: depth.noise.quadratic_per_m,
            },
            time_offset_ms: depth.time_offset.map(|delay| delay.seconds * 1e3),
            time_offset_std_ms: depth.time_offset.map(|delay| delay.std_s * 1e3),
        }
    }
}

impl TryFrom<&DepthDocument> for DepthCalibration {
    type Error = DocumentError;
    fn try_from(document: &DepthDocument) -> Result<Self, DocumentError> {
        let image_size = image_size(document.image_size)?;
        let lens = Lens::try_from(&document.lens).map_err(|e| e.inside("lens"))?;
        let reading = match (document.kind, document.unit_m, document.disparity) {
            (DepthKind::Depth, Some(unit_m), _) if unit_m > 0.0 => DepthReading::Metric { unit_m },
            (DepthKind::Depth, ..) => {
                return Err(DocumentError::field(
                    "unit_m",
                    "must be meters per unit, above 0, for kind depth",
                ));
            }
            (DepthKind::Disparity, _, Some(DisparityDocument { offset, slope })) => {
                DepthReading::Disparity { offset, slope }
            }
            (DepthKind::Disparity, _, None) => {
                return Err(DocumentError::field(
                    "disparity",
                    "needs offset and slope for kind disparity",
                ));
            }
        };
        let correction =
            document.correction.as_ref().map(|correction| correction.to_correction(image_size));
        let bias = |range: &BiasRangeDocument| DepthBias {
            from_m: range.from,
            to_m: range.to,
            before_m: range.before,
            after_m: range.after,
            rms_after_m: range.rms_after,
            patches: range.patches,
        };
        Ok(Self {
            camera: DepthCamera {
                image_size,
                lens,
                reading,
                correction: correction.transpose().map_err(|e| e.inside("correction"))?,
            },
            invalid: document.invalid,
            lens_std: document
                .lens_std
                .to_values(lens.model())
                .map_err(|e| e.inside("lens_std"))?,
            bias: document.bias_m.ranges.iter().map(bias).collect(),
            noise: DepthNoise {
                constant_m: document.noise_m.constant,
                quadratic_per_m: document.noise_m.quadratic,
            },
            time_offset: document.time_offset_ms.map(|offset_ms| ExposureDelay {
                seconds: offset_ms * 1e-3,
                std_s: document.time_offset_std_ms.unwrap_or(0.0) * 1e-3,
            }),
        })
    }
}

impl From<&DepthCorrection> for CorrectionDocument {
    fn from(correction: &DepthCorrection) -> Self {
        let nodes = correction.grid.node_count();
        Self {
            quantity: correction.quantity.name().to_owned(),
            cells: [correction.grid.cols, correction.grid.rows],
            coefficients: correction.coefficients.chunks(nodes).map(<[f64]>::to_vec).collect(),
            seen_m: correction.seen_m,
        }
    }
}

impl CorrectionDocument {
    fn to_correction(&self, size: ImageSize) -> Result<DepthCorrection, DocumentError> {
        let quantity = match self.quantity.as_str() {
            "inverse_depth" => CorrectedQuantity::InverseDepth,
            "depth" => CorrectedQuantity::Depth,
            _ => return Err(DocumentError::field("quantity", "must be inverse_depth or depth")),
        };
        let [cols, rows] = self.cells;
        if cols > 1000 || rows > 1000 || (cols == 0) != (rows == 0) {
            return Err(DocumentError::field(
                "cells",
                "must be two numbers up to 1000, or 0 and 0",
            ));
        }
        let grid = SplineGrid { size, cols, rows };
        let whole = |nodes: &Vec<f64>| {
            nodes.len() == grid.node_count() && nodes.iter().all(|node| node.is_finite())
        };
        let terms = self.coefficients.len();
        if terms == 0 || terms > MAX_TERMS || !self.coefficients.iter().all(whole) {
            let count = grid.node_count();
            return Err(DocumentError::field(
                "coefficients",
                format!("must be 1 to {MAX_TERMS} lists of {count} numbers"),
            ));
        }
        let [near, far] = self.seen_m;
        if !(near > 0.0 && far >= near && far.is_finite()) {
            return Err(DocumentError::field(
                "seen_m",
                "must be the nearest and the farthest distance, above 0",
            ));
        }
        Ok(DepthCorrection {
            quantity,
            terms,
            grid,
            coefficients: self.coefficients.concat(),
            seen_m: self.seen_m,
        })
    }
}
