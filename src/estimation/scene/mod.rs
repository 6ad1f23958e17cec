//! A camera's lens, its poses and the scene's points from points observed in many images of an
//! unknown scene (HZ chapters 18 and 19).
//!
//! ```text
//! tracks --reconstruction--> poses, points and a first lens, image by image (resection)
//!        --bundle--> all at once: lens, poses, points by least squares
//!        --covariance--> what of the lens the images determine, and how well
//! ```
//!
//! Lengths have no unit: the scene's frame is that of the first used camera, and its scale is that
//! of the first pair. Results are scaled later (`calibration/scene`), to 1 for the greatest
//! distance between two cameras, or to meters where depth was measured too ([`metric_scale`]).
//! Parameters that images hardly determine are constrained by stated priors ([`lens_prior`]).

pub mod bundle;
#[cfg(test)]
mod bundle_tests;
mod clusters;
pub mod covariance;
#[cfg(test)]
mod covariance_tests;
pub mod hypotheses;
pub mod lens_by_image;
pub mod lens_prior;
pub mod metric_scale;
mod parts;
pub mod problem;
pub mod reconstruction;
pub mod resection;
pub mod robust_bundle;
pub mod rotation_only;
