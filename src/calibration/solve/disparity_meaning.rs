//! The meaning of disparity that nobody states: 1/z as a linear function of the reading, from the
//! readings in the board's middle and its distances by color.

use nalgebra::{Point3, center};

use crate::geometry::depth_camera::{DepthReading, PosedDepthLens};
use crate::geometry::median::median;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;

/// A reading in the middle of a board at a known distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::calibration) struct KnownReading {
    pub(in crate::calibration) reading: f64,
    /// 1/z of the board's middle in front of the depth camera, in 1/m.
    pub(in crate::calibration) inverse_depth: f64,
}

/// The reading of `image` in the middle of `board`; `None` where that is outside the image, or the
/// reading is `invalid`.
pub(in crate::calibration) fn reading_in_middle(
    (image, invalid): (&DepthImage, Option<u16>),
    depth: &PosedDepthLens,
    board: &Target,
    color_from_board: &Pose,
) -> Option<KnownReading> {
    let [near, far] = board.extent();
    let middle: Point3<f64> = center(&near, &far);
    let point = depth.depth_from_color * (*color_from_board * middle);
    let pixel = depth.lens.pixel_from_point(&point)?;
    let (x, y) = (pixel.x.round(), pixel.y.round());
    let is_inside = image.size().contains(Pixel::new(x, y)) && image.only_reading().is_none();
    let reading = is_inside.then(|| image.row(y as usize)[x as usize])?;
    (Some(reading) != invalid)
        .then(|| KnownReading { reading: f64::from(reading), inverse_depth: 1.0 / point.z })
}

/// The line through readings at known distances, by the median of the slopes between them
/// (H. Theil, 1950); `None` where no two readings differ.
pub(in crate::calibration) fn disparity_through(known: &[KnownReading]) -> Option<DepthReading> {
    let slopes = known.iter().enumerate().flat_map(|(k, a)| {
        let others = known[k + 1..].iter().filter(|b| (a.reading - b.reading).abs() > 1.0);
        others.map(|b| (a.inverse_depth - b.inverse_depth) / (a.reading - b.reading))
    });
    let slope = median(slopes.collect())?;
    let offsets = known.iter().map(|it| it.inverse_depth - slope * it.reading);
    Some(DepthReading::Disparity { offset: median(offsets.collect())?, slope })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_reading_beside_the_board_does_not_move_the_line() {
        let at = |reading: f64| KnownReading { reading, inverse_depth: 3.1 - 0.0028 * reading };
        let mut known = [600.0, 700.0, 820.0, 910.0].map(at).to_vec();
        known.push(KnownReading { reading: 400.0, inverse_depth: 0.9 });
        let Some(DepthReading::Disparity { offset, slope }) = disparity_through(&known) else {
            panic!("no line")
        };
        assert!((slope + 0.0028).abs() < 1e-9 && (offset - 3.1).abs() < 1e-6, "{offset} {slope}");
        assert_eq!(disparity_through(&[at(600.0), at(600.0)]), None);
    }
}
