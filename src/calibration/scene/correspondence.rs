//! From images to the input of estimation: pairs of images with their geometry, and tracks.

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::Point2;

use crate::calibration::scene::pair_geometry::{
    SceneGeometry, geometry_of, is_one_view, scene_geometry, stayed,
};
use crate::estimation::interrupt::Interrupt;
use crate::estimation::scene::problem::{SceneProblem, TrackPoint};
use crate::estimation::scene::reconstruction::ImagePair;
use crate::estimation::scene::rotation_only::RotatedPair;
use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::degeneracy::{TwoViewGeometry, TwoViewKind};
use crate::features::detector::{FeatureOptions, Features, find_features};
use crate::features::matching::{
    Comparison, DescriptorTable, Match, compare_descriptors, match_descriptors,
};
use crate::features::patch::PatchImage;
use crate::features::tracks::join_tracks;
use crate::geometry::median::median;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::imaging::gray::GrayView;
use crate::imaging::stated_camera::StatedCamera;

/// One photograph: its name and what is needed of it.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneImage {
    /// Its path or sequence number.
    pub name: String,
    /// Its size.
    pub size: ImageSize,
    /// Shared, so that a copy costs nothing.
    features: Arc<Features>,
    /// The luma to localize keypoints in more exactly; `None` if the image is no longer available.
    patches: Option<Arc<PatchImage>>,
    /// What its file states of the camera.
    pub stated: Option<StatedCamera>,
}

impl SceneImage {
    /// Finds the features of `image`.
    pub fn of(name: String, image: GrayView<'_>) -> Self {
        Self::with_options(name, image, &FeatureOptions::default())
    }

    /// Finds the features of `image` with these options.
    pub fn with_options(name: String, image: GrayView<'_>, options: &FeatureOptions) -> Self {
        let features = Arc::new(find_features(image, options));
        let patches = Some(Arc::new(PatchImage::of(image)));
        Self { name, size: image.size(), features, patches, stated: None }
    }

    /// One with these features.
    #[cfg(test)]
    pub(crate) fn of_features(name: &str, size: ImageSize, features: Features) -> Self {
        let (name, features) = (name.to_owned(), Arc::new(features));
        Self { name, size, features, patches: None, stated: None }
    }

