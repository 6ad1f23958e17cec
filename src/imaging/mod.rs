//! Images and the moments they were taken. Pure; may use geometry (for undistortion).

pub mod bayer;
pub mod decode;
mod decode_error;
pub mod deep_gray;
pub mod depth_encoding;
pub mod depth_image;
pub mod draw;
pub mod factory;
pub mod frame;
pub mod gray;
pub mod image_file;
mod jpeg;
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
