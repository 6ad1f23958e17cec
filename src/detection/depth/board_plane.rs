//! The board's surface in a depth image: small patches inside its outline, each with its own noise,
//! without those off the plane.
//!
//! A plane's 1/z is linear over a pinhole image, so each patch is a linear fit; lens distortion
//! within one patch is far below its noise.

use nalgebra::{Matrix3, Vector3};

use crate::geometry::depth_camera::{DepthReading, DepthTile};
use crate::geometry::lens::Lens;
use crate::geometry::median::median;
use crate::geometry::pixel::Pixel;
use crate::imaging::depth_image::DepthImage;

/// A depth image, what its values mean, and the lens that it was taken through.
#[derive(Debug, Clone, Copy)]
pub struct DepthInput<'a> {
    /// The image.
    pub image: &'a DepthImage,
    /// What a value of it means.
    pub reading: DepthReading,
    /// The depth camera's lens.
    pub lens: &'a Lens,
}

/// Options of the measurement of a board's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneOptions {
    /// The value that means no reading, besides 0 for metric depth.
    pub invalid: Option<u16>,
    /// Approximate number of patches. Default: 150.
    pub tiles: u32,
    /// Patches whose relative distance from the common plane is greater are rejected. Default:
    /// 0.05.
    pub tolerance: f64,
}

impl Default for PlaneOptions {
    fn default() -> Self {
        Self { invalid: None, tiles: 150, tolerance: 0.05 }
    }
}

/// Why no surface was measured.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoPlane {
    /// Every reading is the same.
    #[error(
        "its depth image reads {reading} everywhere (a dropped frame, or a stream that had not started) and is not used"
    )]
    Blank {
        /// Which.
        reading: u16,
    },
    /// The outline is almost entirely outside the image.
    #[error("the board is outside the depth image")]
    Outside,
    /// Too few readings inside the outline.
    #[error(
        "only {percent} % of the depth image inside the board's outline has readings, 40 % are needed"
    )]
    Holes {
        /// How many.
        percent: u32,
    },
    /// The surface inside the outline is not one plane.
    #[error(
        "the depth image is not flat inside the board's outline: only {percent} % of it lies on one plane"
    )]
    NotFlat {
        /// How much.
        percent: u32,
    },
}

/// Readings of a patch that are farther from its plane, in standard deviations, are trimmed.
/// Chosen, not swept.
const TRIM_STDS: f64 = 3.5;

/// The least pixels of an outline within the image, the least and the largest side of a patch in
/// pixels, and the least number of patches. Chosen, not swept.
const LEAST_AREA_PX: usize = 100;
const SIDES_PX: [usize; 2] = [6, 48];
const LEAST_TILES: usize = 6;

/// Measures the surface inside `outline`, a closed polygon in pixels of the depth image.
///
/// # Errors
/// [`NoPlane`]: blank, outside the image, holes, not flat.
pub fn find_board_plane(
    depth: DepthInput<'_>,
    outline: &[Pixel],
    options: &PlaneOptions,
) -> Result<Vec<DepthTile>, NoPlane> {
    let DepthInput { image, lens, .. } = depth;
    if let Some(reading) = image.only_reading() {
        return Err(NoPlane::Blank { reading });
    }
    let spans = spans_inside(outline, image);
    let area: usize = spans.iter().map(|span| span.end - span.start).sum();
    if area < LEAST_AREA_PX {
        return Err(NoPlane::Outside);
    }
    let side = ((area as f64 / f64::from(options.tiles.max(1))).sqrt() as usize)
        .clamp(SIDES_PX[0], SIDES_PX[1]);
    let (mut tiles, mut seen) = (Vec::new(), 0);
    let (top, bottom) = (spans[0].y, spans[spans.len() - 1].y + 1);
    let left = spans.iter().map(|span| span.start).min().unwrap_or(0);
    let right = spans.iter().map(|span| span.end).max().unwrap_or(0);
    let mut samples = Vec::with_capacity(side * side);
    for y in (top..bottom).step_by(side) {
        let rows = &spans[y - top..(y - top + side).min(spans.len())];
        for x in (left..right).step_by(side) {
            let inside = gather(depth, options.invalid, rows, x..x + side, &mut samples);
            seen += samples.len();
            if 2 * samples.len() >= inside.max(side * side / 2) {
                tiles.extend(fit_tile(&mut samples));
            }
        }
    }
    let percent = |part: usize, whole: usize| (100 * part / whole.max(1)) as u32;
    if 5 * seen < 2 * area || tiles.len() < LEAST_TILES {
        return Err(NoPlane::Holes { percent: percent(seen, area) });
    }
    let all = tiles.len();
    keep_plane(&mut tiles, lens, options.tolerance);
    if 10 * tiles.len() < 7 * all {
        return Err(NoPlane::NotFlat { percent: percent(tiles.len(), all) });
    }
    Ok(tiles)
}

