//! The images that a command writes: their names, their encoding, and which files they may not
//! replace.

use std::collections::BTreeSet;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};

use crate::cli::files::write_file;
use crate::cli::sources::{SourcedFrames, files_of};
use crate::imaging::decode;
use crate::imaging::frame::Frame;
use crate::imaging::remap::{Interpolation, PixelMap};

/// The files that a command writes from images: none replaces an image that the command reads, and
/// none is written twice.
#[derive(Debug)]
pub(super) struct ResultFiles {
    read: BTreeSet<PathBuf>,
    written: BTreeSet<PathBuf>,
}

impl ResultFiles {
    /// For a command that reads `sources`.
    pub(super) fn of<'a>(sources: impl IntoIterator<Item = &'a String>) -> Self {
        let files = sources.into_iter().flat_map(|source| files_of(source));
        let read = files.filter_map(|file| file.canonicalize().ok()).collect();
        Self { read, written: BTreeSet::new() }
    }

    /// Writes the result for the image `path`.
    ///
    /// # Errors
    /// A line for a file that may not be overwritten, or with the system's error.
    pub(super) fn write(&mut self, path: &str, out: &Path, bytes: &[u8]) -> Result<(), String> {
        if out.canonicalize().is_ok_and(|known| self.read.contains(&known)) {
            let name = out.display();
            return Err(format!("{name} would overwrite the input image; choose another --out"));
        }
        if !self.written.insert(out.to_owned()) {
            let name = out.display();
            return Err(format!(
                "{path}: {name} was written from another image of that name; rename one"
            ));
        }
        write_file(out, bytes).map_err(|failure| failure.line().unwrap_or_default().to_owned())
    }
}

/// The image's name with the extension .png; for a frame of a recording, the recording's name and
/// the sequence number.
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

/// A frame mapped through `map`, as a PNG file; with 16 bits if it is gray and has them. `None` if
/// its size is not the map's.
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

/// A gray image if the image has no colors.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_image_that_is_read_is_written_over_and_no_result_twice() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["depth/1.png", "plain/2.png", "3.png", "out/4.png"] {
            std::fs::create_dir_all(at(name).parent().unwrap()).unwrap();
            std::fs::write(at(name), b"image").unwrap();
        }
        let given = ["plain", "3*.png"].map(|name| at(name).display().to_string());
        let with_sensors = folder.path().display().to_string();
        let mut files = ResultFiles::of(given.iter().chain([&with_sensors]));
        for name in ["depth/1.png", "plain/2.png", "3.png"] {
            let refused = files.write("a.png", &at(name), b"result").unwrap_err();
            assert!(refused.contains("would overwrite the input image"), "{refused}");
            assert_eq!(std::fs::read(at(name)).unwrap(), b"image");
        }
        // An earlier result may be written anew, once.
        std::fs::remove_file(at("out/4.png")).unwrap();
        files.write("a.png", &at("out/4.png"), b"result").unwrap();
        let refused = files.write("b/a.png", &at("out/4.png"), b"other").unwrap_err();
        assert!(refused.starts_with("b/a.png: ") && refused.contains("rename one"), "{refused}");
        assert_eq!(std::fs::read(at("out/4.png")).unwrap(), b"result");
    }
}
