//! Where the points that a row of depths stands for are in another camera's image: in single
//! precision and without a branch.

use nalgebra::{Point3, Vector3};

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::registration::distortion_lookup::{DistortionLookup, seen};
use crate::imaging::registration::nearest_canvas::SquareRow;

/// The color camera, as points of the depth camera's images come to it.
#[derive(Debug, Clone)]
pub(super) struct ColorView {
    pub(super) size: ImageSize,
    /// Of `color_from_depth`.
    pub(super) translation: Vector3<f32>,
    projection: ColorProjection,
}

/// What a lens does to normalized coordinates.
#[derive(Debug, Clone)]
enum ColorProjection {
    Plane(PlaneLens),
    Table(DistortionLookup),
}

/// Every lens with a distorted image plane, as a rational one with some coefficients 0.
#[derive(Debug, Clone, Copy)]
struct PlaneLens {
    focal: [f32; 2],
    skew: f32,
    principal: [f32; 2],
    numerator: [f32; 3],
    denominator: [f32; 3],
    tangential: [f32; 2],
    radius2_limit: f32,
}

impl ColorView {
    pub(super) fn new(lens: &Lens, size: ImageSize, color_from_depth: &Pose) -> Self {
        let projection = match PlaneLens::new(lens, size) {
            Some(plane) => ColorProjection::Plane(plane),
            None => ColorProjection::Table(DistortionLookup::new(lens, size)),
        };
        Self { size, translation: color_from_depth.translation().cast(), projection }
    }

    /// The pixel at normalized coordinates; NaN for what lies well outside the image.
    pub(super) fn pixel(&self, x: f32, y: f32) -> [f32; 2] {
        match &self.projection {
            ColorProjection::Plane(lens) => lens.pixel(x, y),
            ColorProjection::Table(table) => table.pixel(x, y),
        }
    }

    /// Where the points that a row of depths stands for are, of rays rotated to the color camera's
    /// axes; a reading reaches `half` pixels to each side where color is as far as depth.
    #[inline(always)]
    pub(super) fn project(
        &self,
        rays_in_color: [&[f32]; 3],
        depths: &[f32],
        half: f32,
        row: &mut SquareRow,
    ) {
        let ([right, down, ahead], [tx, ty, tz]) = (rays_in_color, self.translation.into());
        let SquareRow { center: [x, y], half: halves, depth: distances, .. } = row;
        let rays = right.iter().zip(down).zip(ahead).zip(depths);
        let points = x.iter_mut().zip(y.iter_mut()).zip(halves).zip(distances);
        for ((((x, y), reach), distance), (((right, down), ahead), depth)) in points.zip(rays) {
            let z = depth * ahead + tz;
            let per_z = 1.0 / z;
            (*x, *y) = ((depth * right + tx) * per_z, (depth * down + ty) * per_z);
            *reach = half * depth * per_z;
            *distance = if (*depth > 0.0) & (z > 0.0) { z } else { 0.0 };
        }
        let points = x.iter_mut().zip(y);
        match &self.projection {
            ColorProjection::Plane(lens) => points.for_each(|(x, y)| [*x, *y] = lens.pixel(*x, *y)),
            ColorProjection::Table(table) => {
                points.for_each(|(x, y)| [*x, *y] = table.pixel(*x, *y));
            }
        }
    }
}

impl PlaneLens {
    /// `None` for another kind of lens.
    fn new(lens: &Lens, size: ImageSize) -> Option<Self> {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = lens.distortion.as_rational()?;
        let (numerator, denominator, tangential) = ([k1, k2, k3], [k4, k5, k6], [p1, p2]);
        let CameraMatrix { fx, fy, cx, cy, skew } = lens.matrix;
        Some(Self {
            focal: [fx as f32, fy as f32],
            skew: skew as f32,
            principal: [cx as f32, cy as f32],
            numerator: numerator.map(|k| k as f32),
            denominator: denominator.map(|k| k as f32),
            tangential: tangential.map(|p| p as f32),
            radius2_limit: radius_limit(lens, size).powi(2) as f32,
        })
    }

    /// See [`crate::geometry::lens::Rational`].
    #[inline(always)]
    fn pixel(&self, x: f32, y: f32) -> [f32; 2] {
        let ([k1, k2, k3], [k4, k5, k6], [p1, p2]) =
            (self.numerator, self.denominator, self.tangential);
        let (xx, xy, yy) = (x * x, x * y, y * y);
        let r2 = xx + yy;
        let factor =
            (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let bent_x = factor * x + 2.0 * p1 * xy + p2 * (r2 + 2.0 * xx);
        let bent_y = factor * y + p1 * (r2 + 2.0 * yy) + 2.0 * p2 * xy;
        let ([fx, fy], [cx, cy]) = (self.focal, self.principal);
        let outside = if r2 < self.radius2_limit { 0.0 } else { f32::NAN };
        [fx * bent_x + self.skew * bent_y + cx + outside, fy * bent_y + cy]
    }
}

/// A little more than the largest radius that the image shows, as far as the lens is one-to-one
/// there: beyond it, the formula gives pixels that no lens does.
fn radius_limit(lens: &Lens, size: ImageSize) -> f64 {
    let [low, high] = seen(lens, size);
    let shown = low.abs().sup(&high.abs()).norm();
    let is_one_to_one = |radius: f64| {
        let directions = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)];
        directions.iter().all(|(x, y)| {
            lens.pixel_from_point(&Point3::new(x * radius, y * radius, 1.0)).is_some()
        })
    };
    let (mut inside, mut outside) = (0.0, shown);
    if is_one_to_one(shown) {
        return shown;
    }
    for _ in 0..40 {
        let between = 0.5 * (inside + outside);
        if is_one_to_one(between) {
            inside = between;
        } else {
            outside = between;
        }
    }
    inside
}
