//! Which topics of a bag are a camera's, by their types and names.
//!
//! `/front/image_raw`, `/front/image_raw/compressed` and `/front/camera_info` are of the camera
//! `/front`; a name that ends in a sensor, as `/front/depth/image_rect_raw`, is that sensor of the
//! camera before it. The names are those of image_transport, realsense2_camera, depth cameras
//! after OpenNI, and librealsense's own bags.

use std::collections::BTreeMap;
use std::path::Path;

use crate::imaging::frame::SensorKind;
use crate::recording::RecordingError;
use crate::recording::bag::storage::BagTopic;
use crate::recording::topic_names::{names_topic, topic_begins};

/// How a topic carries images; of several that carry the same the first is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Transport {
    Raw,
    Compressed,
    CompressedDepth,
}

/// A topic of images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ImageTopic {
    pub sensor: SensorKind,
    /// Whether the name says which sensor; if not, a depth encoding makes it depth.
    pub named: bool,
    pub transport: Transport,
}

/// What a topic is to a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Image(ImageTopic),
    CameraInfo(SensorKind),
    Transforms,
}

/// The topics of one camera, by their index in the bag.
#[derive(Debug)]
pub(super) struct CameraTopics {
    pub roles: BTreeMap<usize, Role>,
}

/// A topic of images or camera_info by its name.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Named {
    camera: String,
    /// The sensor's own namespace, which its camera_info shares.
    namespace: String,
    sensor: Option<SensorKind>,
}

impl CameraTopics {
    /// The camera of the topics that `asked` names; the only one where it names none.
    ///
    /// # Errors
    /// [`RecordingError::NoFrames`], [`RecordingError::NoSuchTopic`] and
    /// [`RecordingError::SeveralCameras`].
    pub(super) fn pick(
        path: &Path,
        topics: &[BagTopic],
        asked: &[String],
    ) -> Result<Self, RecordingError> {
        let images: Vec<_> = topics
            .iter()
            .enumerate()
            .filter_map(|(index, topic)| Some((index, transport(topic)?, Named::of(&topic.name))))
            .collect();
        if images.is_empty() {
            return Err(RecordingError::NoFrames { path: path.to_owned() });
        }
        let all: Vec<&str> = images.iter().map(|image| topics[image.0].name.as_str()).collect();
        let is_there = |asked: &String| all.iter().any(|name| topic_begins(asked, name));
        if let Some(topic) = asked.iter().find(|asked| !is_there(asked)) {
            let (path, topic) = (path.to_owned(), topic.clone());
            return Err(RecordingError::NoSuchTopic { path, topic, known: all.join(", ") });
        }
        let mut picked = BTreeMap::new();
        for (index, transport, named) in &images {
            let name = &topics[*index].name;
            let derived = asked.is_empty() && is_derived(name);
            if !derived && names_topic(asked, name) {
                let same =
                    picked.entry((named.namespace.clone(), named.sensor)).or_insert_with(Vec::new);
                same.push((*transport, *index, named));
            }
        }
        let mut of_sensor: BTreeMap<SensorKind, (usize, Transport, &Named)> = BTreeMap::new();
        let several = |a: usize, b: usize| RecordingError::SeveralCameras {
            path: path.to_owned(),
            cameras: [topics[a].name.clone(), topics[b].name.clone()],
        };
        let mut first: Option<(usize, &Named)> = None;
        for mut same in picked.into_values() {
            same.sort_by_key(|(transport, index, _)| (*transport, *index));
            let Some((transport, index, named)) = same.first().copied() else { continue };
            let (other, camera) = *first.get_or_insert((index, named));
            if asked.is_empty() && camera.camera != named.camera {
                return Err(several(other, index));
            }
            let sensor = named.sensor.unwrap_or(SensorKind::Color);
            let before = of_sensor.insert(sensor, (index, transport, named));
            if let Some((before, ..)) = before {
                return Err(several(before, index));
            }
        }
        Ok(Self { roles: roles(topics, &of_sensor) })
    }

