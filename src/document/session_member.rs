//! What one camera of a rig contributes to a session.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::session_record::{RunningEstimate, SessionMember};
use crate::document::error::DocumentError;
use crate::document::session_progress::{
    CoverageDocument, EstimateDocument, GuidanceDocument, is_finite, rejected_counts, rejections,
};

/// What one camera of a rig contributes to a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionMemberDocument {
    /// The camera's name.
    pub camera: String,
    /// Frames searched.
    pub frames_seen: u64,
    /// Frames in which the board was found.
    pub boards_seen: u64,
    /// Views kept for the solve.
    pub views_kept: u32,
    /// Kept views whose frame set also has a kept view of another camera.
    pub views_shared: u32,
    /// Frames not kept, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Where in its image corners have been seen.
    pub coverage: CoverageDocument,
    /// What the person with the board should do next for it.
    pub guidance: GuidanceDocument,
    /// The estimate from its views so far; null before the first.
    pub estimate: Option<EstimateDocument>,
}

impl From<&SessionMember> for SessionMemberDocument {
    fn from(member: &SessionMember) -> Self {
        Self {
            camera: member.camera.clone(),
            frames_seen: member.frames_seen,
            boards_seen: member.boards_seen,
            views_kept: member.views_kept,
            views_shared: member.views_shared,
            rejected: rejected_counts(&member.rejected),
            coverage: (&member.coverage).into(),
            guidance: (&member.guidance).into(),
            estimate: member
                .estimate
                .as_ref()
                .filter(|estimate| is_finite(estimate))
                .map(EstimateDocument::from),
        }
    }
}

impl TryFrom<&SessionMemberDocument> for SessionMember {
    type Error = DocumentError;
    fn try_from(document: &SessionMemberDocument) -> Result<Self, DocumentError> {
        let estimate = document.estimate.as_ref().map(RunningEstimate::try_from).transpose();
        Ok(Self {
            camera: document.camera.clone(),
            frames_seen: document.frames_seen,
            boards_seen: document.boards_seen,
            views_kept: document.views_kept,
            views_shared: document.views_shared,
            rejected: rejections(&document.rejected),
            coverage: document
                .coverage
                .clone()
                .try_into()
                .map_err(|e: DocumentError| e.inside("coverage"))?,
            guidance: document.guidance.clone().into(),
            estimate: estimate.map_err(|e| e.inside("estimate"))?,
        })
    }
}
