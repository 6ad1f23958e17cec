//! How far to trust a calibration.

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

impl Verdict {
    /// Adds a reason for which the grade is no better than `grade`.
    pub fn lower(&mut self, grade: Grade, reason: String) {
        self.grade = self.grade.min(grade);
        self.reasons.push(reason);
    }
}
