//! Thread `rig-<name>`: owns a rig's session, borrows its cameras while it collects, performs what
//! it decides.

use std::sync::Arc;
use std::thread;

use tokio::sync::oneshot;
use ulid::Ulid;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::result::{Calibration, Grade};
use crate::calibration::session::{Action, CameraFrame, KeptView, Session, SessionOver};
use crate::calibration::session_record::{SessionRecord, SessionRequest, SessionState};
use crate::calibration::solve_rig::solve_rig;
use crate::calibration::view::View;
use crate::estimation::camera::CameraOptions;
use crate::pipeline::board_look::{BoardLook, Manner, picture_of};
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::event::{CalibrationEvent, DetectionEvent, EventKind, EventLog};
use crate::pipeline::guarded::guarded;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::{Look, LookError};
use crate::pipeline::live_rig::LiveRig;
use crate::pipeline::message::Message;
use crate::pipeline::rig_inbox::{Looked, Next, RigMessage, RigSeat};
use crate::pipeline::search::Search;
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::session_thread::frame_facts;
use crate::pipeline::solve_thread::Job;
use crate::pipeline::view_picture::view_picture;
use crate::store::{Picture, RigPlace, Store};

pub(super) struct RigThread {
    pub(super) rig: Arc<LiveRig>,
    pub(super) store: Arc<Store>,
    pub(super) events: Arc<EventLog>,
    pub(super) auto_approve: bool,
    pub(super) admission: AdmissionOptions,
    pub(super) current: Option<Current>,
    /// For the frames that are kept.
    pub(super) board_look: BoardLook,
}

/// The rig's newest session, with the cameras that it borrows.
pub(super) struct Current {
    session: Session,
    cameras: Vec<Arc<LiveCamera>>,
}

impl RigThread {
    pub(super) fn run(mut self) {
        loop {
            match self.rig.inbox.next() {
                Next::Closed => break,
                Next::Message(message) => self.take(message),
                Next::Moment(moment) => self.observe(moment),
                Next::Ended(reason) => {
                    self.tell(|session| session.source_ended(&reason, utc_now_ns()));
                }
            }
        }
        if self.current.as_ref().is_some_and(|current| !current.session.record().state.is_over()) {
            self.release();
            // The counts since the last view; the views themselves are stored already.
            self.save_session();
        }
    }

    fn take(&mut self, message: RigMessage) {
        match message {
            RigMessage::Start(request, cameras, reply) => {
                let _ = reply.send(self.start(request, cameras));
            }
            RigMessage::Resume(record, cameras) => self.resume(*record, cameras),
            RigMessage::Stop(id, reply) => {
                let _ = reply.send(self.end(&id, Session::stop));
            }
            RigMessage::Abort(id, reply) => {
                let _ = reply.send(self.end(&id, Session::abort));
            }
            RigMessage::Solved { session, solved } => self.finish(&session, solved),
        }
    }

    fn start(
        &mut self,
        request: SessionRequest,
        cameras: Vec<Arc<LiveCamera>>,
    ) -> Result<SessionRecord, StartError> {
        let rig = self.rig.plan.name.clone();
        if let Some(running) =
            self.current.as_ref().filter(|current| !current.session.record().state.is_over())
        {
            return Err(StartError::Busy {
                camera: rig,
                session: running.session.record().id.clone(),
            });
        }
        let record =
            SessionRecord::begin(&Ulid::generate().to_string(), &rig, request, utc_now_ns());
        let session = Session::begin(record, &self.rig.plan.cameras, &self.admission);
        let record = session.record().clone();
        self.store
            .begin_session(&record)
            .map_err(|error| StartError::Store { detail: error.to_string() })?;
        if let Err(error) = self.borrow_cameras(&record, &cameras) {
            let refused = SessionRecord {
                state: SessionState::Failed,
                reason: Some(error.to_string()),
                finished_at_ns: Some(record.started_at_ns),
                ..record
            };
            self.save(&refused);
            return Err(error);
        }
        tracing::info!(rig, session = record.id, "session begins");
        self.current = Some(Current { session, cameras });
        self.show();
        self.publish_session();
        Ok(record)
    }

