//! The sessions of the fleet's cameras and rigs.

use std::sync::Arc;

use tokio::sync::oneshot;

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::fleet::Fleet;
use crate::pipeline::instrument::Instrument;
use crate::pipeline::message::{EndReply, Message};
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::unknown::{UnknownCamera, UnknownRig};
use crate::store::StoreError;

impl Fleet {
    /// The newest session of each camera and each rig since the daemon started, running or over.
    /// Older ones are in the store.
    pub fn live_sessions(&self) -> Vec<Arc<SessionRecord>> {
        let sessions = self.instruments();
        sessions.iter().filter_map(|instrument| instrument.session.borrow().clone()).collect()
    }

    /// The session `id`, if it is the newest of its camera or rig since the daemon started. Older
    /// ones are in the store.
    pub fn live_session(&self, id: &str) -> Option<Arc<SessionRecord>> {
        self.owner(id).and_then(|owner| owner.session.borrow().clone())
    }

    /// Starts a session on the camera `name`; it is stored when this returns.
    ///
    /// # Errors
    /// [`StartError`].
    pub async fn start_session(
        &self,
        name: &str,
        request: SessionRequest,
    ) -> Result<SessionRecord, StartError> {
        let camera = self
            .own_link(name)
            .map_err(|UnknownCamera { camera }| StartError::UnknownCamera { camera })?;
        start(&camera, request).await
    }

    /// Starts a session on the rig `name`; it is stored when this returns.
    ///
    /// # Errors
    /// [`StartError`], also when one of its cameras is in a session.
    pub async fn start_rig_session(
        &self,
        name: &str,
        request: SessionRequest,
    ) -> Result<SessionRecord, StartError> {
        let rig =
            self.rig_link(name).map_err(|UnknownRig { rig }| StartError::UnknownRig { rig })?;
        start(&rig, request).await
    }

    /// Ends the collecting of session `id` and begins to solve. Returns without waiting for the
    /// solve, see [`Self::session_over`]. A session that already solves is left alone.
    ///
    /// # Errors
    /// [`EndError`]; a session that is not the newest of its camera counts as unknown here.
    pub async fn stop_session(&self, id: &str) -> Result<SessionRecord, EndError> {
        self.end_session(id, Message::Stop).await
    }

    /// Aborts session `id`; its views stay stored.
    ///
    /// # Errors
    /// [`EndError`]; a session that is not the newest of its camera counts as unknown here.
    pub async fn abort_session(&self, id: &str) -> Result<SessionRecord, EndError> {
        self.end_session(id, Message::Abort).await
    }

    /// Aborts session `id`, which no camera or rig continues. Blocks while cameras are exchanged.
    ///
    /// # Errors
    /// [`EndError`]; a session that is over, or that its camera goes on with, is not touched.
    pub fn abort_stored(&self, id: &str) -> Result<SessionRecord, EndError> {
        let _exchanging = self.exchanging();
        let broken = |error: StoreError| EndError::Store { detail: error.to_string() };
        let stored = self.store().session(id).map_err(broken)?;
        let unknown = || EndError::UnknownSession { id: id.to_owned() };
        let mut record = stored.ok_or_else(unknown)?;
        let over = EndError::Over { id: id.to_owned(), state: record.state };
        if self.owner(id).is_some() || record.abort(utc_now_ns()).is_err() {
            return Err(over);
        }
        self.store().save_session(&record).map_err(broken)?;
        Ok(record)
    }

    /// Forgets session `id`, which is over and was deleted from the store.
    pub async fn forget_session(&self, id: &str) {
        let Some(owner) = self.owner(id) else { return };
        let (reply, answer) = oneshot::channel();
        // If the thread has ended, the daemon is stopping and nothing is shown any more.
        if owner.messages.send(Message::Forget(id.to_owned(), reply)).await.is_ok() {
            let _ = answer.await;
        }
    }

    /// Waits until session `id` has ended.
    ///
    /// # Errors
    /// [`EndError::UnknownSession`] if it is not, or stops being, the newest of its camera;
    /// [`EndError::Stopping`].
    pub async fn session_over(&self, id: &str) -> Result<Arc<SessionRecord>, EndError> {
        let unknown = || EndError::UnknownSession { id: id.to_owned() };
        let mut session = self.owner(id).ok_or_else(unknown)?.session.subscribe();
        let ended = |record: &Option<Arc<SessionRecord>>| {
            record.as_ref().is_none_or(|record| record.id != id || record.state.is_over())
        };
        let record = session.wait_for(ended).await.map_err(|_| EndError::Stopping)?.clone();
        record.filter(|record| record.id == id).ok_or_else(unknown)
    }

    async fn end_session(
        &self,
        id: &str,
        how: fn(String, EndReply) -> Message,
    ) -> Result<SessionRecord, EndError> {
        let owner = self.owner(id).ok_or_else(|| EndError::UnknownSession { id: id.to_owned() })?;
        let (reply, answer) = oneshot::channel();
        let message = how(id.to_owned(), reply);
        owner.messages.send(message).await.map_err(|_| EndError::Stopping)?;
        answer.await.map_err(|_| EndError::Stopping)?
    }

    /// The instrument whose newest session is `id`.
    fn owner(&self, id: &str) -> Option<Arc<Instrument>> {
        let has = |instrument: &Arc<Instrument>| {
            instrument.session.borrow().as_ref().is_some_and(|record| record.id == id)
        };
        self.instruments().into_iter().find(has)
    }
}

async fn start(
    instrument: &Instrument,
    request: SessionRequest,
) -> Result<SessionRecord, StartError> {
    let (reply, answer) = oneshot::channel();
    let message = Message::Start(request, reply);
    instrument.messages.send(message).await.map_err(|_| StartError::Stopping)?;
    answer.await.map_err(|_| StartError::Stopping)?
}
