//! A lattice that is larger than the board, such as a floor of tiles (`floor_limits`).
//!
//! Candidates around it on its lines belong to it without being measured, so the search continues
//! with the rest of the image.

use nalgebra::Vector3;

use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::lattice::LatticeScene;
use crate::detection::grid::in_steps;
use crate::detection::search::candidates::edges_along;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// How far around a lattice candidates count as its continuation, relative to its own extent:
/// beyond that, the distortion moves its lines away from their prediction. Chosen.
const AROUND_EXTENTS: f32 = 2.0;
/// The largest distance of such a candidate from a crossing of the lines, in narrow intervals: an
/// unrelated position lies so near to one in 4 of 25 cases. Chosen.
const MOST_OFF_INTERVALS: f32 = 0.2;

impl TargetDetector {
    /// Grows the lattice in `grid` until it has more than `most` crossings.
    pub(super) fn grow_further(&mut self, view: GrayView<'_>, most: usize) {
        let scene = LatticeScene {
            image: view,
            candidates: &self.candidates.found,
            neighborhood: &self.neighborhood,
            sheets: &self.sheets,
            thresholds: &self.thresholds.lattice,
        };
        self.growth.grow(scene, &mut self.grid, most);
    }

    /// No lattice starts from the candidates around the lattice in `grid` that lie on its lines.
    pub(super) fn spend_around(&mut self) {
        let Self { grid, sheets, candidates, used, pairs, thresholds, .. } = self;
        let Some(bounds) = grid.bounds() else { return };
        pairs.clear();
        pairs.extend(grid.members.iter().filter_map(|&(i, j)| {
            let pixel = grid.pixel(i, j)?;
            Some(ChartPair {
                place: [i, j].map(|k| f64::from(sheets.line(k))),
                pixel: [f64::from(pixel.x), f64::from(pixel.y)],
                weight: 1.0,
            })
        }));
        let Some(chart) = Chart::fit(pairs) else { return };
        let Some(lattice_from_image) = chart.matrix().try_inverse() else { return };
        let [left, right, top, bottom] =
            [bounds.i.0, bounds.i.1, bounds.j.0, bounds.j.1].map(|k| sheets.line(k));
        let extent = AROUND_EXTENTS * (right - left).max(bottom - top);
        let narrow = sheets.widths[0].min(sheets.widths[1]);
        for (candidate, used) in candidates.found.iter().zip(used) {
            let pixel = candidate.pixel;
            let place =
                lattice_from_image * Vector3::new(f64::from(pixel.x), f64::from(pixel.y), 1.0);
            let [x, y] = [place.x / place.z, place.y / place.z].map(|v| v as f32);
            let is_near = (left - extent..=right + extent).contains(&x)
                && (top - extent..=bottom + extent).contains(&y);
            if *used || !is_near {
                continue;
            }
            let (i, j) = (sheets.nearest_line(x), sheets.nearest_line(y));
            let (x, y) = (sheets.line(i), sheets.line(j));
            let (Some(expected), Some(steps)) = (chart.at(x, y), chart.steps(x, y)) else {
                continue;
            };
            let cell: [Vec2; 2] = steps.map(|step| step * narrow);
            let is_on = in_steps(pixel - expected, cell)
                .is_some_and(|off| off.amax() <= MOST_OFF_INTERVALS);
            let edges = edges_along(steps, grid.polarity(i, j));
            *used = is_on && candidate.has_edges(edges, thresholds.lattice.most_rotation);
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::detection::coded::detector::TargetDetector;
    use crate::geometry::dictionary::Dictionary;
    use crate::geometry::target::{CharucoBoard, Target};
    use crate::imaging::gray::GrayImage;

    /// More than eleven searches of levels may measure for floors, less than there are tiles of
    /// 8 px on two levels.
    const MOST_PLACES_TESTED: usize = 20_000;

    /// A floor of tiles of so many pixels, seen at a slant.
    fn floor([width, height]: [usize; 2], tile_px: f64) -> GrayImage {
        let bright = |x: f64, y: f64| {
            let (x, y) = (x - 300.0, y - 200.0);
            let tile = |v: f64| (v / (1.0 + 0.0006 * y) / tile_px).floor() as i64;
            (tile(x + 0.1 * y) + tile(y - 0.1 * x)).rem_euclid(2) == 0
        };
        let gray = |x: usize, y: usize| {
            let at = |v: usize, k: usize| v as f64 - 0.5 + (k as f64 + 0.5) / 4.0;
            let count = (0..16).filter(|&sub| bright(at(x, sub % 4), at(y, sub / 4))).count();
            40 + 10 * count as u8
        };
        let pixels = (0..width * height).map(|at| gray(at % width, at / width));
        GrayImage::from_pixels(width, height, pixels.collect()).expect("so many pixels")
    }

    #[test]
    fn the_places_measured_on_a_floor_are_bounded() {
        let dictionary = Dictionary::named("DICT_4X4_50").expect("a dictionary");
        let target = Target::Charuco(CharucoBoard {
            cols: 7,
            rows: 5,
            square_m: 0.04,
            marker_m: 0.03,
            dictionary,
            first_id: 0,
            legacy: Some(false),
        });
        let mut detector = TargetDetector::new(target).expect("a target with markers");
        for tile_px in [8.0, 12.0, 20.0] {
            let image = floor([1280, 720], tile_px);
            assert!(detector.find(image.view()).is_err());
            let places = detector.growth.places;
            assert!(places < MOST_PLACES_TESTED, "tiles of {tile_px} px: {places} places");
        }
    }
}