    fn resume(&mut self, record: SessionRecord, cameras: Vec<Arc<LiveCamera>>) {
        let views = self.stored_views(&record.id);
        tracing::info!(
            rig = self.rig.plan.name,
            session = record.id,
            views = views.len(),
            "session goes on"
        );
        let (session, actions) =
            Session::resume(record, &self.rig.plan.cameras, &views, &self.admission);
        if session.record().state == SessionState::Collecting
            && let Err(error) = self.borrow_cameras(session.record(), &cameras)
        {
            tracing::error!(
                rig = self.rig.plan.name,
                "the session collects without its cameras: {error}"
            );
        }
        self.current = Some(Current { session, cameras });
        self.perform(actions);
        self.show();
    }

    fn stored_views(&self, session: &str) -> Vec<(KeptView, View)> {
        let read = || {
            Ok::<_, crate::store::StoreError>((
                self.store.rig_places(session)?,
                self.store.views(session)?,
            ))
        };
        let (places, views) = read().unwrap_or_else(|error| {
            tracing::error!(rig = self.rig.plan.name, session, "kept views are left out: {error}");
            Default::default()
        });
        let members = &self.rig.plan.cameras;
        let member =
            |camera: &str| members.iter().position(|name| name == camera).unwrap_or(members.len());
        let place = |place: &RigPlace| {
            let RigPlace { number, ref camera, moment } = *place;
            KeptView { number, camera: member(camera), frame_set: moment, view: 0 }
        };
        let of_place = |at: &RigPlace| views.iter().find(|view| view.number == at.number).cloned();
        places.iter().filter_map(|at| Some((place(at), of_place(at)?))).collect()
    }

    /// Has every camera search for the session's board, or none of them.
    fn borrow_cameras(
        &self,
        record: &SessionRecord,
        cameras: &[Arc<LiveCamera>],
    ) -> Result<(), StartError> {
        self.rig.inbox.collect_for(Some((&record.id, cameras.len())));
        for (member, camera) in cameras.iter().enumerate() {
            let seat = RigSeat { inbox: Arc::clone(&self.rig.inbox), member };
            let search = Search {
                session: record.id.clone(),
                target: record.request.target,
                rig: Some(seat),
            };
            let (reply, answer) = oneshot::channel();
            let asked = camera.messages.blocking_send(Message::Lend(search, reply)).ok();
            let lent = asked
                .and_then(|()| answer.blocking_recv().ok())
                .unwrap_or(Err(StartError::Stopping));
            if let Err(error) = lent {
                self.give_back(&record.id, &cameras[..member]);
                return Err(error);
            }
        }
        Ok(())
    }

    fn give_back(&self, session: &str, cameras: &[Arc<LiveCamera>]) {
        self.rig.inbox.collect_for(None);
        for camera in cameras {
            camera.search.set(None);
            let _ = camera.messages.blocking_send(Message::GiveBack(session.to_owned()));
        }
    }

    fn end(
        &mut self,
        id: &str,
        how: fn(&mut Session, i64) -> Result<Vec<Action>, SessionOver>,
    ) -> Result<SessionRecord, EndError> {
        let unknown = || EndError::UnknownSession { id: id.to_owned() };
        let current = self
            .current
            .as_mut()
            .filter(|current| current.session.record().id == id)
            .ok_or_else(unknown)?;
        let actions = how(&mut current.session, utc_now_ns())
            .map_err(|over| EndError::Over { id: id.to_owned(), state: over.state })?;
        self.perform(actions);
        self.show();
        self.current.as_ref().map(|current| current.session.record().clone()).ok_or_else(unknown)
    }

