//! The session document, and the request that starts one.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::sensor::SensorId;
use crate::calibration::session_record::{
    Finish, HeldLens, RunningEstimate, SessionMember, SessionRecord, SessionRequest, SessionState,
};
use crate::calibration::target::CalibrationTarget;
use crate::document::error::DocumentError;
use crate::document::lens::LensDocument;
use crate::document::lens_model::LensRequest;
use crate::document::pose::PoseDocument;
use crate::document::session_member::SessionMemberDocument;
use crate::document::session_progress::{
    CoverageDocument, EstimateDocument, GuidanceDocument, is_finite, rejected_counts, rejections,
};
use crate::document::target::TargetDocument;
use crate::document::time;
use crate::geometry::lens::Lens;
use crate::imaging::frame::SensorKind;

/// What starts a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StartDocument {
    /// The calibration target: a board, or a scene for none. A board has no default size: count its
    /// corners, squares or tags, and measure one.
    pub target: TargetDocument,
    /// The lens model to fit; default: `auto`.
    #[serde(default)]
    pub lens: LensRequest,
    /// When to stop by itself; default: it runs until it is stopped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<FinishDocument>,
    /// Known lenses of a rig's cameras, which are held fixed, by `CAMERA.color`; as `lens` in
    /// calibrations.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub given: BTreeMap<String, LensDocument>,
}

impl From<&SessionRequest> for StartDocument {
    fn from(request: &SessionRequest) -> Self {
        Self {
            target: request.target.into(),
            lens: request.lens.into(),
            finish: request.finish.map(FinishDocument::from),
            given: given_document(&request.given),
        }
    }
}

impl TryFrom<&StartDocument> for SessionRequest {
    type Error = DocumentError;
    fn try_from(document: &StartDocument) -> Result<Self, DocumentError> {
        Ok(Self {
            target: CalibrationTarget::try_from(&document.target)
                .map_err(|e| e.inside("target"))?,
            lens: document.lens.into(),
            finish: document
                .finish
                .map(Finish::try_from)
                .transpose()
                .map_err(|e| e.inside("finish"))?,
            given: document
                .given
                .iter()
                .map(|(name, lens)| held(name, lens).map_err(|e| e.inside("given")))
                .collect::<Result<_, _>>()?,
        })
    }
}

fn given_document(given: &[HeldLens]) -> BTreeMap<String, LensDocument> {
    let name = |sensor: &SensorId| {
        let camera = sensor.camera.as_deref().unwrap_or_default();
        format!("{camera}.{}", sensor.kind.name())
    };
    given.iter().map(|held| (name(&held.sensor), (&held.lens).into())).collect()
}

/// The lens that is held under `name`, as in `left.color`.
fn held(name: &str, lens: &LensDocument) -> Result<HeldLens, DocumentError> {
    let wrong = || {
        DocumentError::field(
            name,
            "is not the color lens of a camera of the rig; write it as `left.color`",
        )
    };
    let (camera, kind) = name.rsplit_once('.').ok_or_else(wrong)?;
    if camera.is_empty() || SensorKind::from_name(kind) != Some(SensorKind::Color) {
        return Err(wrong());
    }
    let lens = Lens::try_from(lens).map_err(|e| e.inside(name))?;
    Ok(HeldLens { sensor: SensorId::of(camera, SensorKind::Color), lens })
}

/// When a session finishes by itself: as soon as all given goals are reached, or the time is up.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FinishDocument {
    /// The median over the image of the predicted 1-σ projection uncertainty that is good enough,
    /// in pixels.
    #[schema(exclusive_minimum = 0.0)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty_px: Option<f64>,
    /// Do not finish before this many views are kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_views: Option<u32>,
    /// The longest it may collect, in seconds of the frames' time; what has been gathered by then
    /// is solved.
    #[schema(exclusive_minimum = 0.0)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_seconds: Option<f64>,
}

impl From<Finish> for FinishDocument {
    fn from(finish: Finish) -> Self {
        let Finish { uncertainty_px, min_views, max_seconds } = finish;
        Self { uncertainty_px, min_views, max_seconds }
    }
}

impl TryFrom<FinishDocument> for Finish {
    type Error = DocumentError;
    fn try_from(document: FinishDocument) -> Result<Self, DocumentError> {
        let FinishDocument { uncertainty_px, min_views, max_seconds } = document;
        for (field, value) in [("uncertainty_px", uncertainty_px), ("max_seconds", max_seconds)] {
            if let Some(value) = value.filter(|value| value.is_nan() || *value <= 0.0) {
                return Err(DocumentError::field(
                    field,
                    format!("{value} is not a valid goal; give a positive number"),
                ));
            }
        }
        Ok(Self { uncertainty_px, min_views, max_seconds })
    }
}

