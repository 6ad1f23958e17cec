//! The image that is stored with a view.

use std::sync::Arc;

use crate::imaging::decode;
use crate::imaging::frame::{Frame, PixelFormat};
use crate::imaging::gray::GrayImage;

const JPEG_QUALITY: u8 = 92;

/// A frame as an image file: its media type and bytes. A frame that is a file is kept unchanged.
/// Any other becomes a JPEG, which is only for display: the corners are stored beside it with full
/// precision. `None` for a frame that cannot be decoded.
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
