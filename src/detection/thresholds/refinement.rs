//! The thresholds of a corner's fit.
//!
//! The constants of the statistics of whole boards stand beside their formulas in `refine/`:
//! `misfit`, `scatter`, `straightness`, `edge_curvature` and `noise`.

use crate::detection::thresholds::entry::{ThresholdOrigin, thresholds};

thresholds! {
    /// Two fits of each corner, and whether it is one (`refine/`). A sample is a pixel, or the mean
    /// of the pixels of a coarser window.
    RefinementThresholds {
        /// Half width of the first fit's window.
        first_reach: f64 = 5.0, "samples", ThresholdOrigin::Swept;
        /// Largest half width of a window: more pixels cost more time than they gain.
        second_reach: f64 = 11.5, "samples", ThresholdOrigin::Swept;
        /// Least share of a window's samples inside the image.
        least_inside: f64 = 0.5, "share", ThresholdOrigin::Derived("with less than half, the corner is outside");
        /// Fewer samples do not determine a corner's nine unknowns.
        fewest_samples: usize = 30, "samples", ThresholdOrigin::Derived("three for each unknown");
        /// A first fit is repeated in a larger window if the blur is this many times what the
        /// window was made for.
        wider: f64 = 1.4, "1", ThresholdOrigin::Swept;
        /// A first fit is repeated if the corner is this far from the window's center.
        recenter: f64 = 2.0, "samples", ThresholdOrigin::Swept;
        /// Most windows of a first fit: it bounds the time.
        most_windows: usize = 5, "windows", ThresholdOrigin::Swept;
        /// Least blur that a first window is made for.
        least_start_blur_px: f64 = 0.7, "px", ThresholdOrigin::Swept;
        /// Least amplitude to start from.
        least_start_amplitude: f64 = 0.5, "gray levels", ThresholdOrigin::Derived("half a level is rounding");
        /// Largest amplitude taken over from the corner before.
        most_start_contrast: f64 = 2.0, "quadrant amplitudes", ThresholdOrigin::Swept;
        /// Largest offset taken over from the corner before.
        most_start_offset: f64 = 0.3, "quadrant amplitudes", ThresholdOrigin::Swept;
        /// Tolerance of a residual in the first fit, where the noise is unknown, plus
        /// `first_tolerance_levels`.
        first_tolerance: f64 = 0.3, "amplitudes", ThresholdOrigin::Swept;
        /// See `first_tolerance`.
        first_tolerance_levels: f64 = 6.0, "gray levels", ThresholdOrigin::Derived("three standard deviations of a dim sensor's noise");
        /// The first fit ends with a step below this.
        first_enough: f64 = 0.07, "blur widths", ThresholdOrigin::Derived("convergence is quadratic: the error left is its square");
        /// A first step that changes no other unknown by more than this may be the only one.
        first_alike: f64 = 0.25, "share or radians", ThresholdOrigin::Swept;
        /// Tolerance of a residual in the second fit, plus `second_tolerance`.
        second_tolerance_stds: f64 = 4.0, "noise standard deviations", ThresholdOrigin::Swept;
        /// What the model does not explain.
        second_tolerance: f64 = 0.08, "amplitudes", ThresholdOrigin::Swept;
        /// The second fit ends with a step below this.
        second_enough: f64 = 0.05, "blur widths", ThresholdOrigin::Derived("as `first_enough`");
        /// Inlier ratio of an unoccluded corner: below, the fit is repeated with more tolerance.
        clear_inliers: f64 = 0.7, "share", ThresholdOrigin::Swept;
        /// That tolerance.
        patient_tolerance: f64 = 0.3, "amplitudes", ThresholdOrigin::Swept;
        /// Corners with this many times the median mean square after the first fit are under light
        /// of their own, or beside an occluder.
        shaded: f64 = 1.6, "medians", ThresholdOrigin::Swept;
        /// Added to the tolerance while light is removed, fit by fit.
        shaded_tolerances: [f64; 4] = [0.5, 0.3, 0.15, 0.05], "amplitudes (the first of four)", ThresholdOrigin::Swept;
        /// Corners with this many times the mean square of the closest quarter are tried with light
        /// of their own, in light, not in gray values (1.2 to 2 swept).
        may_be_lit: f64 = 1.6, "mean squares", ThresholdOrigin::Swept;
        /// And have it where that leaves less than this part.
        lit_alone: f64 = 0.5, "share", ThresholdOrigin::Derived("it explains more than it leaves");
        /// A highlight is seen where this many corners have light of their own: of photographs
        /// without one, up to two have.
        fewest_lit: usize = 3, "corners", ThresholdOrigin::Derived("they span an area");
        /// In a highlight, every corner has light of its own where that leaves less than this
        /// part (0.7 to 0.9 swept).
        lit_in_highlight: f64 = 0.8, "share", ThresholdOrigin::Swept;
        /// A first fit has converged with at least this inlier ratio.
        least_settled_inliers: f64 = 0.4, "share", ThresholdOrigin::Swept;
        /// And a last step below this.
        most_settled_step: f64 = 0.3, "samples", ThresholdOrigin::Swept;
        /// Farthest that a corner may move from its prediction.
        most_moved: f64 = 0.4, "cells", ThresholdOrigin::Derived("at half a cell another corner is as near");
        /// Movements that are always allowed within that: the search's own error.
        always_moved_px: f64 = 3.0, "px", ThresholdOrigin::Swept;
        /// The same of large boards.
        always_moved: f64 = 0.08, "cells", ThresholdOrigin::Swept;
        /// Least amplitude of a corner.
        least_amplitude: f64 = 1.0, "gray levels", ThresholdOrigin::Derived("the rounding of black and white");
        /// Largest cosine between the two edges.
        most_correlation: f64 = 0.985, "cosine", ThresholdOrigin::Derived("at 10 degrees they are nearly one line");
        /// Least inlier ratio of an accepted corner: true corners keep a margin under motion blur
        /// of several pixels and heavy noise.
        least_inliers: f64 = 0.42, "share", ThresholdOrigin::Swept;
        /// Largest last step of an accepted corner.
        most_step: f64 = 0.25, "samples", ThresholdOrigin::Swept;
        /// Largest rms residual of an accepted corner.
        most_residual: f64 = 0.6, "amplitudes", ThresholdOrigin::Swept;
        /// Motion blur is distinguished from round blur above this width.
        least_motion_px: f64 = 1.2, "px", ThresholdOrigin::Swept;
        /// Corners at which kinds of blur are compared.
        compared_corners: usize = 6, "corners", ThresholdOrigin::Swept;
        /// Fits with other print removed before the last one: each improves black, white and blur.
        print_rounds: usize = 2, "fits", ThresholdOrigin::Swept;
        /// Most alignments of all corners with the print: in each it is where the one before put
        /// them. They end where corners rest.
        aligned_rounds: usize = 8, "alignments", ThresholdOrigin::Derived("corners rest after three or four: it bounds the time");
        /// Where the weight of an alignment's window has fallen to exp(−2): errors fell by a third
        /// from 1.8 to 3.5.
        aligned_reach: f64 = 3.5, "blur widths", ThresholdOrigin::Swept;
        /// Least blur that an alignment's window is made for.
        least_aligned_blur_px: f64 = 2.0, "px", ThresholdOrigin::Derived("a window of 15 pixels: ten for each unknown");
        /// Blur above which it is searched for in samples of 2×2 pixels.
        coarse_blur_px: f64 = 3.0, "px", ThresholdOrigin::Derived("a sample is then narrower than the blur");
    }
}
