//! Thread `session-<camera>`: owns the camera's session, performs what it decides, and answers
//! requests.
//!
//! What it is told comes through one bounded queue, in order. A kept view is on disk before the
//! next frame is looked at.

use std::sync::mpsc::Sender;
use std::sync::{Arc, PoisonError};

use tokio::sync::mpsc;
use ulid::Ulid;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::drift::DriftWatch;
use crate::calibration::result::{Calibration, Grade};
use crate::calibration::session::{Action, KeptView, Observed, Session, SessionOver};
use crate::calibration::session_record::{SessionRecord, SessionRequest, SessionState};
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;
use crate::imaging::factory::FactorySensor;
use crate::imaging::frame::SensorKind;
use crate::pipeline::board_look::{BoardLook, Manner, picture_of};
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::companions::{companions_of, rgbd_input, stereo_input};
use crate::pipeline::event::{CalibrationEvent, DetectionEvent, EventKind};
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::{Look, LookError};
use crate::pipeline::message::{CapturedFrame, Message};
use crate::pipeline::search::Search;
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::solve_thread::Job;
use crate::pipeline::view_picture::view_picture;
use crate::store::{Companion, Store};

pub(super) struct SessionThread {
    pub(super) camera: Arc<LiveCamera>,
    pub(super) store: Arc<Store>,
    pub(super) jobs: Sender<Job>,
    pub(super) auto_approve: bool,
    pub(super) admission: AdmissionOptions,
    pub(super) session: Option<Session>,
    /// For the frames that are kept.
    pub(super) board_look: BoardLook,
    /// The rig's session that the camera is lent to.
    pub(super) lent_to: Option<String>,
    /// The calibration that held when the session began.
    pub(super) drift: Option<DriftWatch>,
}

impl SessionThread {
    pub(super) fn run(mut self, mut messages: mpsc::Receiver<Message>) {
        while let Some(message) = messages.blocking_recv() {
            if self.camera.stop.is_set() {
                break;
            }
            self.take(message);
        }
        // The counts since the last view; the views themselves are stored already.
        if let Some(session) =
            self.session.take().filter(|session| !session.record().state.is_over())
        {
            self.save(session.record());
        }
    }

