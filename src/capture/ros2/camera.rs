//! A configured camera of a ROS 2 driver: its publishers found, and found again.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::thread;
use std::time::{Duration, Instant};

use crate::capture::ros2::options::Ros2Options;
use crate::capture::ros2::source::{Ros2Source, Subscriptions};
use crate::capture::{CaptureError, FrameSource, SourceOpener};
use crate::dds::{DdsError, Participant, PublishedTopic, TopicReader};
use crate::recording::CameraMessages;

/// How long opening waits for a publisher to be discovered: by RTPS each participant announces
/// itself to a new one at once, and ten times a second is often enough to ask.
pub(super) const DISCOVERY: Duration = Duration::from_millis(1000);
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Images that wait to be taken: at 30 a second the reader may be 250 ms late.
const IMAGES_HISTORY: i32 = 8;
/// Transforms that wait: each node's at the start.
const TRANSFORMS_HISTORY: i32 = 64;
const TRANSFORMS: &str = "/tf_static";
const INFO_TYPE: &str = "sensor_msgs/msg/CameraInfo";
const TRANSFORMS_TYPE: &str = "tf2_msgs/msg/TFMessage";

/// A camera whose publisher may come and go.
#[derive(Debug)]
pub struct Ros2Camera {
    options: Ros2Options,
    participant: Option<Arc<Participant>>,
    /// The number of the next frame set: it goes on rising when the publisher is found again.
    next_sequence: Arc<AtomicU64>,
}

impl Ros2Camera {
    /// A camera that is not opened yet.
    pub fn new(options: Ros2Options) -> Self {
        Self { options, participant: None, next_sequence: Arc::default() }
    }

    fn open_source(&mut self) -> Result<Ros2Source, CaptureError> {
        let participant = match &self.participant {
            Some(participant) => Arc::clone(participant),
            None => Participant::join(self.options.domain).map_err(|error| failed(&error))?,
        };
        self.participant = Some(Arc::clone(&participant));
        let names = [Some(&self.options.topic), self.options.depth.as_ref()];
        let images: Vec<PublishedTopic> = names
            .into_iter()
            .flatten()
            .map(|name| self.publisher(&participant, name))
            .collect::<Result<_, _>>()?;
        let typed: Vec<(&str, &str)> =
            images.iter().map(|image| (image.name.as_str(), image.type_name.as_str())).collect();
        let messages = CameraMessages::of_topics(&typed).map_err(|error| CaptureError::Lost {
            device: self.options.topic.clone(),
            reason: error.to_string(),
        })?;
        let subscribe = |offered: &PublishedTopic, depth| {
            participant.subscribe(offered, depth).map_err(|error| failed(&error))
        };
        let of_type = |name: &str, type_name: &str| {
            let mut offered = participant.publishers_of(name).into_iter();
            offered.find(|offered| offered.type_name == type_name)
        };
        let infos = images.iter().map(|image| {
            let name = CameraMessages::info_topic(&image.name);
            of_type(&name, INFO_TYPE).map(|offered| subscribe(&offered, 1)).transpose()
        });
        let transforms = of_type(TRANSFORMS, TRANSFORMS_TYPE)
            .map(|offered| subscribe(&offered, TRANSFORMS_HISTORY))
            .transpose()?;
        let infos = infos.collect::<Result<_, _>>()?;
        let images_read: Result<Vec<TopicReader>, _> =
            images.iter().map(|image| subscribe(image, IMAGES_HISTORY)).collect();
        let read = Subscriptions { images: images_read?, infos, transforms };
        // Those that were taken when the topic was open before are no images of now.
        read.images.iter().for_each(TopicReader::skip);
        let source =
            Ros2Source::new(self.options.clone(), images, read, messages, &self.next_sequence);
        Ok(source.with_stated_calibration())
    }

    /// Who publishes the images on `name`; waits for a moment.
    fn publisher(
        &self,
        participant: &Participant,
        name: &str,
    ) -> Result<PublishedTopic, CaptureError> {
        let deadline = Instant::now() + DISCOVERY;
        loop {
            let offered = participant.publishers_of(name);
            let images = offered.iter().find(|offered| offered.type_name.ends_with("Image"));
            if let Some(found) = images.or(offered.first()) {
                return Ok(found.clone());
            }
            if Instant::now() >= deadline {
                return Err(CaptureError::Lost {
                    device: name.to_owned(),
                    reason: absence(participant),
                });
            }
            thread::sleep(POLL_INTERVAL);
        }
    }
}

impl SourceOpener for Ros2Camera {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        Ok(Box::new(self.open_source()?))
    }
}

fn failed(error: &DdsError) -> CaptureError {
    CaptureError::Failed { reason: error.to_string() }
}

/// Why there is nobody: what there is instead.
fn absence(participant: &Participant) -> String {
    let id = participant.domain().id;
    let published = participant.published();
    let is_image = |topic: &&PublishedTopic| topic.type_name.ends_with("Image");
    let images: BTreeSet<&str> =
        published.iter().filter(is_image).map(|topic| topic.name.as_str()).collect();
    if !images.is_empty() {
        let names: Vec<&str> = images.into_iter().collect();
        return format!("no publisher in domain {id}; images are on {}", names.join(", "));
    }
    match published.is_empty() {
        true => format!("no publisher in domain {id}, and no topic at all; start the driver"),
        false => format!("no publisher in domain {id}, and none of images; start the driver"),
    }
}
