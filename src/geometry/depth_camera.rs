//! A depth camera: the distance that a reading at a pixel stands for, and the point.

use nalgebra::Point3;

use crate::geometry::depth_correction::DepthCorrection;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

/// The meaning of the numbers in a depth image, as the device gives them. Depth is along the
/// optical axis (z), not along the ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthReading {
    /// z = unit · reading.
    Metric {
        /// Meters per unit.
        unit_m: f64,
    },
    /// 1/z = offset + slope · reading (Kinect 1: slope < 0; a stereo matcher: offset 0, slope
    /// 1/(f·baseline)).
    Disparity {
        /// 1/m.
        offset: f64,
        /// 1/m per unit.
        slope: f64,
    },
}

impl DepthReading {
    /// 1/z, in 1/m; `None` for a reading that no surface in front of the camera has.
    pub fn inverse_depth(self, reading: f64) -> Option<f64> {
        let inverse = match self {
            Self::Metric { unit_m } => 1.0 / (unit_m * reading),
            Self::Disparity { offset, slope } => offset + slope * reading,
        };
        (inverse.is_finite() && inverse > 0.0).then_some(inverse)
    }

    /// The reading at 1/z, in 1/m.
    pub fn reading(self, inverse_depth: f64) -> f64 {
        match self {
            Self::Metric { unit_m } => 1.0 / (unit_m * inverse_depth),
            Self::Disparity { offset, slope } => (inverse_depth - offset) / slope,
        }
    }

    /// The absolute change of 1/z per unit of the reading, in 1/m: the quantization step.
    pub fn inverse_depth_step(self, inverse_depth: f64) -> f64 {
        match self {
            Self::Metric { unit_m } => unit_m * inverse_depth * inverse_depth,
            Self::Disparity { slope, .. } => slope.abs(),
        }
    }
}

/// A depth camera's lens and its pose relative to color.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosedDepthLens {
    /// The lens, for images of the depth camera's own size.
    pub lens: Lens,
    /// From the color camera's frame to the depth camera's.
    pub depth_from_color: Pose,
}

/// A depth camera with its lens and the correction of its systematic error.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthCamera {
    /// The size of its images.
    pub image_size: ImageSize,
    /// The lens.
    pub lens: Lens,
    /// The meaning of its readings.
    pub reading: DepthReading,
    /// The correction of its readings; `None` where the factory calibration is as good.
    pub correction: Option<DepthCorrection>,
}

impl DepthCamera {
    /// The corrected 1/z of a reading at `pixel`, in 1/m; `None` for a reading that no surface has.
    pub fn inverse_depth(&self, pixel: Pixel, reading: f64) -> Option<f64> {
        let inverse = self.reading.inverse_depth(reading)?;
        match &self.correction {
            Some(correction) => correction.correct(pixel, inverse),
            None => Some(inverse),
        }
    }

    /// The point of a reading at `pixel`, in the depth camera's frame, in meters; `None` for a
    /// reading that no surface has, or where the lens has no ray for the pixel.
    pub fn point_from_reading(&self, pixel: Pixel, reading: f64) -> Option<Point3<f64>> {
        let z = 1.0 / self.inverse_depth(pixel, reading)?;
        let bearing = self.lens.bearing_from_pixel(pixel)?;
        (bearing.z > 0.0).then(|| Point3::from(bearing.into_inner() * (z / bearing.z)))
    }
}

/// Readings of one small patch of a flat surface, combined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthTile {
    /// The center of its readings.
    pub pixel: Pixel,
    /// The uncorrected 1/z there, in 1/m. It is the mean of the readings, since 1/z of a plane is
    /// linear over an image without distortion.
    pub inverse_depth: f64,
    /// Standard deviation of a single reading's 1/z about the patch's own plane, in 1/m.
    pub reading_std: f64,
    /// Number of readings.
    pub count: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;

    #[test]
    fn readings_become_points_and_back() {
        let lens =
            Lens::pinhole(CameraMatrix { fx: 580.0, fy: 590.0, cx: 320.0, cy: 240.0, skew: 0.0 });
        for reading in [
            DepthReading::Metric { unit_m: 0.001 },
            DepthReading::Disparity { offset: 3.12, slope: -0.002_85 },
            DepthReading::Disparity { offset: 0.0, slope: 0.01 },
        ] {
            let camera = DepthCamera {
                image_size: ImageSize::new(640, 480),
                lens,
                reading,
                correction: None,
            };
            let point = Point3::new(0.3, -0.2, 1.7);
            let pixel = lens.pixel_from_point(&point).unwrap();
            let again = camera.point_from_reading(pixel, reading.reading(1.0 / 1.7)).unwrap();
            assert!((again - point).norm() < 1e-12, "{again}");
            let step = reading.inverse_depth(reading.reading(0.5) + 1.0).unwrap() - 0.5;
            assert!((step.abs() / reading.inverse_depth_step(0.5) - 1.0).abs() < 0.01);
        }
        assert_eq!(DepthReading::Metric { unit_m: 0.001 }.inverse_depth(0.0), None);
        assert_eq!(
            DepthReading::Disparity { offset: 3.0, slope: -0.003 }.inverse_depth(2047.0),
            None
        );
    }
}
