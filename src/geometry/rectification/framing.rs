//! The framing of rectified images: which part of the field of view of one camera, or of two
//! parallel ones, they show.

use nalgebra::{Matrix3, Vector2, Vector4};

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::flat_image::{WIDEST, flat_from_ray};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::rectification::{StereoAxis, StereoCamera};

/// A camera with the rotation that rectifies it.
pub(super) struct RotatedCamera<'a> {
    pub camera: &'a StereoCamera,
    pub rectified_from_camera: Matrix3<f64>,
}

/// The camera matrix of both rectified images, of `size`.
pub(super) fn common_matrix(
    cameras: &[RotatedCamera<'_>; 2],
    axis: StereoAxis,
    size: ImageSize,
    alpha: f64,
) -> CameraMatrix {
    let (focal_px, principal) = match cameras.iter().all(RotatedCamera::is_plane) {
        true => by_rectangles(cameras, axis, size, alpha),
        false => by_sides(cameras, size, alpha),
    };
    CameraMatrix { fx: focal_px, fy: focal_px, cx: principal.x, cy: principal.y, skew: 0.0 }
}

/// The camera matrix of the rectified images of a single camera, of the same size as its own.
pub(super) fn own_matrix(camera: &RotatedCamera<'_>, alpha: f64) -> CameraMatrix {
    let matrix = match camera.is_plane() {
        true => camera.matrix_by_rectangles(alpha),
        false => camera.matrix_by_sides(camera.camera.image_size, alpha),
    };
    let CameraMatrix { fx, fy, cx, cy, .. } = matrix;
    // For a lens that sees next to nothing, no field can fill the image.
    let is_usable = fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|value| value.is_finite());
    if is_usable { matrix } else { camera.camera.lens.matrix }
}

