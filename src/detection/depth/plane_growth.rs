//! The flat surface that a board lies on: a plate, a table, a wall. A board covers a small part of
//! most depth images; its support often covers the whole image, and determines what the board alone
//! cannot.
//!
//! Patches are added from the board outwards, each next to one already added. A patch is tested by
//! its own noise, its slope and its distance from the common plane. An edge, a gap or a step ends
//! the surface.

use nalgebra::{Matrix3, Vector3};

use crate::detection::depth::board_plane::{DepthInput, PlaneOptions, fit_tile};
use crate::geometry::depth_camera::DepthTile;
use crate::geometry::lens::Lens;
use crate::geometry::median::median;
use crate::geometry::pixel::Pixel;

/// Approximate number of patches that cover an image. Chosen, not swept.
const PATCHES: f64 = 400.0;

/// Least side of a patch, in pixels: 36 readings, twelve for each unknown of a plane.
const LEAST_SIDE_PX: usize = 6;

/// A patch continues its neighbor if their deviations from the common plane differ by at most this
/// many standard deviations of both, plus this fraction of 1/z: the systematic error changes by
/// less from patch to patch. Neither was swept.
const MOST_STEP_STDS: f64 = 4.0;
const MOST_STEP_PART: f64 = 0.0015;

/// A patch whose readings scatter more than this many times as much as the board's contains an
/// edge. Chosen, not swept.
const MOST_SCATTER: f64 = 1.6;

/// Neighboring readings are correlated: the standard deviation of a patch's mean is at least this
/// fraction of that of one reading.
const LEAST_READING_STDS: f64 = 0.1;

/// One patch of the image.
#[derive(Clone, Copy)]
struct PlanePatch {
    tile: DepthTile,
    ray: Vector3<f64>,
}

/// The patches of the surface that `board` (its own patches) lies on, without those inside its
/// `outline`.
pub fn grow_plane(
    depth: DepthInput<'_>,
    board: &[DepthTile],
    outline: &[Pixel],
    options: &PlaneOptions,
) -> Vec<DepthTile> {
    let stds = board.iter().map(|tile| tile.reading_std).collect();
    let Some(median_std) = median(stds) else { return Vec::new() };
    let mut patches = PatchGrid::new(depth, options.invalid, median_std);
    let mut plane = PlaneSums::default();
    board
        .iter()
        .filter_map(|tile| Some(PlanePatch { tile: *tile, ray: ray(depth.lens, tile.pixel)? }))
        .for_each(|p| plane.add(&p));
    let mut layer: Vec<usize> = (0..patches.count())
        .filter(|cell| is_inside(outline, patches.middle(*cell)) && patches.at(*cell).is_some())
        .collect();
    let mut taken = vec![false; patches.count()];
    layer.iter().for_each(|cell| taken[*cell] = true);
    let mut grown = Vec::new();
    while let (false, Some(normal)) = (layer.is_empty(), plane.solve()) {
        let continues =
            |near: &PlanePatch, next: &PlanePatch| goes_on(&normal, near, next, options.tolerance);
        layer = patches.next_layer(&layer, &mut taken, continues);
        for patch in layer.iter().filter_map(|cell| patches.at(*cell)) {
            plane.add(&patch);
            if !is_inside(outline, patch.tile.pixel) {
                grown.push(patch.tile);
            }
        }
    }
    grown
}

/// The patches of an image, row by row. Most are never reached: each is measured on first use.
struct PatchGrid<'a> {
    depth: DepthInput<'a>,
    invalid: Option<u16>,
    /// The median scatter of the board's readings, in 1/z.
    median_std: f64,
    /// Pixels along a side of a patch.
    side: usize,
    /// How many there are along a row and along a column.
    across: usize,
    down: usize,
    measured: Vec<Option<Option<PlanePatch>>>,
}

impl<'a> PatchGrid<'a> {
    fn new(depth: DepthInput<'a>, invalid: Option<u16>, median_std: f64) -> Self {
        let size = depth.image.size();
        let area = f64::from(size.width) * f64::from(size.height);
        let side = ((area / PATCHES).sqrt() as usize).max(LEAST_SIDE_PX);
        let (across, down) = (size.width as usize / side, size.height as usize / side);
        let measured = vec![None; across * down];
        Self { depth, invalid, median_std, side, across, down, measured }
    }

