//! Begins and ends a session: acquires its cameras, and assembles their frames.

use std::sync::Arc;

use ulid::Ulid;

use crate::calibration::guidance::Guidance;
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::session::gate::KeptViews;
use crate::calibration::session::{Action, DepthFrame, KeptView, Session, SessionOver};
use crate::calibration::session_record::{
    OtherOrigin, SessionRecord, SessionRequest, SessionState,
};
use crate::calibration::view::{FrameFacts, View};
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::SensorKind;
use crate::imaging::image_file::frame_from_file;
use crate::locks::lock;
use crate::pipeline::assembly::{Assembly, AssemblyPlan};
use crate::pipeline::auxiliary::AuxiliaryViews;
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::scene_search::stored_scene;
use crate::pipeline::search::{CameraSearch, CameraTaken};
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::session_thread::SessionThread;
use crate::pipeline::unstored::Unstored;
use crate::store::SensorView;

impl SessionThread {
    /// Resumes a session that an earlier run of the daemon left unfinished.
    pub(super) fn resume(&mut self, mut record: SessionRecord) {
        let name = self.instrument.name.clone();
        if let Err(other) = self.take_sources(&mut record) {
            let (session, actions) = Session::give_up(record, &other.to_string(), utc_now_ns());
            self.session = Some(session);
            self.perform(actions);
            return;
        }
        let stored = self.store.sensor_views(&record.id).unwrap_or_else(|error| {
            tracing::error!(instrument = name, "kept views are left out: {error}");
            Vec::new()
        });
        let (session, actions) = self.resumed(record, &stored);
        let (id, views) = (&session.record().id, session.kept().len());
        tracing::info!(instrument = name, session = id, views, "session goes on");
        self.auxiliary = AuxiliaryViews::of_stored(&stored);
        self.drift = self.drift_watch();
        let record = session.record().clone();
        let needs_cameras = record.state == SessionState::Collecting || !self.instrument.is_rig;
        if needs_cameras && let Err(error) = self.acquire(&record.id) {
            tracing::error!(instrument = name, "the session is without cameras: {error}");
        }
        self.session = Some(session);
        if record.state == SessionState::Collecting {
            self.collect(&record);
        }
        self.perform(actions);
        self.show();
    }

    /// Records the sources of the cameras' images.
    fn take_sources(&self, record: &mut SessionRecord) -> Result<(), OtherOrigin> {
        let mut cameras = self.instrument.cameras.iter();
        cameras.try_for_each(|camera| record.take_source(&camera.name, &camera.image_source))
    }

    /// Records which devices deliver the frames.
    pub(super) fn take_devices(&mut self) {
        for camera in &Arc::clone(&self.instrument).cameras {
            if let Some(device) = camera.streaming_device() {
                self.let_happen(|session| {
                    session.device_gives_frames(&camera.name, &device, utc_now_ns())
                });
            }
        }
    }

    /// The session of `record` with its stored views, and the first actions to perform.
    fn resumed(&self, record: SessionRecord, stored: &[SensorView]) -> (Session, Vec<Action>) {
        if record.request.target.is_scene() {
            let key_frames = self.kept_key_frames(&record.id, stored);
            return Session::resume_scene(record, &key_frames, &self.admission);
        }
        let (views, members) = (self.kept_views(stored), self.instrument.member_names());
        let id = record.id.clone();
        let depth = |place: &KeptView| self.kept_depth(&id, stored, place);
        Session::resume_with_depth(record, &members, &views, depth, &self.admission)
    }