/// State of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SessionStateName {
    /// Searching frames for the board and accepting views.
    Collecting,
    /// Stopped, and computing the result.
    Solving,
    /// There is a calibration.
    Finished,
    /// There is no calibration, and `reason` says why; the views are kept.
    Failed,
    /// Aborted, by request, or because a camera's source in the configuration, or its device, has
    /// changed; the views are kept.
    Aborted,
}

impl From<SessionStateName> for SessionState {
    fn from(name: SessionStateName) -> Self {
        match name {
            SessionStateName::Collecting => Self::Collecting,
            SessionStateName::Solving => Self::Solving,
            SessionStateName::Finished => Self::Finished,
            SessionStateName::Failed => Self::Failed,
            SessionStateName::Aborted => Self::Aborted,
        }
    }
}

impl From<SessionState> for SessionStateName {
    fn from(state: SessionState) -> Self {
        match state {
            SessionState::Collecting => Self::Collecting,
            SessionState::Solving => Self::Solving,
            SessionState::Finished => Self::Finished,
            SessionState::Failed => Self::Failed,
            SessionState::Aborted => Self::Aborted,
        }
    }
}

/// A calibration session: what was asked for, what has been gathered, what to do next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionDocument {
    /// Sortable by time.
    pub id: String,
    /// The camera's name, or the rig's.
    pub camera: String,
    /// What each camera of a rig contributes, in the rig's order; left out for one camera. For a
    /// rig, `frames_seen` and `boards_seen` are sums, `coverage` and `estimate` the worst camera's,
    /// and `views_kept` counts frame sets.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<SessionMemberDocument>,
    /// The image source of each camera, by its name: the device or the recording, and its mode. A
    /// session never mixes two.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub sources: BTreeMap<String, String>,
    /// The device of each camera, by its name: model and serial number, where known. A session
    /// never mixes two.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub devices: BTreeMap<String, String>,
    /// Its state.
    pub state: SessionStateName,
    /// Why it failed, is waiting or was aborted.
    pub reason: Option<String>,
    /// When it was started.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: jiff::Timestamp,
    /// When it ended.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<jiff::Timestamp>,
    /// The board.
    pub target: TargetDocument,
    /// The lens model asked for.
    pub lens: LensRequest,
    /// When it stops by itself; empty when it runs till it is stopped.
    pub finish: FinishDocument,
    /// Lenses of a rig that are held as they are; left out where there are none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub given: BTreeMap<String, LensDocument>,
    /// Frames searched.
    pub frames_seen: u64,
    /// Frames in which the board was found.
    pub boards_seen: u64,
    /// Views kept for the solve.
    pub views_kept: u32,
    /// Frames not kept, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Where in the image corners have been seen.
    pub coverage: CoverageDocument,
    /// What the person with the board should do next.
    pub guidance: GuidanceDocument,
    /// The estimate from the views so far; null before the first.
    pub estimate: Option<EstimateDocument>,
    /// The identifier of the resulting calibration.
    pub calibration: Option<String>,
    /// Whether that calibration was deleted since; left out where it was not.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub calibration_deleted: bool,
}

impl From<&SessionRecord> for SessionDocument {
    fn from(record: &SessionRecord) -> Self {
        Self {
            id: record.id.clone(),
            camera: record.camera.clone(),
            cameras: record.members.iter().map(SessionMemberDocument::from).collect(),
            sources: record.sources.clone(),
            devices: record.devices.clone(),
            state: record.state.into(),
            reason: record.reason.clone(),
            started_at: time::from_utc_ns(record.started_at_ns),
            finished_at: record.finished_at_ns.map(time::from_utc_ns),
            target: record.request.target.into(),
            lens: record.request.lens.into(),
            finish: record.request.finish.map(FinishDocument::from).unwrap_or_default(),
            given: given_document(&record.request.given),
            frames_seen: record.frames_seen,
            boards_seen: record.boards_seen,
            views_kept: record.views_kept,
            rejected: rejected_counts(&record.rejected),
            coverage: (&record.coverage).into(),
            guidance: (&record.guidance).into(),
            estimate: record
                .estimate
                .as_ref()
                .filter(|estimate| is_finite(estimate))
                .map(EstimateDocument::from),
            calibration: record.calibration.clone(),
            // The record does not know: where documents are served, the store is asked.
            calibration_deleted: false,
        }
    }
}

