//! The camera that a photograph's file states (EXIF): what all images by one camera state alike.

use std::io::Cursor;

use exif::{Exif, In, Reader, Tag, Value};

use crate::geometry::pixel::ImageSize;

/// What a file states of the camera that took the image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StatedCamera {
    /// Make, model and serial number, as far as they are stated.
    pub camera: Option<String>,
    /// The focal length, in millimeters.
    pub focal_mm: Option<f64>,
    /// The size of the image that the camera wrote.
    pub image_size: Option<ImageSize>,
}

/// What the EXIF attributes of a JPEG, PNG or TIFF file state; `None` of a file without any.
pub fn stated_camera(file: &[u8]) -> Option<StatedCamera> {
    let exif = Reader::new().read_from_container(&mut Cursor::new(file)).ok()?;
    let names = [Tag::Make, Tag::Model, Tag::BodySerialNumber];
    let names: Vec<String> = names.into_iter().filter_map(|tag| text(&exif, tag)).collect();
    let number = |tag: Tag| exif.get_field(tag, In::PRIMARY)?.value.get_uint(0);
    let image_size = match (number(Tag::PixelXDimension), number(Tag::PixelYDimension)) {
        (Some(width), Some(height)) if width > 0 && height > 0 => {
            Some(ImageSize::new(width, height))
        }
        _ => None,
    };
    let camera = (!names.is_empty()).then(|| names.join(" "));
    Some(StatedCamera { camera, focal_mm: focal_mm(&exif), image_size })
}

/// Whether the EXIF attributes state that the image must be rotated or mirrored to be upright. It
/// is not: a lens holds for the pixels as the sensor gave them.
pub fn states_rotation(file: &[u8]) -> bool {
    let exif = Reader::new().read_from_container(&mut Cursor::new(file)).ok();
    let orientation = exif.and_then(|exif| {
        exif.get_field(Tag::Orientation, In::PRIMARY).and_then(|field| field.value.get_uint(0))
    });
    // 1 is upright; 2 to 8 are the other ways (EXIF 2.3, tag 0x0112); others have no meaning.
    orientation.is_some_and(|orientation| (2..=8).contains(&orientation))
}

fn text(exif: &Exif, tag: Tag) -> Option<String> {
    let Value::Ascii(lines) = &exif.get_field(tag, In::PRIMARY)?.value else { return None };
    let text = String::from_utf8_lossy(lines.first()?);
    let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    (!text.is_empty()).then(|| text.to_owned())
}

fn focal_mm(exif: &Exif) -> Option<f64> {
    let field = exif.get_field(Tag::FocalLength, In::PRIMARY)?;
    // 0 means unknown.
    let focal_mm: f64 = field.display_value().to_string().parse().ok()?;
    (focal_mm.is_finite() && focal_mm > 0.0).then_some(focal_mm)
}

#[cfg(test)]
pub(crate) mod tests {
    use exif::experimental::Writer;
    use exif::{Field, Rational};

    use super::*;

    /// EXIF attributes as a TIFF file.
    fn tiff(fields: &[Field]) -> Vec<u8> {
        let (mut writer, mut tiff) = (Writer::new(), Cursor::new(Vec::new()));
        fields.iter().for_each(|field| writer.push_field(field));
        writer.write(&mut tiff, false).unwrap();
        tiff.into_inner()
    }

    /// EXIF attributes that state an orientation, as a TIFF file.
    pub(crate) fn with_orientation(orientation: u16) -> Vec<u8> {
        let value = Value::Short(vec![orientation]);
        tiff(&[Field { tag: Tag::Orientation, ifd_num: In::PRIMARY, value }])
    }

    #[test]
    fn all_but_upright_is_a_rotation() {
        let stated = (0..10).filter(|orientation| states_rotation(&with_orientation(*orientation)));
        assert_eq!(stated.collect::<Vec<_>>(), [2, 3, 4, 5, 6, 7, 8]);
        assert!(!states_rotation(b"P5 2 2 255 abcd"));
    }

    #[test]
    fn the_camera_its_lens_and_the_size_it_wrote_are_read() {
        let field = |tag: Tag, value: Value| Field { tag, ifd_num: In::PRIMARY, value };
        let ascii = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
        let fields = [
            field(Tag::Make, ascii("Maker ")),
            field(Tag::Model, ascii("M 5")),
            field(Tag::FocalLength, Value::Rational(vec![Rational { num: 185, denom: 10 }])),
            field(Tag::PixelXDimension, Value::Long(vec![3000])),
            field(Tag::PixelYDimension, Value::Long(vec![2000])),
        ];
        let found = stated_camera(&tiff(&fields)).unwrap();
        assert_eq!(found.camera.as_deref(), Some("Maker M 5"));
        assert_eq!(found.focal_mm, Some(18.5));
        assert_eq!(found.image_size, Some(ImageSize::new(3000, 2000)));
        assert_eq!(stated_camera(b"P5 2 2 255 abcd"), None);
    }
}
