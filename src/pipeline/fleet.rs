//! All cameras of the daemon as one live object: the only thing that the layers above talk to.

use std::sync::Arc;

use tokio::sync::{mpsc, oneshot, watch};

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::pipeline::camera_status::{CameraState, CameraStatus};
use crate::pipeline::event::{EventLog, EventStream};
use crate::pipeline::live_frame::LiveFrame;
use crate::pipeline::session_request::{EndError, Request, StartError};

/// No such camera is configured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("there is no camera `{camera}`; see GET /v1/cameras for those there are")]
pub struct UnknownCamera {
    /// The name that was asked for.
    pub camera: String,
}

/// All cameras, live. Reading never waits on a camera or a solve.
#[derive(Debug)]
pub struct Fleet {
    cameras: Vec<CameraLink>,
    events: Arc<EventLog>,
}

/// The ends of one camera's channels that face the outside.
#[derive(Debug)]
pub(super) struct CameraLink {
    pub(super) status: watch::Receiver<CameraStatus>,
    pub(super) frames: watch::Receiver<Option<Arc<LiveFrame>>>,
    pub(super) session: watch::Receiver<Option<Arc<SessionRecord>>>,
    pub(super) requests: mpsc::Sender<Request>,
}

impl Fleet {
    /// Every camera, in the order of the configuration.
    pub fn cameras(&self) -> Vec<CameraStatus> {
        self.cameras.iter().map(|camera| camera.status.borrow().clone()).collect()
    }

    /// One camera.
    ///
    /// # Errors
    /// [`UnknownCamera`].
    pub fn camera(&self, name: &str) -> Result<CameraStatus, UnknownCamera> {
        Ok(self.link(name)?.status.borrow().clone())
    }

    /// Whether any camera delivers.
    pub fn is_ready(&self) -> bool {
        self.cameras.iter().any(|camera| camera.status.borrow().state == CameraState::Streaming)
    }

    /// A camera's newest frame with what was seen in it, now and as it changes; `None` before the first.
    ///
    /// # Errors
    /// [`UnknownCamera`].
    pub fn frames(&self, name: &str) -> Result<watch::Receiver<Option<Arc<LiveFrame>>>, UnknownCamera> {
        Ok(self.link(name)?.frames.clone())
    }

    /// The newest session of each camera since the daemon started, running or over. Older ones are in the store.
    pub fn live_sessions(&self) -> Vec<Arc<SessionRecord>> {
        self.cameras.iter().filter_map(|camera| camera.session.borrow().clone()).collect()
    }

    /// The session `id`, if it is the newest of its camera since the daemon started. Older ones are in the store.
    pub fn live_session(&self, id: &str) -> Option<Arc<SessionRecord>> {
        self.session_link(id).and_then(|camera| camera.session.borrow().clone())
    }

    /// Starts a session on the camera `name`; it is stored when this returns.
    ///
    /// # Errors
    /// [`StartError`].
    pub async fn start_session(&self, name: &str, request: SessionRequest) -> Result<SessionRecord, StartError> {
        let link = self.link(name).map_err(|UnknownCamera { camera }| StartError::UnknownCamera { camera })?;
        let (reply, answer) = oneshot::channel();
        link.requests.send(Request::Start(request, reply)).await.map_err(|_| StartError::Stopping)?;
        answer.await.map_err(|_| StartError::Stopping)?
    }

    /// Ends the collecting of session `id` and begins to solve; returns without waiting for the solve, see
    /// [`Self::session_over`]. A session that solves already is left to it.
    ///
    /// # Errors
    /// [`EndError`]; a session that is not the newest of its camera counts as unknown here.
    pub async fn stop_session(&self, id: &str) -> Result<SessionRecord, EndError> {
        self.end_session(id, Request::Stop).await
    }

    /// Gives session `id` up; its views stay stored.
    ///
    /// # Errors
    /// [`EndError`]; a session that is not the newest of its camera counts as unknown here.
    pub async fn abort_session(&self, id: &str) -> Result<SessionRecord, EndError> {
        self.end_session(id, Request::Abort).await
    }

    /// Waits until session `id` has ended.
    ///
    /// # Errors
    /// [`EndError::UnknownSession`] if it is not, or stops being, the newest of its camera; [`EndError::Stopping`].
    pub async fn session_over(&self, id: &str) -> Result<Arc<SessionRecord>, EndError> {
        let unknown = || EndError::UnknownSession { id: id.to_owned() };
        let mut session = self.session_link(id).ok_or_else(unknown)?.session.clone();
        let ended = |record: &Option<Arc<SessionRecord>>| {
            record.as_ref().is_none_or(|record| record.id != id || record.state.is_over())
        };
        let record = session.wait_for(ended).await.map_err(|_| EndError::Stopping)?.clone();
        record.filter(|record| record.id == id).ok_or_else(unknown)
    }

    /// The events after `last_seen`; from now on, when `None`.
    pub fn events(&self, last_seen: Option<u64>) -> EventStream {
        self.events.follow(last_seen)
    }

    async fn end_session(
        &self,
        id: &str,
        request: fn(String, oneshot::Sender<Result<SessionRecord, EndError>>) -> Request,
    ) -> Result<SessionRecord, EndError> {
        let link = self.session_link(id).ok_or_else(|| EndError::UnknownSession { id: id.to_owned() })?;
        let (reply, answer) = oneshot::channel();
        link.requests.send(request(id.to_owned(), reply)).await.map_err(|_| EndError::Stopping)?;
        answer.await.map_err(|_| EndError::Stopping)?
    }

    fn link(&self, name: &str) -> Result<&CameraLink, UnknownCamera> {
        let found = self.cameras.iter().find(|camera| camera.status.borrow().name == name);
        found.ok_or_else(|| UnknownCamera { camera: name.to_owned() })
    }

    fn session_link(&self, id: &str) -> Option<&CameraLink> {
        let has = |camera: &&CameraLink| camera.session.borrow().as_ref().is_some_and(|record| record.id == id);
        self.cameras.iter().find(has)
    }
}
