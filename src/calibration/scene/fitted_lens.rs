//! One lens model fitted to a scene.

use crate::estimation::scene::bundle::BundleStop;
use crate::estimation::scene::covariance::LensCovariance;
use crate::estimation::scene::robust_bundle::RobustBundle;

/// A fit of one model with its statements about the lens.
#[derive(Debug, Clone)]
pub(super) struct LensFit {
    pub fit: RobustBundle,
    pub covariance: LensCovariance,
    /// The posterior probability that the images are crops.
    pub cropped: f64,
    /// The posterior probability that pixels are not square.
    pub stretched: f64,
}

/// When a fit stops. The limit is a guard: from 1.8 times the focal length 60 steps reach the
/// minimum (`bundle_tests`), and a fit that is cut short is a wrong answer.
pub(super) const FITTING: BundleStop = BundleStop { max_steps: 200, least_decrease: 3e-6 };
