//! Why images without a target do not determine a lens.

use crate::calibration::given_misfit::contradiction;
use crate::estimation::error::EstimationError;
use crate::estimation::given_misfit::GivenMisfit;

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
    #[error(
        "`{name}` was taken with {camera}, `{other}` with {expected}: all images must be from one camera"
    )]
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
        "`{name}` is {size}, the others are {expected}: all images must be from one camera, uncropped"
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
        "no two images show the same scene (median of {between_neighbors} inlier matches between consecutive images): take smaller steps, and choose a scene without repeated texture"
    )]
    NothingAgrees {
        /// The median number of inlier matches between an image and the next.
        between_neighbors: usize,
    },
    /// Only a time stamp or the like matches, not the scene.
    #[error(
        "no two images show the same scene from different places: the matches of {pairs} pairs are at the same pixels in both images, like a time stamp; take smaller steps around a textured scene"
    )]
    OnlyWhatStays {
        /// How many pairs of images share that.
        pairs: usize,
    },
    /// The texture repeats, so matches are ambiguous.
    #[error(
        "the texture repeats: {percent:.0} % of the features match at several places in the next image; photograph a scene without repeated texture"
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
        "only {used} of {images} images are connected by matches (median between consecutive images: {between_neighbors}): take smaller steps, and choose a scene with more texture"
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
        "the camera moved along its optical axis (within {angle_deg:.0} degrees), where focal length, distortion and depth are correlated; move it sideways, and rotate it about its optical axis"
    )]
    ForwardMotion {
        /// The root mean square angle between motion and optical axis.
        angle_deg: f64,
    },
    /// The focal length is too uncertain to be of use.
    #[error(
        "the images do not determine the focal length (uncertainty {percent:.0} %): move the camera sideways around the scene, and rotate it by 90 degrees about its axis for some images"
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
    /// The images fit without the given parameters only.
    #[error("{}", contradiction(.0, "images"))]
    Contradicted(GivenMisfit),
    /// Nobody waits for it any more.
    #[error("the calibration was canceled; start it again")]
    Interrupted,
    /// The solution is not finite.
    #[error(
        "no lens fits the images: give sharp images of one static scene by one camera with fixed zoom and focus"
    )]
    NoFit,
}
