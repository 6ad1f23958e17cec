//! Thread `session-<instrument>`: owns the session of a camera or a rig, performs its actions, and
//! answers requests.
//!
//! Its messages come through one bounded queue, in order. Everything that a session keeps is on
//! disk before it is announced; while it cannot be stored, the session is paused (`pausing`).

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::sync::mpsc;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::drift::DriftWatch;
use crate::calibration::session::gate::KeptViews;
use crate::calibration::session::{Action, Observed, Session};
use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::imaging::factory::FactorySensor;
use crate::imaging::frame::SensorKind;
use crate::locks::lock;
use crate::pipeline::assembly::Assembly;
use crate::pipeline::auxiliary::AuxiliaryViews;
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::event::{DetectionEvent, EventKind};
use crate::pipeline::guarded::guarded;
use crate::pipeline::instrument::Instrument;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::message::{Message, SeenFrameSet};
use crate::pipeline::observations::solve_job;
use crate::pipeline::seen::SeenFrame;
use crate::pipeline::solve_job::EstimateJob;
use crate::pipeline::store_health::StoreHealth;
use crate::pipeline::unstored::Unstored;
use crate::store::Store;

pub(super) struct SessionThread {
    pub(super) instrument: Arc<Instrument>,
    pub(super) store: Arc<Store>,
    pub(super) health: Arc<StoreHealth>,
    pub(super) auto_approve: bool,
    pub(super) admission: AdmissionOptions,
    pub(super) session: Option<Session>,
    /// Combines the frames of the session that collects.
    pub(super) assembly: Option<Arc<Assembly>>,
    pub(super) auxiliary: AuxiliaryViews,
    /// Watches the calibration that was current when the session began.
    pub(super) drift: Option<DriftWatch>,
    /// What could not be stored.
    pub(super) unstored: Option<Unstored>,
    /// The frame sets of replays that arrived while the session was paused.
    pub(super) waiting: VecDeque<SeenFrameSet>,
}

impl SessionThread {
    pub(super) fn new(
        instrument: Arc<Instrument>,
        store: Arc<Store>,
        health: Arc<StoreHealth>,
        auto_approve: bool,
        admission: AdmissionOptions,
    ) -> Self {
        Self {
            instrument,
            store,
            health,
            auto_approve,
            admission,
            session: None,
            assembly: None,
            auxiliary: AuxiliaryViews::default(),
            drift: None,
            unstored: None,
            waiting: VecDeque::new(),
        }
    }

    pub(super) fn run(mut self, mut messages: mpsc::Receiver<Message>) {
        while let Some(message) = self.next_message(&mut messages) {
            if self.instrument.stop.is_set() {
                break;
            }
            if let Err(fault) = guarded(|| self.take(message)) {
                self.give_up(&fault.to_string());
            }
        }
        // Releases the threads that wait for room in the queue.
        drop(messages);
        self.instrument.jobs.close();
        self.health.go_on(&self.instrument.name);
        let Some(session) = self.session.take().filter(|s| !s.record().state.is_over()) else {
            return;
        };
        self.release(&session.record().id);
        // The counts since the last view; the views themselves are stored already.
        if self.unstored.is_none()
            && let Err(error) = self.store.save_session(session.record())
        {
            tracing::error!(session = session.record().id, "its counts are not stored: {error}");
        }
    }

    /// After a panic: the session in memory may be half changed. Its stored views stay, and its
    /// cameras are free for another one.
    fn give_up(&mut self, fault: &str) {
        tracing::error!(instrument = self.instrument.name, "{fault}");
        self.unstored = None;
        self.health.go_on(&self.instrument.name);
        self.let_happen(|session| session.fail(fault, utc_now_ns()));
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Seen(seen, session) if self.is_current(&session) => self.observe(*seen),
            Message::Ended { session, reason } if self.is_current(&session) => {
                self.let_happen(|session| session.source_ended(&reason, utc_now_ns()));
            }
            Message::CameraLost { place, reason } => {
                self.take_devices();
                self.let_happen(|session| session.camera_lost(place, &reason));
            }
            Message::CamerasBack => {
                self.take_devices();
                self.let_happen(Session::camera_back);
            }
            Message::Moved(what) => self.report_moved(what),
            Message::Waited(seconds) => self.let_happen(|session| session.waited(seconds)),
            Message::Estimated { session, place, estimate } if self.is_current(&session) => {
                self.let_happen(|session| estimate.take_to(session, place));
            }
            Message::Solved { session, solved } if self.is_current(&session) => {
                self.finish(solved);
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
            Message::Forget(id, reply) => {
                self.forget(&id);
                let _ = reply.send(());
            }
            _ => {}
        }
    }

