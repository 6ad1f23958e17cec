//! Why images without a target do not determine a lens.

use crate::estimation::error::EstimationError;

/// Why there is no calibration: one line each, with what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneRefusal {
    /// A given parameter that no fitted lens has, or a value that it cannot have.
    #[error(transparent)]
    Given(#[from] EstimationError),
    /// Fewer than three.
    #[error(
        "{images} images are too few to calibrate without a target: give at least 3, better 8, from different places"
    )]
    TooFewImages {
        /// How many there are.
        images: usize,
    },
    /// Most images repeat others.
    #[error(
        "{images} images show only {views} different views, which are too few: give at least 3, better 8, from different places"
    )]
    TooFewViews {
        /// How many images there are.
        images: usize,
        /// How many of them differ.
        views: usize,
    },
    /// The files state different cameras.
    #[error("`{name}` is by {camera}, `{other}` by {expected}: all images must be by one camera")]
    DifferentCameras {
        /// The image of another camera.
        name: String,
        /// Its camera.
        camera: String,
        /// One of most images.
        other: String,
        /// Their camera.
        expected: String,
    },
    /// The files state different focal lengths.
    #[error(
        "`{name}` was taken at {focal_mm} mm, `{other}` at {expected_mm} mm: calibrate each zoom setting by itself"
    )]
    DifferentZoom {
        /// The image of another focal length.
        name: String,
        /// That, in millimeters.
        focal_mm: f64,
        /// One of most images.
        other: String,
        /// Theirs.
        expected_mm: f64,
    },
    /// One camera has one size.
    #[error(
        "`{name}` is {size}, the others are {expected}: all images must be by one camera, uncropped"
    )]
    DifferentSizes {
        /// The image of another size.
        name: String,
        /// Its size.
        size: crate::geometry::pixel::ImageSize,
        /// That of most.
        expected: crate::geometry::pixel::ImageSize,
    },
    /// Too few features to match.
    #[error(
        "the images have too little texture or are blurred (a median of {median} features): photograph something with texture, in focus, holding still"
    )]
    NoTexture {
        /// The median number of features of an image.
        median: usize,
    },
    /// Too few matches are inliers.
    #[error(
        "no two images show the same scene: between neighbors a median of {between_neighbors} matches agree; take smaller steps, and something whose texture does not repeat"
    )]
    NothingAgrees {
        /// The median number of inlier matches between an image and the next.
        between_neighbors: usize,
    },
    /// Only a time stamp or the like matches, not the scene.
    #[error(
        "no two images show the same scene from two places: what {pairs} pairs of them share stays at its place in the image, as a time stamp does; take smaller steps around something with texture"
    )]
    OnlyWhatStays {
        /// How many pairs of images share that.
        pairs: usize,
    },
    /// The texture repeats, so matches are ambiguous.
    #[error(
        "the texture repeats: {percent:.0} % of what an image shows is alike at several places of the next one, so that matches are ambiguous; photograph something whose texture does not repeat"
    )]
    RepeatedTexture {
        /// The part of the features of an image that the next shows at several places: the median.
        percent: f64,
    },
    /// The same image, or a camera on a tripod.
    #[error(
        "the camera stood still (or all images are the same one): move it around the scene between images"
    )]
    Still,
    /// Homographies explain all matches, but no rotation explains the homographies.
    #[error(
        "one plane is all that the images show, which does not determine the lens: include things at different depths"
    )]
    OnePlane,
    /// Too little parallax to triangulate, and too little rotation to calibrate without it.
    #[error(
        "hardly any parallax: the camera moved too little for the depth of the scene; move it sideways by at least a tenth of the distance to the scene"
    )]
    HardlyAnyParallax,
    /// Only a part of the images is connected by matches.
    #[error(
        "only {used} of {images} images hang together: too few matches between neighbors (a median of {between_neighbors}), too little texture or too large steps"
    )]
    TooFewConnected {
        /// Images with a pose.
        used: usize,
        /// All.
        images: usize,
        /// The median number of inlier matches between an image and the next.
        between_neighbors: usize,
    },
    /// Focal length and depth are not separable.
    #[error(
        "the camera moved forward (within {angle_deg:.0} degrees of where it points): focal length, distortion and depth trade; move it sideways, and rotate it about its axis"
    )]
    ForwardMotion {
        /// The root mean square angle between motion and optical axis.
        angle_deg: f64,
    },
    /// The focal length is too uncertain to be of use.
    #[error(
        "the images do not determine the focal length (known to {percent:.0} % only): move the camera sideways around the scene, and rotate it by 90 degrees about its axis for some images"
    )]
    FocalUndetermined {
        /// Its standard deviation over itself.
        percent: f64,
    },
    /// A name that the lens does not have.
    #[error("--given {name}: the {model} lens has no such parameter")]
    UnknownParameter {
        /// What was given.
        name: String,
        /// The lens asked for.
        model: crate::geometry::lens::LensModel,
    },
    /// Nobody waits for it any more.
    #[error("the calibration was ended before it was done")]
    Interrupted,
    /// The solution is not finite.
    #[error(
        "no lens fits the images: give sharp images of one static scene by one camera with fixed zoom and focus"
    )]
    NoFit,
}
