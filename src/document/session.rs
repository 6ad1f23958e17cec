//! The session document, and the request that starts one.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::calibration::UncertaintyDocument;
use crate::document::error::DocumentError;
use crate::document::lens::{LensDocument, LensRequest};
use crate::document::pose::PoseDocument;
use crate::document::target::TargetDocument;
use crate::geometry::board::Chessboard;

/// What starts a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionRequest {
    /// The board. There is no default: count its inner corners and measure a square.
    pub target: TargetDocument,
    /// The lens model to fit; `auto` when left out.
    #[serde(default)]
    pub lens: LensRequest,
    /// When to stop by itself; when left out it runs till it is stopped.
    #[serde(default)]
    pub finish: Option<FinishDocument>,
}

impl SessionRequest {
    /// Refuses a board or a goal that cannot be.
    ///
    /// # Errors
    /// [`DocumentError::Field`] naming the field.
    pub fn check(&self) -> Result<(), DocumentError> {
        Chessboard::try_from(self.target).map_err(|e| e.inside("target"))?;
        self.finish.unwrap_or_default().check().map_err(|e| e.inside("finish"))
    }
}

/// When a session stops by itself: as soon as the uncertainty is reached with enough views, or the time is over.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FinishDocument {
    /// The median predicted uncertainty to reach, in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty_px: Option<f64>,
    /// Not before so many views are kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_views: Option<u32>,
    /// Not later than so many seconds after its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_seconds: Option<f64>,
}

impl FinishDocument {
    /// Refuses a goal that cannot be reached.
    ///
    /// # Errors
    /// [`DocumentError::Field`] naming the field.
    pub fn check(&self) -> Result<(), DocumentError> {
        let positive = |field: &str, value: Option<f64>| match value {
            Some(value) if !(value.is_finite() && value > 0.0) => {
                Err(DocumentError::field(field, format!("{value} cannot be reached; give a positive number")))
            }
            _ => Ok(()),
        };
        positive("uncertainty_px", self.uncertainty_px)?;
        positive("max_seconds", self.max_seconds)
    }
}

/// Where a session stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SessionState {
    /// Looking for boards and keeping views.
    Collecting,
    /// Stopped, and computing the result.
    Solving,
    /// There is a calibration.
    Finished,
    /// There is none, and `reason` says why; the views stay.
    Failed,
    /// Given up by request.
    Aborted,
}

impl SessionState {
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

    /// Whether nothing more will happen to it.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Finished | Self::Failed | Self::Aborted)
    }
}

/// A calibration session: what was asked for, what has been gathered, what to do next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionDocument {
    /// Sortable by time.
    pub id: String,
    /// The camera's name.
    pub camera: String,
    /// Where it stands.
    pub state: SessionState,
    /// Why it failed, waits or was given up.
    pub reason: Option<String>,
    /// When it was started.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: jiff::Timestamp,
    /// When it was over.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<jiff::Timestamp>,
    /// The board.
    pub target: TargetDocument,
    /// The lens model asked for.
    pub lens: LensRequest,
    /// When it stops by itself; empty when it runs till it is stopped.
    pub finish: FinishDocument,
    /// Frames looked at.
    pub frames_seen: u64,
    /// Frames in which the board was found.
    pub boards_seen: u64,
    /// Views kept for the solve.
    pub views_kept: u64,
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
}

/// Where in the image corners have been seen.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct CoverageDocument {
    /// Part of the cells that hold corners, 0 to 1.
    pub fraction: f64,
    /// Corners kept in each cell: rows from the image's top, each from its left.
    pub cells: Vec<Vec<u32>>,
}

/// What the person with the board should do next.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct GuidanceDocument {
    /// In words.
    pub message: String,
    /// Where the board's outline should be, as corners of a polygon in pixels; empty when there is no such wish.
    pub outline_px: Vec<[f64; 2]>,
}

/// A running estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EstimateDocument {
    /// The lens.
    pub lens: LensDocument,
    /// Root mean square of the reprojection errors, in pixels.
    pub rms_px: f64,
    /// Predicted 1-σ reprojection uncertainty over the image.
    pub uncertainty_px: UncertaintyDocument,
}

/// Every session, newest first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionsDocument {
    /// Newest first.
    pub sessions: Vec<SessionDocument>,
}

/// A view that a session kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionViewDocument {
    /// Its number in the session, from 0: its picture is `…/views/{n}.jpg`.
    pub n: u32,
    /// The frame's path or sequence number.
    pub name: String,
    /// When its frame was received.
    #[schema(value_type = String, format = DateTime)]
    pub taken_at: jiff::Timestamp,
    /// How many corners were found.
    pub corners: u32,
    /// The corners in pixels, in the board's order.
    pub corners_px: Vec<[f64; 2]>,
    /// Whether the newest estimate uses it; null before there is one.
    pub used: Option<bool>,
    /// Why it is not used.
    pub reason: Option<String>,
    /// Its reprojection error in the newest estimate, in pixels.
    pub rms_px: Option<f64>,
    /// Where the board was, by the newest estimate.
    pub camera_from_board: Option<PoseDocument>,
    /// Where its picture is.
    pub picture: String,
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
            (r#"{"target":{"kind":"chessboard","cols":9,"rows":6}}"#.into(), "target.square_m: is missing"),
            (
                format!(r#"{{{target},"finish":{{"uncertainty_px":-1}}}}"#),
                "finish.uncertainty_px: -1 cannot be reached; give a positive number",
            ),
        ];
        for (json, expected) in table {
            let checked = from_json::<SessionRequest>(json.as_bytes()).and_then(|request| request.check());
            assert_eq!(checked.unwrap_err().to_string(), expected);
        }
        let request: SessionRequest = from_json(format!("{{{target}}}").as_bytes()).unwrap();
        assert_eq!((request.check(), request.lens, request.finish), (Ok(()), LensRequest::Auto, None));
    }
}