    fn count(&self) -> usize {
        self.measured.len()
    }

    fn middle(&self, cell: usize) -> Pixel {
        let [x, y] = [cell % self.across, cell / self.across];
        Pixel::new((x as f64 + 0.5) * self.side as f64, (y as f64 + 0.5) * self.side as f64)
    }

    fn at(&mut self, cell: usize) -> Option<PlanePatch> {
        let measured = self.measured[cell].unwrap_or_else(|| self.measure(cell));
        self.measured[cell] = Some(measured);
        measured
    }

    fn measure(&self, cell: usize) -> Option<PlanePatch> {
        let DepthInput { reading, lens, .. } = self.depth;
        let corner = [cell % self.across, cell / self.across].map(|place| place * self.side);
        let tile = measure(self.depth, self.invalid, corner, self.side)?;
        // With quantization alone, a patch along a step of depth has no scatter, so only greater
        // scatter is suspect.
        let step = reading.inverse_depth_step(tile.inverse_depth);
        (tile.reading_std <= MOST_SCATTER * self.median_std.hypot(0.5 * step)).then_some(())?;
        Some(PlanePatch { tile, ray: ray(lens, tile.pixel)? })
    }

    /// The patches that continue those of `layer` and are not yet `taken`.
    fn next_layer(
        &mut self,
        layer: &[usize],
        taken: &mut [bool],
        continues: impl Fn(&PlanePatch, &PlanePatch) -> bool,
    ) -> Vec<usize> {
        let mut next = Vec::new();
        for from in layer {
            let Some(near) = self.at(*from) else { continue };
            for cell in neighbors(*from, self.across, self.down) {
                if !taken[cell] && self.at(cell).is_some_and(|patch| continues(&near, &patch)) {
                    taken[cell] = true;
                    next.push(cell);
                }
            }
        }
        next
    }
}

/// Sums for a least squares plane: n of n · ray = 1/z.
#[derive(Default)]
struct PlaneSums {
    square: Matrix3<f64>,
    right: Vector3<f64>,
}

impl PlaneSums {
    fn add(&mut self, patch: &PlanePatch) {
        self.square += patch.ray * patch.ray.transpose();
        self.right += patch.ray * patch.tile.inverse_depth;
    }

    fn solve(&self) -> Option<Vector3<f64>> {
        Some(self.square.cholesky()?.solve(&self.right))
    }
}

fn goes_on(plane: &Vector3<f64>, near: &PlanePatch, next: &PlanePatch, tolerance: f64) -> bool {
    let off = |patch: &PlanePatch| patch.tile.inverse_depth - plane.dot(&patch.ray);
    let std = |patch: &PlanePatch| {
        patch.tile.reading_std * (1.0 / f64::from(patch.tile.count)).sqrt().max(LEAST_READING_STDS)
    };
    let limit =
        MOST_STEP_STDS * std(near).hypot(std(next)) + MOST_STEP_PART * next.tile.inverse_depth;
    (off(next) - off(near)).abs() <= limit && off(next).abs() <= tolerance * next.tile.inverse_depth
}

fn neighbors(cell: usize, across: usize, down: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (cell % across, cell / across);
    let left = (x > 0).then(|| cell - 1);
    let right = (x + 1 < across).then_some(cell + 1);
    let above = (y > 0).then(|| cell - across);
    let below = (y + 1 < down).then_some(cell + across);
    [left, right, above, below].into_iter().flatten()
}

/// The patch with this top left corner; `None` where more than a quarter of its readings is
/// missing.
fn measure(
    depth: DepthInput<'_>,
    invalid: Option<u16>,
    [left, top]: [usize; 2],
    side: usize,
) -> Option<DepthTile> {
    let mut samples = Vec::with_capacity(side * side);
    for y in top..top + side {
        for (x, raw) in depth.image.row(y).iter().enumerate().skip(left).take(side) {
            if Some(*raw) != invalid
                && let Some(inverse) = depth.reading.inverse_depth(f64::from(*raw))
            {
                samples.push([x as f64, y as f64, inverse]);
            }
        }
    }
    if 4 * samples.len() < 3 * side * side { None } else { fit_tile(&mut samples) }
}

