//! The thresholds of chessboards: search, verification, tracking, reasons.

use crate::detection::thresholds::entry::{ThresholdOrigin, Visitor, thresholds};

thresholds! {
    /// Candidates for corners: maxima of the response, each measured twice
    /// (`search/candidates.rs`).
    CandidateThresholds {
        /// Tiles of the response (4×4 pixels) whose maximum is examined, per corner of the board.
        /// One square of the board among them is enough.
        tiles_a_corner: usize = 6, "tiles", ThresholdOrigin::Swept;
        /// Bounds of that number.
        fewest_tiles: usize = 320, "tiles", ThresholdOrigin::Swept;
        /// Bounds of that number: the time for any image is bounded by it.
        most_tiles: usize = 768, "tiles", ThresholdOrigin::Swept;
        /// Candidates that go on.
        most: usize = 600, "candidates", ThresholdOrigin::Swept;
        /// Weaker responses are noise even in an image of low contrast.
        least_response: u8 = 4, "gray levels", ThresholdOrigin::Derived("twice the noise of a dim sensor");
        /// Responses below the strongest divided by this are ignored.
        least_share: usize = 32, "1", ThresholdOrigin::Swept;
        /// Least correlation with a chessboard corner where the response is largest.
        least_first_score: f32 = 0.35, "correlation", ThresholdOrigin::Swept;
        /// The same after moving to where the edges cross.
        least_score: f32 = 0.45, "correlation", ThresholdOrigin::Swept;
        /// A candidate with this correlation, nearer to its response than `settled_px`, stays.
        clear_score: f32 = 0.6, "correlation", ThresholdOrigin::Swept;
        /// See `clear_score`.
        settled_px: f32 = 0.5, "px", ThresholdOrigin::Derived("half a pixel: the response's own grid");
        /// Least contrast of a candidate.
        least_contrast: f32 = 3.0, "gray levels", ThresholdOrigin::Swept;
        /// Farthest that a candidate may move from its response.
        most_moved_px: f32 = 2.5, "px", ThresholdOrigin::Swept;
        /// Least cosine, negated, between the two ends of an edge seen from the corner: straight is
        /// 1.
        least_straight: f32 = 0.6, "cosine", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// Four candidates that close a square (`search/seeds.rs`).
    SeedThresholds {
        /// Nearer candidates are the same corner.
        least_step_px: f32 = 3.5, "px", ThresholdOrigin::Derived("the ring of the response is 4 px wide");
        /// How far a neighbor may lie off the edge that leads to it.
        off_edge: f32 = 0.4, "tangent", ThresholdOrigin::Swept;
        /// How far the edges of neighbors may differ in direction.
        edge_angle: f32 = 0.5, "sine", ThresholdOrigin::Swept;
    }
}

/// A window's size, and the thresholds that a corner measured in it must pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowThresholds {
    /// Reach, as part of the distance to the neighbors.
    pub reach: f32,
    /// Largest reach, in pixels.
    pub most_px: f32,
    /// Least correlation with a chessboard corner.
    pub least_score: f32,
    /// Least contrast, as a share of the neighbors'.
    pub least_contrast: f32,
    /// Largest distance from the prediction, in steps.
    pub most_off: f32,
}

impl WindowThresholds {
    /// As large as squares allow.
    pub const WIDE: Self =
        Self { reach: 0.4, most_px: 16.0, least_score: 0.62, least_contrast: 0.3, most_off: 0.4 };
    /// Beside an occluder of the rest of the squares.
    pub const NARROW: Self =
        Self { reach: 0.16, most_px: 8.0, least_score: 0.72, least_contrast: 0.5, most_off: 0.15 };
    /// Very close beside an occluder.
    pub const CLOSE: Self =
        Self { reach: 0.08, most_px: 4.0, least_score: 0.75, least_contrast: 0.4, most_off: 0.1 };

