//! A calibration as ROS 2 holds it.

use crate::calibration::result::{Calibration, Grade, SensorResult};
use crate::recording::ros2_results::{
    FrameTransform, camera_info, optical_frame, sensor_namespace,
};

/// What of a calibration goes on the graph.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Results {
    pub id: String,
    pub created_at_ns: i64,
    pub grade: Grade,
    pub rms_px: Option<f64>,
    pub uncertainty_px: Option<f64>,
    /// Each sensor's namespace, and its camera_info; the camera's own first.
    pub infos: Vec<(String, Vec<u8>)>,
    pub transforms: Vec<FrameTransform>,
    /// The sensors whose lens ROS has no exact name for.
    pub left_out: Vec<String>,
}

impl Results {
    /// Of the calibration of `camera`.
    pub fn of(camera: &str, calibration: &Calibration) -> Self {
        let mut results = Self {
            id: calibration.id.clone(),
            created_at_ns: calibration.created_at_ns,
            grade: calibration.verdict.grade,
            rms_px: calibration.guide().map(|sensor| sensor.rms_px),
            uncertainty_px: calibration.guide().map(|sensor| sensor.uncertainty_px.median),
            infos: Vec::new(),
            transforms: Vec::new(),
            left_out: Vec::new(),
        };
        let first = calibration.sensors.first().map(|sensor| &sensor.id);
        for sensor in &calibration.sensors {
            let (size, lens) = match &sensor.result {
                SensorResult::Image(image) => (image.image_size, &image.lens),
                SensorResult::Depth(depth) => (depth.camera.image_size, &depth.camera.lens),
            };
            let own = sensor.id.camera.as_deref().unwrap_or(camera);
            let frame = optical_frame(own, sensor.id.kind);
            match camera_info(&frame, lens, size, calibration.created_at_ns) {
                Some(info) => results.infos.push((sensor_namespace(own, sensor.id.kind), info)),
                None => results.left_out.push(calibration.name_of(&sensor.id)),
            }
            let known = first.and_then(|first| Some((first, calibration.pose(first, &sensor.id)?)));
            results.transforms.extend(known.map(|(first, pose)| FrameTransform {
                parent: optical_frame(first.camera.as_deref().unwrap_or(camera), first.kind),
                child: frame,
                parent_from_child: pose.target_from_source,
            }));
        }
        results
    }
}
