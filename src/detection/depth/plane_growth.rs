//! The flat surface that a board lies on: a plate, a table, a wall. A board covers a small part of
//! most depth images; its support often covers the whole image, and determines what the board alone
//! cannot.
//!
//! Patches are added from the board outwards, each next to one already added. A patch is tested by
//! its own noise, its slope and its distance from the common plane. An edge, a gap or a step ends
//! the surface.

use nalgebra::{Matrix3, Vector3};

use crate::detection::depth::board_plane::{PlaneOptions, fit_tile};
use crate::geometry::depth_camera::{DepthReading, DepthTile};
use crate::geometry::lens::Lens;
use crate::geometry::median::median;
use crate::geometry::pixel::Pixel;
use crate::imaging::depth_image::DepthImage;

/// Approximate number of patches that cover an image.
const PATCHES: f64 = 400.0;

/// A patch continues its neighbor if their deviations from the common plane differ by at most this
/// many standard deviations of both, plus this fraction of 1/z: the systematic error changes by
/// less from patch to patch.
const STEP: [f64; 2] = [4.0, 0.0015];

/// A patch whose readings scatter more than this many times as much as the board's contains an
/// edge.
const ROUGH: f64 = 1.6;

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
    image: &DepthImage,
    (reading, lens): (DepthReading, &Lens),
    (board, outline): (&[DepthTile], &[Pixel]),
    options: &PlaneOptions,
) -> Vec<DepthTile> {
    let size = image.size();
    let side = ((f64::from(size.width) * f64::from(size.height) / PATCHES).sqrt() as usize).max(6);
    let (across, down) = (size.width as usize / side, size.height as usize / side);
    let stds = board.iter().map(|tile| tile.reading_std).collect();
    let Some(median_std) = median(stds) else { return Vec::new() };
    let patch = |cell: usize| {
        let tile = measure(
            image,
            reading,
            options.invalid,
            [cell % across * side, cell / across * side],
            side,
        )?;
        // With quantization alone, a patch along a step of depth has no scatter, so only greater
        // scatter is suspect.
        let step = reading.inverse_depth_step(tile.inverse_depth);
        (tile.reading_std <= ROUGH * median_std.hypot(0.5 * step)).then_some(())?;
        Some(PlanePatch { tile, ray: ray(lens, tile.pixel)? })
    };
    let mut plane = PlaneSums::default();
    board
        .iter()
        .filter_map(|tile| Some(PlanePatch { tile: *tile, ray: ray(lens, tile.pixel)? }))
        .for_each(|p| plane.add(&p));
    // Most patches are never reached: each is measured on first use.
    let mut measured: Vec<Option<Option<PlanePatch>>> = vec![None; across * down];
    let mut patch_at = |cell: usize| *measured[cell].get_or_insert_with(|| patch(cell));
    let inside = |pixel: Pixel| is_inside(outline, pixel);
    let on_board = |cell: usize| {
        let at = Pixel::new(
            ((cell % across) as f64 + 0.5) * side as f64,
            ((cell / across) as f64 + 0.5) * side as f64,
        );
        inside(at)
    };
    let mut layer: Vec<usize> =
        (0..across * down).filter(|cell| on_board(*cell) && patch_at(*cell).is_some()).collect();
    let mut taken = vec![false; across * down];
    layer.iter().for_each(|cell| taken[*cell] = true);
    let mut grown = Vec::new();
    while let (false, Some(normal)) = (layer.is_empty(), plane.solve()) {
        let mut next = Vec::new();
        for from in &layer {
            let Some(near) = patch_at(*from) else { continue };
            for cell in neighbors(*from, across, down) {
                let Some(patch) = (if taken[cell] { None } else { patch_at(cell) }) else {
                    continue;
                };
                if goes_on(&normal, &near, &patch, options.tolerance) {
                    taken[cell] = true;
                    next.push(cell);
                }
            }
        }
        for cell in &next {
            if let Some(patch) = patch_at(*cell) {
                plane.add(&patch);
                if !inside(patch.tile.pixel) {
                    grown.push(patch.tile);
                }
            }
        }
        layer = next;
    }
    grown
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
    let limit = STEP[0] * std(near).hypot(std(next)) + STEP[1] * next.tile.inverse_depth;
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
    image: &DepthImage,
    reading: DepthReading,
    invalid: Option<u16>,
    [left, top]: [usize; 2],
    side: usize,
) -> Option<DepthTile> {
    let mut samples = Vec::with_capacity(side * side);
    for y in top..top + side {
        for (x, raw) in image.row(y).iter().enumerate().skip(left).take(side) {
            if Some(*raw) != invalid
                && let Some(inverse) = reading.inverse_depth(f64::from(*raw))
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
    use crate::geometry::pixel::ImageSize;

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
        let board = find_board_plane(&image, (METRIC, &lens()), &outline, &options).unwrap();
        grow_plane(&image, (METRIC, &lens()), (&board, &outline), &options)
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
