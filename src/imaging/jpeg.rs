//! JPEG as cameras send it: luma without the colors, Huffman tables left out, ends cut off.

use std::borrow::Cow;

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode_error::DecodeError;
use crate::imaging::pixel_format::luma_row_from_rgb;

const SOI: u8 = 0xd8;
const EOI: u8 = 0xd9;
const SOS: u8 = 0xda;
const DHT: u8 = 0xc4;

/// What the segments before the first scan say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct JpegHeader {
    /// The image's size.
    pub size: ImageSize,
    /// Whether any Huffman table comes with it: motion JPEG may leave them out.
    has_huffman_tables: bool,
}

impl JpegHeader {
    /// Reads the segments up to the first scan.
    pub fn read(bytes: &[u8]) -> Result<Self, DecodeError> {
        let truncated = || DecodeError::Truncated { format: "JPEG", bytes: bytes.len() };
        if bytes.is_empty() {
            return Err(DecodeError::Empty);
        }
        if !bytes.starts_with(&[0xff, SOI]) {
            return Err(DecodeError::NotAnImage);
        }
        let mut size = None;
        let mut has_huffman_tables = false;
        let mut at = 2;
        loop {
            let marker = *bytes.get(at + 1).ok_or_else(truncated)?;
            if bytes[at] != 0xff || marker == 0xff {
                at += 1;
                continue;
            }
            if matches!(marker, 0x00 | 0x01 | SOI | 0xd0..=0xd7) {
                at += 2;
                continue;
            }
            if marker == EOI {
                return Err(truncated());
            }
            let length =
                usize::from(u16::from_be_bytes([*byte(bytes, at + 2)?, *byte(bytes, at + 3)?]));
            match marker {
                DHT => has_huffman_tables = true,
                0xc0..=0xcf if !matches!(marker, 0xc8 | 0xcc) => {
                    let word = |k: usize| {
                        Ok(u16::from_be_bytes([*byte(bytes, at + k)?, *byte(bytes, at + k + 1)?]))
                    };
                    let (height, width) = (word(5)?, word(7)?);
                    size = Some(ImageSize::new(u32::from(width), u32::from(height)));
                }
                SOS => break,
                _ => {}
            }
            at += 2 + length.max(2);
        }
        let malformed = || DecodeError::Malformed {
            format: "JPEG",
            reason: "no frame header before the scan".into(),
        };
        let size = size.filter(|size| size.width > 0 && size.height > 0).ok_or_else(malformed)?;
        Ok(Self { size, has_huffman_tables })
    }
}

/// How many of the bytes are the JPEG that they begin with, its end marker included (ITU-T T.81,
/// B.1.1); `None` where they begin with none, or end before it does.
pub fn jpeg_length(bytes: &[u8]) -> Option<usize> {
    if !bytes.starts_with(&[0xff, SOI]) {
        return None;
    }
    let mut at = 2;
    loop {
        // Between markers is coded data, in which 0xff is followed by 0, or fill bytes.
        at += bytes.get(at..)?.iter().position(|byte| *byte == 0xff)?;
        match *bytes.get(at + 1)? {
            EOI => return Some(at + 2),
            0xff => at += 1,
            0x00 | 0x01 | SOI | 0xd0..=0xd7 => at += 2,
            _ => {
                let length = u16::from_be_bytes([*bytes.get(at + 2)?, *bytes.get(at + 3)?]);
                at += 2 + usize::from(length.max(2));
            }
        }
    }
}

fn byte(bytes: &[u8], at: usize) -> Result<&u8, DecodeError> {
    bytes.get(at).ok_or(DecodeError::Truncated { format: "JPEG", bytes: bytes.len() })
}

/// The luma of a JPEG, row by row, into `pixels`; the chroma is skipped, not converted.
pub(super) fn luma(
    bytes: &[u8],
    header: JpegHeader,
    pixels: &mut Vec<u8>,
) -> Result<(), DecodeError> {
    let bytes = with_huffman_tables(bytes, header);
    let mut decoder =
        JpegDecoder::new_with_options(ZCursor::new(&*bytes), options(ColorSpace::Luma, true));
    decoder.decode_headers().map_err(|error| malformed(&error))?;
    let area = header.size.width as usize * header.size.height as usize;
    if matches!(decoder.input_colorspace(), Some(ColorSpace::Luma | ColorSpace::YCbCr)) {
        return decode(&bytes, ColorSpace::Luma, area, pixels);
    }
    let mut rgb = Vec::new();
    decode(&bytes, ColorSpace::RGB, area * 3, &mut rgb)?;
    pixels.resize(area, 0);
    luma_row_from_rgb(&rgb, pixels);
    Ok(())
}

