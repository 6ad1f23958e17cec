//! A calibration as ROS 2 holds it.

use crate::calibration::result::{Calibration, Grade, SensorResult};
use crate::calibration::sensor::SensorId;
use crate::calibration::stereo_pair::StereoPair;
use crate::geometry::rectification::RectifiedCamera;
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
    /// Each sensor's camera_info; a camera's own first.
    pub infos: Vec<SensorInfo>,
    pub transforms: Vec<FrameTransform>,
    /// The sensors whose lens ROS has no exact name for.
    pub left_out: Vec<String>,
}

/// What is known of a sensor's lens.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SensorInfo {
    /// The sensor's camera.
    pub camera: String,
    /// Under which its topics are, as in `/front/depth`, in a rig `/head/left`.
    pub namespace: String,
    /// `sensor_msgs/msg/CameraInfo`.
    pub message: Vec<u8>,
}

impl Results {
    /// Of the calibration of the camera or rig `name`. With `alpha` 0 rectified images have
    /// only valid pixels, with 1 all source pixels.
    pub fn of(name: &str, calibration: &Calibration, alpha: f64) -> Self {
        let guide = calibration.guide();
        let mut results = Self {
            id: calibration.id.clone(),
            created_at_ns: calibration.created_at_ns,
            grade: calibration.verdict.grade,
            rms_px: guide.map(|sensor| sensor.rms_px),
            uncertainty_px: guide.map(|sensor| sensor.uncertainty_px.median),
            infos: Vec::new(),
            transforms: Vec::new(),
            left_out: Vec::new(),
        };
        let pair = rectified_pair(calibration, alpha);
        let first = calibration.sensors.first().map(|sensor| &sensor.id);
        for sensor in &calibration.sensors {
            let (lens, size) = match &sensor.result {
                SensorResult::Image(image) => (&image.lens, image.image_size),
                SensorResult::Depth(depth) => (&depth.camera.lens, depth.camera.image_size),
            };
            let own = sensor.id.camera.as_deref().unwrap_or(name);
            let frame = optical_frame(own, sensor.id.kind);
            let as_one_of_two = pair.iter().find(|(id, _)| *id == sensor.id);
            let rectified = as_one_of_two
                .map_or_else(|| RectifiedCamera::framed(lens, size, alpha), |(_, pair)| *pair);
            match camera_info(&frame, lens, size, &rectified, calibration.created_at_ns) {
                Some(message) => {
                    let within = sensor_namespace(own, sensor.id.kind);
                    let rig = sensor.id.camera.as_ref().map(|_| format!("/{name}"));
                    let namespace = rig.unwrap_or_default() + &within;
                    results.infos.push(SensorInfo { camera: own.to_owned(), namespace, message });
                }
                None => results.left_out.push(calibration.name_of(&sensor.id)),
            }
            let known = first.and_then(|first| Some((first, calibration.pose(first, &sensor.id)?)));
            results.transforms.extend(known.map(|(first, pose)| FrameTransform {
                parent: optical_frame(first.camera.as_deref().unwrap_or(name), first.kind),
                child: frame,
                parent_from_child: pose.target_from_source,
            }));
        }
        results
    }
}

/// The two cameras of a stereo rig, or the two infrared sensors of a camera, rectified; none of
/// other calibrations.
fn rectified_pair(calibration: &Calibration, alpha: f64) -> Vec<(SensorId, RectifiedCamera)> {
    let Ok(pair) = StereoPair::of(calibration, None) else { return Vec::new() };
    let Ok((pair, stereo)) = pair.left_first(alpha) else { return Vec::new() };
    let [first, second] = pair.cameras.map(|camera| camera.image_size);
    // ROS takes a rectified image to be of the raw one's size.
    if first != second {
        return Vec::new();
    }
    pair.sensors.into_iter().zip(stereo.cameras).collect()
}
