//! Localizes the points of a reconstruction in its images more exactly than keypoints do. The
//! extremum of a scale space lies elsewhere on a surface that is seen at another slant, and the
//! center of a spot does not project to the center of its image: neighboring images share these
//! errors, and a lens fit absorbs them. So the patch of one image is matched in the others by least
//! squares (A. Grün, *Adaptive least squares correlation*, 1985), warped by the surface's slope,
//! the poses and the lens; the slope is one of the unknowns.

use nalgebra::{Matrix2, Matrix4, Matrix4x2, Point2, Vector2, Vector3, Vector4};

use crate::calibration::scene::correspondence::{SceneImage, in_parallel};
use crate::estimation::scene::bundle::{Bundle, SceneObservation, SceneState};
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::features::patch::PatchImage;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

/// Samples along each side of a patch.
const SAMPLES_PER_SIDE: usize = 11;
/// Half the side of a patch, in keypoint scales: about what the inner cells of a descriptor cover.
const RADIUS_SCALES: f64 = 3.0;
/// Bounds of half the side of a patch, in pixels of the sampled image.
const RADIUS_PX: [f64; 2] = [4.0, 12.0];
/// The greatest number of steps of the fit.
const MOST_STEPS: usize = 10;
/// The fit ends once no view moves by more, in pixels.
const SETTLED_PX: f64 = 0.01;
/// The longest step of a view, in pixels.
const LONGEST_STEP_PX: f64 = 1.0;
/// Patches with less correlation show different things, or an occlusion boundary.
const LEAST_CORRELATION: f64 = 0.85;
/// The match may be this far from the keypoint: the first in pixels, plus the second times its
/// scale.
const FARTHEST_PX_AND_SCALES: [f64; 2] = [0.5, 0.5];
/// Standard deviation of the prior on a surface's slope, as the tangent of the angle to the image.
const SLOPE_STD: f64 = 1.5;
/// Standard deviation of luma, of 255, against which that prior is weighted; patches with less
/// contrast are not matched.
const LUMA_STD: f64 = 2.0;
/// The least error of interpolation, in pixels of the sampled image.
const LEAST_STD_PX: f64 = 0.03;

/// Moves the observations of `start` to where the images show the same spot, with the standard
/// deviations of the patch fits. Observations that are not matched stay as they are.
pub(super) fn localize(images: &[SceneImage], start: &mut Reconstruction, threads: usize) {
    let patches: Option<Vec<&PatchImage>> =
        start.images.iter().map(|image| images[*image].patches()).collect();
    let Some(patches) = patches else { return };
    let points: Vec<usize> = (0..start.state.points.len()).collect();
    let located = {
        let (bundle, state) = (&start.bundle, &start.state);
        in_parallel(&points, threads, |point| located(&patches, bundle, state, *point))
    };
    for (seen, located) in start.bundle.observations.iter_mut().zip(located) {
        let Some(located) = located else { continue };
        for (seen, located) in seen.iter_mut().zip(located) {
            let Some((pixel, std_px)) = located else { continue };
            (seen.pixel, seen.inverse_std) = (pixel, 1.0 / std_px);
        }
    }
}

/// The refined pixel of each observation of a point, with the standard deviation per coordinate.
fn located(
    patches: &[&PatchImage],
    bundle: &Bundle,
    state: &SceneState,
    point: usize,
) -> Option<Vec<Option<(Pixel, f64)>>> {
    let seen = &bundle.observations[point];
    let reference = reference(state, seen, point);
    let reference_patch = ReferencePatch::of(patches, state, &seen[reference], point)?;
    let mut views: Vec<Option<MatchedPatch<'_>>> = seen
        .iter()
        .enumerate()
        .map(|(k, seen)| {
            let view = || MatchedPatch::of(patches[seen.camera], state, &reference_patch, seen);
            (k != reference).then(view).flatten()
        })
        .collect();
    let mut slope = Vector2::zeros();
    for _ in 0..MOST_STEPS {
        let (step, step_px) = reference_patch.step(&mut views, &state.lens, slope);
        slope += step;
        if step_px < SETTLED_PX {
            break;
        }
    }
    let mut located = vec![None; seen.len()];
    let mut least = f64::INFINITY;
    for ((at, view), seen) in located.iter_mut().zip(&views).zip(seen) {
        let Some(view) = view else { continue };
        let Some((pixel, std_px)) = view.found(&reference_patch, &state.lens, slope) else {
            continue;
        };
        let farthest_px = FARTHEST_PX_AND_SCALES[0] + FARTHEST_PX_AND_SCALES[1] * seen.scale_px;
        let is_better = std_px * seen.inverse_std < 1.0;
        if is_better && pixel.distance_px(seen.pixel) <= farthest_px {
            *at = Some((pixel, std_px));
            least = least.min(std_px);
        }
    }
    if !least.is_finite() {
        return None;
    }
    located[reference] = Some((seen[reference].pixel, least));
    Some(located)
}

