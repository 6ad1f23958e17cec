//! Depth images that are stored mirrored, or upside down, relative to color: found by a solve with
//! that undone. Without infrared no corners show it, and the planes are fitted by another unit, or a
//! lens that does not exist.

use crate::imaging::depth_image::DepthImage;

/// How depth images are stored relative to color's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthOrientation {
    /// Left and right are exchanged.
    Mirrored,
    /// Top and bottom are exchanged.
    Flipped,
    /// Both are.
    Rotated,
}

impl DepthOrientation {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Mirrored, Self::Flipped, Self::Rotated];

    /// What it is, for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mirrored => "mirrored (left and right exchanged)",
            Self::Flipped => "flipped (top and bottom exchanged)",
            Self::Rotated => "rotated by 180 degrees",
        }
    }

    /// The image with that undone.
    pub(super) fn undone(self, depth: &DepthImage) -> Option<DepthImage> {
        let (rows, columns) = match self {
            Self::Mirrored => (false, true),
            Self::Flipped => (true, false),
            Self::Rotated => (true, true),
        };
        let (width, height) = (depth.size().width as usize, depth.size().height as usize);
        let row = |y: usize| depth.row(if rows { height - 1 - y } else { y });
        let column = |x: usize| if columns { width - 1 - x } else { x };
        let readings = (0..height).flat_map(|y| (0..width).map(move |x| row(y)[column(x)]));
        DepthImage::new(depth.size(), readings.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pixel::ImageSize;

    #[test]
    fn undoing_it_exchanges_rows_and_columns() {
        let image = DepthImage::new(ImageSize::new(3, 2), vec![1, 2, 3, 4, 5, 6]).unwrap();
        let undone = |how: DepthOrientation| how.undone(&image).unwrap().readings().to_vec();
        assert_eq!(undone(DepthOrientation::Mirrored), [3, 2, 1, 6, 5, 4]);
        assert_eq!(undone(DepthOrientation::Flipped), [4, 5, 6, 1, 2, 3]);
        assert_eq!(undone(DepthOrientation::Rotated), [6, 5, 4, 3, 2, 1]);
    }
}
