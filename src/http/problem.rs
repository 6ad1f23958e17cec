//! Errors as RFC 9457 `application/problem+json`, each with a `detail` that states what to do.

use axum::http::header::{ALLOW, CONTENT_TYPE, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use crate::document::error::DocumentError;
use crate::document::reading::to_json;
use crate::pipeline::fleet_error::ApproveError;
use crate::pipeline::preview::error::PreviewError;
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::unknown::{UnknownCamera, UnknownRig};
use crate::store::StoreError;

/// Why a request was refused.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Problem {
    /// Always `about:blank`: the status says which kind it is.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The status in words.
    title: &'static str,
    /// The HTTP status.
    status: u16,
    /// What was wrong and what to do.
    detail: String,
    /// The invalid field of the request, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    field: Option<String>,
    #[serde(skip)]
    header: Option<Box<(HeaderName, HeaderValue)>>,
}

impl Problem {
    /// An error with this status.
    pub fn new(status: StatusCode, detail: impl Into<String>) -> Self {
        Self {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Problem"),
            status: status.as_u16(),
            detail: detail.into(),
            field: None,
            header: None,
        }
    }

    /// 404: not found.
    pub fn not_found(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, detail)
    }

    /// 409: not possible in the present state.
    pub fn conflict(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, detail)
    }

    /// 422: a field of the request has an invalid value.
    pub fn field(field: &str, problem: &str) -> Self {
        let refusal = Self::new(StatusCode::UNPROCESSABLE_ENTITY, format!("{field}: {problem}"));
        Self { field: Some(field.to_owned()), ..refusal }
    }

    /// 500: a fault of the daemon itself.
    pub fn broken(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, detail)
    }

    /// 503: not possible at present.
    pub fn unavailable(detail: impl Into<String>) -> Self {
        let refusal = Self::new(StatusCode::SERVICE_UNAVAILABLE, detail);
        Self { header: Some(Box::new((RETRY_AFTER, HeaderValue::from_static("1")))), ..refusal }
    }

    /// 429: too many requests.
    pub fn too_many(detail: impl Into<String>) -> Self {
        let refusal = Self::new(StatusCode::TOO_MANY_REQUESTS, detail);
        Self { header: Some(Box::new((RETRY_AFTER, HeaderValue::from_static("1")))), ..refusal }
    }

    /// 401: no token, or an unknown one.
    pub fn unauthorized(detail: impl Into<String>) -> Self {
        let refusal = Self::new(StatusCode::UNAUTHORIZED, detail);
        Self {
            header: Some(Box::new((WWW_AUTHENTICATE, HeaderValue::from_static("Bearer")))),
            ..refusal
        }
    }

    /// 405: not possible with this method, only with the `allowed` ones.
    pub fn method_not_allowed(detail: impl Into<String>, allowed: Option<HeaderValue>) -> Self {
        let refusal = Self::new(StatusCode::METHOD_NOT_ALLOWED, detail);
        Self { header: allowed.map(|allowed| Box::new((ALLOW, allowed))), ..refusal }
    }

    /// The status of the answer.
    pub fn status(&self) -> u16 {
        self.status
    }

    /// The field with the invalid value, if there is one.
    pub fn field_name(&self) -> Option<&str> {
        self.field.as_deref()
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        if status.is_server_error() {
            tracing::warn!(status = self.status, detail = self.detail, "a request failed");
        }
        let body = to_json(&self).unwrap_or_default();
        let mut response =
            (status, [(CONTENT_TYPE, "application/problem+json")], body).into_response();
        if let Some(header) = self.header {
            response.headers_mut().insert(header.0, header.1);
        }
        response
    }
}

impl From<DocumentError> for Problem {
    /// 400 for a body that is not JSON, 422 for a field.
    fn from(error: DocumentError) -> Self {
        match &error {
            DocumentError::Syntax { .. } => Self::new(StatusCode::BAD_REQUEST, error.to_string()),
            DocumentError::Field { field, problem } => Self::field(field, problem),
        }
    }
}

