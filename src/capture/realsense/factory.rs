//! The factory's intrinsics, extrinsics and depth unit, as the device or the recording states them.

use nalgebra::{Matrix3, Vector3};
use realsense_rust::base::Rs2Intrinsics;
use realsense_rust::device::Device;
use realsense_rust::kind::{Rs2DistortionModel, Rs2Option, Rs2StreamKind};
use realsense_rust::stream_profile::StreamProfile;

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Distortion, Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::{FactoryCalibration, FactorySensor, StatedLens};
use crate::imaging::frame::SensorKind;

/// Which of our sensors a stream is; of two infrared ones the first is the left, from which depth
/// is measured.
pub(super) fn sensor_of(stream: &StreamProfile) -> Option<SensorKind> {
    match (stream.kind(), stream.index()) {
        (Rs2StreamKind::Color, _) => Some(SensorKind::Color),
        (Rs2StreamKind::Infrared, 0 | 1) => Some(SensorKind::Infrared),
        (Rs2StreamKind::Infrared, 2) => Some(SensorKind::Infrared2),
        (Rs2StreamKind::Depth, _) => Some(SensorKind::Depth),
        _ => None,
    }
}

/// What is stated of every stream.
pub(super) fn factory_calibration(
    device: &Device,
    streams: &[StreamProfile],
) -> FactoryCalibration {
    let color = streams.iter().find(|stream| sensor_of(stream) == Some(SensorKind::Color));
    let depth_unit =
        device.sensors().iter().find_map(|sensor| sensor.get_option(Rs2Option::DepthUnits));
    let stated = streams.iter().filter_map(|stream| {
        let sensor = sensor_of(stream)?;
        let intrinsics = stream.intrinsics().ok()?;
        Some(FactorySensor {
            sensor,
            image_size: ImageSize::new(intrinsics.width() as u32, intrinsics.height() as u32),
            lens: lens_of(&intrinsics),
            stated: stated_lens(&intrinsics),
            color_from_sensor: color.and_then(|color| color_from(stream, color)),
        })
    });
    let mut sensors: Vec<FactorySensor> = stated.collect();
    sensors.sort_by_key(|stated| stated.sensor);
    let depth_encoding = depth_unit.map(|unit_m| DepthEncoding::metric(decimal(unit_m)));
    FactoryCalibration { sensors, depth_encoding }
}

/// A single-precision number by its shortest decimal form: 0.001, not 0.0010000000474974513.
fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

fn color_from(stream: &StreamProfile, color: &StreamProfile) -> Option<Pose> {
    let extrinsics = stream.extrinsics(color).ok()?;
    // The library's rotation is column by column.
    let rotation = Matrix3::from_column_slice(&extrinsics.rotation().map(f64::from));
    Some(Pose::from_matrix(&rotation, Vector3::from(extrinsics.translation().map(f64::from))))
}

fn stated_lens(intrinsics: &Rs2Intrinsics) -> StatedLens {
    let distortion = intrinsics.distortion();
    StatedLens {
        model: format!("{:?}", distortion.model),
        focal_px: [intrinsics.fx(), intrinsics.fy()].map(f64::from),
        principal_px: [intrinsics.ppx(), intrinsics.ppy()].map(f64::from),
        coefficients: distortion.coeffs.iter().copied().map(f64::from).collect(),
    }
}

/// The lens in a model of ours. The library's *inverse* and *modified* Brown models have none that
/// says the same, except where all their coefficients are zero.
fn lens_of(intrinsics: &Rs2Intrinsics) -> Option<Lens> {
    let distortion = intrinsics.distortion();
    let straight = distortion.coeffs.iter().all(|coefficient| *coefficient == 0.0);
    let [fx, fy, cx, cy] =
        [intrinsics.fx(), intrinsics.fy(), intrinsics.ppx(), intrinsics.ppy()].map(f64::from);
    let matrix = CameraMatrix { fx, fy, cx, cy, skew: 0.0 };
    if straight {
        return Some(Lens::pinhole(matrix));
    }
    let model = LensModel::from_camera_info(match distortion.model {
        Rs2DistortionModel::BrownConrady => "plumb_bob",
        Rs2DistortionModel::KannalaBrandt => "equidistant",
        _ => return None,
    })?;
    let count = model.coefficient_names().len();
    let coefficients: Vec<f64> =
        distortion.coeffs.iter().take(count).copied().map(f64::from).collect();
    Some(Lens { matrix, distortion: Distortion::from_coefficients(model, &coefficients)? })
}
