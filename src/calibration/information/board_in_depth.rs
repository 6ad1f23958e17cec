//! What depth and infrared show of one view of a board.

use crate::calibration::information::camera_information::ViewInformation;
use crate::calibration::information::depth_fit::sample;
use crate::estimation::rgbd::plane_information::TileSample;
use crate::geometry::depth_camera::DepthTile;

/// What depth and infrared show of one view.
#[derive(Debug, Clone, Default)]
pub struct BoardInDepth {
    /// The board's surface; `None` where depth did not measure it.
    pub surface: Option<MeasuredView>,
    /// The corners that infrared sees; `None` where it sees no board.
    pub infrared: Option<ViewInformation>,
}

/// The board's surface in the depth image of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredView {
    /// Which of the session's views it is.
    pub number: u32,
    pub(super) tiles: Vec<DepthTile>,
    /// A sample of the tiles on the board's plane.
    pub(super) sample: TileSample,
    /// The distance of the surface, in meters.
    pub(super) z_m: f64,
}

impl MeasuredView {
    pub(super) fn new(number: u32, tiles: Vec<DepthTile>) -> Self {
        let z_m = distance_m(&tiles);
        let sample = sample(&tiles, &vec![true; tiles.len()]);
        Self { number, tiles, sample, z_m }
    }

    /// The same with this number.
    #[must_use]
    pub fn numbered(self, number: u32) -> Self {
        Self { number, ..self }
    }
}

/// The distance of a surface, in meters.
pub(super) fn distance_m(tiles: &[DepthTile]) -> f64 {
    let sum = tiles.iter().map(|tile| tile.inverse_depth).sum::<f64>();
    tiles.len() as f64 / sum.max(f64::MIN_POSITIVE)
}
