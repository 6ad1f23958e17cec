//! Image coverage: a grid of cells, each with the number of corners seen in it.

use crate::detection::board_detection::Detection;
use crate::geometry::pixel::{ImageSize, Pixel};

/// Cells along the image's longer and shorter side.
const LONG_CELLS: usize = 8;
const SHORT_CELLS: usize = 6;

/// How many corners of kept views fell into each cell of the image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Coverage {
    cells: Vec<Vec<u32>>,
}

impl Default for Coverage {
    /// Empty, for images in landscape format.
    fn default() -> Self {
        Self { cells: vec![vec![0; LONG_CELLS]; SHORT_CELLS] }
    }
}

impl Coverage {
    /// Empty, for images of `size`.
    pub fn empty(size: ImageSize) -> Self {
        let (cols, rows) = if size.width >= size.height {
            (LONG_CELLS, SHORT_CELLS)
        } else {
            (SHORT_CELLS, LONG_CELLS)
        };
        Self { cells: vec![vec![0; cols]; rows] }
    }

    /// From stored counts, row by row; `None` unless every row has the same number of cells, at
    /// least one.
    pub fn from_cells(cells: Vec<Vec<u32>>) -> Option<Self> {
        let cols = cells.first()?.len();
        (cols > 0 && cells.iter().all(|row| row.len() == cols)).then_some(Self { cells })
    }

    /// Counts the corners of `detection` in an image of `size`.
    pub fn add(&mut self, detection: &Detection, size: ImageSize) {
        self.add_pixels(detection.corners.iter().map(|corner| corner.pixel), size);
    }

    /// Counts `pixels` of an image of `size`.
    pub fn add_pixels(&mut self, pixels: impl IntoIterator<Item = Pixel>, size: ImageSize) {
        for pixel in pixels {
            if let Some((row, col)) = self.cell_of(pixel, size) {
                self.cells[row][col] = self.cells[row][col].saturating_add(1);
            }
        }
    }

    /// The counts, row by row from the image's top, each row from its left.
    pub fn cells(&self) -> &[Vec<u32>] {
        &self.cells
    }

    /// The fraction of cells in which a corner was seen, 0 to 1.
    pub fn fraction(&self) -> f64 {
        let cells = self.cells.iter().flatten();
        let seen = cells.clone().filter(|count| **count > 0).count();
        seen as f64 / cells.count() as f64
    }

    /// The cell (row, column) that `pixel` lies in; `None` outside the image.
    pub fn cell_of(&self, pixel: Pixel, size: ImageSize) -> Option<(usize, usize)> {
        if !size.contains(pixel) {
            return None;
        }
        let cell = |x: f64, length: u32, cells: usize| {
            let cell = (x + 0.5) / f64::from(length) * cells as f64;
            (cell as usize).min(cells - 1)
        };
        let (rows, cols) = (self.cells.len(), self.cells[0].len());
        Some((cell(pixel.y, size.height, rows), cell(pixel.x, size.width, cols)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_has_one_cell_and_the_outside_none() {
        let size = ImageSize::new(640, 480);
        let coverage = Coverage::empty(size);
        assert_eq!(coverage.cell_of(Pixel::new(-0.5, -0.5), size), Some((0, 0)));
        assert_eq!(coverage.cell_of(Pixel::new(639.4, 479.4), size), Some((5, 7)));
        assert_eq!(coverage.cell_of(Pixel::new(79.49, 0.0), size), Some((0, 0)));
        assert_eq!(coverage.cell_of(Pixel::new(79.51, 0.0), size), Some((0, 1)));
        for outside in [Pixel::new(-0.6, 10.0), Pixel::new(639.5, 10.0), Pixel::new(f64::NAN, 10.0)]
        {
            assert_eq!(coverage.cell_of(outside, size), None);
        }
    }

    #[test]
    fn a_tall_image_has_tall_cells() {
        let coverage = Coverage::empty(ImageSize::new(480, 640));
        assert_eq!((coverage.cells().len(), coverage.cells()[0].len()), (8, 6));
        assert_eq!(coverage.fraction(), 0.0);
    }
}