/// The pixels of one row that lie inside an outline.
struct Span {
    y: usize,
    start: usize,
    end: usize,
}

/// One span per row from the outline's top to its bottom, clipped to the image. A board's outline
/// is convex except for lens distortion: its outermost crossings bound each row.
fn spans_inside(outline: &[Pixel], image: &DepthImage) -> Vec<Span> {
    let size = image.size();
    let finite = outline.len() >= 3 && outline.iter().all(|pixel| pixel.is_finite());
    let lowest = outline.iter().map(|p| p.y).fold(f64::INFINITY, f64::min).max(0.0);
    let highest = outline
        .iter()
        .map(|p| p.y)
        .fold(f64::NEG_INFINITY, f64::max)
        .min(f64::from(size.height) - 1.0);
    if !finite || lowest > highest {
        return Vec::new();
    }
    (lowest.ceil() as usize..=highest.floor() as usize)
        .map(|y| {
            let line = y as f64;
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for (a, b) in outline.iter().zip(outline.iter().cycle().skip(1)) {
                if (a.y <= line) != (b.y <= line) {
                    let x = a.x + (line - a.y) / (b.y - a.y) * (b.x - a.x);
                    (low, high) = (low.min(x), high.max(x));
                }
            }
            let start = low.max(0.0).ceil().min(f64::from(size.width)) as usize;
            let end =
                (high.min(f64::from(size.width) - 1.0).floor() + 1.0).max(start as f64) as usize;
            Span { y, start, end: if low <= high { end } else { start } }
        })
        .collect()
}

/// Collects (x, y, 1/z) of the readings in a patch; returns how many of its pixels lie inside the
/// outline.
fn gather(
    depth: DepthInput<'_>,
    invalid: Option<u16>,
    rows: &[Span],
    columns: std::ops::Range<usize>,
    samples: &mut Vec<[f64; 3]>,
) -> usize {
    samples.clear();
    let mut inside = 0;
    for span in rows {
        let (start, end) = (span.start.max(columns.start), span.end.min(columns.end));
        inside += end.saturating_sub(start);
        for x in start..end {
            let raw = depth.image.row(span.y)[x];
            if Some(raw) == invalid {
                continue;
            }
            if let Some(inverse) = depth.reading.inverse_depth(f64::from(raw)) {
                samples.push([x as f64, span.y as f64, inverse]);
            }
        }
    }
    inside
}

