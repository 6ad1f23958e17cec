//! Every threshold of detection, with its unit and its origin.
//!
//! | file | of what |
//! | --- | --- |
//! | `chessboard` | the search, verification and tracking of a chessboard |
//! | `refinement` | the fit of one corner |
//! | `markers` | boards with markers: lattice, labels, what is reported |
//! | `entry` | a threshold's value, unit and origin |
//!
//! They are one value, [`Thresholds`], that goes through the pipeline beside the image. The
//! sensitivity bench (`benches/thresholds.rs`) changes one at a time by a fifth and counts what
//! that costs in recall, in wrong boards and in accuracy; `docs/detection/thresholds.md` is its
//! table.

pub mod chessboard;
mod entry;
pub mod markers;
pub mod refinement;

pub use crate::detection::thresholds::entry::{ThresholdEntry, ThresholdOrigin};

use crate::detection::thresholds::chessboard::{
    CandidateThresholds, ConsistencyThresholds, CornerThresholds, EdgeThresholds, EndThresholds,
    MeasureThresholds, ReasonThresholds, SearchThresholds, SeedThresholds, StretchThresholds,
    TrackingThresholds, Windows,
};
use crate::detection::thresholds::entry::Scale;
use crate::detection::thresholds::markers::{
    LabelThresholds, LatticeThresholds, MarkerCornerThresholds, MarkerTrackingThresholds,
};
use crate::detection::thresholds::refinement::RefinementThresholds;

/// All thresholds of detection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thresholds {
    /// Candidates for corners.
    pub candidates: CandidateThresholds,
    /// Squares of four candidates.
    pub seeds: SeedThresholds,
    /// The windows in which a corner is measured.
    pub windows: Windows,
    /// One corner at its prediction.
    pub measure: MeasureThresholds,
    /// Candidates farther off than predicted.
    pub stretch: StretchThresholds,
    /// The search over the levels.
    pub search: SearchThresholds,
    /// Edges between corners.
    pub edges: EdgeThresholds,
    /// A grid held against the image.
    pub consistency: ConsistencyThresholds,
    /// Visible ends of the board.
    pub ends: EndThresholds,
    /// Refined corners.
    pub corners: CornerThresholds,
    /// From image to image.
    pub tracking: TrackingThresholds,
    /// Why there is no board.
    pub reasons: ReasonThresholds,
    /// The fit of one corner.
    pub refinement: RefinementThresholds,
    /// The lattice of a board with markers.
    pub lattice: LatticeThresholds,
    /// Where in the board a lattice lies.
    pub labels: LabelThresholds,
    /// The corners of a board with markers that are reported.
    pub marker_corners: MarkerCornerThresholds,
    /// The same from image to image.
    pub marker_tracking: MarkerTrackingThresholds,
}

impl Default for Thresholds {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Thresholds {
    /// The values in use.
    pub const DEFAULT: Self = Self {
        candidates: CandidateThresholds::DEFAULT,
        seeds: SeedThresholds::DEFAULT,
        windows: Windows::DEFAULT,
        measure: MeasureThresholds::DEFAULT,
        stretch: StretchThresholds::DEFAULT,
        search: SearchThresholds::DEFAULT,
        edges: EdgeThresholds::DEFAULT,
        consistency: ConsistencyThresholds::DEFAULT,
        ends: EndThresholds::DEFAULT,
        corners: CornerThresholds::DEFAULT,
        tracking: TrackingThresholds::DEFAULT,
        reasons: ReasonThresholds::DEFAULT,
        refinement: RefinementThresholds::DEFAULT,
        lattice: LatticeThresholds::DEFAULT,
        labels: LabelThresholds::DEFAULT,
        marker_corners: MarkerCornerThresholds::DEFAULT,
        marker_tracking: MarkerTrackingThresholds::DEFAULT,
    };

    /// Every threshold, in the order of the stages.
    pub fn entries() -> Vec<ThresholdEntry> {
        let mut entries = Vec::new();
        let mut thresholds = Self::DEFAULT;
        thresholds.visit(&mut |name, unit, origin, number| {
            entries.push(ThresholdEntry { name, value: number.value(), unit, origin });
        });
        entries
    }

    /// These thresholds with the one called `name` multiplied by `factor` (a count changes by one
    /// at least); `None` if no threshold has that name.
    pub fn scaled(mut self, name: &str, factor: f64) -> Option<Self> {
        let mut found = false;
        self.visit(&mut |visited, _, _, number| {
            if visited == name {
                number.scale(factor);
                found = true;
            }
        });
        found.then_some(self)
    }

    fn visit(
        &mut self,
        visit: &mut dyn FnMut(String, &'static str, ThresholdOrigin, &mut dyn Scale),
    ) {
        macro_rules! stages {
            ($($stage:ident),*) => {$(
                self.$stage.visit(&mut |field, unit, origin, number| {
                    visit(format!("{}.{field}", stringify!($stage)), unit, origin, number);
                });
            )*};
        }
        stages!(
            candidates,
            seeds,
            windows,
            measure,
            stretch,
            search,
            edges,
            consistency,
            ends,
            corners,
            tracking,
            reasons,
            refinement,
            lattice,
            labels,
            marker_corners,
            marker_tracking
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_threshold_has_one_name_and_can_be_scaled() {
        let entries = Thresholds::entries();
        assert!(entries.len() > 180, "{}", entries.len());
        for entry in &entries {
            let same = entries.iter().filter(|other| other.name == entry.name).count();
            assert_eq!(same, 1, "{}", entry.name);
            for factor in [0.8, 1.25] {
                let scaled = Thresholds::DEFAULT.scaled(&entry.name, factor).expect("its name");
                assert_ne!(scaled, Thresholds::DEFAULT, "{} by {factor}", entry.name);
            }
        }
        assert_eq!(Thresholds::DEFAULT.scaled("candidates.nothing", 2.0), None);
    }
}
