//! How far to trust a calibration.

/// How a calibration performs on views that it was not fitted to. A figure that could not be
/// computed is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Checks {
    /// Projection difference between two disjoint halves, over what their uncertainties predict:
    /// about 1 when the model is right.
    pub split_half_ratio: Option<f64>,
    /// Error on held-out views.
    pub held_out_rms_px: Option<f64>,
    /// Fraction of the corners that was not used.
    pub outlier_fraction: f64,
    /// Fraction of the image in which corners were seen, 0 to 1.
    pub coverage: f64,
}

/// How far to trust a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// Not to be used.
    Poor,
    /// Usable, with the reasons in mind.
    Usable,
    /// Good as it is.
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

    /// The grade of a figure that should be low: `Good` up to the first limit, `Usable` up to the
    /// second.
    pub(in crate::calibration) fn of_figure(value: f64, [good, usable]: [f64; 2]) -> Self {
        if value <= good {
            Self::Good
        } else if value <= usable {
            Self::Usable
        } else {
            Self::Poor
        }
    }
}

/// One reason of a verdict, with the best grade that it allows.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::calibration) struct Finding {
    /// The best grade that it allows; `Good` for mere information.
    pub(in crate::calibration) grade: Grade,
    /// One sentence that a person can act on.
    pub(in crate::calibration) reason: String,
}

impl Finding {
    /// `None` for a figure that is good.
    pub(in crate::calibration) fn worse_than_good(grade: Grade, reason: String) -> Option<Self> {
        (grade != Grade::Good).then_some(Self { grade, reason })
    }
}

/// A grade with its reasons, each one that a person can act on.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The grade.
    pub grade: Grade,
    /// Why it is no better; empty if there is nothing to mention.
    pub reasons: Vec<String>,
}

impl Verdict {
    /// The worst grade of `findings`, with their reasons in order: the worst first, those of one
    /// grade as they are given.
    pub(in crate::calibration) fn of(mut findings: Vec<Finding>) -> Self {
        findings.sort_by_key(|finding| finding.grade);
        Self {
            grade: findings.first().map_or(Grade::Good, |worst| worst.grade),
            reasons: findings.into_iter().map(|finding| finding.reason).collect(),
        }
    }

    /// Adds a reason for which the grade is no better than `grade`.
    pub fn lower(&mut self, grade: Grade, reason: String) {
        self.grade = self.grade.min(grade);
        self.reasons.push(reason);
    }
}
