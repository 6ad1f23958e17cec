//! Images that a command writes: their names, and PNG.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};

use crate::cli::sources::SourcedFrames;
use crate::imaging::decode;
use crate::imaging::frame::Frame;
use crate::imaging::remap::{Interpolation, PixelMap};

/// The image's name with the ending .png; for a frame of a recording the recording's name and the
/// sequence number.
pub(super) fn result_name(frames: &SourcedFrames) -> String {
    let stem =
        |path: &str| Path::new(path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    match (&frames.set.name, &frames.recording) {
        (Some(name), _) => format!("{}.png", stem(name)),
        (None, recording) => {
            format!(
                "{}-{:06}.png",
                stem(recording.as_deref().unwrap_or("frame")),
                frames.set.sequence
            )
        }
    }
}

/// A frame through `map`, as a PNG file: with 16 bits where it has them and is gray. `None` if it
/// has another size than the map's.
pub(super) fn mapped_png(frame: &Frame, map: &PixelMap) -> Result<Option<Vec<u8>>, String> {
    let mapped = match decode::gray16(frame).map_err(|error| error.to_string())? {
        Some(deep) => map.gray16(&deep, Interpolation::Bicubic).map(DynamicImage::ImageLuma16),
        None => {
            let image = decode::rgb(frame).map_err(|error| error.to_string())?;
            map.rgb(&image, Interpolation::Bicubic).map(gray_or_color)
        }
    };
    mapped.map(|image| png(&image)).transpose().map_err(|error| error.to_string())
}

fn png(image: &DynamicImage) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// Gray for an image without colors.
fn gray_or_color(image: RgbImage) -> DynamicImage {
    let gray = image.pixels().all(|pixel| pixel[0] == pixel[1] && pixel[1] == pixel[2]);
    if gray {
        let values = image.pixels().map(|pixel| pixel[0]).collect();
        GrayImage::from_raw(image.width(), image.height(), values)
            .map_or(DynamicImage::ImageRgb8(image), DynamicImage::ImageLuma8)
    } else {
        DynamicImage::ImageRgb8(image)
    }
}
