//! What a thin lens keeps sharp, and which board suits it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::geometry::thin_lens::{DepthOfField, ThinLens};

/// How much of the image's width the advised board fills.
const FILL: f64 = 0.5;
/// The sharp range is cut off at this many times its nearest distance: a board in the middle of an
/// unbounded one would be too large. Chosen.
const MOST_FAR_OVER_NEAR: f64 = 3.0;

/// What a lens keeps sharp: distances in meters from the lens, null for infinity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FocusDocument {
    /// Focal length, in meters.
    pub focal_m: f64,
    /// Focal length over the aperture's diameter.
    pub f_number: f64,
    /// The width of one pixel, in meters.
    pub pixel_m: f64,
    /// The distance in focus.
    pub focus_m: Option<f64>,
    /// Largest acceptable circle of confusion, in pixels.
    pub blur_px: f64,
    /// Between which distances things, and so a board, are sharp.
    pub depth_of_field: DepthOfFieldDocument,
    /// The nearest focus that keeps infinity sharp.
    pub hyperfocal_m: f64,
    /// The focal length that a calibration should find, in pixels.
    pub focal_px: f64,
    /// A board to use and where to hold it; null where no number of squares was given.
    pub board: Option<BoardAdviceDocument>,
}

/// Between which distances things are sharp.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DepthOfFieldDocument {
    /// The nearest.
    pub near_m: f64,
    /// The farthest; null for infinity.
    pub far_m: Option<f64>,
}

/// A board that fills half of the image's width where it is sharp, tilted too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BoardAdviceDocument {
    /// Inner corners along a row.
    pub cols: u32,
    /// The side of one square, in meters.
    pub square_m: f64,
    /// Where to hold it.
    pub distance_m: f64,
}

impl BoardAdviceDocument {
    /// A board of `cols` inner corners a row, for an image `width_px` pixels wide. At its distance
    /// both the nearest and the farthest corner of the tilted board stay sharp to `blur_px`: it is
    /// the middle (in 1/distance) of the sharp range, which is cut off at three times its nearest
    /// distance.
    fn new(lens: &ThinLens, blur_px: f64, cols: u32, width_px: u32) -> Self {
        let DepthOfField { near_m, far_m } = lens.depth_of_field(blur_px);
        let far_m = far_m.min(MOST_FAR_OVER_NEAR * near_m);
        let distance_m = 2.0 / (1.0 / near_m + 1.0 / far_m);
        let width_m = FILL * f64::from(width_px) * distance_m / lens.focal_px();
        Self { cols, square_m: width_m / f64::from(cols.saturating_add(1)), distance_m }
    }
}

impl FocusDocument {
    /// For a lens of which `blur_px` is sharp enough; `board` is the inner corners along a row and
    /// the image's width in pixels.
    pub fn new(lens: &ThinLens, blur_px: f64, board: Option<(u32, u32)>) -> Self {
        let bounded = |distance_m: f64| distance_m.is_finite().then_some(distance_m);
        let depth = lens.depth_of_field(blur_px);
        let advice = |(cols, width_px)| BoardAdviceDocument::new(lens, blur_px, cols, width_px);
        Self {
            focal_m: lens.focal_m,
            f_number: lens.f_number,
            pixel_m: lens.pixel_m,
            focus_m: bounded(lens.focus_m),
            blur_px,
            depth_of_field: DepthOfFieldDocument {
                near_m: depth.near_m,
                far_m: bounded(depth.far_m),
            },
            hyperfocal_m: lens.hyperfocal_m(blur_px),
            focal_px: lens.focal_px(),
            board: board.map(advice),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::reading::{from_json, to_json};

    #[test]
    fn infinity_is_null_and_the_rest_survives() {
        let lens =
            ThinLens { focal_m: 0.008, f_number: 2.0, pixel_m: 3.45e-6, focus_m: f64::INFINITY };
        let document = FocusDocument::new(&lens, 1.0, Some((9, 1280)));
        assert_eq!((document.focus_m, document.depth_of_field.far_m), (None, None));
        let board = document.board.clone().unwrap();
        let width_px = board.square_m * 10.0 / board.distance_m * document.focal_px;
        assert!((width_px - 640.0).abs() < 1e-9, "half of the width: {width_px}");
        assert!(lens.blur_px(board.distance_m) < 1.0, "{board:?}");
        let json = to_json(&document).unwrap();
        assert_eq!(from_json::<FocusDocument>(json.as_bytes()), Ok(document));
    }
}
