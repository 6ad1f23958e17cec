//! Why an estimate could not be made. A fault of a single view is not an error, but a
//! [`crate::estimation::view_fault::ViewFault`] of that view.

/// Why there is no estimate, and what would help.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EstimationError {
    /// The image has no area.
    #[error(
        "an image of {width}x{height} pixels cannot be calibrated: give the size of the images that the pixels were measured in"
    )]
    ImageSize {
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// NaN or infinite.
    #[error(
        "view `{view}`, point {point}: {what} is not a finite number; correct it or leave the point out"
    )]
    NotFinite {
        /// The view's name.
        view: String,
        /// Which point of the view, counted from 0.
        point: usize,
        /// Which of its numbers.
        what: &'static str,
    },
    /// A standard deviation of 0 or less.
    #[error(
        "view `{view}`, point {point}: a standard deviation of {std_px} px is impossible; give a positive one"
    )]
    Std {
        /// The view's name.
        view: String,
        /// Which point of the view, counted from 0.
        point: usize,
        /// What was given.
        std_px: f64,
    },
    /// A given parameter that the lens does not have.
    #[error("a {model} lens has no parameter `{name}`: give one of {known}")]
    UnknownParameter {
        /// The lens model.
        model: crate::geometry::lens::LensModel,
        /// What was given.
        name: String,
        /// What it has.
        known: String,
    },
    /// A given parameter that is not a number, or a focal length that is not positive.
    #[error("{name} cannot be {value}: give a finite number, positive for a focal length")]
    GivenValue {
        /// Its name.
        name: String,
        /// What was given.
        value: f64,
    },
    /// A given parameter that no lens has for images of this size.
    #[error(
        "{name} = {value} px is impossible for {size} images ({:.0} to {:.0} px: {why}); give it in pixels of these images",
        range[0],
        range[1]
    )]
    GivenRange {
        /// Its name.
        name: String,
        /// What was given.
        value: f64,
        /// The images' size.
        size: crate::geometry::pixel::ImageSize,
        /// From where to where it may be.
        range: [f64; 2],
        /// Why no further.
        why: &'static str,
    },
    /// Not enough views to determine the lens.
    #[error(
        "usable views: {usable}; at least {needed} are needed, with the board tilted differently in each{rejected}"
    )]
    TooFewViews {
        /// Views that could be used.
        usable: usize,
        /// How many it takes.
        needed: usize,
        /// Which views could not be used and why, as `; view: reason`, or nothing.
        rejected: String,
    },
    /// The board was never tilted.
    #[error(
        "the board has the same orientation in all views, so the focal length is not determined: tilt it by 20 to 45 degrees in different directions"
    )]
    ParallelViews,
    /// B of Zhang's method is not positive definite.
    #[error(
        "no camera matrix fits these homographies: the distortion is too strong for the closed-form solution, or corners are mislabeled; check the order of the corners, and add views with the board near the image center"
    )]
    NoCameraMatrix,
    /// No start led to a plausible camera.
    #[error(
        "no plausible camera fits these views: check the order of the corners, the board's size in corners, and the image size"
    )]
    NoFit,
    /// The views fit without the given parameters only.
    #[error(
        "the views contradict the given {name} {given}: without it, they determine {estimated:.4} ± {std:.4}; give the value of this camera at this image size, focus and zoom, or none"
    )]
    Contradicted {
        /// The parameter that is farthest off.
        name: &'static str,
        /// What was given.
        given: f64,
        /// Its estimate.
        estimated: f64,
        /// The estimate's standard deviation.
        std: f64,
    },
    /// A parameter that these views do not determine.
    #[error("these views do not determine {parameter} ({value:.3e} ± {std:.3e}): {remedy}")]
    Undetermined {
        /// The weakest parameter's name.
        parameter: &'static str,
        /// Its estimate.
        value: f64,
        /// Its standard deviation.
        std: f64,
        /// What to do.
        remedy: &'static str,
    },
    /// A coefficient that has the same effect as the others and the focal lengths together.
    #[error(
        "these views do not determine {parameter} of a {model} lens: near 0 its effect is nearly that of the focal lengths and other coefficients, especially if the lens is nearly a pinhole; calibrate with --lens {instead}, which the views determine, or hold it fixed with --given {parameter}=0"
    )]
    OpenCoefficient {
        /// The lens model.
        model: crate::geometry::lens::LensModel,
        /// The coefficient.
        parameter: &'static str,
        /// A model that the views determine.
        instead: crate::geometry::lens::LensModel,
    },
    /// A measured board that lacks one of the observed corners.
    #[error(
        "the measured board has no corner at ({x_m:.4}, {y_m:.4}) m: give a shape that was measured on this board, with the same corners and the same square size"
    )]
    OtherBoard {
        /// Where the corner is stated, in the board frame, in meters.
        x_m: f64,
        /// The same along y.
        y_m: f64,
    },
    /// An interrupt was requested: the result is no longer needed.
    #[error("the computation was canceled: start it again")]
    Interrupted,
    /// A view that determines no pose.
    #[error("no pose can be estimated for view `{view}`: {reason}")]
    NoPose {
        /// The view's name.
        view: String,
        /// Why.
        reason: String,
    },
    /// A sensor of a rig that never saw the board together with another.
    #[error(
        "sensor `{sensor}` never saw the board in a frame set with another sensor: show it to both at once"
    )]
    NothingShared {
        /// The sensor's name.
        sensor: String,
    },
    /// A sensor of a rig whose every view is inconsistent with the others.
    #[error(
        "the board poses of sensor `{sensor}` agree with those of the other sensors in no frame set: give frames that were taken at the same time, from sensors that are rigidly mounted"
    )]
    NothingAgrees {
        /// The sensor's name.
        sensor: String,
    },
    /// The direct linear transform takes one view.
    #[error(
        "the direct linear transform takes one view, not {views}: give one, or omit \"method\": \"dlt\""
    )]
    NotOneView {
        /// How many were given.
        views: usize,
    },
    /// A direct linear transform needs six points in space.
    #[error(
        "{points} points are too few for a direct linear transform: give at least 6 that do not lie on one plane"
    )]
    TooFewPoints {
        /// How many were given.
        points: usize,
    },
    /// The points lie on a plane, a line, or with the camera on a surface that determines no
    /// projection.
    #[error(
        "the points are (nearly) coplanar, which does not determine a projection matrix: add points at other depths, or give several views of the plane without \"method\": \"dlt\""
    )]
    Coplanar,
}