    /// The stored depth image of a view; `None` where there is none, or it cannot be decoded.
    fn kept_depth(
        &self,
        session: &str,
        stored: &[SensorView],
        place: &KeptView,
    ) -> Option<DepthFrame> {
        let name = self.instrument.is_rig.then(|| self.instrument.member_names());
        let name = name.and_then(|names| names.get(place.camera).cloned());
        let together = || {
            let is_own = |view: &&SensorView| {
                view.frame_set == place.frame_set && view.sensor.camera == name
            };
            stored.iter().filter(is_own)
        };
        let depth = together().find(|view| view.sensor.kind == SensorKind::Depth)?;
        let size = depth.frame.image_size;
        let picture = self.store.sensor_picture(session, place.frame_set, &depth.sensor).ok()??;
        let frame = frame_from_file(SensorKind::Depth, picture.bytes);
        let sees = |view: &&SensorView| {
            view.sensor.kind.is_of_depth()
                && view.frame.image_size == size
                && view.detection.is_some()
        };
        let factory = lock(&self.instrument.cameras.get(place.camera)?.factory);
        Some(DepthFrame {
            image: Arc::new(DepthImage::from_frame(&frame).ok()?),
            encoding: depth.depth_encoding.unwrap_or(DepthEncoding::ORDINARY),
            factory: factory.sensor(SensorKind::Depth).and_then(|it| it.depth_lens(size)),
            infrared: together().find(sees).and_then(|view| view.detection.clone()),
        })
    }

    /// The stored key frames with the features of their images, in the order in which they were
    /// kept.
    fn kept_key_frames(
        &self,
        session: &str,
        stored: &[SensorView],
    ) -> Vec<(KeptView, FrameFacts, SceneImage)> {
        let key_frame = |view: &SensorView| {
            let number = view.number?;
            let image = self.store.picture(session, number).map_err(|error| error.to_string());
            let image = image.and_then(|image| image.ok_or_else(|| "it has no image".to_owned()));
            let name = view.frame.display_name();
            let features = image
                .and_then(|image| stored_scene(name, image).map_err(|error| error.to_string()));
            let fault = |error| tracing::error!(session, number, "key frame left out: {error}");
            let kept = KeptView { number, camera: 0, frame_set: view.frame_set, view: 0 };
            Some((kept, view.frame.clone(), features.map_err(fault).ok()?))
        };
        let mut key_frames: Vec<_> = stored.iter().filter_map(key_frame).collect();
        key_frames.sort_by_key(|(kept, ..)| kept.number);
        key_frames
    }

    /// The stored views as the session continues with them, in the order in which they were kept.
    fn kept_views(&self, stored: &[SensorView]) -> Vec<(KeptView, View)> {
        let members = self.instrument.member_names();
        let place = |view: &SensorView| match &view.sensor.camera {
            Some(camera) => members.iter().position(|name| name == camera),
            None => Some(0),
        };
        let kept =
            |view: &SensorView| view.to_kept(place(view).unwrap_or(self.instrument.cameras.len()));
        let mut views: Vec<(KeptView, View)> = stored.iter().filter_map(kept).collect();
        views.sort_by_key(|(kept, _)| kept.number);
        views
    }

    /// Begins a session; it is stored when this returns.
    pub(super) fn start(&mut self, request: SessionRequest) -> Result<SessionRecord, StartError> {
        let instrument = Arc::clone(&self.instrument);
        let running = self.session.as_ref().map(Session::record);
        if let Some(running) = running.filter(|record| !record.state.is_over()) {
            let (camera, session) = (instrument.name.clone(), running.id.clone());
            return Err(StartError::Busy { camera, session });
        }
        if let Some(unstored) = &self.unstored {
            return Err(StartError::Store { detail: unstored.reason().to_owned() });
        }
        let id = Ulid::generate().to_string();
        let mut record = SessionRecord::begin(&id, &instrument.name, request, utc_now_ns());
        for camera in &instrument.cameras {
            record.sources.insert(camera.name.clone(), camera.image_source.clone());
            record.devices.extend(camera.streaming_device().map(|it| (camera.name.clone(), it)));
        }
        let session = Session::begin(record, &instrument.member_names(), &self.admission);
        let record = session.record().clone();
        self.acquire(&id)?;
        if let Err(error) = self.store.begin_session(&record) {
            self.release(&id);
            return Err(StartError::Store { detail: error.to_string() });
        }
        tracing::info!(instrument = instrument.name, session = id, "session begins");
        self.session = Some(session);
        self.auxiliary = AuxiliaryViews::default();
        self.drift = self.drift_watch();
        self.collect(&record);
        self.show();
        self.publish_session();
        instrument.cameras.iter().for_each(|camera| camera.announce());
        Ok(record)
    }

