//! The public state of a session: the record that is stored, served and resumed from.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::calibration::admission::Rejections;
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::Guidance;
use crate::calibration::result::ProjectionUncertainty;
use crate::calibration::sensor::SensorId;
use crate::calibration::target::CalibrationTarget;
use crate::estimation::problem::LensChoice;
use crate::estimation::uncertainty::UncertaintyMap;
use crate::geometry::lens::Lens;
use crate::imaging::frame::SensorKind;

/// What a session is asked to do.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionRequest {
    /// The board that is shown, or the scene.
    pub target: CalibrationTarget,
    /// Which lens model to fit.
    pub lens: LensChoice,
    /// When there are enough views; `None` runs until it is stopped.
    pub finish: Option<Finish>,
    /// Lenses of a rig that are known and held fixed.
    pub given: Vec<HeldLens>,
}

/// A lens that is held fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldLens {
    /// Whose.
    pub sensor: SensorId,
    /// The lens.
    pub lens: Lens,
}

/// When a session has enough views and solves by itself: as soon as every given goal is reached, or
/// the time is up.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Finish {
    /// The goal for the median over the image of the predicted 1-σ projection uncertainty, in
    /// pixels.
    pub uncertainty_px: Option<f64>,
    /// The least number of views.
    pub min_views: Option<u32>,
    /// The longest time to collect, in seconds of the frames' time; then the gathered views are
    /// solved.
    pub max_seconds: Option<f64>,
}

/// The state of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SessionState {
    /// Takes frames and keeps views.
    Collecting,
    /// Computes its calibration; takes no more frames.
    Solving,
    /// Has its calibration.
    Finished,
    /// Has none, and says why; its views stay.
    Failed,
    /// Given up, on request or because a camera's source or device has changed; its views stay.
    Aborted,
}

impl SessionState {
    /// Every state.
    pub const ALL: [Self; 5] =
        [Self::Collecting, Self::Solving, Self::Finished, Self::Failed, Self::Aborted];

    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Collecting => "collecting",
            Self::Solving => "solving",
            Self::Finished => "finished",
            Self::Failed => "failed",
            Self::Aborted => "aborted",
        }
    }

    /// The state with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }

    /// Whether it is final.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Finished | Self::Failed | Self::Aborted)
    }
}

/// The estimate from the views so far.
#[derive(Debug, Clone, PartialEq)]
pub struct RunningEstimate {
    /// The lens, as far as it is known.
    pub lens: Lens,
    /// Root mean square of the reprojection error, in pixels.
    pub rms_px: f64,
    /// How well the lens is known over the image.
    pub uncertainty_px: ProjectionUncertainty,
    /// The same at each place of a grid; `None` in an estimate that was read back.
    pub uncertainty_map: Option<Arc<UncertaintyMap>>,
    /// How many views it was made of.
    pub views: u32,
}

/// The grid that a running estimate's uncertainty is shown on, columns.
pub const SHOWN_COLUMNS: u32 = 25;

/// One camera's contribution to a session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionMember {
    /// The camera's name.
    pub camera: String,
    /// Frames searched.
    pub frames_seen: u64,
    /// Frames in which the board was found.
    pub boards_seen: u64,
    /// Views kept.
    pub views_kept: u32,
    /// Views kept in frame sets of which another camera's view was kept too.
    pub views_shared: u32,
    /// Why the other frames were not kept.
    pub rejected: Rejections,
    /// Where in the image corners were seen.
    pub coverage: Coverage,
    /// What to do next for this camera.
    pub guidance: Guidance,
    /// What its views amount to; `None` before there are enough.
    pub estimate: Option<RunningEstimate>,
}

impl SessionMember {
    /// A camera that has not given anything yet.
    pub fn begin(camera: &str) -> Self {
        Self {
            camera: camera.to_owned(),
            frames_seen: 0,
            boards_seen: 0,
            views_kept: 0,
            views_shared: 0,
            rejected: Rejections::default(),
            coverage: Coverage::default(),
            guidance: Guidance::default(),
            estimate: None,
        }
    }