/// The observation whose ray is closest to the mean of all rays: the others differ least from it.
fn reference(state: &SceneState, seen: &[SceneObservation], point: usize) -> usize {
    let point = state.points[point];
    let ray = |seen: &SceneObservation| {
        let center = state.cameras_from_scene[seen.camera].inverse().translation();
        (point.coords - center).try_normalize(1e-12).unwrap_or_else(Vector3::zeros)
    };
    let mean: Vector3<f64> = seen.iter().map(ray).sum();
    let nearness = |k: &usize| ray(&seen[*k]).dot(&mean);
    (0..seen.len()).max_by(|a, b| nearness(a).total_cmp(&nearness(b))).unwrap_or(0)
}

/// The patch of the reference image.
struct ReferencePatch {
    camera_from_scene: Pose,
    /// Normalized coordinates of a grid of three by three places in the patch, row by row.
    places: [Point2<f64>; 9],
    /// The inverse depth of the patch's center.
    inverse_depth: f64,
    /// Luma at the samples, row by row, its mean 0 and its mean square 1.
    luma: [f64; SAMPLES_PER_SIDE * SAMPLES_PER_SIDE],
    /// The number of samples per pixel, at least 1: samples closer than a pixel are not
    /// independent.
    independent: f64,
}

/// The position of sample `k` along a side, -1 to 1.
fn side(k: usize) -> f64 {
    2.0 * k as f64 / (SAMPLES_PER_SIDE - 1) as f64 - 1.0
}

/// The weight of a row or column of samples: exp(−2 t²), a Gaussian whose σ is half of half the
/// patch's side.
const WEIGHTS: [f64; SAMPLES_PER_SIDE] = [
    0.135_335, 0.278_037, 0.486_752, 0.726_149, 0.923_116, 1.0, 0.923_116, 0.726_149, 0.486_752,
    0.278_037, 0.135_335,
];

/// The weight of sample `k`.
fn weight(k: usize) -> f64 {
    WEIGHTS[k % SAMPLES_PER_SIDE] * WEIGHTS[k / SAMPLES_PER_SIDE]
}

impl ReferencePatch {
    fn of(
        patches: &[&PatchImage],
        state: &SceneState,
        seen: &SceneObservation,
        point: usize,
    ) -> Option<Self> {
        let camera_from_scene = state.cameras_from_scene[seen.camera];
        let depth = (camera_from_scene * state.points[point]).z;
        let image = patches[seen.camera];
        let [least, most] = RADIUS_PX.map(|px| px * image.spacing_px());
        let radius_px = (RADIUS_SCALES * seen.scale_px).clamp(least, most);
        let at =
            |u: f64, v: f64| Pixel::new(seen.pixel.x + radius_px * u, seen.pixel.y + radius_px * v);
        let mut places = [Point2::origin(); 9];
        for (k, place) in places.iter_mut().enumerate() {
            let pixel = at((k % 3) as f64 - 1.0, (k / 3) as f64 - 1.0);
            let bearing = state.lens.bearing_from_pixel(pixel)?;
            *place = Point2::new(bearing.x / bearing.z, bearing.y / bearing.z);
        }
        let mut luma = [0.0; SAMPLES_PER_SIDE * SAMPLES_PER_SIDE];
        for (k, luma) in luma.iter_mut().enumerate() {
            *luma = image.sample(at(side(k % SAMPLES_PER_SIDE), side(k / SAMPLES_PER_SIDE)))?.value;
        }
        let (mean, std) = mean_and_std(&luma);
        if std < LUMA_STD {
            return None;
        }
        luma.iter_mut().for_each(|luma| *luma = (*luma - mean) / std);
        let spacing = 2.0 * radius_px / (SAMPLES_PER_SIDE - 1) as f64 / image.spacing_px();
        let independent = (1.0 / spacing).powi(2).max(1.0);
        let inverse_depth = 1.0 / depth;
        Some(Self { camera_from_scene, places, inverse_depth, luma, independent })
    }

