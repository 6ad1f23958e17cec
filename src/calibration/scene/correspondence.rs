//! From images to what estimation takes: pairs of images with their geometry, and tracks.

use std::sync::Arc;

use nalgebra::Point2;

use crate::estimation::interrupt::Interrupt;
use crate::estimation::scene::problem::{SceneProblem, TrackPoint};
use crate::estimation::scene::reconstruction::ImagePair;
use crate::estimation::scene::rotation_only::RotatedPair;
use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::degeneracy::{TwoViewGeometry, TwoViewKind, two_view_geometry};
use crate::features::detector::{FeatureOptions, Features, find_features};
use crate::features::matching::{DescriptorTable, Match, match_descriptors};
use crate::features::patch::PatchImage;
use crate::features::tracks::join_tracks;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::imaging::gray::GrayView;

/// One photograph: its name and what is needed of it.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneImage {
    /// Its path or sequence number.
    pub name: String,
    /// Its size.
    pub size: ImageSize,
    /// Shared, so that a copy costs nothing.
    features: Arc<Features>,
    /// What keypoints are located in to more than their own precision; none where there is no
    /// image any more.
    patches: Option<Arc<PatchImage>>,
}

impl SceneImage {
    /// Finds the features of `image`.
    pub fn of(name: String, image: GrayView<'_>) -> Self {
        Self::with_options(name, image, &FeatureOptions::default())
    }

    /// Finds the features of `image` as `options` say.
    pub fn with_options(name: String, image: GrayView<'_>, options: &FeatureOptions) -> Self {
        let features = Arc::new(find_features(image, options));
        let patches = Some(Arc::new(PatchImage::of(image)));
        Self { name, size: image.size(), features, patches }
    }

    /// One with these features.
    #[cfg(test)]
    pub(crate) fn of_features(name: &str, size: ImageSize, features: Features) -> Self {
        Self { name: name.to_owned(), size, features: Arc::new(features), patches: None }
    }

    /// Where its features are, strongest first.
    pub fn pixels(&self) -> impl Iterator<Item = Pixel> + '_ {
        self.features.keypoints.iter().map(|keypoint| keypoint.pixel)
    }

    /// The first of the features that are where `feature` is: one keypoint has a feature for each
    /// direction that dominates around it, but is measured once.
    fn place(&self, feature: usize) -> usize {
        let keypoints = &self.features.keypoints;
        let at = keypoints[feature].pixel;
        (0..feature).rev().take_while(|k| keypoints[*k].pixel == at).last().unwrap_or(feature)
    }

    /// Its luma.
    pub(super) fn patches(&self) -> Option<&PatchImage> {
        self.patches.as_deref()
    }

    /// How many features it has.
    pub fn feature_count(&self) -> usize {
        self.features.keypoints.len()
    }

    /// The descriptors of its strongest features, `count` at most.
    pub(super) fn table(&self, count: usize) -> DescriptorTable {
        let descriptors = &self.features.descriptors;
        DescriptorTable::new(&descriptors[..count.min(descriptors.len())])
    }
}

/// What the matches of all pairs of images say.
#[derive(Debug, Clone)]
pub(super) struct ImagePairs {
    pub problem: SceneProblem,
    /// Pairs with an epipolar geometry.
    pub general: Vec<ImagePair>,
    /// Pairs that a homography explains.
    pub rotated: Vec<RotatedPair>,
    /// The homography that explains most of each pair's matches, whatever it leaves: distortion
    /// changes that of a camera that only rotated.
    pub homographies: Vec<RotatedPair>,
    /// Pairs of which a homography explains nearly all.
    pub nearly_planar: usize,
    /// Pairs between which nothing moved.
    pub still: usize,
    /// The number of inlier matches between each image and the next.
    pub between_neighbors: Vec<usize>,
}

/// The strongest features of each image, by which pairs that share nothing are recognized.
const PREVIEWED: usize = 600;

/// Pairs with fewer preliminary matches share nothing: as many agree by chance.
const LEAST_PREVIEWED: usize = 6;

