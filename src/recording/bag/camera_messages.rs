//! One camera's ROS messages as they arrive: the same images, stamps and stated calibration as from
//! a bag.

use std::collections::BTreeMap;

use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::recording::bag::camera_info::CameraInfo;
use crate::recording::bag::image_error::RosImageError;
use crate::recording::bag::images;
use crate::recording::bag::stamped_sets::StampedSets;
use crate::recording::bag::stated::stated;
use crate::recording::bag::storage::{BagTopic, MessageEncoding, one_type_name};
use crate::recording::bag::topics::{ImageTopic, sensor_and_info, transport};
use crate::recording::bag::transforms::FrameTree;

/// The image topics of one camera, and what has come on them.
#[derive(Debug)]
pub struct CameraMessages {
    topics: Vec<(BagTopic, ImageTopic)>,
    sets: StampedSets,
    infos: BTreeMap<SensorKind, CameraInfo>,
    frame_ids: BTreeMap<SensorKind, String>,
    tree: FrameTree,
}

/// Why topics or a message have no images of a camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraMessageError {
    /// A type that has no images.
    #[error(
        "{topic} has the type {type_name}; images are sensor_msgs/msg/Image or CompressedImage"
    )]
    NoImages {
        /// The topic.
        topic: String,
        /// The type of its messages.
        type_name: String,
    },
    /// A message that is no image, or has less data than it says.
    #[error("{topic} has {fault}")]
    Image {
        /// The topic.
        topic: String,
        /// What is wrong with it.
        fault: RosImageError,
    },
}

impl CameraMessages {
    /// Of the image topics `topics`, each its name and its type (`sensor_msgs/msg/Image`); the
    /// first has the camera's images, and a second one their depth.
    ///
    /// # Errors
    /// [`CameraMessageError::NoImages`].
    pub fn of_topics(topics: &[(&str, &str)]) -> Result<Self, CameraMessageError> {
        let topic = |(index, (name, type_name)): (usize, &(&str, &str))| {
            let message_type = one_type_name(type_name);
            let topic =
                BagTopic { name: (*name).to_owned(), message_type, layout: MessageEncoding::Cdr };
            let transport = transport(&topic).ok_or_else(|| CameraMessageError::NoImages {
                topic: topic.name.clone(),
                type_name: (*type_name).to_owned(),
            })?;
            let by_name = if index > 0 { Some(SensorKind::Depth) } else { sensor_and_info(name).0 };
            let sensor = by_name.unwrap_or(SensorKind::Color);
            Ok((topic, ImageTopic { sensor, named: by_name.is_some(), transport }))
        };
        let topics: Vec<_> =
            topics.iter().enumerate().map(topic).collect::<Result<_, CameraMessageError>>()?;
        Ok(Self {
            sets: StampedSets::new(topics.len()),
            topics,
            infos: BTreeMap::new(),
            frame_ids: BTreeMap::new(),
            tree: FrameTree::default(),
        })
    }

    /// The topic of the camera_info that belongs to the images on `topic`.
    pub fn info_topic(topic: &str) -> String {
        sensor_and_info(topic).1
    }

    /// Takes in an image of the topic with this index. One without a time was taken when it
    /// arrived.
    ///
    /// # Errors
    /// [`CameraMessageError::Image`].
    pub fn take_image(
        &mut self,
        index: usize,
        message: &[u8],
        arrived_utc_ns: i64,
    ) -> Result<(), CameraMessageError> {
        let Some((topic, image)) = self.topics.get(index) else { return Ok(()) };
        let (header, frame) = images::read(topic, *image, message)
            .and_then(|(header, frame)| whole(frame).map(|frame| (header, frame)))
            .map_err(|fault| CameraMessageError::Image { topic: topic.name.clone(), fault })?;
        let stamp_ns = if header.stamp_ns == 0 { arrived_utc_ns } else { header.stamp_ns };
        self.frame_ids.entry(frame.sensor).or_insert(header.frame_id);
        self.sets.push(stamp_ns, frame);
        Ok(())
    }

    /// Takes in the camera_info of the topic with this index; one that cannot be read states
    /// nothing.
    pub fn take_info(&mut self, index: usize, message: &[u8]) {
        let Some((_, image)) = self.topics.get(index) else { return };
        if let Ok(info) = CameraInfo::read(MessageEncoding::Cdr, message) {
            self.infos.insert(image.sensor, info);
        }
    }

    /// Takes in static transforms; what cannot be read states nothing.
    pub fn take_transforms(&mut self, message: &[u8]) {
        let _ = self.tree.read(MessageEncoding::Cdr, message);
    }

