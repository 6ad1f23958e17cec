//! Everything that a session keeps is stored before it is announced. While it cannot be stored, the
//! session is paused and gives the reason: it takes no frames, and resumes by itself as soon as
//! everything that is waiting has been stored.

use std::sync::Arc;

use tokio::sync::mpsc;
use ulid::Ulid;

use crate::calibration::result::{Calibration, Grade};
use crate::calibration::sensor::SensorId;
use crate::calibration::session::{Action, KeptView, Session};
use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::calibration::view::FrameFacts;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::frame::SensorKind;
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::event::EventKind;
use crate::pipeline::message::{Message, SeenFrameSet};
use crate::pipeline::scene_search::key_frame_image;
use crate::pipeline::seen::{SensorObservation, searched_frame};
use crate::pipeline::session_thread::SessionThread;
use crate::pipeline::solve_job::SolveFailure;
use crate::pipeline::unstored::{Unstored, UnstoredWork};
use crate::store::{Picture, SensorView, StoreError};

impl SessionThread {
    /// The next message. While waiting for it, retries what could not be stored.
    pub(super) fn next_message(
        &mut self,
        messages: &mut mpsc::Receiver<Message>,
    ) -> Option<Message> {
        loop {
            let Some(retry_at) = self.unstored.as_ref().map(Unstored::retry_at) else {
                return messages.blocking_recv();
            };
            let clock = tokio::runtime::Builder::new_current_thread().enable_time().build();
            let Ok(clock) = clock else { return messages.blocking_recv() };
            let next =
                clock.block_on(async { tokio::time::timeout_at(retry_at, messages.recv()).await });
            match next {
                Ok(message) => return message,
                Err(_) => self.try_again(),
            }
        }
    }

    /// The views of a kept frame set, those of the other sensors too, as they are stored. The part
    /// of the other sensors' views that a solve needs stays in memory.
    pub(super) fn views_to_store(
        &mut self,
        seen: &SeenFrameSet,
        kept: &[KeptView],
    ) -> Vec<(SensorView, Picture)> {
        let Some(session) = &self.session else { return Vec::new() };
        let members = self.instrument.member_names();
        let mut rows = Vec::new();
        for place in kept {
            rows.extend(key_frame_row(session, place, seen));
            let seen_by = self.instrument.cameras.get(place.camera);
            let encoding = seen_by.and_then(|camera| camera.depth_encoding());
            if let Some((view, observation)) = key_frame_depth(session, place, seen, encoding) {
                self.auxiliary.add(place.number, place.frame_set, None, &observation);
                rows.push((view, observation.image));
            }
            let Some((view, frame)) =
                session.view(place).zip(seen.frames.get(place.camera).and_then(Option::as_ref))
            else {
                continue;
            };
            let camera = members.get(place.camera);
            // The sensor that is searched is stored as color, even if it is infrared.
            let sensor = |kind: SensorKind| match camera {
                Some(camera) => SensorId::of(camera, kind),
                None => SensorId::own(kind),
            };
            for (index, observation) in frame.sensors.iter().enumerate() {
                let is_searched = index == 0;
                let kind = if is_searched { SensorKind::Color } else { observation.sensor };
                let image_size = observation.image_size;
                let detection = if is_searched {
                    Some(view.detection.clone())
                } else {
                    self.auxiliary.add(
                        place.number,
                        place.frame_set,
                        camera.map(String::as_str),
                        observation,
                    );
                    observation.detection.clone()
                };
                let sensor_view = SensorView {
                    frame_set: place.frame_set,
                    sensor: sensor(kind),
                    number: is_searched.then_some(place.number),
                    frame: FrameFacts { image_size, ..view.frame.clone() },
                    depth_encoding: observation.depth_encoding,
                    detection,
                };
                rows.push((sensor_view, observation.image.clone()));
            }
        }
        self.show_memory();
        rows
    }

    /// Stores the session's present state, then performs `actions`.
    pub(super) fn store_actions(&mut self, actions: Vec<Action>) {
        match &mut self.unstored {
            Some(unstored) => unstored.then(actions),
            None => self.store_or_pause(Unstored::new(UnstoredWork::Actions(actions))),
        }
    }

    /// Names and stores the calibration, ends the session with it, and announces both.
    pub(super) fn finish(&mut self, solved: Result<Box<Calibration>, SolveFailure>) {
        let Some(record) = self.session.as_ref().map(Session::record) else { return };
        if record.state != SessionState::Solving || self.unstored.is_some() {
            return;
        }
        let now_ns = utc_now_ns();
        match solved {
            Ok(solved) => {
                let calibration = Calibration {
                    id: Ulid::generate().to_string(),
                    camera: Some(self.instrument.name.clone()),
                    created_at_ns: now_ns,
                    ..*solved
                };
                self.store_or_pause(Unstored::new(UnstoredWork::Calibration(Box::new(
                    calibration,
                ))));
            }
            Err(failure) => {
                let reason = failure.to_string();
                let session = self.session.as_mut();
                let actions =
                    session.map_or_else(Vec::new, |session| session.fail(&reason, now_ns));
                self.perform(actions);
            }
        }
    }