    /// Acquires every camera for the session, or none of them.
    fn acquire(&self, session: &str) -> Result<(), StartError> {
        let cameras = &self.instrument.cameras;
        for (place, camera) in cameras.iter().enumerate() {
            if let Err(CameraTaken { owner }) = camera.search.acquire(session) {
                cameras[..place].iter().for_each(|camera| give_back(camera, session));
                return Err(StartError::Busy { camera: camera.name.clone(), session: owner });
            }
            camera.status.send_modify(|status| status.session = Some(session.to_owned()));
        }
        Ok(())
    }

    /// Makes every camera search for the session's board from now on.
    fn collect(&mut self, record: &SessionRecord) {
        let instrument = &self.instrument;
        let plan = AssemblyPlan {
            session: record.id.clone(),
            target: record.request.target,
            instrument: instrument.name.clone(),
            factories: instrument.cameras.iter().map(|c| Arc::clone(&c.factory)).collect(),
            admission: self.admission,
        };
        let metrics = Arc::clone(&instrument.metrics);
        let assembly = Arc::new(Assembly::new(plan, instrument.messages.clone(), metrics));
        if let Some(session) = &self.session {
            assembly.set_kept(KeptViews::of(session));
        }
        for (place, camera) in instrument.cameras.iter().enumerate() {
            let search = CameraSearch { assembly: Arc::clone(&assembly), place };
            camera.search.set(&record.id, Some(Arc::new(search)));
        }
        self.assembly = Some(assembly);
    }

    /// Stops the search of every camera.
    pub(super) fn stop_collecting(&mut self, session: &str) {
        for camera in &self.instrument.cameras {
            camera.search.set(session, None);
            camera.suggest(&Guidance::default());
            camera.show_shared_with(None);
        }
        if let Some(assembly) = self.assembly.take() {
            assembly.close();
        }
        self.waiting.clear();
    }

    /// Releases the cameras.
    pub(super) fn release(&mut self, session: &str) {
        self.stop_collecting(session);
        self.instrument.cameras.iter().for_each(|camera| give_back(camera, session));
    }

    /// Ends the session on request. Its new state is stored before it is announced.
    pub(super) fn end(
        &mut self,
        id: &str,
        how: fn(&mut Session, i64) -> Result<Vec<Action>, SessionOver>,
    ) -> Result<SessionRecord, EndError> {
        if !self.is_current(id) {
            return Err(EndError::UnknownSession { id: id.to_owned() });
        }
        if let Some(reason) = self.unstored.as_ref().map(Unstored::reason) {
            return Err(EndError::Store { detail: reason.to_owned() });
        }
        let unknown = || EndError::UnknownSession { id: id.to_owned() };
        let mut ended = self.session.clone().ok_or_else(unknown)?;
        let actions = how(&mut ended, utc_now_ns())
            .map_err(|over| EndError::Over { id: id.to_owned(), state: over.state })?;
        self.store
            .save_session(ended.record())
            .map_err(|error| EndError::Store { detail: error.to_string() })?;
        let record = ended.record().clone();
        self.session = Some(ended);
        self.perform_stored(actions);
        self.show();
        Ok(record)
    }

    /// Drops the session if it is the session `id` and is over.
    pub(super) fn forget(&mut self, id: &str) {
        let is_over =
            |session: &Session| session.record().id == id && session.record().state.is_over();
        if self.session.take_if(|session| is_over(session)).is_some() {
            self.instrument.session.send_replace(None);
        }
    }
}

fn give_back(camera: &LiveCamera, session: &str) {
    if camera.search.release(session) {
        camera.status.send_modify(|status| status.session = None);
        camera.announce();
    }
}
