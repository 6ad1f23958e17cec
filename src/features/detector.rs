//! The features of one image: a limited number, spread over the image.

use crate::features::descriptor::{Descriptor, describe};
use crate::features::extrema::{Extremum, extrema};
use crate::features::keypoint::Keypoint;
use crate::features::orientation::{Gradients, orientations};
use crate::features::scale_space::{Octave, Octaves, SCALES};
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// Keypoints with their descriptors, strongest first; any leading part of them is spread over the
/// image too.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// The keypoints.
    pub keypoints: Vec<Keypoint>,
    /// Their descriptors, in the same order.
    pub descriptors: Vec<Descriptor>,
}

/// Options of feature detection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FeatureOptions {
    /// The largest number of keypoints in one image.
    pub max_features: usize,
}

impl Default for FeatureOptions {
    /// 3000: more would hardly lower a calibration's uncertainty, since the weakest are left out,
    /// and the time of matching grows with the square of their number.
    fn default() -> Self {
        Self { max_features: 3000 }
    }
}

/// Cells along the longer side of the image, over which keypoints are spread. Chosen, not swept.
const CELLS: usize = 12;

/// The features of `image`: extrema of the difference of Gaussians with RootSIFT descriptors. Empty
/// for an image that is too small or has no texture.
pub fn find_features(image: GrayView<'_>, options: &FeatureOptions) -> Features {
    let octaves = Octaves::of(image);
    let mut found: Vec<(Extremum, usize)> = Vec::new();
    let mut kept: Vec<Octave> = Vec::new();
    for (k, octave) in octaves.enumerate() {
        found.extend(extrema(&octave).into_iter().map(|extremum| (extremum, k)));
        kept.push(octave);
    }
    let pixel = |(extremum, octave): &(Extremum, usize)| {
        let Octave { spacing_px, offset_px, .. } = kept[*octave];
        Pixel::new(extremum.x * spacing_px + offset_px, extremum.y * spacing_px + offset_px)
    };
    let order = spread_over_image(&found, image, pixel);
    let chosen = &order[..order.len().min(options.max_features)];
    let mut described: Vec<(usize, Keypoint, Descriptor)> = Vec::new();
    let mut gradients = Gradients::default();
    for (k, octave) in kept.iter().enumerate() {
        for level in 1..=SCALES {
            let here = |index: usize| {
                let (extremum, octave) = &found[index];
                *octave == k && (extremum.level.round() as usize).clamp(1, SCALES) == level
            };
            let ranks: Vec<usize> = (0..chosen.len()).filter(|rank| here(chosen[*rank])).collect();
            if ranks.is_empty() {
                continue;
            }
            gradients.fill(&octave.gaussians[level]);
            for rank in ranks {
                let extremum = &found[chosen[rank]].0;
                for angle in orientations(&gradients, extremum) {
                    let keypoint = Keypoint {
                        pixel: pixel(&found[chosen[rank]]),
                        scale_px: extremum.sigma() * octave.spacing_px,
                        angle,
                        contrast: extremum.contrast,
                    };
                    described.push((rank, keypoint, describe(&gradients, extremum, angle)));
                }
            }
        }
    }
    described.sort_by_key(|(rank, ..)| *rank);
    described.truncate(options.max_features);
    let (keypoints, descriptors) =
        described.into_iter().map(|(_, keypoint, descriptor)| (keypoint, descriptor)).unzip();
    Features { keypoints, descriptors }
}