    /// The estimate of the camera with the greatest uncertainty; `None` while a camera has none.
    pub(super) fn worst_estimate(members: &[Self]) -> Option<RunningEstimate> {
        let estimates: Option<Vec<&RunningEstimate>> =
            members.iter().map(|member| member.estimate.as_ref()).collect();
        let median = |estimate: &RunningEstimate| estimate.uncertainty_px.median;
        estimates?.into_iter().max_by(|a, b| median(a).total_cmp(&median(b))).cloned()
    }
}

/// A session as seen from outside.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionRecord {
    /// Sortable by time.
    pub id: String,
    /// The camera's name, or the rig's.
    pub camera: String,
    /// The contribution of each camera of a rig, in the rig's order; empty for one camera. The
    /// record's own counts of frames and boards are then sums, its coverage and estimate are those
    /// of the worst camera, and its views are the frame sets kept.
    pub members: Vec<SessionMember>,
    /// The source of each camera's images, by its name, in words: views from another source have
    /// another lens.
    pub sources: BTreeMap<String, String>,
    /// The device of each camera, by its name: model and serial number, as far as it states them.
    pub devices: BTreeMap<String, String>,
    /// The request.
    pub request: SessionRequest,
    /// Its state.
    pub state: SessionState,
    /// Why it failed, or what it waits for.
    pub reason: Option<String>,
    /// UTC, nanoseconds since the Unix epoch.
    pub started_at_ns: i64,
    /// When it ended, likewise; `None` before.
    pub finished_at_ns: Option<i64>,
    /// Frames searched.
    pub frames_seen: u64,
    /// Frames in which the board was found.
    pub boards_seen: u64,
    /// Views kept.
    pub views_kept: u32,
    /// Why the other frames were not kept.
    pub rejected: Rejections,
    /// Seconds of frame time spent collecting.
    pub collecting_s: f64,
    /// Where in the image corners were seen.
    pub coverage: Coverage,
    /// What to do next.
    pub guidance: Guidance,
    /// What the views amount to; `None` before there are enough.
    pub estimate: Option<RunningEstimate>,
    /// The id of its calibration, once finished.
    pub calibration: Option<String>,
}

impl SessionRequest {
    /// The lens of a rig's camera, if it is held fixed.
    pub fn held(&self, camera: &str) -> Option<Lens> {
        let color = SensorId::of(camera, SensorKind::Color);
        self.given.iter().find(|held| held.sensor == color).map(|held| held.lens)
    }
}

/// Images of a camera that the session cannot continue with: the earlier ones have another origin.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the {} of camera `{camera}` changed from {was} to {is}, and a session never mixes views of both; its views are kept: start a new session",
    origin.name()
)]
pub struct OtherOrigin {
    /// What has changed.
    pub origin: ImageOrigin,
    /// The camera's name.
    pub camera: String,
    /// Where its earlier images come from, in words.
    pub was: String,
    /// Where its images come from now, in words.
    pub is: String,
}

/// Where a camera's images come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageOrigin {
    /// The source that is configured.
    Source,
    /// The device that gives them.
    Device,
}

impl ImageOrigin {
    fn name(self) -> &'static str {
        match self {
            Self::Source => "source",
            Self::Device => "device",
        }
    }
}

impl SessionRecord {
    /// The record of a session that is about to collect.
    pub fn begin(id: &str, camera: &str, request: SessionRequest, started_at_ns: i64) -> Self {
        Self {
            id: id.to_owned(),
            camera: camera.to_owned(),
            members: Vec::new(),
            sources: BTreeMap::new(),
            devices: BTreeMap::new(),
            request,
            state: SessionState::Collecting,
            reason: None,
            started_at_ns,
            finished_at_ns: None,
            frames_seen: 0,
            boards_seen: 0,
            views_kept: 0,
            rejected: Rejections::default(),
            collecting_s: 0.0,
            coverage: Coverage::default(),
            guidance: Guidance::default(),
            estimate: None,
            calibration: None,
        }
    }

