//! How far a session is, whole or by camera: counts, coverage, guidance, the estimate so far.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::admission::Rejections;
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::Guidance;
use crate::calibration::session_record::RunningEstimate;
use crate::document::error::DocumentError;
use crate::document::image_sensor::UncertaintyDocument;
use crate::document::lens::LensDocument;
use crate::document::pose::PoseDocument;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::Pixel;

/// Where in the image corners have been seen.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct CoverageDocument {
    /// Fraction of the cells that contain corners, 0 to 1.
    pub fraction: f64,
    /// Corners kept in each cell: rows from the image's top, each from its left.
    pub cells: Vec<Vec<u32>>,
}

/// What the person with the board should do next.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct GuidanceDocument {
    /// In words.
    pub message: String,
    /// Where the board's outline should be, as corners of a polygon in pixels; empty when there is
    /// no such request.
    pub outline_px: Vec<[f64; 2]>,
    /// Where the board should be next, as camera_from_board; null when no place is better than
    /// another.
    #[serde(default)]
    pub target_pose: Option<PoseDocument>,
    /// Predicted uncertainty after the suggested view, in pixels, of the quantity that the goal
    /// limits; null as long as views do not determine the pose of a depth camera beside color.
    #[serde(default)]
    pub expected_uncertainty_px: Option<f64>,
    /// Predicted number of further views until the goal is reached, at least and at most; null
    /// without a goal.
    #[serde(default)]
    pub views_to_go: Option<[u32; 2]>,
}

/// A running estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EstimateDocument {
    /// The lens.
    pub lens: LensDocument,
    /// Root mean square of the reprojection errors, in pixels.
    pub rms_px: f64,
    /// Predicted 1-σ projection uncertainty over the image.
    pub uncertainty_px: UncertaintyDocument,
    /// Number of views it was estimated from.
    pub views: u32,
}

/// As [`rejected_counts`], the other way round.
pub(super) fn rejections(counts: &BTreeMap<String, u64>) -> Rejections {
    Rejections::from_counts(counts.iter().map(|(kind, count)| (kind.as_str(), *count)))
}

/// Whether a document can say it: JSON has no number for infinity.
pub(super) fn is_finite(estimate: &RunningEstimate) -> bool {
    estimate.lens.parameters().into_iter().chain([estimate.rms_px]).all(f64::is_finite)
}

/// Each kind of rejection with its count.
pub fn rejected_counts(rejected: &Rejections) -> BTreeMap<String, u64> {
    rejected.iter().map(|(kind, count)| (kind.to_owned(), count)).collect()
}

impl From<&Coverage> for CoverageDocument {
    fn from(coverage: &Coverage) -> Self {
        Self { fraction: coverage.fraction(), cells: coverage.cells().to_vec() }
    }
}

impl TryFrom<CoverageDocument> for Coverage {
    type Error = DocumentError;
    fn try_from(document: CoverageDocument) -> Result<Self, DocumentError> {
        let uneven = || DocumentError::field("cells", "has no cells, or rows of different lengths");
        Self::from_cells(document.cells).ok_or_else(uneven)
    }
}

impl From<&Guidance> for GuidanceDocument {
    fn from(guidance: &Guidance) -> Self {
        let outline_px = guidance.outline_px.iter().map(|pixel| [pixel.x, pixel.y]).collect();
        Self {
            message: guidance.message.clone(),
            outline_px,
            target_pose: guidance.camera_from_board.as_ref().map(PoseDocument::from),
            expected_uncertainty_px: guidance.expected_uncertainty_px,
            views_to_go: guidance.views_to_go,
        }
    }
}

impl From<GuidanceDocument> for Guidance {
    fn from(document: GuidanceDocument) -> Self {
        let outline_px = document.outline_px.into_iter().map(|[x, y]| Pixel::new(x, y)).collect();
        Self {
            message: document.message,
            outline_px,
            // What was asked for last is asked for anew with the next frame.
            camera_from_board: document.target_pose.and_then(|pose| (&pose).try_into().ok()),
            expected_uncertainty_px: document.expected_uncertainty_px,
            views_to_go: document.views_to_go,
        }
    }
}

impl From<&RunningEstimate> for EstimateDocument {
    fn from(estimate: &RunningEstimate) -> Self {
        Self {
            lens: (&estimate.lens).into(),
            rms_px: estimate.rms_px,
            uncertainty_px: estimate.uncertainty_px.into(),
            views: estimate.views,
        }
    }
}

impl TryFrom<&EstimateDocument> for RunningEstimate {
    type Error = DocumentError;
    fn try_from(document: &EstimateDocument) -> Result<Self, DocumentError> {
        Ok(Self {
            lens: Lens::try_from(&document.lens).map_err(|e| e.inside("lens"))?,
            rms_px: document.rms_px,
            uncertainty_px: document.uncertainty_px.into(),
            uncertainty_map: None,
            views: document.views,
        })
    }
}
