//! Points, poses, lenses: positions in space and in images. Pure; uses no other layer.
//!
//! # Conventions (all of Plumb)
//!
//! | what | convention |
//! | --- | --- |
//! | pixel | x right, y down; integer coordinates are pixel *centers*; an image of width w spans −0.5 … w − 0.5 |
//! | camera frame | right-handed, x right, y down, z forward (optical frame) |
//! | board frame | origin at the first inner corner, x along a row, y along the columns, z = x × y (away from the camera) |
//! | pose | `a_from_b` maps coordinates in b to coordinates in a: `p_a = a_from_b * p_b`; unit quaternion with w ≥ 0 |
//! | units | meters, radians, seconds, pixels; a name carries its unit where it is none of these |

pub mod board;
pub mod camera_matrix;
pub mod depth_camera;
pub mod depth_correction;
pub mod dictionary;
pub mod flat_image;
pub mod homography;
pub mod image_region;
pub mod lens;
pub mod median;
pub mod physical;
pub mod pixel;
pub mod polynomial;
pub mod pose;
pub mod printed_board;
pub mod rectification;
pub mod target;
pub mod thin_lens;
