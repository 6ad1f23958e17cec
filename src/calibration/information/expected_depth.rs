//! The expected measurement of a suggested board by a depth camera: where, how accurately, and
//! whether it is possible.

use nalgebra::Point3;

use crate::calibration::information::candidate_views::BoardPoints;
use crate::estimation::rgbd::plane_information::{PlacedDepth, TileSample};
use crate::geometry::depth_camera::DepthTile;
use crate::geometry::median::median;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// The noise of a depth camera's readings, estimated from views.
#[derive(Debug, Clone, Default)]
pub struct DepthTileNoise {
    /// View by view: ln of the distance in meters, and ln of a reading's standard deviation in 1/z.
    seen: Vec<[f64; 2]>,
    /// The line through them.
    line: Option<NoiseLine>,
    /// ln of the distances at which a board in view could not be measured.
    missed: Vec<f64>,
}

/// ln of a reading's standard deviation in 1/z as a linear function of ln of the distance in
/// meters.
#[derive(Debug, Clone, Copy)]
struct NoiseLine {
    /// The mean of the views, which is a point on the line.
    mean: [f64; 2],
    slope: f64,
}

/// A reading's standard deviation in 1/z before any view: that of a stereo camera with a focal
/// length times baseline of 30 px m and a disparity error of a tenth of a pixel.
const UNSEEN_STD_PER_M: f64 = 0.003;
/// Bounds of the slope in σ(1/z) ∝ z^slope: 0 for triangulation, −2 for time of flight.
const SLOPES: [f64; 2] = [-2.5, 1.0];
/// Fewer views, or distances that differ by less than this factor, do not determine the slope.
const LEAST_DISTANCES: usize = 5;
const LEAST_RANGE: f64 = 1.3;
/// Distances with a smaller relative difference are the same.
const SAME_DISTANCE: f64 = 0.02;
/// Tiles of the sample, across and down the board.
const ACROSS: [u32; 2] = [6, 4];
/// As in the solve: tiles per view, bounds of their sides in pixels, and how many squares the
/// surface extends beyond the outer corners.
const TILES: f64 = 150.0;
const SIDES_PX: [f64; 2] = [6.0, 48.0];
const MARGIN_SQUARES: f64 = 0.8;
/// The least number of tiles for a plane.
const LEAST_TILES: f64 = 6.0;

impl DepthTileNoise {
    /// Learns from the tiles of views, each with the distance of its board in meters. Distances at
    /// which boards were missed before are forgotten: the boards may have been searched for in the
    /// wrong place.
    pub fn learn<'a>(&mut self, views: impl Iterator<Item = (f64, &'a [DepthTile])>) {
        let of_view = |(z_m, tiles): (f64, &[DepthTile])| {
            let std = median(tiles.iter().map(|tile| tile.reading_std).collect())?;
            Some([z_m.ln(), std.max(f64::MIN_POSITIVE).ln()])
        };
        self.seen = views.filter_map(of_view).collect();
        let mean = |axis: usize| {
            self.seen.iter().map(|view| view[axis]).sum::<f64>() / self.seen.len().max(1) as f64
        };
        let mean = [mean(0), mean(1)];
        let sum = |of: fn([f64; 2]) -> f64| {
            let each = self.seen.iter().map(|view| [view[0] - mean[0], view[1] - mean[1]]);
            each.map(of).sum::<f64>()
        };
        let nearest = self.seen.iter().map(|view| view[0]).fold(f64::INFINITY, f64::min);
        let farthest = self.seen.iter().map(|view| view[0]).fold(f64::NEG_INFINITY, f64::max);
        let shows_slope =
            self.seen.len() >= LEAST_DISTANCES && farthest - nearest > LEAST_RANGE.ln();
        let slope = sum(|[x, y]| x * y) / sum(|[x, _]| x * x);
        let slope = if shows_slope { slope.clamp(SLOPES[0], SLOPES[1]) } else { 0.0 };
        self.missed.clear();
        self.line = (!self.seen.is_empty()).then_some(NoiseLine { mean, slope });
    }

    /// Records that a board in view at this distance was not measured.
    pub fn miss(&mut self, z_m: f64) {
        let is_known = |known: &f64| (z_m.ln() - known).abs() < SAME_DISTANCE;
        if z_m > 0.0 && !self.missed.iter().any(is_known) {
            self.missed.push(z_m.ln());
        }
    }

    /// A reading's standard deviation in 1/z at a distance, in 1/m.
    fn std_per_m(&self, z_m: f64) -> f64 {
        self.line.map_or(UNSEEN_STD_PER_M, |NoiseLine { mean, slope }| {
            (mean[1] + slope * (z_m.ln() - mean[0])).exp()
        })
    }

    /// Whether a board at the nearest distance on record was measured.
    fn is_measured(&self, z_m: f64) -> bool {
        let off = |known: f64| (known - z_m.ln()).abs();
        let nearest =
            |all: &mut dyn Iterator<Item = f64>| all.map(off).fold(f64::INFINITY, f64::min);
        let measured = nearest(&mut self.seen.iter().map(|view| view[0]));
        measured <= nearest(&mut self.missed.iter().copied()) || self.seen.is_empty()
    }

    /// A sample of the tiles of a board there; `None` where depth would not measure it.
    pub fn expected(
        &self,
        depth: &PlacedDepth,
        size: ImageSize,
        board: &BoardPoints,
        color_from_board: &Pose,
    ) -> Option<TileSample> {
        let depth_from_board = depth.depth_from_color * *color_from_board;
        let outline = board.outline(MARGIN_SQUARES);
        let pixel = |point: Point3<f64>| depth.lens.pixel_from_point(&(depth_from_board * point));
        let [a, b, c, d] = outline.map(pixel);
        let [a, b, c, d] = [a?, b?, c?, d?];
        let area_px = 0.5 * ((c.x - a.x) * (d.y - b.y) - (d.x - b.x) * (c.y - a.y)).abs();
        let middle_m = (depth_from_board * board.middle()).z;
        if !(middle_m > 0.0 && self.is_measured(middle_m)) {
            return None;
        }
        let [near, far] = [outline[0], outline[2]];
        let side_px = (area_px / TILES).sqrt().clamp(SIDES_PX[0], SIDES_PX[1]);
        let tile = |k: u32| {
            let part = |k: u32, count: u32, near: f64, far: f64| {
                near + (f64::from(k) + 0.5) / f64::from(count) * (far - near)
            };
            let (i, j) = (k % ACROSS[0], k / ACROSS[0]);
            let (x, y) = (part(i, ACROSS[0], near.x, far.x), part(j, ACROSS[1], near.y, far.y));
            let pixel = pixel(Point3::new(x, y, 0.0)).filter(|pixel| size.contains(*pixel))?;
            let plane = depth.plane_inverse_depth(&depth_from_board, pixel)?;
            Some(DepthTile {
                pixel,
                inverse_depth: depth.uncorrected(pixel, plane),
                reading_std: self.std_per_m(1.0 / plane),
                count: (side_px * side_px) as u32,
            })
        };
        let tiles: Vec<DepthTile> = (0..ACROSS[0] * ACROSS[1]).filter_map(tile).collect();
        let each = area_px / (side_px * side_px) / f64::from(ACROSS[0] * ACROSS[1]);
        (each * tiles.len() as f64 >= LEAST_TILES).then_some(TileSample { tiles, each })
    }
}
