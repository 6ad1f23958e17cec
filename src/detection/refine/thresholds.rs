//! Every bound of a corner's fit, with its unit and its origin.
//!
//! *Derived* ones follow from what is said. *Chosen* ones were set where the golden figures of
//! detection (recall, wrong corners, error against predicted error) are flat; unlike those of
//! `detection/thresholds.rs` they are not swept one by one, since a fit has no recall of its own.
//! The constants of the statistics of whole boards stand beside their formulas in `misfit`,
//! `scatter`, `straightness` and `noise`.

/// Half width of the first fit's window, in samples. Chosen.
pub(super) const FIRST_REACH: f64 = 5.0;
/// Largest half width of a window, in samples: more pixels cost more time than they gain. Chosen.
pub(super) const SECOND_REACH: f64 = 11.5;
/// Least share of a window's samples inside the image. Derived: with less than half, the corner
/// itself is outside.
pub(super) const LEAST_INSIDE: f64 = 0.5;
/// Fewer samples than this do not determine a corner's nine unknowns. Chosen: three for each.
pub(super) const FEWEST_SAMPLES: usize = 30;

/// A first fit is repeated in a larger window if the blur is this many times what the window was
/// made for. Chosen.
pub(super) const WIDER: f64 = 1.4;
/// A first fit is recentered if the corner is this many samples from the window's center. Chosen.
pub(super) const RECENTER: f64 = 2.0;
/// Most windows of a first fit. Chosen: it bounds the time.
pub(super) const MOST_WINDOWS: usize = 5;
/// Least blur that a first window is made for, in pixels. Chosen.
pub(super) const LEAST_START_BLUR_PX: f64 = 0.7;
/// Least amplitude to start from, in gray levels. Derived: half a level is rounding.
pub(super) const LEAST_START_AMPLITUDE: f64 = 0.5;
/// Largest amplitude of the corner before, in units of the quadrants' own. Chosen.
pub(super) const MOST_START_CONTRAST: f64 = 2.0;
/// Largest offset of the corner before, in units of the quadrants' amplitude. Chosen.
pub(super) const MOST_START_OFFSET: f64 = 0.3;
/// Tolerance of a residual in the first fit, where the noise is unknown: this part of the
/// amplitude, plus `FIRST_TOLERANCE_LEVELS`. Chosen.
pub(super) const FIRST_TOLERANCE_AMPLITUDE: f64 = 0.3;
/// In gray levels. Chosen: three standard deviations of a dim sensor's noise.
pub(super) const FIRST_TOLERANCE_LEVELS: f64 = 6.0;
/// The first fit ends with a step below this, in standard deviations of the blur. Derived:
/// convergence is quadratic, so the remaining error is about its square.
pub(super) const FIRST_ENOUGH: f64 = 0.07;
/// A first step that changes no other unknown by more than this, as a share of it or in radians,
/// may be the only one. Chosen.
pub(super) const FIRST_ALIKE: f64 = 0.25;

/// Tolerance of a residual in the second fit, in standard deviations of the noise. Chosen.
pub(super) const SECOND_TOLERANCE_STDS: f64 = 4.0;
/// Added to it, as a part of the amplitude: what the model does not explain. Chosen.
pub(super) const SECOND_TOLERANCE_AMPLITUDE: f64 = 0.08;
/// The second fit ends with a step below this, likewise.
pub(super) const SECOND_ENOUGH: f64 = 0.05;
/// Inlier ratio of an unoccluded corner: below, the fit is repeated with more tolerance. Chosen.
pub(super) const MOST_AGREE: f64 = 0.7;
/// That tolerance, as a part of the amplitude. Chosen.
pub(super) const PATIENT_TOLERANCE: f64 = 0.3;
/// Corners with this many times the median mean square after the first fit are under light of
/// their own, or beside an occluder. Chosen.
pub(super) const SHADED: f64 = 1.6;
/// Added to the tolerance while light is removed, as shares of the amplitude. Chosen: each about
/// half the one before.
pub(super) const SHADED_TOLERANCES: [f64; 4] = [0.5, 0.3, 0.15, 0.05];

/// A first fit has converged with at least this inlier ratio and a last step, in samples, below
/// `MOST_SETTLED_STEP`. Chosen.
pub(super) const LEAST_SETTLED_INLIERS: f64 = 0.4;
/// See `LEAST_SETTLED_INLIERS`.
pub(super) const MOST_SETTLED_STEP: f64 = 0.3;
/// Farthest that a corner may move from its prediction, in cells. Derived: at half a cell another
/// corner is as near.
pub(super) const MOST_MOVED_CELLS: f64 = 0.4;
/// Movements that are always allowed within that, in pixels. Chosen: the search's own error.
pub(super) const ALWAYS_MOVED_PX: f64 = 3.0;
/// The same in cells, for large boards. Chosen.
pub(super) const ALWAYS_MOVED_CELLS: f64 = 0.08;
/// Least amplitude of a corner, in gray levels. Derived: the rounding of black and white.
pub(super) const LEAST_AMPLITUDE: f64 = 1.0;
/// Largest cosine between the two edges, in absolute value: at 10 degrees they are nearly one line.
/// Chosen.
pub(super) const MOST_CORRELATION: f64 = 0.985;
/// Least inlier ratio of an accepted corner. Chosen: true corners keep a margin under motion blur
/// of several pixels and heavy noise.
pub(super) const LEAST_INLIERS: f64 = 0.42;
/// Largest last step of an accepted corner, in samples. Chosen.
pub(super) const MOST_STEP: f64 = 0.25;
/// Largest rms residual of an accepted corner, as a part of its amplitude. Chosen.
pub(super) const MOST_RESIDUAL: f64 = 0.6;
/// Least variance of the blur, in pixels squared: a sharper edge is only a pixel's own width.
/// Chosen.
pub(super) const LEAST_BLUR_VARIANCE: f64 = 0.01;

/// Corners from which on every other one's edge halves are enough for the scatter. Chosen: 20
/// corners have 80 halves.
pub(super) const ENOUGH_CORNERS: usize = 40;
/// Motion blur is distinguished from round blur above this width, in pixels. Chosen.
pub(super) const LEAST_MOTION_PX: f64 = 1.2;
/// Corners at which kinds of blur are compared. Chosen.
pub(super) const COMPARED_CORNERS: usize = 6;
/// Fits with other print removed before the last one: each improves black, white and blur. Chosen.
pub(super) const PRINT_ROUNDS: usize = 2;
