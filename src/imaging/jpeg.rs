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
pub(super) struct Header {
    /// The picture's size.
    pub size: ImageSize,
    /// Whether any Huffman table comes with it: motion JPEG may leave them out.
    has_huffman_tables: bool,
}

impl Header {
    /// Reads the segments up to the first scan.
    pub fn read(bytes: &[u8]) -> Result<Self, DecodeError> {
        let truncated = || DecodeError::Truncated { format: "JPEG", bytes: bytes.len() };
        if bytes.is_empty() {
            return Err(DecodeError::Empty);
        }
        if !bytes.starts_with(&[0xff, SOI]) {
            return Err(DecodeError::NotAPicture);
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

fn byte(bytes: &[u8], at: usize) -> Result<&u8, DecodeError> {
    bytes.get(at).ok_or(DecodeError::Truncated { format: "JPEG", bytes: bytes.len() })
}

/// The luma of a JPEG, row by row, into `pixels`; the chroma is skipped, not converted.
pub(super) fn luma(bytes: &[u8], header: Header, pixels: &mut Vec<u8>) -> Result<(), DecodeError> {
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
pub(super) fn rgb(bytes: &[u8], header: Header) -> Result<Vec<u8>, DecodeError> {
    let area = header.size.width as usize * header.size.height as usize;
    let mut pixels = Vec::new();
    decode(&with_huffman_tables(bytes, header), ColorSpace::RGB, area * 3, &mut pixels)?;
    Ok(pixels)
}

/// Decodes strictly; a picture with a fault in the middle of its scan, such as the stray bytes that
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
        let reason = "its headers contradict each other about the picture's size".into();
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

/// The picture with the standard's example tables put in where it comes with none, as motion JPEG
/// does.
fn with_huffman_tables(bytes: &[u8], header: Header) -> Cow<'_, [u8]> {
    if header.has_huffman_tables {
        return Cow::Borrowed(bytes);
    }
    let mut whole = Vec::with_capacity(bytes.len() + 432);
    whole.extend_from_slice(&bytes[..2]);
    for (class_and_id, lengths, values) in STANDARD_TABLES {
        let length = 2 + 1 + 16 + values.len();
        whole.extend_from_slice(&[0xff, DHT, (length >> 8) as u8, length as u8, class_and_id]);
        whole.extend_from_slice(lengths);
        whole.extend_from_slice(values);
    }
    whole.extend_from_slice(&bytes[2..]);
    Cow::Owned(whole)
}

type HuffmanTable = (u8, &'static [u8; 16], &'static [u8]);

/// ITU-T T.81, tables K.3 to K.6: class and destination, how many codes of each length, and their
/// values.
const STANDARD_TABLES: [HuffmanTable; 4] = [
    (0x00, &[0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0], &DC_VALUES),
    (0x01, &[0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0], &DC_VALUES),
    (0x10, &[0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d], &LUMA_AC_VALUES),
    (0x11, &[0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77], &CHROMA_AC_VALUES),
];

const DC_VALUES: [u8; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

#[rustfmt::skip]
const LUMA_AC_VALUES: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07, 0x22, 0x71, 0x14, 0x32,
    0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0, 0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16,
    0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45,
    0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69,
    0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94,
    0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6,
    0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8,
    0xd9, 0xda, 0xe1, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
    0xf9, 0xfa,
];

#[rustfmt::skip]
const CHROMA_AC_VALUES: [u8; 162] = [
    0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71, 0x13, 0x22, 0x32, 0x81,
    0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09, 0x23, 0x33, 0x52, 0xf0, 0x15, 0x62, 0x72, 0xd1, 0x0a, 0x16, 0x24, 0x34,
    0xe1, 0x25, 0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44,
    0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68,
    0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92,
    0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4,
    0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6,
    0xd7, 0xd8, 0xd9, 0xda, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
    0xf9, 0xfa,
];
