//! Images and the moments they were taken. Pure; may use geometry (for undistortion).

pub mod bayer;
pub mod board_picture;
mod color_view;
pub mod decode;
mod decode_error;
mod depth_conversion;
pub mod depth_image;
pub mod depth_picture;
mod distortion_lookup;
pub mod draw;
pub mod error_picture;
pub mod factory;
pub mod frame;
pub mod gray;
pub mod heat_map;
mod jpeg;
pub mod lettering;
mod nearest_canvas;
pub mod picture_file;
pub mod pixel_format;
mod plausible;
mod png;
pub mod point_cloud;
pub mod registration;
pub mod remap;
pub mod timestamp;
pub mod undistort;