/// As OpenCV's `stereoRectify`. The center of what the image corners show is in the center of the
/// rectified image. The focal length is between the least that shows only what both cameras see
/// everywhere, and the greatest that shows all of their fields of view.
fn by_rectangles(
    cameras: &[RotatedCamera<'_>; 2],
    axis: StereoAxis,
    size: ImageSize,
    alpha: f64,
) -> (f64, Vector2<f64>) {
    let start = 0.5 * cameras.iter().map(|camera| camera.focal_px(axis, size)).sum::<f64>();
    let last = Vector2::new(f64::from(size.width), f64::from(size.height)).map(|l| l - 1.0);
    let [a, b] = cameras.each_ref().map(RotatedCamera::middle_of_corners);
    let principal = 0.5 * last - start * 0.5 * (a + b);
    // The focal lengths at which each side of a field coincides with that of the image.
    let reaching = |field: &FlatField| {
        let FlatField { low, high } = field;
        [
            -principal.x / low.x,
            -principal.y / low.y,
            (last.x - principal.x) / high.x,
            (last.y - principal.y) / high.y,
        ]
    };
    let fields = cameras.each_ref().map(RotatedCamera::fields);
    let positive = |focal_px: &f64| focal_px.is_finite() && *focal_px > 0.0;
    let of_inner = fields.iter().flat_map(|(inner, _)| reaching(inner)).filter(positive);
    let of_outer = fields.iter().flat_map(|(_, outer)| reaching(outer)).filter(positive);
    let inner = of_inner.reduce(f64::max).unwrap_or(start);
    let outer = of_outer.reduce(f64::min).unwrap_or(start);
    (inner * (1.0 - alpha) + outer * alpha, principal)
}

/// As OpenCV's `fisheye::stereoRectify`, by the midpoints of the images' sides, which OpenCV takes
/// half a pixel to the right of and below their true positions.
fn by_sides(cameras: &[RotatedCamera<'_>; 2], size: ImageSize, alpha: f64) -> (f64, Vector2<f64>) {
    let [a, b] = cameras.each_ref().map(|camera| camera.matrix_by_sides(size, alpha));
    (a.fy.min(b.fy), 0.5 * Vector2::new(a.cx + b.cx, a.cy + b.cy))
}

/// A rectangle of normalized coordinates.
#[derive(Debug, Clone, Copy)]
struct FlatField {
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl RotatedCamera<'_> {
    /// Whether its lens distorts an image plane, as OpenCV's models except `fisheye` do.
    fn is_plane(&self) -> bool {
        self.camera.lens.model().facts().opencv.is_some_and(|known| !known.fisheye)
    }

    /// Normalized coordinates in the rectified frame of the ray through `pixel`.
    fn flat(&self, pixel: Pixel) -> Option<Vector2<f64>> {
        let ray = self.camera.lens.bearing_from_pixel(pixel)?;
        Some(flat_from_ray(&(self.rectified_from_camera * ray.into_inner())))
    }

    /// The focal length perpendicular to the axis, for images of `size`.
    fn focal_px(&self, axis: StereoAxis, size: ImageSize) -> f64 {
        let (own, matrix) = (self.camera.image_size, &self.camera.lens.matrix);
        match axis {
            StereoAxis::Horizontal => matrix.fy * f64::from(size.height) / f64::from(own.height),
            StereoAxis::Vertical => matrix.fx * f64::from(size.width) / f64::from(own.width),
        }
    }

    /// The mean of the rectified positions of the image's corners; where the lens model does not
    /// reach all four, of points as far towards them as it does.
    fn middle_of_corners(&self) -> Vector2<f64> {
        let [x, y] = self.last_pixel().map(|last| 0.5 * last);
        let corners_at = |part: f64| {
            let corners = [(-part, -part), (part, -part), (-part, part), (part, part)];
            let seen = corners
                .map(|(right, down)| self.flat(Pixel::new(x * (1.0 + right), y * (1.0 + down))));
            let seen: Vec<Vector2<f64>> = seen.into_iter().flatten().collect();
            (seen.len() == corners.len()).then(|| mean(seen.into_iter()))
        };
        parts().find_map(corners_at).unwrap_or_else(Vector2::zeros)
    }

    /// The largest field that the image covers everywhere, from the image's sides (or as far
    /// towards them as the lens model reaches), and the smallest field that contains the whole
    /// image.
    fn fields(&self) -> (FlatField, FlatField) {
        // OpenCV's grid.
        const LAST: u32 = 8;
        let [right, bottom] = self.last_pixel();
        let widest = Vector2::repeat(WIDEST);
        let mut inner = FlatField { low: -widest, high: widest };
        let mut outer = FlatField { low: widest, high: -widest };
        for (row, col) in (0..=LAST).flat_map(|row| (0..=LAST).map(move |col| (row, col))) {
            let part = |step: u32, length: f64| f64::from(step) * length / f64::from(LAST);
            let Some(at) = self.flat(Pixel::new(part(col, right), part(row, bottom))) else {
                continue;
            };
            outer = FlatField { low: outer.low.inf(&at), high: outer.high.sup(&at) };
            if col == 0 {
                inner.low.x = inner.low.x.max(at.x);
            } else if col == LAST {
                inner.high.x = inner.high.x.min(at.x);
            }
            if row == 0 {
                inner.low.y = inner.low.y.max(at.y);
            } else if row == LAST {
                inner.high.y = inner.high.y.min(at.y);
            }
        }
        let inner = FlatField { low: inner.low.sup(&outer.low), high: inner.high.inf(&outer.high) };
        (inner, outer)
    }

    /// OpenCV's `getOptimalNewCameraMatrix`: between the matrix with which the inner of the two
    /// [`Self::fields`] fills the image, and the one with which the outer does.
    fn matrix_by_rectangles(&self, alpha: f64) -> CameraMatrix {
        let last = Vector2::from(self.last_pixel());
        let filling = |FlatField { low, high }: FlatField| {
            let focal = last.component_div(&(high - low));
            Vector4::new(focal.x, focal.y, -focal.x * low.x, -focal.y * low.y)
        };
        let (inner, outer) = self.fields();
        let between = filling(inner).lerp(&filling(outer), alpha);
        CameraMatrix { fx: between.x, fy: between.y, cx: between.z, cy: between.w, skew: 0.0 }
    }

    /// OpenCV's `fisheye::estimateNewCameraMatrixForUndistortRectify`, for rectified images of
    /// `size`.
    fn matrix_by_sides(&self, size: ImageSize, alpha: f64) -> CameraMatrix {
        let own = self.camera.image_size;
        let (width, height) = (f64::from(own.width), f64::from(own.height));
        let (half_width, half_height) = (f64::from(own.width / 2), f64::from(own.height / 2));
        let aspect = self.camera.lens.matrix.fx / self.camera.lens.matrix.fy;
        let sides =
            [(half_width, 0.0), (width, half_height), (half_width, height), (0.0, half_height)];
        let half = Vector2::new(half_width, half_height);
        let flat =
            sides.into_iter().filter_map(|(x, y)| self.flat_towards(half, Vector2::new(x, y)));
        let square: Vec<Vector2<f64>> = flat.map(|at| Vector2::new(at.x, at.y * aspect)).collect();
        let middle = mean(square.iter().copied());
        let reach = 0.5 * Vector2::new(width, height * aspect);
        let low = square.iter().fold(middle, |low, at| low.inf(at));
        let high = square.iter().fold(middle, |high, at| high.sup(at));
        let each = [
            reach.x / (middle.x - low.x),
            reach.x / (high.x - middle.x),
            reach.y / (middle.y - low.y),
            reach.y / (high.y - middle.y),
        ];
        let finite = each.into_iter().filter(|focal_px| focal_px.is_finite());
        let least = finite.clone().reduce(f64::min).unwrap_or(self.camera.lens.matrix.fx);
        let most = finite.reduce(f64::max).unwrap_or(self.camera.lens.matrix.fx);
        let focal_px = alpha * least + (1.0 - alpha) * most;
        let principal = reach - focal_px * middle;
        let scale = Vector2::new(f64::from(size.width) / width, f64::from(size.height) / height);
        CameraMatrix {
            fx: focal_px * scale.x,
            fy: focal_px / aspect * scale.y,
            cx: principal.x * scale.x,
            cy: principal.y / aspect * scale.y,
            skew: 0.0,
        }
    }

    /// The rectified position of the pixel `to`, or of one as far towards it from `from` as the
    /// lens model reaches.
    fn flat_towards(&self, from: Vector2<f64>, to: Vector2<f64>) -> Option<Vector2<f64>> {
        parts().find_map(|part| self.flat(Pixel::from(from + (to - from) * part)))
    }

    fn last_pixel(&self) -> [f64; 2] {
        let ImageSize { width, height } = self.camera.image_size;
        [f64::from(width) - 1.0, f64::from(height) - 1.0]
    }
}

/// Parts of a path on which the end of a lens model's range is searched for, from the whole path
/// downwards.
fn parts() -> impl Iterator<Item = f64> {
    // The end is found to a twentieth of the path. Chosen.
    const STEPS: u32 = 20;
    (1..=STEPS).rev().map(|step| f64::from(step) / f64::from(STEPS))
}

/// The mean of `places`; 0 of none.
fn mean(places: impl Iterator<Item = Vector2<f64>>) -> Vector2<f64> {
    let (sum, count) = places.fold((Vector2::zeros(), 0.0), |(sum, n), at| (sum + at, n + 1.0));
    sum / f64::max(count, 1.0)
}