    /// A followed board decides whether its moment is worth keeping; what is kept is what a search
    /// finds.
    fn searched_if_worth(&mut self, mut moment: Vec<Option<Looked>>) -> Vec<Option<Looked>> {
        let Some(Current { session, .. }) = &self.current else { return moment };
        let worth = |(member, looked): (usize, &Option<Looked>)| {
            let Some(looked) = looked else { return false };
            let facts = frame_facts(&looked.captured);
            let keeps = |detection: &Arc<_>| session.would_keep(member, &facts, detection);
            looked.look.outcome.as_ref().is_ok_and(keeps)
        };
        if moment.iter().enumerate().any(worth) {
            let target = session.record().request.target;
            for looked in moment.iter_mut().flatten().filter(|looked| looked.look.followed) {
                let sighting =
                    self.board_look.look(&looked.captured.frame_set, &target, Manner::Searched);
                looked.look = Look::of(sighting, looked.look.elapsed_ms);
            }
        }
        moment
    }

    fn observe(&mut self, moment: Vec<Option<Looked>>) {
        let moment = self.searched_if_worth(moment);
        let Some(current) = self.current.as_mut() else { return };
        let sightings: Vec<Option<CameraFrame>> =
            moment.iter().map(|looked| looked.as_ref().map(sighting)).collect();
        let Some(observed) = current.session.observe(&sightings) else { return };
        for ((camera, looked), admission) in
            current.cameras.iter().zip(&moment).zip(&observed.admissions)
        {
            if let (Some(looked), Some(admission)) = (looked, admission) {
                publish_detection(camera, &current.session.record().id, looked, admission);
            }
        }
        for kept in &observed.kept {
            if let Some(Some(looked)) = moment.get(kept.camera) {
                self.keep(kept, looked);
            }
        }
        self.perform(observed.actions);
        self.show();
    }

    /// Lets something happen to the session, if there is one, and performs what it decides.
    fn tell(&mut self, what: impl FnOnce(&mut Session) -> Vec<Action>) {
        if let Some(current) = &mut self.current {
            let actions = what(&mut current.session);
            if !actions.is_empty() {
                self.perform(actions);
                self.show();
            }
        }
    }

