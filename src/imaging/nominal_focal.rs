//! The focal length that a photograph's file states (EXIF): nominal, but a check on an estimate.

use std::io::Cursor;

use exif::{In, Reader, Tag};

use crate::geometry::pixel::ImageSize;

/// A focal length as a camera states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NominalFocal {
    /// In pixels of the image.
    pub focal_px: f64,
    /// What it is rounded to, as a standard deviation.
    pub std_px: f64,
}

/// The diagonal of a frame of 35 mm film, 36 mm × 24 mm, in millimeters.
const FILM_DIAGONAL_MM: f64 = 43.266_615;

/// The equivalent focal length is a whole number of millimeters (EXIF 2.3, tag 0xA405): a value
/// rounded to 1 errs by 1 / √12.
const ROUNDING_MM: f64 = 0.288_675;

/// The focal length that the EXIF attributes of a JPEG or TIFF file state for 35 mm film, in pixels
/// of an image of `size`: film and sensor are compared by their diagonals (CIPA DCG-001). `None`
/// where they state none.
pub fn nominal_focal(file: &[u8], size: ImageSize) -> Option<NominalFocal> {
    let exif = Reader::new().read_from_container(&mut Cursor::new(file)).ok()?;
    let field = exif.get_field(Tag::FocalLengthIn35mmFilm, In::PRIMARY)?;
    // 0 means unknown.
    let focal_mm = field.value.get_uint(0).filter(|focal_mm| *focal_mm > 0)?;
    let px_per_mm = size.diagonal_px() / FILM_DIAGONAL_MM;
    let (focal_px, std_px) = (f64::from(focal_mm) * px_per_mm, ROUNDING_MM * px_per_mm);
    Some(NominalFocal { focal_px, std_px })
}

#[cfg(test)]
mod tests {
    use exif::experimental::Writer;
    use exif::{Field, Value};

    use super::*;

    /// The least of a JPEG file that states `focal_mm`.
    fn jpeg(focal_mm: u16) -> Vec<u8> {
        let value = Value::Short(vec![focal_mm]);
        let field = Field { tag: Tag::FocalLengthIn35mmFilm, ifd_num: In::PRIMARY, value };
        let (mut writer, mut tiff) = (Writer::new(), Cursor::new(Vec::new()));
        writer.push_field(&field);
        writer.write(&mut tiff, false).unwrap();
        let tiff = tiff.into_inner();
        let length = (2 + 6 + tiff.len()) as u16;
        let mut file = vec![0xff, 0xd8, 0xff, 0xe1];
        file.extend(length.to_be_bytes());
        file.extend(b"Exif\0\0");
        file.extend(tiff);
        file.extend([0xff, 0xd9]);
        file
    }

    #[test]
    fn the_equivalent_focal_length_is_by_the_diagonal() {
        // As wide as film, 3:2: 36 mm are 3600 pixels.
        let found = nominal_focal(&jpeg(50), ImageSize::new(3600, 2400)).unwrap();
        assert!((found.focal_px - 5000.0).abs() < 0.01, "{found:?}");
        assert!((found.std_px - 28.87).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn what_states_none_gives_none() {
        let size = ImageSize::new(640, 480);
        assert_eq!(nominal_focal(&jpeg(0), size), None);
        assert_eq!(nominal_focal(&jpeg(35)[..20], size), None);
        assert_eq!(nominal_focal(b"P5 2 2 255 abcd", size), None);
        assert_eq!(nominal_focal(&[], size), None);
    }
}