/// Fits a plane to the samples of a patch, trimmed twice; `None` where there are too few or they
/// are on a line.
pub(super) fn fit_tile(samples: &mut Vec<[f64; 3]>) -> Option<DepthTile> {
    let mut last = None;
    for _ in 0..3 {
        let count = samples.len() as f64;
        if samples.len() < 12 {
            return None;
        }
        let mean = [0, 1, 2].map(|k| samples.iter().map(|s| s[k]).sum::<f64>() / count);
        let (mut square, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for s in samples.iter() {
            let row = Vector3::new(s[0] - mean[0], s[1] - mean[1], 1.0);
            square += row * row.transpose();
            right += row * (s[2] - mean[2]);
        }
        let slope = square.cholesky()?.solve(&right);
        let rest = |s: &[f64; 3]| {
            s[2] - mean[2] - slope[0] * (s[0] - mean[0]) - slope[1] * (s[1] - mean[1])
        };
        let std = (samples.iter().map(|s| rest(s).powi(2)).sum::<f64>() / (count - 3.0)).sqrt();
        last = Some(DepthTile {
            pixel: Pixel::new(mean[0], mean[1]),
            inverse_depth: mean[2],
            reading_std: std,
            count: samples.len() as u32,
        });
        let before = samples.len();
        samples.retain(|s| rest(s).abs() <= TRIM_STDS * std);
        if samples.len() == before {
            break;
        }
    }
    last
}

/// Keeps the tiles on one plane: least median of squares over planes through three tiles, then
/// least squares over its inliers.
fn keep_plane(tiles: &mut Vec<DepthTile>, lens: &Lens, tolerance: f64) {
    let ray = |tile: &DepthTile| {
        let bearing = lens.bearing_from_pixel(tile.pixel)?;
        (bearing.z > 0.0).then(|| bearing.into_inner() / bearing.z)
    };
    tiles.retain(|tile| ray(tile).is_some());
    let rays: Vec<Vector3<f64>> = tiles.iter().filter_map(ray).collect();
    let deviations = |plane: &Vector3<f64>| -> Vec<f64> {
        let each = tiles.iter().zip(&rays);
        each.map(|(tile, ray)| ((tile.inverse_depth - plane.dot(ray)) / tile.inverse_depth).abs())
            .collect()
    };
    let through = |chosen: &[usize]| {
        let (mut square, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for k in chosen {
            square += rays[*k] * rays[*k].transpose();
            right += rays[*k] * tiles[*k].inverse_depth;
        }
        Some(square.cholesky()?.solve(&right))
    };
    let count = tiles.len();
    let triples =
        (0..TRIPLES).map(|k| [k * 7919, k * 104_729 + count / 3, k * 1_299_709 + 2 * count / 3]);
    let planes = triples.filter_map(|triple| through(&triple.map(|k| k % count.max(1))));
    let best = planes
        .map(|plane| (median(deviations(&plane)).unwrap_or(f64::INFINITY), plane))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((scale, mut plane)) = best else { return tiles.clear() };
    let limit = (INLIER_MEDIANS * scale).max(LEAST_LIMIT).min(tolerance);
    for _ in 0..3 {
        let off = deviations(&plane);
        let near: Vec<usize> = (0..count).filter(|k| off[*k] <= limit).collect();
        plane = through(&near).unwrap_or(plane);
    }
    let mut deviations = deviations(&plane).into_iter();
    tiles.retain(|_| deviations.next().is_some_and(|deviation| deviation <= tolerance));
}

/// Triples tried: with a third of the tiles off the plane, all but one in 10⁷ images get a triple
/// of inliers.
const TRIPLES: usize = 50;

/// Tiles within this many times the median deviation from the best triple's plane are fitted, and
/// those within this relative distance in any case. Chosen, not swept.
const INLIER_MEDIANS: f64 = 4.0;
const LEAST_LIMIT: f64 = 0.002;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::pixel::ImageSize;

    const METRIC: DepthReading = DepthReading::Metric { unit_m: 0.001 };

    fn lens() -> Lens {
        Lens::pinhole(CameraMatrix { fx: 300.0, fy: 300.0, cx: 160.0, cy: 120.0, skew: 0.0 })
    }

    fn image(z_m: impl Fn(f64, f64) -> f64) -> DepthImage {
        let at = |k: usize| z_m((k % 320) as f64, (k / 320) as f64);
        DepthImage::new(
            ImageSize::new(320, 240),
            (0..320 * 240).map(|k| (at(k) * 1000.0).round() as u16).collect(),
        )
        .unwrap()
    }

    fn square(low: f64, high: f64) -> Vec<Pixel> {
        vec![
            Pixel::new(low, low),
            Pixel::new(high, low),
            Pixel::new(high, high),
            Pixel::new(low, high),
        ]
    }

    #[test]
    fn a_tilted_plane_is_measured_and_a_hand_before_it_is_left_out() {
        let plane = |x: f64, y: f64| 1.0 / (0.7 + 0.0004 * (x - 160.0) - 0.0002 * (y - 120.0));
        let with_hand = image(|x, y| if x > 150.0 && y > 150.0 { 0.6 } else { plane(x, y) });
        let depth = DepthInput { image: &with_hand, reading: METRIC, lens: &lens() };
        let tiles =
            find_board_plane(depth, &square(40.0, 200.0), &PlaneOptions::default()).unwrap();
        assert!(tiles.len() > 80, "{}", tiles.len());
        for tile in tiles {
            let truth = 1.0 / plane(tile.pixel.x, tile.pixel.y);
            assert!((tile.inverse_depth - truth).abs() < 1e-4, "{tile:?} {truth}");
            assert!(tile.reading_std < 4e-4 && !(tile.pixel.x > 158.0 && tile.pixel.y > 158.0));
        }
    }

    #[test]
    fn what_cannot_be_measured_is_said() {
        let find = |image: &DepthImage, outline: &[Pixel]| {
            let depth = DepthInput { image, reading: METRIC, lens: &lens() };
            find_board_plane(depth, outline, &PlaneOptions::default())
        };
        let flat = image(|x, _| 1.0 + 1e-3 * x);
        assert_eq!(find(&flat, &square(400.0, 500.0)), Err(NoPlane::Outside));
        assert_eq!(find(&flat, &[Pixel::new(f64::NAN, 0.0); 4]), Err(NoPlane::Outside));
        let blank = image(|_, _| 0.0);
        assert_eq!(find(&blank, &square(40.0, 200.0)), Err(NoPlane::Blank { reading: 0 }));
        let holes = image(|x, y| if x < 20.0 && y < 20.0 { 1.0 } else { 0.0 });
        assert_eq!(find(&holes, &square(40.0, 200.0)), Err(NoPlane::Holes { percent: 0 }));
        let bent = image(|x, _| if x < 110.0 { 1.0 } else { 1.6 });
        assert!(matches!(find(&bent, &square(40.0, 200.0)), Err(NoPlane::NotFlat { .. })));
    }
}