    fn perform(&mut self, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Estimate(member) => self.estimate(member),
                Action::Announce => self.publish_session(),
                Action::Solve => {
                    self.release();
                    self.save_session();
                    self.solve();
                }
                Action::Close => self.close(),
            }
        }
    }

    fn keep(&self, place: &KeptView, looked: &Looked) {
        let Some(Current { session, cameras }) = &self.current else { return };
        let (Some(view), Some(camera)) = (session.view(place), cameras.get(place.camera)) else {
            return;
        };
        camera.metrics.views.with_label_values(&[&camera.name]).inc();
        let id = &session.record().id;
        let picture = picture_of(&looked.captured.frame_set).and_then(view_picture);
        let (media_type, bytes) = picture.unwrap_or(("image/jpeg", Vec::new().into()));
        let picture = Picture { media_type: media_type.to_owned(), bytes: bytes.to_vec() };
        let kept =
            RigPlace { number: place.number, camera: camera.name.clone(), moment: place.frame_set };
        if let Err(error) = self.store.append_rig_view(id, &kept, view, &picture) {
            // The session goes on with the view in memory; only a restart would lose it.
            tracing::error!(
                camera = camera.name,
                session = id,
                view = place.number,
                "the view is not stored: {error}"
            );
        }
        self.save(session.record());
    }

    /// Made at once, and not beside the frames: where a replay ends must not depend on how fast the
    /// machine is.
    fn estimate(&mut self, member: usize) {
        let Some(current) = &mut self.current else { return };
        let job = Job::of(&current.session, member, false);
        let estimate = job.and_then(|job| job.estimate());
        let actions = current.session.estimated(member, estimate);
        self.perform(actions);
    }

    fn solve(&self) {
        let Some(current) = &self.current else { return };
        let record = current.session.record();
        let (session, target) = (record.id.clone(), record.request.target);
        let options = CameraOptions { lens: record.request.lens, ..CameraOptions::default() };
        let (input, inbox) = (current.session.input(), Arc::clone(&self.rig.inbox));
        let work = move || {
            let solved = guarded(|| solve_rig(&input, &options).map_err(|error| error.to_string()));
            let calibration = solved.and_then(|solved| solved).map(|solved| {
                Box::new(Calibration {
                    session: Some(session.clone()),
                    ..solved.into_calibration(target)
                })
            });
            inbox.ask(RigMessage::Solved { session, solved: calibration });
        };
        // Nobody waits for it: a solve that is cut short is begun again with the next start.
        if let Err(error) =
            thread::Builder::new().name(format!("solve-{}", self.rig.plan.name)).spawn(work)
        {
            let session = record.id.clone();
            let solved = Err(format!("a thread for the solve could not be started: {error}"));
            self.rig.inbox.ask(RigMessage::Solved { session, solved });
        }
    }

    fn finish(&mut self, id: &str, solved: Result<Box<Calibration>, String>) {
        let solving = |current: &&Current| {
            current.session.record().id == id
                && current.session.record().state == SessionState::Solving
        };
        if self.current.as_ref().filter(solving).is_none() {
            return;
        }
        let now_ns = utc_now_ns();
        let outcome = solved.and_then(|solved| self.calibration_made(*solved, now_ns));
        self.tell(|session| session.solved(outcome, now_ns));
    }

    /// Names and stores the calibration, makes it current if it may, and announces it; its id.
    fn calibration_made(&self, solved: Calibration, now_ns: i64) -> Result<String, String> {
        let rig = &self.rig.plan.name;
        let calibration = Calibration {
            id: Ulid::generate().to_string(),
            camera: Some(rig.clone()),
            created_at_ns: now_ns,
            ..solved
        };
        self.store.append_calibration(&calibration).map_err(|error| error.to_string())?;
        let mut current = self.auto_approve && calibration.verdict.grade == Grade::Good;
        if current && let Err(error) = self.store.set_current(rig, &calibration.id) {
            tracing::error!(rig, "the calibration is stored but not approved: {error}");
            current = false;
        }
        if current {
            self.rig.calibration.send_replace(Some(calibration.id.clone()));
        }
        if let Some(event) = CalibrationEvent::of(&calibration, current) {
            self.events.publish(rig, EventKind::Calibration(event));
        }
        Ok(calibration.id)
    }

    fn release(&self) {
        if let Some(Current { session, cameras }) = &self.current {
            self.give_back(&session.record().id, cameras);
        }
    }

    fn close(&self) {
        self.release();
        let Some(record) = self.current.as_ref().map(|current| current.session.record()) else {
            return;
        };
        let (rig, state) = (&self.rig.plan.name, record.state.name());
        tracing::info!(rig, session = record.id, state, reason = record.reason, "session over");
        self.save_session();
        self.show();
        self.publish_session();
    }

    fn save_session(&self) {
        if let Some(current) = &self.current {
            self.save(current.session.record());
        }
    }

    fn save(&self, record: &SessionRecord) {
        if let Err(error) = self.store.save_session(record) {
            tracing::error!(
                rig = self.rig.plan.name,
                session = record.id,
                "the session is not stored: {error}"
            );
        }
    }

    /// Lets readers see the session as it stands.
    fn show(&self) {
        if let Some(current) = &self.current {
            self.rig.session.send_replace(Some(Arc::new(current.session.record().clone())));
        }
    }

    fn publish_session(&self) {
        if let Some(current) = &self.current {
            let record = current.session.record().clone();
            self.events.publish(&self.rig.plan.name, EventKind::Session(Box::new(record)));
        }
    }
}

fn sighting(looked: &Looked) -> CameraFrame {
    let seen = match &looked.look.outcome {
        Ok(detection) => Ok(detection.as_ref().clone()),
        Err(LookError::NoBoard(reason)) => Err(Rejection::NoBoard(reason.clone())),
        Err(LookError::Unreadable { detail }) => {
            Err(Rejection::Unreadable { detail: detail.clone() })
        }
    };
    CameraFrame { frame: frame_facts(&looked.captured), seen }
}

fn publish_detection(
    camera: &LiveCamera,
    session: &str,
    looked: &Looked,
    admission: &Result<u32, Rejection>,
) {
    let rejection = admission.as_ref().err();
    if let Some(rejection) = rejection {
        camera.metrics.rejected.with_label_values(&[camera.name.as_str(), rejection.kind()]).inc();
    }
    camera.publish(EventKind::Detection(DetectionEvent::of(
        (&looked.captured, &looked.look),
        session,
        admission,
    )));
}
