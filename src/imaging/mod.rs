//! Pictures and the moments they were taken. Pure; may use geometry (for undistortion).

pub mod frame;
pub mod gray;
pub mod timestamp;
