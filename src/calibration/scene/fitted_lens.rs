//! One lens model fitted to a scene.

use crate::estimation::scene::bundle::BundleStop;
use crate::estimation::scene::covariance::LensCovariance;
use crate::estimation::scene::robust_bundle::RobustBundle;

/// A fit of one model with what it says of the lens.
#[derive(Debug, Clone)]
pub(super) struct LensFit {
    pub fit: RobustBundle,
    pub covariance: LensCovariance,
    /// How likely it is that the images are parts of what the camera took.
    pub cropped: f64,
}

/// Where a fit ends. Most settle within 10 steps, one that starts with a focal length 30 % off
/// within 60; one cut short is a wrong answer.
pub(super) const FITTING: BundleStop = BundleStop { max_steps: 200, least_decrease: 3e-6 };
