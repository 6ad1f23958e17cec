//! What a camera states of itself in its messages.

use std::collections::BTreeMap;

use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::{FactoryCalibration, FactorySensor};
use crate::imaging::frame::SensorKind;
use crate::recording::bag::camera_info::CameraInfo;
use crate::recording::bag::transforms::FrameTree;

/// What a camera states of itself, from the `camera_info` and frame of each sensor.
pub(super) fn stated(
    infos: BTreeMap<SensorKind, CameraInfo>,
    frame_ids: &BTreeMap<SensorKind, String>,
    tree: &FrameTree,
) -> FactoryCalibration {
    let color = frame_ids.get(&SensorKind::Color);
    let sensors = infos.into_iter().filter_map(|(sensor, info)| {
        let frame_id = frame_ids.get(&sensor);
        let color_from_sensor =
            color.zip(frame_id).and_then(|(color, sensor)| tree.a_from_b(color, sensor));
        Some(FactorySensor {
            sensor,
            image_size: info.image_size,
            stated: info.stated()?,
            lens: info.lens(),
            color_from_sensor,
        })
    });
    let sensors: Vec<FactorySensor> = sensors.collect();
    let of_depth = sensors.iter().find(|stated| stated.sensor == SensorKind::Depth);
    let depth_encoding = of_depth.map(|_| DepthEncoding::ORDINARY);
    FactoryCalibration { sensors, depth_encoding }
}
