//! How far to trust a calibration: checks and verdict.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::result::{Checks, Grade, Verdict};

/// Checks on data that was not fitted; null where they could not be computed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ChecksDocument {
    /// Difference between the projections of two solutions, each from half of the views, divided by
    /// its predicted uncertainty: about 1 if the model is right.
    pub split_half_ratio: Option<f64>,
    /// Held-out (cross-validation) error, in pixels.
    pub held_out_rms_px: Option<f64>,
    /// Part of the corners that was not used, 0 to 1.
    pub outlier_fraction: f64,
    /// Part of the image in which corners were seen, 0 to 1.
    pub coverage: f64,
}

impl From<Checks> for ChecksDocument {
    fn from(checks: Checks) -> Self {
        let Checks { split_half_ratio, held_out_rms_px, outlier_fraction, coverage } = checks;
        Self { split_half_ratio, held_out_rms_px, outlier_fraction, coverage }
    }
}

impl From<ChecksDocument> for Checks {
    fn from(document: ChecksDocument) -> Self {
        let ChecksDocument { split_half_ratio, held_out_rms_px, outlier_fraction, coverage } =
            document;
        Self { split_half_ratio, held_out_rms_px, outlier_fraction, coverage }
    }
}

/// The grade of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum GradeName {
    /// To be used as it is.
    Good,
    /// To be used with the reasons in mind.
    Usable,
    /// Not to be used.
    Poor,
}

impl From<Grade> for GradeName {
    fn from(grade: Grade) -> Self {
        match grade {
            Grade::Good => Self::Good,
            Grade::Usable => Self::Usable,
            Grade::Poor => Self::Poor,
        }
    }
}

/// A grade with its reasons, each one that a person can act on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct VerdictDocument {
    /// The grade.
    pub grade: GradeName,
    /// What limits the grade, and what to do about it; a good calibration may have remarks too.
    pub reasons: Vec<String>,
}

impl From<&Verdict> for VerdictDocument {
    fn from(verdict: &Verdict) -> Self {
        Self { grade: verdict.grade.into(), reasons: verdict.reasons.clone() }
    }
}

impl From<&VerdictDocument> for Verdict {
    fn from(document: &VerdictDocument) -> Self {
        let grade = match document.grade {
            GradeName::Good => Grade::Good,
            GradeName::Usable => Grade::Usable,
            GradeName::Poor => Grade::Poor,
        };
        Self { grade, reasons: document.reasons.clone() }
    }
}