/// The order in which extrema are selected: the strongest of each cell of the image first, then the
/// second of each, and so on.
fn spread_over_image(
    found: &[(Extremum, usize)],
    image: GrayView<'_>,
    pixel: impl Fn(&(Extremum, usize)) -> Pixel,
) -> Vec<usize> {
    let side_px = image.width().max(image.height()) as f64 / CELLS as f64;
    let cell = |k: usize| {
        let at = pixel(&found[k]);
        ((at.y / side_px) as usize, (at.x / side_px) as usize)
    };
    let mut order: Vec<usize> = (0..found.len()).collect();
    order.sort_by(|a, b| found[*b].0.contrast.total_cmp(&found[*a].0.contrast));
    let mut counts = std::collections::BTreeMap::new();
    let mut ranked: Vec<(usize, usize)> = Vec::with_capacity(order.len());
    for k in order {
        let count = counts.entry(cell(k)).or_insert(0_usize);
        ranked.push((*count, k));
        *count += 1;
    }
    // A stable sort: within one rank the strongest come first.
    ranked.sort_by_key(|(rank, _)| *rank);
    ranked.into_iter().map(|(_, k)| k).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::matching::{DescriptorTable, match_descriptors};
    use crate::imaging::gray::GrayImage;

    const SIDE: usize = 600;

    /// Bright spots on gray: the place and the standard deviation of each, in pixels.
    fn spots() -> Vec<(f64, f64, f64)> {
        (0..36)
            .map(|k| {
                let (col, row) = (f64::from(k % 6), f64::from(k / 6));
                let off = |by: f64| 0.5 * (f64::from(k) * by).sin();
                (
                    60.0 + 95.0 * col + off(1.1),
                    60.0 + 95.0 * row + off(1.9),
                    1.5 + 0.15 * f64::from(k),
                )
            })
            .collect()
    }

    fn image(luma: impl Fn(f64, f64) -> f64) -> GrayImage {
        let at = |k: usize| luma((k % SIDE) as f64, (k / SIDE) as f64).round() as u8;
        GrayImage::from_pixels(SIDE, SIDE, (0..SIDE * SIDE).map(at).collect()).unwrap()
    }

    /// What the difference of Gaussians of deviations σ and kσ, k = 2^(1/3), does to a spot of
    /// deviation s is 1/(σ² + s²) − 1/(k²σ² + s²), greatest at σ = s/√k.
    #[test]
    fn spots_are_found_where_and_as_large_as_they_are() {
        let spots = spots();
        let image = image(|x, y| {
            let spot = |(u, v, s): &(f64, f64, f64)| {
                150.0 * (-((x - u).powi(2) + (y - v).powi(2)) / (2.0 * s * s)).exp()
            };
            60.0 + spots.iter().map(spot).sum::<f64>()
        });
        let found = find_features(image.view(), &FeatureOptions::default());
        let mut sum = [0.0; 2];
        for (x, y, s) in &spots {
            let at = Pixel::new(*x, *y);
            let near = found.keypoints.iter().filter(|one| one.pixel.distance_px(at) < 2.0);
            let strongest = near.max_by(|a, b| a.contrast.total_cmp(&b.contrast)).unwrap();
            let off_px = strongest.pixel.distance_px(at);
            assert!(off_px < 2.0 * strongest.std_px(), "spot of {s} px: {off_px} px off");
            let scale = strongest.scale_px / (s / 2.0_f64.powf(1.0 / 6.0));
            assert!((scale - 1.0).abs() < 0.1, "spot of {s} px: {scale} times as large");
            sum = [sum[0] + strongest.pixel.x - x, sum[1] + strongest.pixel.y - y];
        }
        let mean_px = sum.map(|sum| sum / spots.len() as f64);
        assert!(mean_px.iter().all(|mean| mean.abs() < 0.03), "{mean_px:?}");
    }

    #[test]
    fn an_image_rotated_by_a_quarter_has_the_same_features() {
        let random = |k: i32, by: f64| (f64::from(k) * by).sin() * 43_758.545 % 1.0;
        let spots: Vec<[f64; 4]> = (0..400)
            .map(|k| {
                let place = [random(k, 12.9898), random(k, 78.233)].map(|at| 300.0 + 280.0 * at);
                [place[0], place[1], 2.5 + 1.5 * random(k, 37.719), 70.0 * random(k, 4.898)]
            })
            .collect();
        let luma = |x: f64, y: f64| {
            let spot = |[u, v, s, height]: &[f64; 4]| {
                let square = ((x - u).powi(2) + (y - v).powi(2)) / (2.0 * s * s);
                if square < 20.0 { height * (-square).exp() } else { 0.0 }
            };
            (128.0 + spots.iter().map(spot).sum::<f64>()).clamp(0.0, 255.0)
        };
        let last = SIDE as f64 - 1.0;
        let [upright, rotated] = [image(luma), image(|x, y| luma(y, last - x))]
            .map(|image| find_features(image.view(), &FeatureOptions::default()));
        assert!(upright.keypoints.len() > 100, "{}", upright.keypoints.len());
        let tables = [&upright, &rotated].map(|one| DescriptorTable::new(&one.descriptors));
        let matches = match_descriptors(&tables[0], &tables[1]);
        let is_right = |found: &&crate::features::matching::Match| {
            let first = upright.keypoints[found.first].pixel;
            let second = rotated.keypoints[found.second].pixel;
            second.distance_px(Pixel::new(last - first.y, first.x)) < 0.3
        };
        let right = matches.iter().filter(is_right).count();
        let all = upright.keypoints.len();
        assert_eq!(right, matches.len());
        assert!(4 * right >= 3 * all, "{right} of {all}");
    }
}
