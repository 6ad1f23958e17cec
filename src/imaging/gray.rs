//! Eight-bit luma images: what boards are searched for in; and images of 16 bits.

use crate::geometry::pixel::ImageSize;

/// A gray image of 16 bits, as infrared sensors give it.
pub type Gray16Image = image::ImageBuffer<image::Luma<u16>, Vec<u16>>;

/// An owned 8-bit luma image, rows without padding.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct GrayImage {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl GrayImage {
    /// An image of `width` × `height` pixels, all `value`.
    pub fn filled(width: usize, height: usize, value: u8) -> Self {
        Self { width, height, pixels: vec![value; width * height] }
    }

    /// From row-major pixels; `None` unless there are exactly `width` × `height`.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<u8>) -> Option<Self> {
        (pixels.len() == width.checked_mul(height)?).then_some(Self { width, height, pixels })
    }

    /// Makes it `width` × `height`, keeping its memory; what the pixels then hold is unspecified.
    pub fn reshape(&mut self, width: usize, height: usize) {
        self.pixels.resize(width * height, 0);
        (self.width, self.height) = (width, height);
    }

    /// Its pixels, row by row.
    pub fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Width and height.
    pub fn size(&self) -> ImageSize {
        ImageSize::new(self.width as u32, self.height as u32)
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// All pixels, row by row.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// The pixels of row `y`.
    pub fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// A borrowed view of the whole image.
    pub fn view(&self) -> GrayView<'_> {
        GrayView {
            width: self.width,
            height: self.height,
            stride: self.width,
            pixels: &self.pixels,
        }
    }
}

/// A borrowed 8-bit luma image, whose rows may be padded: a camera's buffer is read where it
/// lies.
#[derive(Debug, Clone, Copy)]
pub struct GrayView<'a> {
    width: usize,
    height: usize,
    stride: usize,
    pixels: &'a [u8],
}

impl<'a> GrayView<'a> {
    /// Rows of `width` pixels every `stride` bytes; `None` if `pixels` is too short or `stride` <
    /// `width`.
    pub fn new(width: usize, height: usize, stride: usize, pixels: &'a [u8]) -> Option<Self> {
        let needed =
            if height == 0 { 0 } else { stride.checked_mul(height - 1)?.checked_add(width)? };
        (stride >= width && pixels.len() >= needed).then_some(Self {
            width,
            height,
            stride,
            pixels,
        })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Width and height.
    pub fn size(&self) -> ImageSize {
        ImageSize::new(self.width as u32, self.height as u32)
    }

    /// Bytes from the start of one row to the start of the next.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The buffer that holds the rows, each starting [`stride`](Self::stride) bytes after the one
    /// above.
    pub fn bytes(&self) -> &'a [u8] {
        self.pixels
    }

    /// The pixels of row `y`.
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.pixels[y * self.stride..y * self.stride + self.width]
    }
}
