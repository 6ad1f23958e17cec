//! Scale-invariant features: positions with texture that other views of the same scene show again,
//! and their matches.
//!
//! ```text
//! luma --scale_space--> Gaussian octaves --extrema--> keypoints --orientation, descriptor-->
//! features --matching--> matches of two images --tracks--> one scene point in many images
//! ```
//!
//! Source: D. G. Lowe, *Distinctive image features from scale-invariant keypoints*, 2004 (SIFT); R.
//! Arandjelović and A. Zisserman, *Three things everyone should know to improve object retrieval*,
//! 2012 (RootSIFT). Deterministic: descriptors are whole numbers, so that their products are exact
//! in any order of summation.

pub mod descriptor;
pub mod detector;
mod extrema;
pub mod keypoint;
pub mod matching;
mod orientation;
pub mod patch;
mod plane;
mod products;
mod scale_space;
pub mod tracks;