    /// Keeps a frame set of a replay until the session resumes; a live one is dropped.
    pub(super) fn set_aside(&mut self, seen: SeenFrameSet) {
        if seen.frames.iter().flatten().any(|frame| frame.waits) {
            // At most as many as were in the queue when the assembly was held.
            self.waiting.push_back(seen);
            return;
        }
        for (camera, frame) in self.instrument.cameras.iter().zip(&seen.frames) {
            if frame.is_some() {
                camera.count_dropped("store", 1);
            }
        }
    }

    fn try_again(&mut self) {
        if let Some(unstored) = self.unstored.take() {
            self.store_or_pause(unstored);
        }
    }

    pub(super) fn store_or_pause(&mut self, mut unstored: Unstored) {
        if let Err(error) = self.store(&unstored.what) {
            self.pause(unstored, &error);
            return;
        }
        self.go_on();
        let then = unstored.take_then();
        self.after(unstored.what);
        if !then.is_empty() {
            self.perform(then);
        }
        // The frame sets that arrived meanwhile, until one of them cannot be stored either.
        while self.unstored.is_none()
            && let Some(seen) = self.waiting.pop_front()
        {
            self.observe(seen);
        }
    }

    fn store(&self, what: &UnstoredWork) -> Result<(), StoreError> {
        let Some(session) = &self.session else { return Ok(()) };
        match what {
            UnstoredWork::Views(kept) => self.store.keep_views(session.record(), &kept.views),
            UnstoredWork::Actions(_) => self.store.save_session(session.record()),
            UnstoredWork::Calibration(calibration) => {
                let mut finished = session.clone();
                finished.calibrated(calibration);
                let record = finished.record();
                if !self.is_approved(calibration) {
                    return self.store.finish_session(record, calibration, false);
                }
                self.instrument.make_current(calibration, &self.store, || {
                    self.store.finish_session(record, calibration, true)
                })
            }
        }
    }

    /// Performs what follows once `what` has been stored.
    fn after(&mut self, what: UnstoredWork) {
        match what {
            UnstoredWork::Views(kept) => self.announce_observed(&kept.seen, kept.observed),
            UnstoredWork::Actions(actions) => {
                self.perform_stored(actions);
                self.show();
            }
            UnstoredWork::Calibration(calibration) => {
                if !self.is_approved(&calibration) {
                    self.instrument.announce_calibration(&calibration, false);
                }
                let session = self.session.as_mut();
                let actions =
                    session.map_or_else(Vec::new, |session| session.calibrated(&calibration));
                self.perform_stored(actions);
                self.show();
            }
        }
    }

    /// Whether `calibration` becomes the current one without a request.
    fn is_approved(&self, calibration: &Calibration) -> bool {
        self.auto_approve && calibration.verdict.grade == Grade::Good
    }

    /// Pauses the session, which takes no frames any more, and announces the reason.
    fn pause(&mut self, mut unstored: Unstored, error: &StoreError) {
        let reason = format!("paused: {error}");
        let is_new = self.health.pause(&self.instrument.name, &reason);
        unstored.failed(&reason);
        self.unstored = Some(unstored);
        if let Some(assembly) = &self.assembly {
            assembly.hold(true);
        }
        if !is_new {
            return;
        }
        tracing::error!(instrument = self.instrument.name, "{reason}");
        // Readers see the session as it was last stored, with the reason for the pause.
        let shown = self.instrument.session.borrow().clone();
        let session = self.session.as_ref().map(Session::record);
        if let (Some(shown), Some(record)) = (shown, session)
            && shown.id == record.id
        {
            let paused = SessionRecord { reason: Some(reason), ..shown.as_ref().clone() };
            let event = EventKind::session(&paused);
            self.instrument.session.send_replace(Some(Arc::new(paused)));
            self.instrument.publish(event);
        }
    }

    fn go_on(&mut self) {
        if !self.health.go_on(&self.instrument.name) {
            return;
        }
        tracing::info!(instrument = self.instrument.name, "what waited is stored; it goes on");
        if let Some(assembly) = &self.assembly {
            assembly.hold(false);
        }
    }
}

/// The row of a view without a board. It has no corners: its features are found in its image again.
fn key_frame_row(
    session: &Session,
    place: &KeptView,
    seen: &SeenFrameSet,
) -> Option<(SensorView, Picture)> {
    let key_frame = session.key_frame(place)?;
    let frame_set = &seen.frames.get(place.camera)?.as_ref()?.frame_set;
    let view = SensorView {
        frame_set: place.frame_set,
        sensor: SensorId::own(SensorKind::Color),
        number: Some(place.number),
        frame: key_frame.frame.clone(),
        depth_encoding: None,
        detection: None,
    };
    Some((view, key_frame_image(searched_frame(frame_set)?)?))
}

/// The depth image of a key frame, both as it is stored and as the solve needs it.
fn key_frame_depth(
    session: &Session,
    place: &KeptView,
    seen: &SeenFrameSet,
    encoding: Option<DepthEncoding>,
) -> Option<(SensorView, SensorObservation)> {
    let key_frame = session.key_frame(place)?;
    let frame_set = &seen.frames.get(place.camera)?.as_ref()?.frame_set;
    let observation = SensorObservation::of_depth(frame_set.frame(SensorKind::Depth)?, encoding)?;
    let view = SensorView {
        frame_set: place.frame_set,
        sensor: SensorId::own(SensorKind::Depth),
        number: None,
        frame: FrameFacts { image_size: observation.image_size, ..key_frame.frame.clone() },
        depth_encoding: encoding,
        detection: None,
    };
    Some((view, observation))
}
