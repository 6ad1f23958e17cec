//! Luma of uncompressed pixels, and what a frame's buffer must hold.
//!
//! Luma is BT.601's Y = 0.299 R + 0.587 G + 0.114 B, the Y that a JPEG and a YUYV frame carry
//! already, in the fixed-point form of OpenCV's `cvtColor`: an image gives the same luma whichever
//! way it came.

use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::PixelFormat;

impl PixelFormat {
    /// Bytes from one pixel to the next in a row (of Y, for `Nv12`); `None` for formats that are
    /// files.
    pub fn bytes_per_pixel(self) -> Option<usize> {
        match self {
            Self::Mono8 | Self::Nv12 => Some(1),
            Self::Mono16 | Self::Yuyv | Self::Uyvy | Self::Depth16 => Some(2),
            Self::Rgb8 | Self::Bgr8 => Some(3),
            Self::Jpeg | Self::Png => None,
        }
    }

    /// Its name in messages: `jpeg`, `png`, or the encoding of a Foxglove raw image.
    pub fn name(self) -> &'static str {
        match self {
            Self::Jpeg => "jpeg",
            Self::Png => "png",
            Self::Mono8 => "mono8",
            Self::Mono16 => "mono16",
            Self::Yuyv => "yuyv",
            Self::Uyvy => "uyvy",
            Self::Nv12 => "nv12",
            Self::Depth16 => "16UC1",
            Self::Rgb8 => "rgb8",
            Self::Bgr8 => "bgr8",
        }
    }

    /// The file format that `bytes` begin like, by their magic number.
    pub fn of_file(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
            Some(Self::Jpeg)
        } else if bytes.starts_with(&[0x89, b'P', b'N', b'G', 0x0d, 0x0a, 0x1a, 0x0a]) {
            Some(Self::Png)
        } else {
            None
        }
    }
}

/// How many bytes an uncompressed buffer of `size` with rows every `stride` bytes must have: the
/// last row may end early.
pub fn buffer_length(size: ImageSize, stride: usize, bytes_per_pixel: usize) -> usize {
    let row = size.width as usize * bytes_per_pixel;
    match size.height {
        0 => 0,
        height => stride.saturating_mul(height as usize - 1).saturating_add(row),
    }
}

/// BT.601 luma of one pixel, rounded as OpenCV's `cvtColor` does.
pub fn luma_from_rgb(red: u8, green: u8, blue: u8) -> u8 {
    ((u32::from(red) * 4899 + u32::from(green) * 9617 + u32::from(blue) * 1868 + 8192) >> 14) as u8
}

/// Luma of a row of interleaved red, green, blue.
pub fn luma_row_from_rgb(rgb: &[u8], luma: &mut [u8]) {
    for (pixel, out) in rgb.chunks_exact(3).zip(luma) {
        *out = luma_from_rgb(pixel[0], pixel[1], pixel[2]);
    }
}

/// Luma of a row of interleaved blue, green, red.
pub fn luma_row_from_bgr(bgr: &[u8], luma: &mut [u8]) {
    for (pixel, out) in bgr.chunks_exact(3).zip(luma) {
        *out = luma_from_rgb(pixel[2], pixel[1], pixel[0]);
    }
}

/// Luma of a row of interleaved U Y V Y.
pub fn luma_row_from_uyvy(uyvy: &[u8], luma: &mut [u8]) {
    for (pair, out) in uyvy.chunks_exact(2).zip(luma) {
        *out = pair[1];
    }
}

/// Luma of a row of interleaved Y U Y V.
pub fn luma_row_from_yuyv(yuyv: &[u8], luma: &mut [u8]) {
    for (pair, out) in yuyv.chunks_exact(2).zip(luma) {
        *out = pair[0];
    }
}

/// Red, green, blue of a row of interleaved Y U Y V with full-range BT.601 colors, as a JPEG's.
pub fn rgb_row_from_yuyv(yuyv: &[u8], rgb: &mut [u8]) {
    for (four, out) in yuyv.chunks_exact(4).zip(rgb.chunks_mut(6)) {
        for (y, pixel) in [four[0], four[2]].into_iter().zip(out.chunks_exact_mut(3)) {
            pixel.copy_from_slice(&rgb_from_ycc(y, four[1], four[3]));
        }
    }
}

/// As [`rgb_row_from_yuyv`], of interleaved U Y V Y.
pub fn rgb_row_from_uyvy(uyvy: &[u8], rgb: &mut [u8]) {
    for (four, out) in uyvy.chunks_exact(4).zip(rgb.chunks_mut(6)) {
        for (y, pixel) in [four[1], four[3]].into_iter().zip(out.chunks_exact_mut(3)) {
            pixel.copy_from_slice(&rgb_from_ycc(y, four[0], four[2]));
        }
    }
}

/// As [`rgb_row_from_yuyv`], of a row of Y and the row of interleaved U V that it shares with its
/// neighbor.
pub fn rgb_row_from_nv12(luma: &[u8], chroma: &[u8], rgb: &mut [u8]) {
    let chroma = chroma.chunks_exact(2).flat_map(|pair| [pair, pair]);
    for ((y, uv), pixel) in luma.iter().zip(chroma).zip(rgb.chunks_exact_mut(3)) {
        pixel.copy_from_slice(&rgb_from_ycc(*y, uv[0], uv[1]));
    }
}

fn rgb_from_ycc(y: u8, u: u8, v: u8) -> [u8; 3] {
    let (y, u, v) = (i32::from(y) << 16, i32::from(u) - 128, i32::from(v) - 128);
    let channel = |value: i32| ((value + 32_768) >> 16).clamp(0, 255) as u8;
    [channel(y + 91_881 * v), channel(y - 22_554 * u - 46_802 * v), channel(y + 116_130 * u)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gray_stays_what_it_is_in_every_format() {
        for value in 0..=255 {
            assert_eq!(luma_from_rgb(value, value, value), value);
            let mut rgb = [0; 6];
            rgb_row_from_yuyv(&[value, 128, value, 128], &mut rgb);
            assert_eq!(rgb, [value; 6]);
            rgb_row_from_uyvy(&[128, value, 128, value], &mut rgb);
            assert_eq!(rgb, [value; 6]);
            rgb_row_from_nv12(&[value, value], &[128, 128], &mut rgb);
            assert_eq!(rgb, [value; 6]);
        }
    }

    #[test]
    fn colors_agree_with_bt_601() {
        assert_eq!(luma_from_rgb(255, 0, 0), 76);
        assert_eq!(luma_from_rgb(0, 255, 0), 150);
        assert_eq!(luma_from_rgb(0, 0, 255), 29);
        let mut rgb = [0; 6];
        rgb_row_from_yuyv(&[76, 85, 76, 255], &mut rgb);
        assert!(rgb[0] >= 253 && rgb[1] <= 1 && rgb[2] <= 1, "{rgb:?}");
        let (mut from_uyvy, mut from_nv12) = ([0; 6], [0; 6]);
        rgb_row_from_uyvy(&[85, 76, 255, 76], &mut from_uyvy);
        rgb_row_from_nv12(&[76, 76], &[85, 255], &mut from_nv12);
        assert_eq!((from_uyvy, from_nv12), (rgb, rgb));
    }

    #[test]
    fn the_last_row_of_a_buffer_needs_no_padding() {
        assert_eq!(buffer_length(ImageSize::new(3, 2), 8, 1), 11);
        assert_eq!(buffer_length(ImageSize::new(3, 0), 8, 1), 0);
        assert_eq!(buffer_length(ImageSize::new(u32::MAX, u32::MAX), usize::MAX, 3), usize::MAX);
    }
}
