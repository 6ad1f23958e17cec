//! The image that is kept with a view.

use std::sync::Arc;

use crate::imaging::decode;
use crate::imaging::frame::{Frame, PixelFormat};
use crate::imaging::gray::GrayImage;

const JPEG_QUALITY: u8 = 92;

/// A frame as an image file: its media type and bytes. A file is kept as it came; anything else
/// becomes a JPEG, for the eye, since the corners are kept with full precision beside it. `None`
/// for a frame that cannot be decoded.
pub(super) fn view_image(frame: &Frame) -> Option<(&'static str, Arc<[u8]>)> {
    match frame.format {
        PixelFormat::Jpeg => Some(("image/jpeg", Arc::clone(&frame.bytes))),
        PixelFormat::Png => Some(("image/png", Arc::clone(&frame.bytes))),
        PixelFormat::Mono8 | PixelFormat::Mono16 => {
            let mut luma = GrayImage::default();
            decode::luma(frame, &mut luma).ok()?;
            Some(("image/jpeg", decode::encode_jpeg(luma.view(), JPEG_QUALITY).into()))
        }
        _ => {
            let rgb = decode::rgb(frame).ok()?;
            Some(("image/jpeg", decode::encode_jpeg_rgb(&rgb, JPEG_QUALITY).into()))
        }
    }
}