    /// Whether an image and the camera_info of each topic have come.
    pub fn has_stated(&self) -> bool {
        self.topics.iter().all(|(_, image)| self.infos.contains_key(&image.sensor))
            && self.frame_ids.len() >= self.topics.len()
    }

    /// What the driver states.
    pub fn factory(&self) -> FactoryCalibration {
        stated(self.infos.clone(), &self.frame_ids, &self.tree)
    }

    /// The next frames taken together, where they have all come.
    pub fn next_frame_set(&mut self) -> Option<FrameSet> {
        self.sets.pop_complete()
    }
}

/// The frame, if it has as many bytes as its rows need.
fn whole(frame: Frame) -> Result<Frame, RosImageError> {
    if matches!(frame.format, PixelFormat::Jpeg | PixelFormat::Png) {
        return Ok(frame);
    }
    let needed = frame.stride.checked_mul(frame.size.height as usize);
    if needed.is_some_and(|needed| needed <= frame.bytes.len()) {
        return Ok(frame);
    }
    Err(RosImageError::CutFrame {
        size: frame.size,
        stride_bytes: frame.stride,
        data_bytes: frame.bytes.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(stamp_s: u32, [width, height]: [u32; 2], encoding: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        let number = |bytes: &mut Vec<u8>, value: u32| {
            bytes.resize(bytes.len().next_multiple_of(4), 0);
            bytes.extend(value.to_le_bytes());
        };
        let text = |bytes: &mut Vec<u8>, text: &str| {
            number(bytes, text.len() as u32 + 1);
            bytes.extend(text.as_bytes());
            bytes.push(0);
        };
        number(&mut bytes, stamp_s);
        number(&mut bytes, 0);
        text(&mut bytes, "front_optical_frame");
        number(&mut bytes, height);
        number(&mut bytes, width);
        text(&mut bytes, encoding);
        bytes.push(0);
        number(&mut bytes, width * if encoding == "16UC1" { 2 } else { 1 });
        number(&mut bytes, data.len() as u32);
        bytes.extend(data);
        bytes
    }

    #[test]
    fn images_and_depth_of_one_stamp_are_one_frame_set() {
        let topics =
            [("/front/image_raw", "sensor_msgs/msg/Image"), ("/d/raw", "sensor_msgs/msg/Image")];
        let mut camera = CameraMessages::of_topics(&topics).unwrap();
        camera.take_image(0, &image(7, [2, 2], "mono8", &[1, 2, 3, 4]), 5).unwrap();
        assert!(camera.next_frame_set().is_none());
        camera.take_image(1, &image(7, [2, 1], "16UC1", &[1, 0, 2, 0]), 5).unwrap();
        let set = camera.next_frame_set().unwrap();
        assert_eq!(set.host_time.utc_ns, 7_000_000_000);
        assert_eq!(&*set.frame(SensorKind::Color).unwrap().bytes, [1, 2, 3, 4]);
        assert_eq!(set.frame(SensorKind::Depth).unwrap().format, PixelFormat::Depth16);
        camera.take_image(0, &image(0, [1, 1], "mono8", &[9]), 12).unwrap();
        camera.take_image(1, &image(0, [1, 1], "16UC1", &[9, 0]), 13).unwrap();
        assert_eq!(camera.next_frame_set().unwrap().host_time.utc_ns, 12);
    }

    #[test]
    fn what_cannot_be_an_image_is_one_line() {
        let topic = [("/front/image_raw", "sensor_msgs/msg/Image")];
        let mut camera = CameraMessages::of_topics(&topic).unwrap();
        let refused = camera.take_image(0, &image(1, [4, 4], "mono8", &[0; 5]), 0);
        let line = refused.unwrap_err().to_string();
        let expected =
            "/front/image_raw has 4x4 images with rows every 4 bytes and 5 bytes of data";
        assert_eq!(line.replace('×', "x"), expected);
        let refused = camera.take_image(0, &image(1, [1, 1], "h264", &[0]), 0);
        let line = refused.unwrap_err().to_string();
        assert!(line.starts_with("/front/image_raw has images encoded as \"h264\""), "{line}");
        let line = camera.take_image(0, b"\0\x01\0\0abc", 0).unwrap_err().to_string();
        assert!(line.contains("cannot be read"), "{line}");
        let other = [("/front/image_raw", "std_msgs/msg/String")];
        let line = CameraMessages::of_topics(&other).unwrap_err().to_string();
        assert!(line.starts_with("/front/image_raw has the type std_msgs/msg/String"), "{line}");
        assert_eq!(CameraMessages::info_topic("/a/image_raw/compressed"), "/a/camera_info");
        assert_eq!(CameraMessages::info_topic("/image_raw"), "/camera_info");
    }
}