    /// How many of them carry images.
    pub(super) fn images(&self) -> usize {
        self.roles.values().filter(|role| matches!(role, Role::Image(_))).count()
    }
}

fn roles(
    topics: &[BagTopic],
    of_sensor: &BTreeMap<SensorKind, (usize, Transport, &Named)>,
) -> BTreeMap<usize, Role> {
    let mut roles = BTreeMap::new();
    for (sensor, (index, transport, named)) in of_sensor {
        let (sensor, transport, by_name) = (*sensor, *transport, named.sensor.is_some());
        roles.insert(*index, Role::Image(ImageTopic { sensor, named: by_name, transport }));
        let info = topics.iter().position(|topic| {
            topic.message_type == "sensor_msgs/CameraInfo"
                && Named::of(&topic.name).namespace == named.namespace
        });
        roles.extend(info.map(|info| (info, Role::CameraInfo(sensor))));
    }
    let is_static = |topic: &BagTopic| {
        topic.name.ends_with("tf_static")
            && ["tf2_msgs/TFMessage", "tf/tfMessage"].contains(&topic.message_type.as_str())
    };
    let transforms = topics.iter().enumerate().filter(|(_, topic)| is_static(topic));
    roles.extend(transforms.map(|(index, _)| (index, Role::Transforms)));
    roles
}

/// Whether a topic carries what was made of another's images: it is read only when asked for.
fn is_derived(name: &str) -> bool {
    name.contains("aligned_")
        || name.ends_with("/image_rect")
        || name.ends_with("/image_rect_color")
}

/// Whether a topic is of images.
pub(super) fn carries_images(topic: &BagTopic) -> bool {
    transport(topic).is_some()
}

pub(super) fn transport(topic: &BagTopic) -> Option<Transport> {
    match topic.message_type.as_str() {
        "sensor_msgs/Image" => Some(Transport::Raw),
        "sensor_msgs/CompressedImage" if topic.name.ends_with("/compressedDepth") => {
            Some(Transport::CompressedDepth)
        }
        "sensor_msgs/CompressedImage" => Some(Transport::Compressed),
        _ => None,
    }
}

impl Named {
    fn of(name: &str) -> Self {
        let name = name.trim_matches('/');
        let name = name.strip_suffix("/compressedDepth").unwrap_or(name);
        let name = name.strip_suffix("/compressed").unwrap_or(name);
        // librealsense's own bags: /device_0/sensor_1/Color_0/image/data.
        let own = [("/image/data", true), ("/info/camera_info", true)];
        let own = own.iter().find_map(|(suffix, _)| name.strip_suffix(suffix));
        let namespace =
            own.unwrap_or_else(|| name.rsplit_once('/').map_or("", |(before, _)| before));
        let last = name.rsplit('/').next().unwrap_or_default();
        // Plumb's own names: /front/color.
        let namespace = if sensor_named(last).is_some() { name } else { namespace };
        let (parent, of_sensor) = namespace.rsplit_once('/').unwrap_or(("", namespace));
        let sensor = sensor_named(of_sensor);
        let camera = match (sensor, own) {
            (None, _) => namespace,
            (Some(_), None) => parent,
            (Some(_), Some(_)) => parent.split('/').next().unwrap_or(parent),
        };
        Self { camera: format!("/{camera}"), namespace: format!("/{namespace}"), sensor }
    }
}

/// The sensor that the name of an image topic says, and the topic of its camera_info.
pub(super) fn sensor_and_info(name: &str) -> (Option<SensorKind>, String) {
    let named = Named::of(name);
    (named.sensor, format!("{}/camera_info", named.namespace.trim_end_matches('/')))
}