    /// One Gauss–Newton step of all views, their own unknowns eliminated by the Schur complement.
    /// Returns the step of the slope, and the longest step of a view in pixels.
    fn step(
        &self,
        views: &mut [Option<MatchedPatch<'_>>],
        lens: &Lens,
        slope: Vector2<f64>,
    ) -> (Vector2<f64>, f64) {
        let prior = (LUMA_STD / SLOPE_STD).powi(2);
        let mut normal = Matrix2::identity() * prior;
        let mut gradient = slope * prior;
        let mut solved = Vec::with_capacity(views.len());
        for slot in views.iter_mut() {
            let equations = slot.as_ref().and_then(|view| view.equations(self, lens, slope));
            let Some((equations, inverse)) =
                equations.and_then(|e| e.own.try_inverse().map(|inverse| (e, inverse)))
            else {
                *slot = None;
                solved.push(None);
                continue;
            };
            let carried = equations.mixed.transpose() * inverse;
            normal += equations.slope - carried * equations.mixed;
            gradient += equations.slope_gradient - carried * equations.own_gradient;
            solved.push(Some((equations, inverse)));
        }
        let step = normal.try_inverse().map_or_else(Vector2::zeros, |i| -(i * gradient));
        let mut step_px = 0.0_f64;
        for (view, solved) in views.iter_mut().zip(solved) {
            let (Some(view), Some((equations, inverse))) = (view, solved) else { continue };
            let own = -(inverse * (equations.own_gradient + equations.mixed * step));
            let offset = Vector2::new(own[0], own[1]);
            step_px = step_px.max(offset.norm());
            view.offset += offset * (LONGEST_STEP_PX / offset.norm().max(LONGEST_STEP_PX));
            (view.gain, view.level) = (view.gain + own[2], view.level + own[3]);
        }
        (step, step_px)
    }
}

/// The weighted mean and standard deviation of a patch.
fn mean_and_std(luma: &[f64; SAMPLES_PER_SIDE * SAMPLES_PER_SIDE]) -> (f64, f64) {
    let (mut sum, mut squares, mut total) = (0.0, 0.0, 0.0);
    for (k, value) in luma.iter().enumerate() {
        let weight = weight(k);
        (sum, squares, total) =
            (sum + weight * value, squares + weight * value * value, total + weight);
    }
    let mean = sum / total;
    (mean, (squares / total - mean * mean).max(0.0).sqrt())
}

/// Another image that shows the spot.
struct MatchedPatch<'a> {
    image: &'a PatchImage,
    view_from_reference: Pose,
    /// From the projection of the point to the matched spot.
    offset: Vector2<f64>,
    gain: f64,
    level: f64,
}

/// The normal equations of one view: over its offset, gain and level, and over the slope.
struct ViewEquations {
    own: Matrix4<f64>,
    own_gradient: Vector4<f64>,
    mixed: Matrix4x2<f64>,
    slope: Matrix2<f64>,
    slope_gradient: Vector2<f64>,
    /// The weighted sum of squared residuals.
    residual_squares: f64,
}

impl<'a> MatchedPatch<'a> {
    fn of(
        image: &'a PatchImage,
        state: &SceneState,
        reference_patch: &ReferencePatch,
        seen: &SceneObservation,
    ) -> Option<Self> {
        let view_from_reference =
            state.cameras_from_scene[seen.camera] * reference_patch.camera_from_scene.inverse();
        let mut view =
            Self { image, view_from_reference, offset: Vector2::zeros(), gain: 1.0, level: 0.0 };
        let warp = view.warp(reference_patch, &state.lens, Vector2::zeros())?;
        view.offset = seen.pixel.to_vector() - warp.nodes[4];
        let luma = view.samples(&warp)?.map(|sample| sample.0);
        let (mean, std) = mean_and_std(&luma);
        (view.level, view.gain) = (mean, std);
        (std >= LUMA_STD).then_some(view)
    }

    /// Where the patch's places project to if the surface slopes by `slope`.
    fn warp(
        &self,
        reference_patch: &ReferencePatch,
        lens: &Lens,
        slope: Vector2<f64>,
    ) -> Option<Warp> {
        let rotation = self.view_from_reference.rotation_matrix();
        let translation = self.view_from_reference.translation();
        let mut nodes = [Vector2::zeros(); 9];
        let mut span = [Vector2::zeros(); 2];
        for (node, place) in nodes.iter_mut().zip(&reference_patch.places) {
            let from_middle = place - reference_patch.places[4];
            let inverse_depth = reference_patch.inverse_depth * (1.0 + slope.dot(&from_middle));
            let ray = rotation * Vector3::new(place.x, place.y, 1.0);
            *node = lens.pixel_from_point(&(ray + translation * inverse_depth).into())?.to_vector();
        }
        let middle = rotation
            * Vector3::new(reference_patch.places[4].x, reference_patch.places[4].y, 1.0)
            + translation * reference_patch.inverse_depth;
        let by_depth =
            lens.project(&middle.into())?.by_point * translation * reference_patch.inverse_depth;
        // Normalized coordinates by places of the patch from -1 to 1.
        for (by, axis) in span.iter_mut().zip([[5, 3], [7, 1]]) {
            *by = (reference_patch.places[axis[0]] - reference_patch.places[axis[1]]) * 0.5;
        }
        Some(Warp { nodes, by_depth, span })
    }