    /// Where its features are, strongest first.
    pub fn pixels(&self) -> impl Iterator<Item = Pixel> + '_ {
        self.features.keypoints.iter().map(|keypoint| keypoint.pixel)
    }

    /// The first feature at the pixel of `feature`: a keypoint has one feature for each dominant
    /// direction around it, but is measured once.
    fn keypoint_of(&self, feature: usize) -> usize {
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

/// What the matches of all pairs of images yield.
#[derive(Debug, Clone)]
pub(super) struct ImagePairs {
    pub problem: SceneProblem,
    /// Pairs with an epipolar geometry.
    pub general: Vec<ImagePair>,
    /// Pairs that a homography explains.
    pub rotated: Vec<RotatedPair>,
    /// For each pair, the homography that explains most of its matches, however many it leaves:
    /// distortion makes even a pure rotation deviate from a homography.
    pub homographies: Vec<RotatedPair>,
    /// The number of pairs of which a homography explains nearly all matches.
    pub nearly_planar: usize,
    /// The number of pairs that share only what stays at its place in the image.
    pub still: usize,
    /// The number of inlier matches between each image and the next.
    pub between_neighbors: Vec<usize>,
    /// For each image but the last: the fraction of its features that match several places of the
    /// next image.
    pub repeated: Vec<f64>,
    /// For each image, an earlier one of the same view. Such an image is in no pair and no track:
    /// it would repeat the earlier observations with the same errors.
    pub same_as: Vec<Option<usize>>,
}

/// The number of strongest features of each image that are matched first, to skip pairs that share
/// nothing.
const PREVIEWED_FEATURES: usize = 600;

/// Pairs with fewer preliminary matches are skipped unless they are neighbors: as many arise by
/// chance.
const LEAST_PREVIEW_MATCHES: usize = 6;

/// Matches and verifies all pairs of `images` with `threads` threads. Stops early once `interrupt`
/// is requested.
pub(super) fn correspond(
    images: &[SceneImage],
    size: ImageSize,
    threads: usize,
    interrupt: &Interrupt,
) -> ImagePairs {
    let tables: Vec<DescriptorTable> = images.iter().map(|image| image.table(usize::MAX)).collect();
    let previews: Vec<DescriptorTable> =
        images.iter().map(|image| image.table(PREVIEWED_FEATURES)).collect();
    let pairs: Vec<(usize, usize)> =
        (0..images.len()).flat_map(|i| (i + 1..images.len()).map(move |j| (i, j))).collect();
    let compared = in_parallel(&pairs, threads, |(i, j)| {
        let is_neighbor = *j == i + 1;
        if interrupt.is_requested() {
            return (None, None);
        }
        let preview = match_descriptors(&previews[*i], &previews[*j]);
        if preview.len() < LEAST_PREVIEW_MATCHES && !is_neighbor {
            return (None, None);
        }
        let Comparison { matches, repeated } = compare_descriptors(&tables[*i], &tables[*j]);
        let part = repeated as f64 / images[*i].feature_count().max(1) as f64;
        let points = matches.iter().map(|m| point_pair(&images[*i], &images[*j], *m));
        let points: Vec<PointPair> = points.collect();
        let found = scene_geometry(&points, fewer_features(&images[*i], &images[*j]), size);
        let matched = found.map(|SceneGeometry { geometry, fixed }| Matched {
            matches,
            points,
            geometry,
            fixed,
        });
        (matched, is_neighbor.then_some(part))
    });
    let (mut matched, repeated): (Vec<Option<Matched>>, Vec<Option<f64>>) =
        compared.into_iter().unzip();
    drop_fixed(images, &pairs, &mut matched, size, (threads, interrupt));
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
        between_neighbors: Vec::new(),
        repeated: repeated.into_iter().flatten().collect(),
        same_as: Vec::new(),
    };
    found.same_as = same_views(images, pairs.iter().zip(&matched));
    let mut verified: Vec<(usize, usize, Vec<Match>)> = Vec::new();
    for ((first, second), matched) in pairs.into_iter().zip(matched) {
        if found.same_as[first].or(found.same_as[second]).is_some() {
            continue;
        }
        if found.same_as[first + 1..second].iter().all(Option::is_some) {
            let moved = matched.as_ref().filter(|of| of.geometry.kind != TwoViewKind::Still);
            let inliers = moved.map_or(0, |of| of.geometry.inliers.len());
            found.between_neighbors.push(inliers);
        }
        let Some(Matched { matches, points, geometry, .. }) = matched else { continue };
        if geometry.kind == TwoViewKind::Still {
            found.still += 1;
            continue;
        }
        let of_keypoints = |k: &usize| Match {
            first: images[first].keypoint_of(matches[*k].first),
            second: images[second].keypoint_of(matches[*k].second),
        };
        verified.push((first, second, geometry.inliers.iter().map(of_keypoints).collect()));
        found.add_pair(first, second, &points, &geometry);
    }
    let tracks = join_tracks(&verified);
    found.problem.tracks = tracks
        .iter()
        .map(|track| track.iter().map(|(image, k)| track_point(images, *image, *k)).collect())
        .collect();
    found
}

/// The matches of a pair of images, with the geometry that they determine.
struct Matched {
    matches: Vec<Match>,
    points: Vec<PointPair>,
    geometry: TwoViewGeometry,
    /// The matches that are known to be fixed to the camera.
    fixed: Vec<usize>,
}