/// Matches and verifies all pairs of `images`, with `threads` threads; none any more once
/// `interrupt` is requested.
pub(super) fn correspond(
    images: &[SceneImage],
    size: ImageSize,
    (threads, interrupt): (usize, &Interrupt),
) -> ImagePairs {
    let tables: Vec<DescriptorTable> = images.iter().map(|image| image.table(usize::MAX)).collect();
    let previews: Vec<DescriptorTable> =
        images.iter().map(|image| image.table(PREVIEWED)).collect();
    let pairs: Vec<(usize, usize)> =
        (0..images.len()).flat_map(|i| (i + 1..images.len()).map(move |j| (i, j))).collect();
    let matched = in_parallel(&pairs, threads, |(i, j)| {
        if interrupt.is_requested() {
            return None;
        }
        let is_neighbor = *j == i + 1;
        let preview = match_descriptors(&previews[*i], &previews[*j]);
        if preview.len() < LEAST_PREVIEWED && !is_neighbor {
            return None;
        }
        let matches = match_descriptors(&tables[*i], &tables[*j]);
        let points = matches.iter().map(|m| point_pair(&images[*i], &images[*j], *m));
        let points: Vec<PointPair> = points.collect();
        let geometry = two_view_geometry(&points, size)?;
        Some((matches, points, geometry))
    });
    let mut found = ImagePairs {
        problem: SceneProblem {
            image_size: size,
            images: images.len(),
            tracks: Vec::new(),
            interrupt: interrupt.clone(),
        },
        general: Vec::new(),
        rotated: Vec::new(),
        homographies: Vec::new(),
        nearly_planar: 0,
        still: 0,
        between_neighbors: vec![0; images.len().saturating_sub(1)],
    };
    let mut verified: Vec<(usize, usize, Vec<Match>)> = Vec::new();
    for ((first, second), matched) in pairs.into_iter().zip(matched) {
        let Some((matches, points, geometry)) = matched else { continue };
        if second == first + 1 {
            found.between_neighbors[first] = geometry.inliers.len();
        }
        let placed = |k: &usize| Match {
            first: images[first].place(matches[*k].first),
            second: images[second].place(matches[*k].second),
        };
        verified.push((first, second, geometry.inliers.iter().map(placed).collect()));
        found.add_pair((first, second), &points, &geometry);
    }
    let tracks = join_tracks(&verified);
    found.problem.tracks = tracks
        .iter()
        .map(|track| track.iter().map(|(image, k)| track_point(images, *image, *k)).collect())
        .collect();
    found
}

impl ImagePairs {
    fn add_pair(
        &mut self,
        (first, second): (usize, usize),
        points: &[PointPair],
        geometry: &TwoViewGeometry,
    ) {
        let matches: Vec<PointPair> = geometry.inliers.iter().map(|k| points[*k]).collect();
        self.nearly_planar += usize::from(geometry.is_nearly_planar);
        if geometry.kind == TwoViewKind::Still {
            self.still += 1;
        }
        if let Some(homography) = geometry.homography {
            let matches = geometry.on_homography;
            let pair = RotatedPair { first, second, homography, matches };
            if geometry.kind != TwoViewKind::General {
                self.rotated.push(pair.clone());
            }
            self.homographies.push(pair);
        }
        if geometry.kind == TwoViewKind::General {
            let fundamental = geometry.fundamental;
            self.general.push(ImagePair { first, second, fundamental, matches });
        }
    }
}

fn to_point(pixel: Pixel) -> Point2<f64> {
    Point2::new(pixel.x, pixel.y)
}

pub(super) fn point_pair(first: &SceneImage, second: &SceneImage, pair: Match) -> PointPair {
    PointPair {
        first: to_point(first.features.keypoints[pair.first].pixel),
        second: to_point(second.features.keypoints[pair.second].pixel),
    }
}

fn track_point(images: &[SceneImage], image: usize, feature: usize) -> TrackPoint {
    let keypoint = &images[image].features.keypoints[feature];
    TrackPoint {
        image,
        pixel: keypoint.pixel,
        scale_px: keypoint.scale_px,
        std_px: keypoint.std_px(),
    }
}

/// `work` on each of `items`, in their order whatever the number of threads.
pub(super) fn in_parallel<T: Sync, R: Send>(
    items: &[T],
    threads: usize,
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    if threads <= 1 || items.len() < 2 {
        return items.iter().map(work).collect();
    }
    let share = items.len().div_ceil(threads);
    std::thread::scope(|scope| {
        let work = &work;
        let parts: Vec<_> = items
            .chunks(share)
            .map(|part| scope.spawn(move || part.iter().map(work).collect::<Vec<R>>()))
            .collect();
        parts
            .into_iter()
            .flat_map(|part| part.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    })
}
