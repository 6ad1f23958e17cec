//! The thresholds of boards with markers.

use crate::detection::thresholds::entry::{ThresholdOrigin, thresholds};

thresholds! {
    /// Lattices of crossings (`coded/detector.rs`, `coded/lattice.rs`). An interval is the distance
    /// between two lines, the narrower one where two alternate.
    LatticeThresholds {
        /// Fewer crossings are no lattice.
        least_crossings: usize = 6, "crossings", ThresholdOrigin::Swept;
        /// The same of squares that fill the image.
        fewest_crossings: usize = 4, "crossings", ThresholdOrigin::Derived("a homography takes four");
        /// Cells from which a lattice is grown, on one pyramid level: it bounds the time.
        most_starts: usize = 48, "cells", ThresholdOrigin::Swept;
        /// Lattices whose markers are read, on one level: it bounds the time.
        most_read: usize = 6, "lattices", ThresholdOrigin::Swept;
        /// A candidate this near to a crossing is that crossing.
        same_px: f32 = 2.5, "px", ThresholdOrigin::Derived("below the least step of two corners, 3.5 px");
        /// How far a neighbor may lie off the edge that leads to it: crossings inside markers lie
        /// farther.
        off_edge: f32 = 0.16, "tangent", ThresholdOrigin::Swept;
        /// Images with a longer side are searched at half their size first.
        large_side_px: usize = 1500, "px", ThresholdOrigin::Swept;
        /// Largest square that is searched for in twice the image.
        small_square_px: f32 = 128.0, "px of twice the image", ThresholdOrigin::Derived("gaps of larger squares are 8 px wide and show in the image");
        /// Least shorter side of an image with a target.
        least_side_px: usize = 24, "px", ThresholdOrigin::Derived("six crossings of 3.5 px each way");
        /// Least correlation with a crossing.
        least_score: f32 = 0.55, "correlation", ThresholdOrigin::Swept;
        /// The same at a place of a labeled board.
        least_known_score: f32 = 0.5, "correlation", ThresholdOrigin::Swept;
        /// Least correlation at a predicted position, before it is moved.
        least_first_score: f32 = 0.3, "correlation", ThresholdOrigin::Swept;
        /// Least contrast.
        least_contrast: f32 = 0.35, "share of the neighbors'", ThresholdOrigin::Swept;
        /// The same at a place of a labeled board, which may lie in a highlight.
        least_known_contrast: f32 = 0.2, "share of the neighbors'", ThresholdOrigin::Swept;
        /// Least alternation of the four squares.
        least_alternation: f32 = 0.25, "share of the contrast", ThresholdOrigin::Swept;
        /// Largest rotation of a candidate's edges against the lattice.
        most_rotation: f32 = 0.5, "sine", ThresholdOrigin::Swept;
        /// Largest distance of a crossing from its neighbors' prediction while the lattice grows.
        most_off: f32 = 0.3, "intervals", ThresholdOrigin::Derived("below one half: the next crossing is nearer");
        /// Half width of a window.
        reach: f32 = 0.85, "share of the undisturbed room", ThresholdOrigin::Swept;
        /// Its lower bound.
        least_reach_px: f32 = 2.5, "px", ThresholdOrigin::Swept;
        /// Its upper bound.
        most_reach_px: f32 = 9.0, "px", ThresholdOrigin::Swept;
        /// Its upper bound beside an occluder.
        close_reach_px: f32 = 4.5, "px", ThresholdOrigin::Swept;
        /// Crossings that are searched for before a wrong start is given up.
        trial_crossings: usize = 7, "crossings", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// Where in the board a lattice lies (`coded/reading.rs`, `coded/labels.rs`, `coded/ends.rs`).
    LabelThresholds {
        /// Difference between a payload's black and white from which on it counts in full.
        least_payload_contrast: f32 = 0.12, "share of the crossings' contrast", ThresholdOrigin::Swept;
        /// Least sum of agreements of a labeling.
        least_significance: f32 = 6.7, "standard deviations of chance", ThresholdOrigin::Derived("10⁻¹¹ of a normal distribution lies beyond");
        /// The same of cells that all agree by `clear_agreement` or more.
        least_clear_significance: f32 = 4.6, "standard deviations of chance", ThresholdOrigin::Swept;
        /// An agreement that chance does not reach.
        clear_agreement: f32 = 0.88, "correlation", ThresholdOrigin::Swept;
        /// By how much the sum must exceed that of any other place.
        margin: f32 = 1.5, "standard deviations of chance", ThresholdOrigin::Swept;
        /// Cells that agree less than this, while another code agrees by `clear_agreement`,
        /// contradict.
        contradicting_agreement: f32 = 0.5, "correlation", ThresholdOrigin::Derived("half of the bits are chance");
        /// Largest share of contradicting cells among those that agree.
        most_contradictions: f32 = 0.1, "share", ThresholdOrigin::Swept;
        /// Least weight of a cell that is counted as read.
        least_read_weight: f32 = 0.8, "1", ThresholdOrigin::Swept;
        /// Agreement of a cell whose place in the board has no marker, negated.
        no_marker_penalty: f32 = 0.2, "correlation", ThresholdOrigin::Swept;
        /// Lines of a lattice that may lie beyond the board: its surroundings have crossings too.
        most_beyond: i32 = 2, "lines", ThresholdOrigin::Swept;
        /// Least share of the crossings that lie on the board.
        least_on_board: f32 = 0.85, "share", ThresholdOrigin::Swept;
        /// Where an outer square is sampled inside the board, outward from the line of corners.
        end_within: f32 = 0.93, "squares", ThresholdOrigin::Derived("short of the print's edge by the blur");
        /// The same outside the board.
        end_beyond: f32 = 1.12, "squares", ThresholdOrigin::Swept;
        /// Distance from a corner at which its four squares are sampled.
        end_beside: f32 = 0.06, "squares", ThresholdOrigin::Derived("inside the border of a marker");
        /// Least difference of those four.
        least_end_contrast: f32 = 0.4, "share of the contrast", ThresholdOrigin::Swept;
        /// Squares of a side that must show that the board ends there.
        least_end_squares: usize = 3, "squares", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// The corners that are reported (`coded/finish.rs`).
    MarkerCornerThresholds {
        /// Fewer corners are not reported.
        least_corners: usize = 4, "corners", ThresholdOrigin::Derived("a homography takes four");
        /// Farthest that a crossing moves from one pyramid level to the next finer one.
        most_sharpened: f32 = 0.15, "intervals", ThresholdOrigin::Swept;
        /// Largest distance of a crossing from its neighbors' prediction before refinement.
        most_off: f32 = 0.25, "intervals", ThresholdOrigin::Swept;
        /// The same after refinement.
        most_refined_off: f32 = 0.12, "intervals", ThresholdOrigin::Swept;
        /// The part of both that a suspect crossing may have.
        suspect_share: f32 = 0.4, "share", ThresholdOrigin::Swept;
        /// A crossing is suspect if it was not refined, or with this many times the median standard
        /// deviation, as at the edge of a highlight or an occluder.
        suspect_stds: f64 = 5.0, "medians", ThresholdOrigin::Swept;
        /// A lattice with a larger share of misplaced crossings is none.
        most_misplaced: f32 = 0.2, "share", ThresholdOrigin::Swept;
        /// Farthest that refinement may move a crossing.
        most_moved: f64 = 0.25, "intervals", ThresholdOrigin::Swept;
        /// Least correlation of a crossing that is reported without refinement.
        standing_score: f32 = 0.65, "correlation", ThresholdOrigin::Swept;
        /// Its standard deviation.
        standing_std_px: f64 = 0.5, "px", ThresholdOrigin::Derived("the crossing is known to its pixel");
        /// Farthest that it may lie from where its neighbors put it.
        most_standing_off: f64 = 3.0, "standard deviations", ThresholdOrigin::Derived("chance, three times in a thousand");
    }
}

thresholds! {
    /// From image to image (`coded/tracking.rs`, `coded/offset_search.rs`).
    MarkerTrackingThresholds {
        /// Farthest that a corner is searched for from where its motion predicts it.
        reach: f32 = 0.025, "share of the longer side", ThresholdOrigin::Swept;
        /// Largest rotation of a crossing's edges since the last image.
        most_rotation: f32 = 0.3, "sine", ThresholdOrigin::Swept;
        /// How far one of two corners may have moved from where the other one's motion puts it.
        alike: f32 = 0.25, "intervals", ThresholdOrigin::Derived("half of what separates a crossing from the next");
        /// The same for each pixel between them: the board rotates and comes nearer.
        slope: f32 = 0.03, "px", ThresholdOrigin::Swept;
        /// Least share of the corners that are searched for that moved alike.
        least_alike: f32 = 0.6, "share", ThresholdOrigin::Swept;
        /// Corners that are refined, to estimate the blur and the error of the others.
        refined: usize = 8, "corners", ThresholdOrigin::Swept;
        /// Least standard deviation of corners that are not.
        least_std_px: f64 = 0.02, "px", ThresholdOrigin::Swept;
        /// Least share of the last image's corners that are found again.
        least_kept: f32 = 0.5, "share", ThresholdOrigin::Swept;
    }
}
