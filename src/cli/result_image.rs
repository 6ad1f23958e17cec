//! Images that a command writes: their names, and PNG.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};

use crate::cli::sources::SourcedFrames;

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

/// A PNG file: gray for an image without colors.
pub(super) fn png(image: RgbImage) -> Result<Vec<u8>, image::ImageError> {
    let gray = image.pixels().all(|pixel| pixel[0] == pixel[1] && pixel[1] == pixel[2]);
    let image = if gray {
        let values = image.pixels().map(|pixel| pixel[0]).collect();
        GrayImage::from_raw(image.width(), image.height(), values)
            .map_or(DynamicImage::ImageRgb8(image), DynamicImage::ImageLuma8)
    } else {
        DynamicImage::ImageRgb8(image)
    };
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}