fn sensor_named(name: &str) -> Option<SensorKind> {
    match name.to_ascii_lowercase().as_str() {
        "color" | "rgb" | "color_0" => Some(SensorKind::Color),
        "infrared" | "infra" | "ir" | "infra1" | "infrared1" | "infrared_0" | "infrared_1" => {
            Some(SensorKind::Infrared)
        }
        "infra2" | "infrared2" | "infrared_2" => Some(SensorKind::Infrared2),
        "depth" | "depth_0" => Some(SensorKind::Depth),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::bag::storage::MessageEncoding;

    fn bag(topics: &[(&str, &str)]) -> Vec<BagTopic> {
        let topic = |(name, message_type): &(&str, &str)| BagTopic {
            name: (*name).to_owned(),
            message_type: format!("sensor_msgs/{message_type}"),
            layout: MessageEncoding::Cdr,
        };
        topics.iter().map(topic).collect()
    }

    fn images_of(
        topics: &[BagTopic],
        asked: &[&str],
    ) -> Result<Vec<(usize, &'static str)>, String> {
        let asked: Vec<String> = asked.iter().map(|asked| (*asked).to_owned()).collect();
        let picked = CameraTopics::pick(Path::new("a.mcap"), topics, &asked);
        let roles = picked.map_err(|error| error.to_string())?.roles.into_iter();
        Ok(roles
            .filter_map(|(index, role)| match role {
                Role::Image(image) => Some((index, image.sensor.name())),
                Role::CameraInfo(_) => Some((index, "info")),
                Role::Transforms => None,
            })
            .collect())
    }

    #[test]
    fn one_camera_s_topics_are_found_by_type_and_name() {
        let realsense = bag(&[
            ("/camera/camera/color/image_raw", "Image"),
            ("/camera/camera/color/image_raw/compressed", "CompressedImage"),
            ("/camera/camera/color/camera_info", "CameraInfo"),
            ("/camera/camera/depth/image_rect_raw", "Image"),
            ("/camera/camera/aligned_depth_to_color/image_raw", "Image"),
            ("/camera/camera/infra1/image_rect_raw", "Image"),
            ("/camera/camera/imu", "Imu"),
        ]);
        let all = [(0, "color"), (2, "info"), (3, "depth"), (5, "infrared")];
        assert_eq!(images_of(&realsense, &[]).unwrap(), all);
        assert_eq!(images_of(&realsense, &["/camera/camera/depth"]).unwrap(), [(3, "depth")]);
        let compressed = images_of(&realsense, &["/camera/camera/color/image_raw/compressed"]);
        assert_eq!(compressed.unwrap(), [(1, "color"), (2, "info")]);
        let own = bag(&[
            ("/device_0/sensor_0/Depth_0/image/data", "Image"),
            ("/device_0/sensor_1/Color_0/image/data", "Image"),
            ("/device_0/sensor_1/Color_0/info/camera_info", "CameraInfo"),
        ]);
        assert_eq!(images_of(&own, &[]).unwrap(), [(0, "depth"), (1, "color"), (2, "info")]);
        let plain =
            bag(&[("/front/image_raw/compressed", "CompressedImage"), ("/front/depth", "Image")]);
        assert_eq!(images_of(&plain, &[]).unwrap(), [(0, "color"), (1, "depth")]);
    }

    #[test]
    fn several_cameras_and_unknown_topics_are_refused_by_name() {
        let two = bag(&[("/cam0/image_raw", "Image"), ("/cam1/image_raw", "Image")]);
        let line = images_of(&two, &[]).unwrap_err();
        assert!(line.contains("/cam0/image_raw") && line.contains("--topic"), "{line}");
        assert_eq!(images_of(&two, &["/cam1/image_raw"]).unwrap(), [(1, "color")]);
        assert_eq!(images_of(&two, &["cam0"]).unwrap(), [(0, "color")]);
        let line = images_of(&two, &["/cam"]).unwrap_err();
        assert!(line.contains("`/cam`") && line.contains("/cam1/image_raw"), "{line}");
        let line = images_of(&bag(&[("/imu", "Imu")]), &[]).unwrap_err();
        assert!(line.contains("no frames"), "{line}");
    }
}