    /// Takes a frame set: what the session keeps of it is stored, then announced.
    pub(super) fn observe(&mut self, seen: SeenFrameSet) {
        if self.unstored.is_some() {
            self.set_aside(seen);
            return;
        }
        let Some(session) = &mut self.session else { return };
        let Some(observed) = session.observe(&seen.observed) else { return };
        if observed.kept.is_empty() {
            self.announce_observed(&seen, observed);
            return;
        }
        let views = self.views_to_store(&seen, &observed.kept);
        self.store_or_pause(Unstored::views(views, seen, observed));
    }

    /// Announces a frame set and performs the resulting actions; what was kept of it is already
    /// stored.
    pub(super) fn announce_observed(&mut self, seen: &SeenFrameSet, observed: Observed) {
        // A client that is notified of the frame finds it counted in the session.
        self.show();
        let Some(record) = self.session.as_ref().map(Session::record) else { return };
        let cameras = Arc::clone(&self.instrument);
        let each = cameras.cameras.iter().zip(&seen.frames).zip(&observed.admissions);
        for ((camera, frame), admission) in each {
            if let (Some(frame), Some(admission)) = (frame, admission) {
                publish_detection(camera, record, frame, admission);
            }
        }
        for kept in &observed.kept {
            if let Some(camera) = cameras.cameras.get(kept.camera) {
                camera.metrics.views.with_label_values(&[&camera.name]).inc();
            }
            self.check_drift(kept);
        }
        if let (Some(session), Some(assembly), false) =
            (&self.session, &self.assembly, observed.kept.is_empty())
        {
            assembly.set_kept(KeptViews::of(session));
        }
        let waits = seen.frames.iter().flatten().any(|frame| frame.waits);
        let in_line = waits && self.estimates_decide();
        for action in observed.actions {
            match action {
                // A replay that waits for its frames waits for the estimate too: where it ends must
                // not depend on the speed of the machine.
                Action::Estimate(place) if in_line => self.estimate_in_line(place),
                other => self.perform(vec![other]),
            }
        }
        self.show();
    }

    fn estimates_decide(&self) -> bool {
        let finish = self.session.as_ref().and_then(|session| session.record().request.finish);
        finish.is_some_and(|finish| finish.uncertainty_px.is_some())
    }

    fn estimate_in_line(&mut self, place: usize) {
        let Some(session) = &mut self.session else { return };
        if let Some(job) = EstimateJob::of(session, place) {
            let actions = job.estimate().take_to(session, place);
            self.perform(actions);
        }
    }

    /// Applies `what` to the session, if there is one, and performs the resulting actions.
    pub(super) fn let_happen(&mut self, what: impl FnOnce(&mut Session) -> Vec<Action>) {
        if let Some(session) = &mut self.session {
            let actions = what(session);
            if !actions.is_empty() {
                self.perform(actions);
                self.show();
            }
        }
    }

    /// Performs the session's actions; if they end it, its state is stored first.
    pub(super) fn perform(&mut self, actions: Vec<Action>) {
        let ends = |action: &Action| matches!(action, Action::Solve | Action::Close);
        if actions.iter().any(ends) {
            self.store_actions(actions);
        } else {
            self.perform_stored(actions);
        }
    }