    /// Luma and its gradient at each sample.
    fn samples(
        &self,
        warp: &Warp,
    ) -> Option<[(f64, Vector2<f64>); SAMPLES_PER_SIDE * SAMPLES_PER_SIDE]> {
        let mut samples = [(0.0, Vector2::zeros()); SAMPLES_PER_SIDE * SAMPLES_PER_SIDE];
        for row in 0..SAMPLES_PER_SIDE {
            let along = warp.row(side(row));
            for column in 0..SAMPLES_PER_SIDE {
                let at = parabola(&along, side(column)) + self.offset;
                let sample = self.image.sample(Pixel::new(at.x, at.y))?;
                samples[row * SAMPLES_PER_SIDE + column] =
                    (sample.value, Vector2::from(sample.slope));
            }
        }
        Some(samples)
    }

    fn equations(
        &self,
        reference_patch: &ReferencePatch,
        lens: &Lens,
        slope: Vector2<f64>,
    ) -> Option<ViewEquations> {
        let warp = self.warp(reference_patch, lens, slope)?;
        let samples = self.samples(&warp)?;
        let mut e = ViewEquations {
            own: Matrix4::zeros(),
            own_gradient: Vector4::zeros(),
            mixed: Matrix4x2::zeros(),
            slope: Matrix2::zeros(),
            slope_gradient: Vector2::zeros(),
            residual_squares: 0.0,
        };
        for (k, (value, by_pixel)) in samples.into_iter().enumerate() {
            let weight = weight(k);
            let residual = value - self.gain * reference_patch.luma[k] - self.level;
            let own = Vector4::new(by_pixel.x, by_pixel.y, -reference_patch.luma[k], -1.0);
            let from_middle = warp.span[0] * side(k % SAMPLES_PER_SIDE)
                + warp.span[1] * side(k / SAMPLES_PER_SIDE);
            let by_slope = from_middle * by_pixel.dot(&warp.by_depth);
            e.own += own * own.transpose() * weight;
            e.own_gradient += own * (residual * weight);
            e.mixed += own * by_slope.transpose() * weight;
            e.slope += by_slope * by_slope.transpose() * weight;
            e.slope_gradient += by_slope * (residual * weight);
            e.residual_squares += residual * residual * weight;
        }
        Some(e)
    }

    /// The matched pixel and the standard deviation of each coordinate; `None` where the images
    /// show different things.
    fn found(
        &self,
        reference_patch: &ReferencePatch,
        lens: &Lens,
        slope: Vector2<f64>,
    ) -> Option<(Pixel, f64)> {
        let equations = self.equations(reference_patch, lens, slope)?;
        let total: f64 = (0..SAMPLES_PER_SIDE * SAMPLES_PER_SIDE).map(weight).sum();
        // The reference patch has unit variance, so the gain's square is the explained variance.
        let explained = self.gain * self.gain * total;
        let correlation2 = explained / (explained + equations.residual_squares);
        if self.gain <= 0.0 || correlation2 < LEAST_CORRELATION * LEAST_CORRELATION {
            return None;
        }
        let variance = equations.residual_squares / total * reference_patch.independent;
        let covariance = equations.own.try_inverse()? * variance;
        let std_px = (0.5 * (covariance[(0, 0)] + covariance[(1, 1)])).sqrt();
        let node = self.warp(reference_patch, lens, slope)?.nodes[4] + self.offset;
        let least = LEAST_STD_PX * self.image.spacing_px();
        std_px.is_finite().then(|| (Pixel::new(node.x, node.y), std_px.hypot(least)))
    }
}

/// Where a patch projects to: three by three nodes, with parabolas between them.
struct Warp {
    nodes: [Vector2<f64>; 9],
    /// The derivative of the pixel by the relative inverse depth.
    by_depth: Vector2<f64>,
    /// Normalized coordinates of the reference along both sides of the patch.
    span: [Vector2<f64>; 2],
}

impl Warp {
    /// The three places along a row.
    fn row(&self, at: f64) -> [Vector2<f64>; 3] {
        let column = |k: usize| [self.nodes[k], self.nodes[k + 3], self.nodes[k + 6]];
        std::array::from_fn(|k| parabola(&column(k), at))
    }
}

/// The parabola through three places at -1, 0 and 1.
#[inline(always)]
fn parabola(through: &[Vector2<f64>; 3], at: f64) -> Vector2<f64> {
    through[0] * (0.5 * at * (at - 1.0))
        + through[1] * (1.0 - at * at)
        + through[2] * (0.5 * at * (at + 1.0))
}

#[cfg(test)]
#[path = "localization_tests.rs"]
mod tests;