    /// Whether `name` is its camera or its rig, or one of the rig's cameras.
    pub fn is_of(&self, name: &str) -> bool {
        self.camera == name || self.members.iter().any(|member| member.camera == name)
    }

    /// Records the source of a camera's images, if it is not known yet.
    ///
    /// # Errors
    /// [`OtherOrigin`]: earlier images have another source.
    pub fn take_source(&mut self, camera: &str, source: &str) -> Result<(), OtherOrigin> {
        let known = known_or(&mut self.sources, camera, source);
        if known == source {
            return Ok(());
        }
        Err(OtherOrigin::of(ImageOrigin::Source, camera, known, source))
    }

    /// Records the device of a camera, if it is not known yet.
    ///
    /// # Errors
    /// As [`Self::take_source`].
    pub(super) fn take_device(&mut self, camera: &str, device: &str) -> Result<(), OtherOrigin> {
        let known = known_or(&mut self.devices, camera, device);
        if !is_another_device(known, device) {
            return Ok(());
        }
        Err(OtherOrigin::of(ImageOrigin::Device, camera, known, device))
    }

    /// The record as the contribution of its only camera.
    pub(super) fn to_member(&self) -> SessionMember {
        SessionMember {
            frames_seen: self.frames_seen,
            boards_seen: self.boards_seen,
            views_kept: self.views_kept,
            rejected: self.rejected.clone(),
            coverage: self.coverage.clone(),
            guidance: self.guidance.clone(),
            estimate: self.estimate.clone(),
            ..SessionMember::begin(&self.camera)
        }
    }

    /// Updates the record from the contribution of its only camera.
    pub(super) fn take_member(&mut self, member: &SessionMember) {
        self.frames_seen = member.frames_seen;
        self.boards_seen = member.boards_seen;
        self.views_kept = member.views_kept;
        self.rejected = member.rejected.clone();
        self.coverage = member.coverage.clone();
        self.estimate = member.estimate.clone();
        if self.state == SessionState::Collecting {
            self.guidance = member.guidance.clone();
        }
    }
}

impl OtherOrigin {
    fn of(origin: ImageOrigin, camera: &str, was: &str, is: &str) -> Self {
        Self { origin, camera: camera.to_owned(), was: was.to_owned(), is: is.to_owned() }
    }
}

/// Where a camera's images come from as it is known: `from` if it is not known yet.
fn known_or<'a>(known: &'a mut BTreeMap<String, String>, camera: &str, from: &str) -> &'a str {
    known.entry(camera.to_owned()).or_insert_with(|| from.to_owned())
}

/// Whether two devices, each in words (its model, then its serial number if known), are different.
/// A device that does not state its serial number this time may be the same.
pub(super) fn is_another_device(was: &str, is: &str) -> bool {
    let only_says_more = |more: &str, less: &str| {
        more.strip_prefix(less).is_some_and(|rest| rest.is_empty() || rest.starts_with(", serial "))
    };
    !only_says_more(was, is) && !only_says_more(is, was)
}

#[cfg(test)]
mod tests {
    use super::is_another_device;

    #[test]
    fn a_device_that_does_not_say_its_serial_number_may_be_the_same() {
        for (was, is, is_another) in [
            ("C920, serial A", "C920, serial A", false),
            ("C920, serial A", "C920", false),
            ("C920", "C920, serial A", false),
            ("C920, serial A", "C920, serial AB", true),
            ("C920, serial A", "C922, serial A", true),
            ("C920", "C920 Pro", true),
        ] {
            assert_eq!(is_another_device(was, is), is_another, "{was} and {is}");
        }
    }
}
