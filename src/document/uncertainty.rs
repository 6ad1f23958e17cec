//! How well projections are known over an image, in numbers.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::estimation::uncertainty::{Distance, UncertaintyMap};

/// The predicted 1-σ uncertainty of projections on a grid of pixels over the image, after the best
/// compensating motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UncertaintyMapDocument {
    /// Whose: `color`, `infrared`, `infrared2`, or a rig's camera.
    pub sensor: String,
    /// How far away things are, in meters; null at infinity.
    pub distance_m: Option<f64>,
    /// Width and height of the image, in pixels.
    pub image_size: [u32; 2],
    /// The grid's columns, in pixels from the left.
    pub x_px: Vec<f64>,
    /// The grid's rows, in pixels from the top.
    pub y_px: Vec<f64>,
    /// Standard deviation in the worst direction at each pixel of the grid, row by row, in pixels;
    /// null where the lens sees nothing.
    pub std_px: Vec<Vec<Option<f64>>>,
}

impl UncertaintyMapDocument {
    /// Of `sensor`, for things at `distance`.
    pub fn new(sensor: &str, distance: Distance, map: &UncertaintyMap) -> Self {
        let grid = map.grid;
        let cols = grid.cols as usize;
        Self {
            sensor: sensor.to_owned(),
            distance_m: match distance {
                Distance::Infinity => None,
                Distance::Meters(meters) => Some(meters),
            },
            image_size: [grid.size.width, grid.size.height],
            x_px: grid.pixels().take(cols).map(|pixel| pixel.x).collect(),
            y_px: grid.pixels().step_by(cols.max(1)).map(|pixel| pixel.y).collect(),
            std_px: map.std_px.chunks(cols.max(1)).map(<[_]>::to_vec).collect(),
        }
    }
}