    pub(super) fn visit(&mut self, names: [&'static str; 5], visit: &mut Visitor<'_>) {
        let [reach, most_px, score, contrast, off] = names;
        visit(reach, "steps", ThresholdOrigin::Swept, &mut self.reach);
        visit(most_px, "px", ThresholdOrigin::Swept, &mut self.most_px);
        visit(score, "correlation", ThresholdOrigin::Swept, &mut self.least_score);
        visit(
            contrast,
            "share of the neighbors'",
            ThresholdOrigin::Swept,
            &mut self.least_contrast,
        );
        visit(off, "steps", ThresholdOrigin::Swept, &mut self.most_off);
    }
}

/// The three windows in which a corner is measured, the widest first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Windows(pub [WindowThresholds; 3]);

impl Windows {
    /// The values in use.
    pub const DEFAULT: Self =
        Self([WindowThresholds::WIDE, WindowThresholds::NARROW, WindowThresholds::CLOSE]);

    /// The widest alone.
    pub fn wide(&self) -> &[WindowThresholds] {
        &self.0[..1]
    }

    /// For tracking from image to image: as far as its squares reach.
    pub fn tracked(&self) -> WindowThresholds {
        WindowThresholds { most_px: f32::MAX, ..self.0[0] }
    }

    pub(super) fn visit(&mut self, visit: &mut Visitor<'_>) {
        const NAMES: [[&str; 5]; 3] = [
            [
                "wide.reach",
                "wide.most_px",
                "wide.least_score",
                "wide.least_contrast",
                "wide.most_off",
            ],
            [
                "narrow.reach",
                "narrow.most_px",
                "narrow.least_score",
                "narrow.least_contrast",
                "narrow.most_off",
            ],
            [
                "close.reach",
                "close.most_px",
                "close.least_score",
                "close.least_contrast",
                "close.most_off",
            ],
        ];
        for (window, names) in self.0.iter_mut().zip(NAMES) {
            window.visit(names, visit);
        }
    }
}

thresholds! {
    /// One corner measured at its prediction (`measure/prediction.rs`).
    MeasureThresholds {
        /// Least alternation of the four squares.
        least_alternation: f32 = 0.3, "share of the contrast", ThresholdOrigin::Swept;
        /// Largest distance of a corner from its neighbors' prediction.
        most_off: f32 = 0.4, "steps", ThresholdOrigin::Derived("below one half: the next corner's is nearer");
        /// The same where no neighbor is known.
        most_off_far: f32 = 0.2, "steps", ThresholdOrigin::Swept;
        /// A position this far from another is measured separately.
        elsewhere: f32 = 0.15, "steps", ThresholdOrigin::Swept;
        /// The immediate surroundings of a corner.
        near_reach: f32 = 0.16, "steps", ThresholdOrigin::Swept;
        /// Least contrast in the immediate surroundings.
        least_near_contrast: f32 = 0.5, "share of the neighbors'", ThresholdOrigin::Swept;
        /// Least correlation with a chessboard corner there.
        least_near_score: f32 = 0.65, "correlation", ThresholdOrigin::Swept;
        /// Least correlation at a predicted position, before it is refined.
        least_first_score: f32 = 0.25, "correlation", ThresholdOrigin::Swept;
        /// Least increase of the correlation for another iteration.
        least_gain: f32 = 0.1, "correlation", ThresholdOrigin::Swept;
        /// Smallest reach of a window.
        least_reach_px: f32 = 2.0, "px", ThresholdOrigin::Derived("six samples each way need four pixels");
        /// Least correlation in a narrower window for its corner to be taken.
        least_narrow_score: f32 = 0.6, "correlation", ThresholdOrigin::Swept;
        /// Least contrast of a narrower window: with less, blur fills it.
        least_narrow_contrast: f32 = 0.6, "share of the widest's", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// Growing a grid to candidates that lie farther off than predicted (`search/stretch.rs`).
    StretchThresholds {
        /// Largest distance of a candidate to the side of its prediction.
        most_aside: f32 = 0.45, "steps", ThresholdOrigin::Swept;
        /// Nearer than predicted: less than a step that skips two occluded corners errs by.
        most_nearer: f32 = 0.45, "steps", ThresholdOrigin::Swept;
        /// Farther than predicted.
        most_farther: f32 = 0.75, "steps", ThresholdOrigin::Swept;
        /// Largest rotation of its edges.
        most_rotation: f32 = 0.5, "sine", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// The search over the levels (`search/`).
    SearchThresholds {
        /// Least corners of a partial board, in `least_line` lines each way: fewer occur by chance.
        least_part: usize = 12, "corners", ThresholdOrigin::Swept;
        /// See `least_part`.
        least_line: u32 = 3, "lines", ThresholdOrigin::Derived("two lines of corners fit any pair of edges");
        /// Grids verified per level.
        most_grids: usize = 2, "grids", ThresholdOrigin::Swept;
        /// Seeds tried per level.
        most_starts: usize = 16, "seeds", ThresholdOrigin::Swept;
        /// Smaller grids are clutter.
        least_grown: usize = 7, "corners", ThresholdOrigin::Swept;
        /// A grid is bridged across occluders again only if it has so many corners more than one
        /// that was rejected.
        worth_bridging: usize = 4, "corners", ThresholdOrigin::Swept;
        /// A candidate this near to a corner is that corner.
        same_px: f32 = 2.5, "px", ThresholdOrigin::Derived("below the least step of two corners, 3.5 px");
        /// Longest side of a square searched for on any but the coarsest level.
        most_step_px: f32 = 36.0, "px", ThresholdOrigin::Swept;
        /// First window in which corners are measured on their way to the image.
        first_reach: f32 = 0.2, "steps", ThresholdOrigin::Swept;
        /// The second one, in the image itself.
        second_reach: f32 = 0.1, "steps", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// The edge between two corners (`measure/edges.rs`).
    EdgeThresholds {
        /// How far from the edge its two sides are sampled.
        aside: f32 = 0.25, "steps", ThresholdOrigin::Derived("the middle of half a square");
        /// Least difference of the two sides.
        least_difference: f32 = 0.25, "share of the corners' contrast", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// A grid held against the image (`verify/consistency.rs`).
    ConsistencyThresholds {
        /// Least share of edges that hold.
        least_held: f32 = 0.75, "share", ThresholdOrigin::Swept;
        /// Largest distance of a corner from its neighbors' prediction.
        most_off: f32 = 0.22, "steps", ThresholdOrigin::Swept;
        /// Misplaced corners that an accepted grid may lose.
        most_misplaced: usize = 12, "corners", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// Visible ends of the board (`verify/ends.rs`).
    EndThresholds {
        /// Where the outermost squares are sampled, outward from the line of corners.
        within: f32 = 0.7, "steps", ThresholdOrigin::Swept;
        /// Where what lies beyond them is sampled.
        beyond: f32 = 1.3, "steps", ThresholdOrigin::Derived("as far outside the border as `within` is inside");
        /// Two squares alternate if they differ by this.
        alternate: f32 = 0.5, "share of the contrast", ThresholdOrigin::Swept;
        /// They are alike below this.
        alike: f32 = 0.3, "share of the contrast", ThresholdOrigin::Swept;
        /// Votes at which an end is possible. A pair of squares votes 2 where what lies beyond
        /// equals one of them, as a board's margin does, else 1.
        least_votes: u32 = 2, "votes", ThresholdOrigin::Swept;
        /// Votes at which an end is certain.
        sure_votes: u32 = 6, "votes", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// The refined corners, each by itself (`verify/corners.rs`).
    CornerThresholds {
        /// Least correlation of a corner that is reported without refinement.
        standing_score: f32 = 0.7, "correlation", ThresholdOrigin::Swept;
        /// Largest distance of such a corner from its neighbors' prediction.
        standing_off: f32 = 0.05, "steps", ThresholdOrigin::Swept;
        /// Least standard deviation of a corner with an occluder a few pixels away, whose edge may
        /// pull it.
        least_tight_std_px: f64 = 0.3, "px", ThresholdOrigin::Swept;
        /// Largest distance of a corner of a part from its neighbors' prediction.
        most_off: f32 = 0.12, "steps", ThresholdOrigin::Swept;
        /// The same next to an occluder.
        most_off_near_occluder: f32 = 0.08, "steps", ThresholdOrigin::Swept;
        /// Corners with a standard deviation above this multiple of the median are held to the
        /// bound next to an occluder.
        suspect_stds: f64 = 5.0, "medians", ThresholdOrigin::Swept;
        /// Least corners that predict those without a square of their own.
        least_anchored: usize = 8, "corners", ThresholdOrigin::Derived("a homography's parameters");
        /// Farthest that a corner may move when it is refined.
        most_moved: f64 = 0.25, "steps", ThresholdOrigin::Swept;
        /// Standard deviation of a corner that could not be refined.
        unrefined_std: f64 = 0.02, "steps", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// Tracking from image to image (`tracking/`).
    TrackingThresholds {
        /// A board with more than one in so many corners off its prediction is searched for.
        most_lost: usize = 4, "1", ThresholdOrigin::Swept;
        /// Search radius of a corner whose neighbors are not found yet.
        most_off_first: f32 = 0.3, "steps", ThresholdOrigin::Swept;
        /// Reach of the wide window: at least this, and the two below.
        predicted_px: f32 = 5.0, "px", ThresholdOrigin::Swept;
        /// How uncertain the neighbors' prediction is.
        predicted_reach: f32 = 0.06, "steps", ThresholdOrigin::Swept;
        /// The same after a wide, coarsely sampled window has found the corner.
        found_reach: f32 = 0.12, "steps", ThresholdOrigin::Swept;
        /// The wide window's reach under blur.
        predicted_blurs: f32 = 2.5, "blur widths", ThresholdOrigin::Swept;
        /// Windows narrow by this factor: each places the corner to within the next.
        narrower: f32 = 0.45, "1", ThresholdOrigin::Swept;
        /// Reach of the last, most exact window.
        exact_px: f32 = 2.5, "px", ThresholdOrigin::Swept;
        /// The same under blur.
        exact_blurs: f32 = 2.0, "blur widths", ThresholdOrigin::Swept;
        /// Largest reach of any window.
        most_reach: f32 = 0.4, "steps", ThresholdOrigin::Derived("below one half: the next corner's begins");
        /// Least correlation with a chessboard corner in the wide window.
        least_far_score: f32 = 0.6, "correlation", ThresholdOrigin::Swept;
        /// And in the exact one.
        least_exact_score: f32 = 0.7, "correlation", ThresholdOrigin::Swept;
        /// Least contrast: windows of other sizes, and light, change it by less.
        least_contrast: f32 = 0.3, "share of the last image's", ThresholdOrigin::Swept;
        /// A wide window is moved while the corner is farther from its center than this.
        far_aside: f32 = 0.4, "reaches", ThresholdOrigin::Swept;
        /// An exact one, likewise.
        exact_aside: f32 = 0.2, "reaches", ThresholdOrigin::Swept;
        /// Windows tried at one place.
        most_iterations: usize = 3, "windows", ThresholdOrigin::Swept;
        /// Steps longer than this make squares in which one pixel is as good as a mean of four.
        large_px: f32 = 16.0, "px", ThresholdOrigin::Derived("rounding then moves a sample by 3 % of a square");
        /// Least difference of an edge's two sides.
        least_difference: f32 = 0.25, "share of the edges' around it", ThresholdOrigin::Swept;
        /// Least share of edges that hold.
        least_held: f32 = 0.75, "share", ThresholdOrigin::Swept;
        /// Where the four squares about a position beyond the board are sampled.
        beyond: f32 = 0.3, "steps", ThresholdOrigin::Swept;
        /// Their least alternation for a closer measurement.
        may_alternate: f32 = 0.1, "share of the contrast", ThresholdOrigin::Swept;
        /// Least standard deviation of a corner that is not refined.
        least_std_px: f64 = 0.05, "px", ThresholdOrigin::Swept;
    }
}

thresholds! {
    /// The reason why there is no board (`reasons.rs`).
    ReasonThresholds {
        /// An image whose brightness varies by less is empty.
        least_range: u8 = 8, "gray levels", ThresholdOrigin::Swept;
        /// Least corners of a grid that is reported.
        least_grid: usize = 6, "corners", ThresholdOrigin::Swept;
        /// Blur wider than this hides the corners of a square.
        most_blur: f32 = 0.25, "steps", ThresholdOrigin::Derived("a Gaussian's ±2σ then fills the square");
    }
}