/// Red, green and blue of a JPEG, interleaved.
pub(super) fn rgb(bytes: &[u8], header: JpegHeader) -> Result<Vec<u8>, DecodeError> {
    let area = header.size.width as usize * header.size.height as usize;
    let mut pixels = Vec::new();
    decode(&with_huffman_tables(bytes, header), ColorSpace::RGB, area * 3, &mut pixels)?;
    Ok(pixels)
}

/// Decodes strictly; an image with a fault in the middle of its scan, such as the stray bytes that
/// webcams send, is decoded again as far as it goes, one that ends before its end marker is
/// refused.
fn decode(
    bytes: &[u8],
    colors: ColorSpace,
    length: usize,
    pixels: &mut Vec<u8>,
) -> Result<(), DecodeError> {
    pixels.clear();
    pixels.resize(length, 0);
    let strict = decode_into(bytes, options(colors, true), pixels);
    if strict.is_ok() {
        return strict;
    }
    if !bytes.windows(2).rev().take(4096).any(|pair| pair == [0xff, EOI]) {
        return Err(DecodeError::Truncated { format: "JPEG", bytes: bytes.len() });
    }
    decode_into(bytes, options(colors, false), pixels)
}

fn decode_into(
    bytes: &[u8],
    options: DecoderOptions,
    pixels: &mut [u8],
) -> Result<(), DecodeError> {
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|error| malformed(&error))?;
    if decoder.output_buffer_size() != Some(pixels.len()) {
        let reason = "its headers contradict each other about the image's size".into();
        return Err(DecodeError::Malformed { format: "JPEG", reason });
    }
    decoder.decode_into(pixels).map_err(|error| malformed(&error))
}

fn options(colors: ColorSpace, strict: bool) -> DecoderOptions {
    let options =
        DecoderOptions::new_fast().set_strict_mode(strict).jpeg_set_out_colorspace(colors);
    options.set_max_width(usize::from(u16::MAX)).set_max_height(usize::from(u16::MAX))
}

fn malformed(error: &zune_jpeg::errors::DecodeErrors) -> DecodeError {
    let text = format!("{error:?}");
    DecodeError::Malformed {
        format: "JPEG",
        reason: text.lines().next().unwrap_or_default().to_owned(),
    }
}

/// The image marked as motion JPEG where it comes without Huffman tables: the decoder then takes
/// the standard's own (ITU-T T.81, tables K.3 to K.6).
fn with_huffman_tables(bytes: &[u8], header: JpegHeader) -> Cow<'_, [u8]> {
    if header.has_huffman_tables {
        return Cow::Borrowed(bytes);
    }
    let start = 2.min(bytes.len());
    Cow::Owned([&bytes[..start], MOTION_JPEG, &bytes[start..]].concat())
}

/// The application segment by which AVI files mark motion JPEG: APP0, its length with these two
/// bytes, a name.
const MOTION_JPEG: &[u8] = b"\xff\xe0\x00\x07AVI1\0";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jpeg_ends_at_its_own_end_marker() {
        let thumbnail = [0xff, 0xe1, 0, 6, 0xff, SOI, 0xff, EOI];
        let coded = [0x12, 0xff, 0x00, 0x34, 0xff, 0xd3, 0x56, 0xff, 0xff, EOI];
        let scan = [0xff, SOS, 0, 3, 1];
        let image = [&[0xff, SOI], &thumbnail[..], &scan, &coded].concat();
        for after in [&[][..], &[0; 100], &[0xff, EOI]] {
            assert_eq!(jpeg_length(&[&image, after].concat()), Some(image.len()));
        }
        for cut in 0..image.len() {
            assert_eq!(jpeg_length(&image[..cut]), None, "{cut} bytes");
        }
    }
}