    /// Goes on with a session that an earlier run of the daemon left.
    pub(super) fn resume(&mut self, record: SessionRecord, views: Vec<View>) {
        tracing::info!(
            camera = self.camera.name,
            session = record.id,
            views = views.len(),
            "session goes on"
        );
        let place = |view: View| {
            let number = view.number;
            (KeptView { number, camera: 0, frame_set: number, view: number }, view)
        };
        let views: Vec<(KeptView, View)> = views.into_iter().map(place).collect();
        let (session, actions) = Session::resume(record, &[], &views, &self.admission);
        self.begin_search(&session);
        self.drift = self.drift_watch();
        self.session = Some(session);
        self.perform(actions);
        self.show();
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Looked { captured, search, look } => self.observe(&captured, &search, look),
            Message::Ended { search, reason } => {
                if self.is_for(search.as_deref()) {
                    self.tell(|session| session.source_ended(&reason, utc_now_ns()));
                }
            }
            Message::CameraLost(reason) => self.tell(|session| session.camera_lost(0, &reason)),
            Message::Moved(what) => self.tell_moved(what),
            Message::CameraBack => self.tell(Session::camera_back),
            Message::Waited(seconds) => self.tell(|session| session.waited(seconds)),
            Message::Estimated { session: id, estimate } => {
                if self.is_current(&id) {
                    self.tell(|session| session.estimated(0, estimate.map(|estimate| *estimate)));
                }
            }
            Message::Solved { session: id, solved } => {
                if self.is_current(&id) {
                    self.finish(solved);
                }
            }
            Message::Start(request, reply) => {
                let _ = reply.send(self.start(request));
            }
            Message::Stop(id, reply) => {
                let _ = reply.send(self.end(&id, Session::stop));
            }
            Message::Abort(id, reply) => {
                let _ = reply.send(self.end(&id, Session::abort));
            }
            Message::Lend(search, reply) => {
                let _ = reply.send(self.lend(search));
            }
            Message::GiveBack(id) => {
                if self.lent_to.take_if(|lent_to| *lent_to == id).is_some() {
                    self.camera.search.set(None);
                    self.camera.status.send_modify(|status| status.session = None);
                    self.camera.announce();
                }
            }
            Message::Wake => {}
        }
    }

    fn start(&mut self, request: SessionRequest) -> Result<SessionRecord, StartError> {
        let camera = self.camera.name.clone();
        self.is_free()?;
        let record =
            SessionRecord::begin(&Ulid::generate().to_string(), &camera, request, utc_now_ns());
        self.store
            .begin_session(&record)
            .map_err(|error| StartError::Store { detail: error.to_string() })?;
        let session = Session::begin(record.clone(), &[], &self.admission);
        tracing::info!(camera, session = record.id, "session begins");
        self.begin_search(&session);
        self.drift = self.drift_watch();
        self.session = Some(session);
        self.show();
        self.publish_session();
        self.camera.announce();
        Ok(record)
    }

    /// Whether no session has the camera.
    fn is_free(&self) -> Result<(), StartError> {
        let own =
            self.session.as_ref().map(Session::record).filter(|record| !record.state.is_over());
        match own.map(|record| &record.id).or(self.lent_to.as_ref()) {
            Some(session) => {
                Err(StartError::Busy { camera: self.camera.name.clone(), session: session.clone() })
            }
            None => Ok(()),
        }
    }

    fn lend(&mut self, search: Search) -> Result<(), StartError> {
        self.is_free()?;
        let id = search.session.clone();
        self.lent_to = Some(id.clone());
        self.camera.search.set(Some(search));
        self.camera.status.send_modify(|status| status.session = Some(id));
        self.camera.announce();
        Ok(())
    }

    fn begin_search(&self, session: &Session) {
        let record = session.record();
        if record.state == SessionState::Collecting {
            let search =
                Search { session: record.id.clone(), target: record.request.target, rig: None };
            self.camera.search.set(Some(search));
        }
    }

    fn end(
        &mut self,
        id: &str,
        how: fn(&mut Session, i64) -> Result<Vec<Action>, SessionOver>,
    ) -> Result<SessionRecord, EndError> {
        let unknown = || EndError::UnknownSession { id: id.to_owned() };
        let session = self
            .session
            .as_mut()
            .filter(|session| session.record().id == id)
            .ok_or_else(unknown)?;
        let actions = how(session, utc_now_ns())
            .map_err(|over| EndError::Over { id: id.to_owned(), state: over.state })?;
        self.perform(actions);
        self.show();
        self.session.as_ref().map(|session| session.record().clone()).ok_or_else(unknown)
    }

    fn observe(&mut self, captured: &CapturedFrame, search: &Search, look: Look) {
        let Some(session) =
            self.session.as_mut().filter(|session| session.record().id == search.session)
        else {
            return;
        };
        let facts = frame_facts(captured);
        // A followed board decides whether its frame is worth keeping; what is kept is what a
        // search finds in it.
        let worth =
            |detection: &Arc<Detection>| look.followed && session.would_keep(0, &facts, detection);
        let look = if look.outcome.as_ref().is_ok_and(worth) {
            Look::of(
                self.board_look.look(&captured.frame_set, &search.target, Manner::Searched),
                look.elapsed_ms,
            )
        } else {
            look
        };
        let seen = match &look.outcome {
            Ok(detection) => Ok(detection.as_ref().clone()),
            Err(LookError::NoBoard(reason)) => Err(Rejection::NoBoard(reason.clone())),
            Err(LookError::Unreadable { detail }) => {
                Err(Rejection::Unreadable { detail: detail.clone() })
            }
        };
        let Some(observed) = session.observe_frame(facts, seen) else { return };
        self.publish_detection(captured, search, &look, &observed);
        let in_line = captured.waits && self.estimates_decide();
        for kept in &observed.kept {
            self.keep(kept, captured);
        }
        for action in observed.actions {
            match action {
                // A replay that waits for its frames waits for this too: how fast the machine is
                // must not decide where it ends.
                Action::Estimate(camera) if in_line => self.estimate_in_line(camera),
                other => self.perform(vec![other]),
            }
        }
        self.show();
    }

    fn estimates_decide(&self) -> bool {
        let finish = self.session.as_ref().and_then(|session| session.record().request.finish);
        finish.is_some_and(|finish| finish.uncertainty_px.is_some())
    }

    fn estimate_in_line(&mut self, camera: usize) {
        if let Some(session) = &mut self.session {
            let estimate = Job::of(session, camera, false).and_then(|job| job.estimate());
            let actions = session.estimated(camera, estimate);
            self.perform(actions);
        }
    }

    fn keep(&mut self, kept: &KeptView, captured: &CapturedFrame) {
        let Some(session) = &self.session else { return };
        let (number, Some(view)) = (kept.number, session.view(kept)) else { return };
        self.camera.metrics.views.with_label_values(&[&self.camera.name]).inc();
        let id = &session.record().id;
        let picture = picture_of(&captured.frame_set).and_then(view_picture);
        let (media_type, bytes) = picture.unwrap_or(("image/jpeg", Vec::new().into()));
        if let Err(error) = self.store.append_view(id, view, media_type, &bytes) {
            // The session goes on with the view in memory; only a restart would lose it.
            tracing::error!(
                camera = self.camera.name,
                session = id,
                view = number,
                "the view is not stored: {error}"
            );
        }
        let unit_m = self.stated_depth().and_then(|stated| stated.depth_unit_m);
        let companions =
            companions_of(number, &captured.frame_set, &session.record().request.target, unit_m);
        if !companions.is_empty()
            && let Err(error) = self.store.append_companions(id, &companions)
        {
            tracing::error!(
                camera = self.camera.name,
                session = id,
                view = number,
                "its depth is not stored: {error}"
            );
        }
        self.save(session.record());
        self.look_for_drift(number);
    }

    /// Lets something happen to the session, if there is one, and performs what it decides.
    fn tell(&mut self, what: impl FnOnce(&mut Session) -> Vec<Action>) {
        if let Some(session) = &mut self.session {
            let actions = what(session);
            if !actions.is_empty() {
                self.perform(actions);
                self.show();
            }
        }
    }

    fn perform(&mut self, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Estimate(_) => self.send_job(false),
                Action::Announce => self.publish_session(),
                Action::Solve => {
                    self.camera.search.set(None);
                    self.save_session();
                    self.send_job(true);
                }
                Action::Close => self.close(),
            }
        }
    }

    fn send_job(&self, is_final: bool) {
        if let Some(session) = &self.session
            && let Some(mut job) = Job::of(session, 0, is_final)
        {
            if is_final {
                let companions = self.companions_of(session);
                job.with_depth = rgbd_input(session, &companions, self.stated_depth().as_ref());
                job.with_infrared2 = stereo_input(session, &companions);
            }
            // Without a solve thread the daemon is going down.
            let _ = self.jobs.send(job);
        }
    }

    /// What other sensors gave together with a session's views.
    fn companions_of(&self, session: &Session) -> Vec<Companion> {
        let id = &session.record().id;
        self.store.companions(id).unwrap_or_else(|error| {
            tracing::error!(
                camera = self.camera.name,
                session = id,
                "depth and infrared are left out: {error}"
            );
            Vec::new()
        })
    }

    /// What the device states of its depth sensor.
    fn stated_depth(&self) -> Option<FactorySensor> {
        let factory = self.camera.factory.lock().unwrap_or_else(PoisonError::into_inner);
        factory.sensor(SensorKind::Depth).cloned()
    }

    fn finish(&mut self, solved: Result<Box<Calibration>, String>) {
        if self
            .session
            .as_ref()
            .is_none_or(|session| session.record().state != SessionState::Solving)
        {
            return;
        }
        let now_ns = utc_now_ns();
        let outcome = solved.and_then(|solved| self.calibration_made(*solved, now_ns));
        self.tell(|session| session.solved(outcome, now_ns));
    }

    /// Names and stores the calibration, makes it current if it may, and announces it; its id.
    fn calibration_made(&self, solved: Calibration, now_ns: i64) -> Result<String, String> {
        let calibration = Calibration {
            id: Ulid::generate().to_string(),
            camera: Some(self.camera.name.clone()),
            created_at_ns: now_ns,
            ..solved
        };
        self.store.append_calibration(&calibration).map_err(|error| error.to_string())?;
        let mut current = self.auto_approve && calibration.verdict.grade == Grade::Good;
        if current && let Err(error) = self.store.set_current(&self.camera.name, &calibration.id) {
            tracing::error!(
                camera = self.camera.name,
                "the calibration is stored but not approved: {error}"
            );
            current = false;
        }
        if current {
            self.camera
                .status
                .send_modify(|status| status.calibration = Some(calibration.id.clone()));
        }
        if let Some(event) = CalibrationEvent::of(&calibration, current) {
            self.camera.publish(EventKind::Calibration(event));
        }
        Ok(calibration.id)
    }

    fn close(&mut self) {
        self.camera.search.set(None);
        let Some(record) = self.session.as_ref().map(Session::record) else { return };
        tracing::info!(
            camera = self.camera.name,
            session = record.id,
            state = record.state.name(),
            reason = record.reason,
            "session over"
        );
        self.camera
            .metrics
            .sessions
            .with_label_values(&[&self.camera.name, record.state.name()])
            .inc();
        self.save_session();
        self.show();
        self.publish_session();
        self.camera.announce();
    }

    fn is_current(&self, id: &str) -> bool {
        self.session.as_ref().is_some_and(|session| session.record().id == id)
    }

    fn is_for(&self, search: Option<&Search>) -> bool {
        search.is_some_and(|search| self.is_current(&search.session))
    }

    fn save_session(&self) {
        if let Some(session) = &self.session {
            self.save(session.record());
        }
    }

    fn save(&self, record: &SessionRecord) {
        if let Err(error) = self.store.save_session(record) {
            tracing::error!(
                camera = self.camera.name,
                session = record.id,
                "the session is not stored: {error}"
            );
        }
    }

    /// Lets readers see the session as it stands.
    fn show(&self) {
        let Some(record) = self.session.as_ref().map(Session::record) else { return };
        self.camera.session.send_replace(Some(Arc::new(record.clone())));
        let running = (!record.state.is_over()).then(|| record.id.clone());
        self.camera.suggest(&record.guidance.outline_px);
        self.camera.status.send_if_modified(|status| {
            let changed = status.session != running;
            status.session = running;
            changed
        });
    }

    fn publish_session(&self) {
        if let Some(session) = &self.session {
            self.camera.publish(EventKind::Session(Box::new(session.record().clone())));
        }
    }

    fn publish_detection(
        &self,
        captured: &CapturedFrame,
        search: &Search,
        look: &Look,
        observed: &Observed,
    ) {
        let Some(admission) = observed.admissions.first().and_then(Option::as_ref) else { return };
        let rejection = admission.as_ref().err();
        let (name, metrics) = (&self.camera.name, &self.camera.metrics);
        if let Some(rejection) = rejection {
            metrics.rejected.with_label_values(&[name, rejection.kind()]).inc();
        }
        let looked = (captured, look);
        self.camera.publish(EventKind::Detection(DetectionEvent::of(
            looked,
            &search.session,
            admission,
        )));
        metrics
            .latency_seconds
            .with_label_values(&[name])
            .observe(captured.arrived.elapsed().as_secs_f64());
    }
}

pub(super) fn frame_facts(captured: &CapturedFrame) -> FrameFacts {
    let frame_set = &captured.frame_set;
    FrameFacts {
        sequence: frame_set.sequence,
        name: frame_set.name.clone(),
        host_time_ns: frame_set.host_time.utc_ns,
        device_time_ns: frame_set.device_time.map(|time| time.monotonic_ns),
        image_size: picture_of(frame_set)
            .map(|frame| frame.size)
            .unwrap_or(crate::geometry::pixel::ImageSize::new(0, 0)),
    }
}
