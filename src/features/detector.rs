//! The features of one image, a bounded number spread over it.

use crate::features::descriptor::{Descriptor, describe};
use crate::features::extrema::{Extremum, extrema};
use crate::features::keypoint::Keypoint;
use crate::features::orientation::{Gradients, orientations};
use crate::features::scale_space::{Octave, Octaves, SCALES};
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// Keypoints with what their surroundings show, strongest first: any first part of them is spread
/// over the image too.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// Where.
    pub keypoints: Vec<Keypoint>,
    /// What, in the same order.
    pub descriptors: Vec<Descriptor>,
}

/// How features are searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FeatureOptions {
    /// The most keypoints of one image.
    pub max_features: usize,
}

impl Default for FeatureOptions {
    /// 3000: more hardly lowers a calibration's uncertainty, since those left out are weak, and
    /// matching takes the square of their number.
    fn default() -> Self {
        Self { max_features: 3000 }
    }
}

/// Cells along the longer side of the image among which keypoints are spread.
const CELLS: usize = 12;

/// The features of `image`: extrema of the difference of Gaussians with RootSIFT descriptors.
/// Empty for an image without texture or too small.
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

/// The order in which extrema are taken: the strongest of each cell of the image first, then the
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
    // Stable: within one rank the strongest come first.
    ranked.sort_by_key(|(rank, _)| *rank);
    ranked.into_iter().map(|(_, k)| k).collect()
}