impl SessionDocument {
    /// The record it came from; `collecting_s` is what the document does not hold: seconds of frame
    /// time spent collecting.
    ///
    /// # Errors
    /// [`DocumentError::Field`] naming the invalid field.
    pub fn to_record(&self, collecting_s: f64) -> Result<SessionRecord, DocumentError> {
        let finish = Some(self.finish).filter(|finish| *finish != FinishDocument::default());
        let (target, lens, given) = (self.target.clone(), self.lens, self.given.clone());
        let start = StartDocument { target, lens, finish, given };
        let estimate = self.estimate.as_ref().map(RunningEstimate::try_from).transpose();
        Ok(SessionRecord {
            id: self.id.clone(),
            camera: self.camera.clone(),
            members: self.cameras.iter().map(SessionMember::try_from).collect::<Result<_, _>>()?,
            sources: self.sources.clone(),
            devices: self.devices.clone(),
            request: (&start).try_into()?,
            state: self.state.into(),
            reason: self.reason.clone(),
            started_at_ns: time::utc_ns(self.started_at),
            finished_at_ns: self.finished_at.map(time::utc_ns),
            frames_seen: self.frames_seen,
            boards_seen: self.boards_seen,
            views_kept: self.views_kept,
            rejected: rejections(&self.rejected),
            collecting_s,
            coverage: self
                .coverage
                .clone()
                .try_into()
                .map_err(|e: DocumentError| e.inside("coverage"))?,
            guidance: self.guidance.clone().into(),
            estimate: estimate.map_err(|e| e.inside("estimate"))?,
            calibration: self.calibration.clone(),
        })
    }
}

/// Every session, newest first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionsDocument {
    /// Newest first.
    pub sessions: Vec<SessionDocument>,
    /// What the store cannot read any more, a line each; left out where there is nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unreadable: Vec<String>,
}

/// A view that a session kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionViewDocument {
    /// Its number in the session, from 0: its image is `…/views/{n}.jpg`.
    pub n: u32,
    /// The camera of a rig; left out for one camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// The frame set of a rig's session that the view belongs to, from 0; left out for one camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moment: Option<u32>,
    /// The frame's path or sequence number.
    pub name: String,
    /// When its frame was received; null for an image of a folder, which states no time.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub taken_at: Option<jiff::Timestamp>,
    /// How many corners were found.
    pub corners: u32,
    /// The corners in pixels, in the board's order.
    pub corners_px: Vec<[f64; 2]>,
    /// Which corner of the board each is: `[col, row]`.
    #[serde(default)]
    pub indices: Vec<[i32; 2]>,
    /// The number of each on a board with markers, as `plumb detect` has it; left out of others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ids: Option<Vec<u32>>,
    /// Whether the session's calibration uses it; null before there is one.
    pub used: Option<bool>,
    /// Why it is not used.
    pub reason: Option<String>,
    /// Its reprojection error in the session's calibration, in pixels.
    pub rms_px: Option<f64>,
    /// Residuals, measured minus projected, for each corner, in pixels. The projection uses the
    /// measured board shape and the board's motion during readout. Null before there is a
    /// calibration, for a view without a pose or without a board, and where a calibration with
    /// `rolling_shutter` has no `motion` for the view.
    pub residuals_px: Option<Vec<[f64; 2]>>,
    /// Where the board was, by the session's calibration.
    pub camera_from_board: Option<PoseDocument>,
    /// Where the scene was, by the session's calibration; without a board only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_from_scene: Option<PoseDocument>,
    /// Where its image is.
    #[serde(rename = "picture")]
    pub image: String,
}

/// The views of a session, in the order they were kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionViewsDocument {
    /// In the order they were kept.
    pub views: Vec<SessionViewDocument>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::reading::from_json;

    #[test]
    fn a_start_names_what_is_wrong() {
        let target = r#""target":{"kind":"chessboard","cols":9,"rows":6,"square_m":0.025}"#;
        let table = [
            ("{}".into(), "target: is missing"),
            (
                r#"{"target":{"kind":"chessboard","cols":9,"rows":6}}"#.into(),
                "target.square_m: is missing",
            ),
            (
                format!(r#"{{{target},"finish":{{"uncertainty_px":-1}}}}"#),
                "finish.uncertainty_px: -1 is not a valid goal; give a positive number",
            ),
            (
                format!(
                    r#"{{{target},"given":{{"left.depth":{{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":0}}}}}}"#
                ),
                "given.left.depth: is not the color lens of a camera of the rig; write it as `left.color`",
            ),
        ];
        for (json, expected) in table {
            let document = from_json::<StartDocument>(json.as_bytes());
            let request = document.and_then(|document| SessionRequest::try_from(&document));
            assert_eq!(request.unwrap_err().to_string(), expected);
        }
        let document: StartDocument = from_json(format!("{{{target}}}").as_bytes()).unwrap();
        let request = SessionRequest::try_from(&document).unwrap();
        assert_eq!(
            (request.lens, request.finish),
            (crate::estimation::problem::LensChoice::Auto, None)
        );
        assert_eq!(StartDocument::from(&request), document);
    }
}
