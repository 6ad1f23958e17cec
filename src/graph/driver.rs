//! The driver that is asked to keep a calibration.

use std::sync::Arc;
use std::task::Waker;

use crate::dds::{DdsError, Participant, ServiceClient};
use crate::recording::ros2_results::read_reply;

/// How many seconds an answer is waited for before it is asked again.
const ANSWER_S: u32 = 5;

/// A driver's `set_camera_info`.
#[derive(Debug)]
pub(super) struct Driver {
    service: String,
    client: ServiceClient,
    /// What it has yet to keep.
    pending: Option<Vec<u8>>,
    /// For how many seconds it has been asked.
    asked_s: Option<u32>,
    said: Option<String>,
}

impl Driver {
    pub fn new(participant: &Arc<Participant>, service: &str) -> Result<Self, DdsError> {
        let type_name = "sensor_msgs/srv/SetCameraInfo";
        let client = ServiceClient::new(participant, service, type_name)?;
        let service = service.to_owned();
        Ok(Self { service, client, pending: None, asked_s: None, said: None })
    }

    /// Has the driver keep this camera_info, when it is there.
    pub fn keep(&mut self, info: Vec<u8>) {
        (self.pending, self.asked_s, self.said) = (Some(info), None, None);
    }

    pub fn wake(&self, waker: &Waker) {
        self.client.wake(waker);
    }

    /// Asks, and hears what it answers; with each second (`seconds` = 1), and when it may have
    /// answered (0).
    pub fn advance(&mut self, participant: &Participant, seconds: u32) {
        if let Some(reply) = self.client.take() {
            let said = match read_reply(&reply.bytes) {
                Some((true, _)) => "kept".to_owned(),
                Some((false, message)) => format!("refused: {message}"),
                None => "sent a malformed reply".to_owned(),
            };
            tracing::info!(service = self.service, "the driver was given the calibration: {said}");
            (self.pending, self.asked_s, self.said) = (None, None, Some(said));
        }
        // Asked each time, so that no coming or going is missed.
        let is_answered = self.client.is_answered(participant);
        let Some(info) = &self.pending else { return };
        if let Some(asked_s) = &mut self.asked_s {
            *asked_s += seconds;
            if *asked_s < ANSWER_S {
                return;
            }
            self.asked_s = None;
        }
        if !is_answered {
            return;
        }
        match self.client.send(participant, info.clone()) {
            Ok(()) => self.asked_s = Some(0),
            Err(error) => tracing::warn!("{error}"),
        }
    }

    /// How it stands, in words.
    pub fn words(&self) -> String {
        match (&self.said, &self.pending, self.asked_s) {
            (Some(said), ..) => said.clone(),
            (None, None, _) => "no calibration to send yet".to_owned(),
            (None, Some(_), Some(_)) => "asked".to_owned(),
            (None, Some(_), None) => format!("no server for {}", self.service),
        }
    }
}