    pub(super) fn perform_stored(&mut self, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Estimate(place) => {
                    let job = self.session.as_ref().and_then(|s| EstimateJob::of(s, place));
                    job.into_iter().for_each(|job| self.instrument.jobs.estimate(job));
                }
                Action::Announce => self.publish_session(),
                Action::Solve => self.solve(),
                Action::Close => self.close(),
            }
        }
    }

    fn solve(&mut self) {
        let Some(id) = self.session.as_ref().map(|session| session.record().id.clone()) else {
            return;
        };
        self.stop_collecting(&id);
        if self.instrument.is_rig {
            self.release(&id);
        }
        if let Err(error) = self.auxiliary.complete(&self.store, &id) {
            tracing::error!(session = id, "depth that is not in memory is left out: {error}");
        }
        let stated: Vec<_> = self.instrument.cameras.iter().map(|c| stated_depth(c)).collect();
        let session = self.session.as_ref();
        let is_rig = self.instrument.is_rig;
        let job = session.map(|s| solve_job(s, &self.auxiliary, &stated, is_rig));
        job.into_iter().for_each(|job| self.instrument.jobs.solve(job));
        // The job contains all that is still needed of them.
        self.auxiliary = AuxiliaryViews::default();
        self.show_memory();
    }

    fn close(&mut self) {
        let Some(record) = self.session.as_ref().map(|session| session.record().clone()) else {
            return;
        };
        let (instrument, state) = (Arc::clone(&self.instrument), record.state.name());
        let name = &instrument.name;
        self.release(&record.id);
        instrument.jobs.abandon_solve();
        tracing::info!(
            instrument = name,
            session = record.id,
            state,
            reason = record.reason,
            "session over"
        );
        instrument.metrics.sessions.with_label_values(&[name.as_str(), state]).inc();
        self.auxiliary = AuxiliaryViews::default();
        self.show_memory();
        self.show();
        self.publish_session();
    }

    pub(super) fn is_current(&self, id: &str) -> bool {
        self.session.as_ref().is_some_and(|session| session.record().id == id)
    }

    /// Shows readers the session's present state.
    pub(super) fn show(&self) {
        // While it cannot be stored, they see the state stored last.
        let Some(session) = &self.session else { return };
        if self.unstored.is_some() {
            return;
        }
        let record = session.record();
        self.instrument.session.send_replace(Some(Arc::new(record.clone())));
        if record.state == SessionState::Collecting {
            let of_members = record.members.iter().map(|member| &member.guidance);
            let own = std::iter::once(&record.guidance);
            let guidances: Vec<_> =
                if self.instrument.is_rig { of_members.collect() } else { own.collect() };
            for (place, (camera, guidance)) in
                self.instrument.cameras.iter().zip(guidances).enumerate()
            {
                camera.suggest(guidance);
                camera.show_shared_with(session.last_key_frame(place).map(|key| key.image.clone()));
            }
        }
    }

    /// Announces the session's present state.
    pub(super) fn publish_session(&self) {
        if let Some(session) = self.session.as_ref().filter(|_| self.unstored.is_none()) {
            self.instrument.publish(EventKind::session(session.record()));
        }
    }

    pub(super) fn show_memory(&self) {
        let name = self.instrument.name.as_str();
        let bytes = i64::try_from(self.auxiliary.depth_bytes()).unwrap_or(i64::MAX);
        self.instrument.metrics.kept_depth_bytes.with_label_values(&[name]).set(bytes);
    }
}

/// What a camera's device states of its depth sensor.
fn stated_depth(camera: &LiveCamera) -> Option<FactorySensor> {
    let factory = lock(&camera.factory);
    factory.sensor(SensorKind::Depth).cloned()
}

fn publish_detection(
    camera: &LiveCamera,
    session: &SessionRecord,
    seen: &SeenFrame,
    admission: &Result<u32, Rejection>,
) {
    let (name, metrics) = (&camera.name, &camera.metrics);
    if let Err(rejection) = admission {
        metrics.rejected.with_label_values(&[name.as_str(), rejection.kind()]).inc();
    }
    camera.publish(EventKind::Detection(DetectionEvent::of(seen, session, admission)));
    let latency_s = seen.arrived.elapsed().as_secs_f64();
    metrics.latency_seconds.with_label_values(&[name]).observe(latency_s);
}
