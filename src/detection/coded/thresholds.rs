//! Every bound of the search for boards with markers, with its unit and its origin.
//!
//! *Derived* ones follow from what is said. *Chosen* ones were set on rendered boards and photographs
//! where recall and wrong labels are flat; they are not swept one by one as those of chessboards
//! are (`detection/thresholds.rs`).

// The search (`detector`).

/// Fewer crossings are no lattice. Chosen.
pub(super) const LEAST_LATTICE: usize = 6;

/// Fewer corners are not reported. Derived: a homography takes four.
pub(super) const LEAST_CORNERS: usize = 4;

/// Cells from which a lattice is grown, on one pyramid level. Chosen: it bounds the time.
pub(super) const MOST_STARTS: usize = 48;

/// Lattices whose markers are read, on one level. Chosen: it bounds the time.
pub(super) const MOST_READ: usize = 6;

/// A candidate this near to a crossing is that crossing, in pixels of the level. Chosen.
pub(super) const SAME_CROSSING_PX: f32 = 2.5;

/// Largest tangent of the angle between an edge and the line to the crossing that it leads to.
/// Chosen: crossings inside markers have more.
pub(super) const MOST_OFF_EDGE: f32 = 0.16;

/// Images whose longer side is more are searched at half their size first, in pixels. Chosen.
pub(super) const LARGE_SIDE_PX: usize = 1500;

/// Least shorter side of an image with a target, in pixels. Chosen.
pub(super) const LEAST_SIDE_PX: usize = 24;

// The order of candidates (`order`).

/// Distances from a crossing at which its squares are sampled, along their diagonals in pixels.
/// Chosen: each about 4/3 of the one before.
pub(super) const SQUARE_DISTANCES_PX: [f32; 8] = [4.0, 5.5, 7.5, 10.0, 13.5, 18.0, 24.0, 32.0];

// Growing a lattice (`lattice`).

/// Least correlation with a crossing. Chosen.
pub(super) const LEAST_CROSSING_SCORE: f32 = 0.55;

/// The same at a place of a labelled board. Chosen.
pub(super) const LEAST_KNOWN_SCORE: f32 = 0.5;

/// Least contrast, as a share of the nearest crossings'. Chosen.
pub(super) const LEAST_CONTRAST: f32 = 0.35;

/// The same at a place of a labelled board, which may lie in a highlight. Chosen.
pub(super) const LEAST_KNOWN_CONTRAST: f32 = 0.2;

/// Least alternation of the four squares, as a share of the contrast. Chosen.
pub(super) const LEAST_ALTERNATION: f32 = 0.25;

/// Largest distance of a crossing from its prediction by its neighbors while the lattice grows, in
/// units of the narrower interval. Chosen.
pub(super) const MOST_GROWN_MISPLACEMENT: f32 = 0.3;

/// Half width of a window, as a part of the undisturbed room around a crossing. Chosen.
pub(super) const REACH: f32 = 0.85;

/// Its lower bound, in pixels. Chosen.
pub(super) const LEAST_REACH_PX: f32 = 2.5;

/// Its upper bound, in pixels. Chosen.
pub(super) const MOST_REACH_PX: f32 = 9.0;

/// Its upper bound beside an occluder, in pixels. Chosen.
pub(super) const CLOSE_REACH_PX: f32 = 4.5;

/// Crossings that are searched for before a wrong start is given up. Chosen.
pub(super) const TRIAL_CROSSINGS: usize = 7;

// Local homographies (`chart`).

/// Radii around a place within which crossings are gathered for a local homography, in grid lines,
/// tried in this order. Chosen.
pub(super) const CHART_REACHES: [i32; 3] = [2, 4, 9];

/// Crossings at which gathering stops. Derived: twice the four that a homography takes.
pub(super) const CHART_CROSSINGS: usize = 8;

/// Weight of the assumption that there is no perspective, relative to one crossing.
/// Chosen: a few crossings with a noise of 2 % of their spread weigh less.
pub(super) const CHART_FLATNESS: f64 = 0.004;

// Reading markers (`reading`).

/// Least difference between a payload's black and white, as a part of the crossings' contrast.
/// Chosen.
pub(super) const LEAST_PAYLOAD_CONTRAST: f32 = 0.12;

// Labelling (`labels`).

/// Least sum of agreements of a labelling, in standard deviations of chance. Chosen: 10⁻¹¹ of a
/// normal distribution lies beyond.
pub(super) const LEAST_SIGNIFICANCE: f32 = 6.7;

/// The same of cells that all agree by [`CLEAR_AGREEMENT`] or more. Chosen.
pub(super) const LEAST_CLEAR_SIGNIFICANCE: f32 = 4.6;

/// An agreement that chance does not reach. Chosen.
pub(super) const CLEAR_AGREEMENT: f32 = 0.88;

/// How many times larger the sum must be than that of any other place. Chosen.
pub(super) const LABEL_MARGIN: f32 = 1.5;

/// Cells that agree less than this, while another code agrees by [`CLEAR_AGREEMENT`], contradict.
/// Derived: half of the bits are chance.
pub(super) const CONTRADICTING_AGREEMENT: f32 = 0.5;

/// Largest share of contradicting cells among those that agree. Chosen.
pub(super) const MOST_CONTRADICTIONS: f32 = 0.1;

/// Least weight of a cell that is counted as read. Chosen.
pub(super) const LEAST_READ_WEIGHT: f32 = 0.8;

/// Lines of a lattice that may lie beyond the board: its surroundings have crossings too. Chosen.
pub(super) const MOST_BEYOND: i32 = 2;

/// Least share of the crossings that lie on the board. Chosen.
pub(super) const LEAST_ON_BOARD: f32 = 0.85;

// Where the board ends (`ends`).

/// Where an outer square is sampled inside the board, in squares from the outermost line of
/// corners. Chosen: short of the print's edge by the blur.
pub(super) const END_WITHIN: f32 = 0.93;

/// The same outside the board. Chosen.
pub(super) const END_BEYOND: f32 = 1.12;

/// Distance from a corner at which its four squares are sampled, in squares. Chosen: inside the
/// border of a marker.
pub(super) const END_BESIDE: f32 = 0.06;

/// Squares of a side that must show that the board ends there. Chosen.
pub(super) const LEAST_END_SQUARES: usize = 3;

// Verification (`finish`).

/// Largest distance of a crossing from its prediction by its neighbors before refinement, in units
/// of the narrower interval. Chosen.
pub(super) const MOST_MISPLACEMENT: f32 = 0.25;

/// The same after refinement. Chosen.
pub(super) const MOST_REFINED_MISPLACEMENT: f32 = 0.12;

/// The part of both that a suspect crossing may have. Chosen.
pub(super) const SUSPECT_SHARE: f32 = 0.4;

/// A crossing is suspect if refinement refused it, or with this many times the median standard
/// deviation, as at the edge of a highlight or an occluder. Chosen; as `suspect_stds` of
/// chessboards.
pub(super) const SUSPECT_STDS: f64 = 5.0;

/// A lattice with a larger share of misplaced crossings is none. Chosen.
pub(super) const MOST_MISPLACED_SHARE: f32 = 0.2;

/// Farthest that refinement may move a crossing, in units of the narrower interval. Chosen.
pub(super) const MOST_MOVED: f64 = 0.25;

/// Least correlation of a crossing that is reported without refinement. Chosen.
pub(super) const STANDING_SCORE: f32 = 0.65;

/// Its standard deviation, in pixels. Derived: the crossing is known to its pixel.
pub(super) const STANDING_STD_PX: f64 = 0.5;