impl From<UnknownRig> for Problem {
    fn from(error: UnknownRig) -> Self {
        Self::not_found(error.to_string())
    }
}

impl From<UnknownCamera> for Problem {
    fn from(error: UnknownCamera) -> Self {
        Self::not_found(error.to_string())
    }
}

impl From<PreviewError> for Problem {
    fn from(error: PreviewError) -> Self {
        match error {
            PreviewError::UnknownCamera(_) | PreviewError::UnknownSensor { .. } => {
                Self::not_found(error.to_string())
            }
            PreviewError::Store(error) => error.into(),
            _ => Self::conflict(error.to_string()),
        }
    }
}

impl From<ApproveError> for Problem {
    fn from(error: ApproveError) -> Self {
        match error {
            ApproveError::UnknownCalibration { .. } | ApproveError::NotConfigured { .. } => {
                Self::not_found(error.to_string())
            }
            ApproveError::NoCamera { .. } => Self::conflict(error.to_string()),
            ApproveError::Store(error) => error.into(),
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Missing { .. } => Self::not_found(error.to_string()),
            StoreError::Held { .. } => Self::conflict(error.to_string()),
            _ => Self::broken(error.to_string()),
        }
    }
}

impl From<StartError> for Problem {
    fn from(error: StartError) -> Self {
        let detail = error.to_string();
        match error {
            StartError::UnknownCamera { .. } | StartError::UnknownRig { .. } => {
                Self::not_found(detail)
            }
            StartError::Busy { .. } => Self::conflict(detail),
            StartError::Store { .. } => Self::unavailable(detail),
            StartError::Stopping => Self::unavailable(detail),
        }
    }
}

impl From<EndError> for Problem {
    fn from(error: EndError) -> Self {
        let detail = error.to_string();
        match error {
            EndError::UnknownSession { .. } => Self::not_found(detail),
            EndError::Over { .. } | EndError::NotConfigured { .. } => Self::conflict(detail),
            EndError::Store { .. } => Self::unavailable(detail),
            EndError::Stopping => Self::unavailable(detail),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::session_request::EndError;

    #[tokio::test]
    async fn a_problem_is_what_the_standard_says() {
        let response = Problem::field("finish.min_views", "-1 is too few").into_response();
        assert_eq!(response.status(), StatusCode::UNPROCESSABLE_ENTITY);
        assert_eq!(response.headers()[CONTENT_TYPE], "application/problem+json");
        let body = axum::body::to_bytes(response.into_body(), 10_000).await.unwrap();
        let expected = r#"{"type":"about:blank","title":"Unprocessable Entity","status":422,"detail":"finish.min_views: -1 is too few","field":"finish.min_views"}"#;
        assert_eq!(String::from_utf8_lossy(&body), expected);
    }

    #[test]
    fn refusals_have_the_contract_s_statuses() {
        let camera = || "front".to_owned();
        let session = || "s1".to_owned();
        let table = [
            (Problem::from(StartError::UnknownCamera { camera: camera() }), 404),
            (StartError::Busy { camera: camera(), session: session() }.into(), 409),
            (StartError::Stopping.into(), 503),
            (EndError::UnknownSession { id: session() }.into(), 404),
            (
                EndError::Over {
                    id: session(),
                    state: crate::calibration::session_record::SessionState::Failed,
                }
                .into(),
                409,
            ),
            (DocumentError::Syntax { line: 1, column: 1, problem: "x".into() }.into(), 400),
            (DocumentError::field("target", "is missing").into(), 422),
            (StoreError::Missing { row: "calibration c1".into() }.into(), 404),
        ];
        for (problem, status) in table {
            assert_eq!(problem.status, status, "{problem:?}");
            assert!(!problem.detail.is_empty());
        }
    }
}