/// Finds the geometry of pairs anew without what other pairs show to be fixed to the camera. Images
/// that share nothing else show the robot's own body only, which is no reason to take them for one
/// view.
fn drop_fixed(
    images: &[SceneImage],
    pairs: &[(usize, usize)],
    matched: &mut [Option<Matched>],
    size: ImageSize,
    (threads, interrupt): (usize, &Interrupt),
) {
    let mut fixed: Vec<BTreeSet<usize>> = vec![BTreeSet::new(); images.len()];
    for ((first, second), of) in pairs.iter().zip(matched.iter()) {
        let Some(of) = of else { continue };
        for Match { first: a, second: b } in of.fixed.iter().map(|k| of.matches[*k]) {
            fixed[*first].insert(images[*first].keypoint_of(a));
            fixed[*second].insert(images[*second].keypoint_of(b));
        }
    }
    let numbers: Vec<usize> = (0..pairs.len()).collect();
    let again = in_parallel(&numbers, threads, |number| {
        let (first, second) = pairs[*number];
        let goes_on = |of: &&Matched| of.fixed.is_empty() && !interrupt.is_requested();
        let of = matched[*number].as_ref().filter(goes_on)?;
        let is_fixed = |k: &usize| {
            let Match { first: a, second: b } = of.matches[*k];
            let is_known = |image: usize, feature: usize| {
                fixed[image].contains(&images[image].keypoint_of(feature))
            };
            stayed(&of.points[*k]) && (is_known(first, a) || is_known(second, b))
        };
        let (fixed, rest): (Vec<usize>, Vec<usize>) =
            (0..of.points.len()).partition(|k| is_fixed(k));
        (!fixed.is_empty()).then(|| geometry_of(&of.points, &rest, size))
    });
    for (of, again) in matched.iter_mut().zip(again) {
        let Some(found) = again else { continue };
        *of = of.take().zip(found).map(|(of, geometry)| Matched { geometry, ..of });
    }
}

fn fewer_features(first: &SceneImage, second: &SceneImage) -> usize {
    first.feature_count().min(second.feature_count())
}

/// For each image, the first earlier image of the same view that is not itself such a repetition:
/// in a slow motion, an image is compared with the last one kept, not with its predecessor.
fn same_views<'a>(
    images: &[SceneImage],
    matched: impl Iterator<Item = (&'a (usize, usize), &'a Option<Matched>)>,
) -> Vec<Option<usize>> {
    let is_same = |((first, second), matched): &(&(usize, usize), &Option<Matched>)| {
        let features = fewer_features(&images[*first], &images[*second]);
        matched.as_ref().is_some_and(|of| is_one_view(&of.geometry, features))
    };
    let same: Vec<(usize, usize)> = matched.filter(is_same).map(|(pair, _)| *pair).collect();
    let mut same_as = vec![None; images.len()];
    for image in 0..images.len() {
        let earlier =
            same.iter().filter(|(first, second)| *second == image && same_as[*first].is_none());
        same_as[image] = earlier.map(|(first, _)| *first).min();
    }
    same_as
}

impl ImagePairs {
    /// The fraction of an image's features that match several places of the next image: the median
    /// over the images.
    pub fn repeated_part(&self) -> f64 {
        median(self.repeated.clone()).unwrap_or(0.0)
    }

    /// The number of images of different views.
    pub fn views(&self) -> usize {
        self.same_as.iter().filter(|same| same.is_none()).count()
    }

    fn add_pair(
        &mut self,
        first: usize,
        second: usize,
        points: &[PointPair],
        geometry: &TwoViewGeometry,
    ) {
        let matches: Vec<PointPair> = geometry.inliers.iter().map(|k| points[*k]).collect();
        self.nearly_planar += usize::from(geometry.is_nearly_planar);
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

/// Applies `work` to each of `items`; the results are in their order whatever the number of
/// threads.
pub(super) fn in_parallel<T: Sync, R: Send>(
    items: &[T],
    threads: usize,
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    if threads <= 1 || items.len() < 2 {
        return items.iter().map(work).collect();
    }
    let share = items.len().div_ceil(threads);
    let of_part = |part: &[T]| part.iter().map(&work).collect::<Vec<R>>();
    std::thread::scope(|scope| {
        let of_part = &of_part;
        let parts = items.chunks(share).enumerate().map(|(index, part)| {
            let thread = std::thread::Builder::new().name(format!("scene-{index}"));
            (part, thread.spawn_scoped(scope, move || of_part(part)))
        });
        let begun: Vec<_> = parts.collect();
        let results = begun.into_iter().flat_map(|(part, thread)| match thread {
            Ok(thread) => thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
            // The system has no thread left: this one does its part.
            Err(_) => of_part(part),
        });
        results.collect()
    })
}
