//! The topics and services of one camera or rig.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::task::Waker;

use crate::dds::{DdsError, Durability, Participant, ServiceServer, TopicWriter};
use crate::graph::driver::Driver;
use crate::graph::results::{Results, SensorInfo};
use crate::recording::ros2_results::{restamped, ros_name, text};

const INFO: &str = "sensor_msgs/msg/CameraInfo";
const TRIGGER: &str = "std_srvs/srv/Trigger";

/// A camera or rig as the graph has it.
#[derive(Debug)]
pub(super) struct GraphTopics {
    participant: Arc<Participant>,
    infos: BTreeMap<String, TopicWriter>,
    state: TopicWriter,
    said: Option<&'static str>,
    pub start: ServiceServer,
    pub stop: ServiceServer,
    pub driver: Option<Driver>,
    pub known: KnownCalibration,
}

/// What the graph knows of a current calibration.
#[derive(Debug, Default)]
pub(super) struct KnownCalibration {
    /// What it says.
    pub results: Option<Results>,
    /// Why boards that a session kept do not agree with it; that stays until there is another one.
    /// Other reasons come and go with the state of the camera.
    pub residual_drift: Option<String>,
}

impl GraphTopics {
    pub fn new(
        participant: &Arc<Participant>,
        name: &str,
        set_camera_info: Option<&str>,
    ) -> Result<Self, DdsError> {
        let base = format!("/plumb/{}", ros_name(name));
        let service =
            |kind: &str| ServiceServer::offer(participant, &format!("{base}/{kind}"), TRIGGER);
        let state = participant.advertise(
            &format!("{base}/state"),
            "std_msgs/msg/String",
            Durability::Latched,
        )?;
        Ok(Self {
            participant: Arc::clone(participant),
            infos: BTreeMap::new(),
            state,
            said: None,
            start: service("start")?,
            stop: service("stop")?,
            driver: set_camera_info.map(|name| Driver::new(participant, name)).transpose()?,
            known: KnownCalibration::default(),
        })
    }

    pub fn wake(&self, waker: &Waker) {
        self.start.wake(waker);
        self.stop.wake(waker);
        if let Some(driver) = &self.driver {
            driver.wake(waker);
        }
    }

    /// Says how the session stands, where that is new.
    pub fn say(&mut self, state: &'static str) -> Result<(), DdsError> {
        if self.said.replace(state) == Some(state) {
            return Ok(());
        }
        self.state.send(text(state))
    }

    /// Publishes the calibration that is current now.
    pub fn publish(&mut self, results: Results) -> Result<(), DdsError> {
        for SensorInfo { namespace, message, .. } in &results.infos {
            let topic = info_topic(namespace);
            if !self.infos.contains_key(&topic) {
                let writer = self.participant.advertise(&topic, INFO, Durability::Latched)?;
                self.infos.insert(topic.clone(), writer);
            }
            if let Some(writer) = self.infos.get(&topic) {
                writer.send(message.clone())?;
            }
        }
        self.known = KnownCalibration { results: Some(results), residual_drift: None };
        Ok(())
    }

    /// Publishes what is known of `camera` again, with the stamp of an image that it took.
    pub fn publish_with_image(&self, camera: &str, utc_ns: i64) -> Result<(), DdsError> {
        let infos = self.known.results.iter().flat_map(|results| &results.infos);
        for SensorInfo { namespace, message, .. } in infos.filter(|info| info.camera == camera) {
            if let Some(writer) = self.infos.get(&info_topic(namespace)) {
                writer.send(restamped(message, utc_ns))?;
            }
        }
        Ok(())
    }
}

fn info_topic(namespace: &str) -> String {
    format!("/plumb{}/camera_info", ros_name(namespace))
}
