//! Images and the moments they were taken. Pure; may use geometry (for undistortion).

pub mod bayer;
mod color_view;
pub mod decode;
mod decode_error;
pub mod deep_gray;
mod depth_conversion;
pub mod depth_encoding;
pub mod depth_image;
mod distortion_lookup;
pub mod draw;
pub mod factory;
pub mod frame;
pub mod gray;
pub mod image_file;
mod jpeg;
mod nearest_canvas;
pub mod no_image;
pub mod nominal_focal;
pub mod pixel_format;
mod plausible;
mod png;
pub mod point_cloud;
pub mod rectify;
pub mod registration;
pub mod remap;
pub mod stated_camera;
pub mod timestamp;
pub mod undistort;

pub use jpeg::jpeg_length;