fn ray(lens: &Lens, pixel: Pixel) -> Option<Vector3<f64>> {
    let bearing = lens.bearing_from_pixel(pixel)?;
    (bearing.z > 1e-3).then(|| bearing.into_inner() / bearing.z)
}

/// Whether a closed polygon has `pixel` inside, by the crossings to its left.
fn is_inside(outline: &[Pixel], pixel: Pixel) -> bool {
    let sides = outline.iter().zip(outline.iter().cycle().skip(1));
    let crossings = sides.filter(|(a, b)| {
        (a.y <= pixel.y) != (b.y <= pixel.y)
            && a.x + (pixel.y - a.y) / (b.y - a.y) * (b.x - a.x) < pixel.x
    });
    crossings.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::depth::board_plane::find_board_plane;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::depth_camera::DepthReading;
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::depth_image::DepthImage;

    const METRIC: DepthReading = DepthReading::Metric { unit_m: 0.0001 };

    fn lens() -> Lens {
        Lens::pinhole(CameraMatrix { fx: 300.0, fy: 300.0, cx: 160.0, cy: 120.0, skew: 0.0 })
    }

    /// Grows from a board in the middle of an image with this depth, in meters.
    fn grown(z_m: impl Fn(f64, f64) -> f64) -> Vec<DepthTile> {
        let noise = |k: usize| 0.0004 * ((k as f64 * 12.9898).sin() * 43_758.545_3).fract();
        let reading = |k: usize| {
            ((z_m((k % 320) as f64, (k / 320) as f64) + noise(k)) * 10_000.0).round() as u16
        };
        let image =
            DepthImage::new(ImageSize::new(320, 240), (0..320 * 240).map(reading).collect())
                .unwrap();
        let outline: Vec<Pixel> = [(120.0, 90.0), (200.0, 90.0), (200.0, 150.0), (120.0, 150.0)]
            .map(|(x, y)| Pixel::new(x, y))
            .to_vec();
        let options = PlaneOptions::default();
        let depth = DepthInput { image: &image, reading: METRIC, lens: &lens() };
        let board = find_board_plane(depth, &outline, &options).unwrap();
        grow_plane(depth, &board, &outline, &options)
    }

    fn tilted(x: f64, y: f64) -> f64 {
        1.0 / (1.0 + 0.0006 * (x - 160.0) - 0.0003 * (y - 120.0))
    }

    #[test]
    fn a_wall_is_followed_to_its_edges_and_through_a_slow_error() {
        let all = grown(tilted);
        assert!(all.len() > 300, "{}", all.len());
        assert!(all.iter().all(|tile| {
            (1.0 / tile.inverse_depth - tilted(tile.pixel.x, tile.pixel.y)).abs() < 5e-4
        }));
        let bent =
            grown(|x, y| tilted(x, y) * (1.0 + 2e-7 * ((x - 160.0).powi(2) + (y - 120.0).powi(2))));
        assert!(bent.len() > 300, "{}", bent.len());
    }

    #[test]
    fn a_step_an_edge_and_another_wall_end_it() {
        let right_of =
            |tiles: &[DepthTile], x: f64| tiles.iter().filter(|tile| tile.pixel.x > x).count();
        let step = grown(|x, y| tilted(x, y) + if x > 230.0 { 0.02 } else { 0.0 });
        assert!(
            right_of(&step, 232.0) == 0 && step.len() > 150,
            "{} {}",
            right_of(&step, 232.0),
            step.len()
        );
        let corner = grown(|x, y| tilted(x, y) - if x > 230.0 { 0.004 * (x - 230.0) } else { 0.0 });
        assert!(
            right_of(&corner, 245.0) == 0 && corner.len() > 150,
            "{}",
            right_of(&corner, 245.0)
        );
        let alone = grown(|x, y| {
            if (115.0..205.0).contains(&x) && (85.0..155.0).contains(&y) { 1.0 } else { 1.5 }
        });
        assert!(alone.len() < 4, "{}", alone.len());
    }
}
