//! The parts of a request: its address, its query, its body. Each error is a [`Problem`].

use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequestParts, Path, Query, Request};
use axum::http::header::CONTENT_TYPE;
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode};
use serde::de::DeserializeOwned;

use crate::document::reading::from_json;
use crate::http::bodies::body;
use crate::http::problem::Problem;

/// The largest body of an ordinary request, in bytes.
pub(super) const SMALL_BODY: usize = 1 << 20;

/// The variable parts of the address, decoded.
pub(super) struct Address<T>(pub(super) T);

impl<T, S> FromRequestParts<S> for Address<T>
where
    T: DeserializeOwned + Send,
    S: Send + Sync,
{
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let refused =
            |error: PathRejection| Problem::not_found(format!("no such address: {error}"));
        Path::from_request_parts(parts, state).await.map(|Path(parts)| Self(parts)).map_err(refused)
    }
}

/// The query's parameters; unknown ones are ignored.
#[cfg_attr(test, derive(Default))]
pub(super) struct Parameters(Vec<(String, String)>);

impl<S: Send + Sync> FromRequestParts<S> for Parameters {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let Query(pairs) = Query::from_request_parts(parts, state).await.map_err(|error| {
            Problem::new(StatusCode::BAD_REQUEST, format!("the query cannot be read: {error}"))
        })?;
        Ok(Self(pairs))
    }
}

/// A query that a struct describes in the API's document and that is parsed into the same struct,
/// so that the two agree.
pub(super) trait ReadQuery: Sized {
    /// # Errors
    /// 422 that names the parameter whose value is invalid.
    fn read(parameters: &Parameters) -> Result<Self, Problem>;
}

/// The parsed query.
pub(super) struct Asked<T>(pub(super) T);

impl<T: ReadQuery, S: Send + Sync> FromRequestParts<S> for Asked<T> {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let parameters = Parameters::from_request_parts(parts, state).await?;
        T::read(&parameters).map(Self)
    }
}

/// The value `given` for `name`, which must be one of `known`.
pub(super) fn known_name(name: &str, given: Option<&str>, known: &[String]) -> Result<(), Problem> {
    match given {
        Some(given) if !known.iter().any(|known| known == given) => {
            Err(unknown(name, given, &known.join(", ")))
        }
        _ => Ok(()),
    }
}

fn unknown(name: &str, given: &str, known: &str) -> Problem {
    Problem::field(name, &format!("`{given}` is not known; give one of {known}"))
}

impl Parameters {
    /// The last value given for `name`.
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.0.iter().rev().find(|(given, _)| given == name).map(|(_, value)| value.as_str())
    }

    /// `name` as true or false.
    pub(super) fn flag(&self, name: &str) -> Result<Option<bool>, Problem> {
        match self.text(name) {
            None => Ok(None),
            Some("true" | "1" | "") => Ok(Some(true)),
            Some("false" | "0") => Ok(Some(false)),
            Some(other) => {
                Err(Problem::field(name, &format!("`{other}` is neither true nor false")))
            }
        }
    }

    /// `name` as a positive number.
    pub(super) fn positive(&self, name: &str) -> Result<Option<f64>, Problem> {
        let number = |text: &str| {
            text.parse().ok().filter(|number: &f64| number.is_finite() && *number > 0.0)
        };
        let wrong =
            |text: &str| Problem::field(name, &format!("`{text}` is not a positive number"));
        self.text(name).map(|text| number(text).ok_or_else(|| wrong(text))).transpose()
    }

    /// `name` as a positive number from `least` to `most`.
    pub(super) fn within(
        &self,
        name: &str,
        [least, most]: [f64; 2],
    ) -> Result<Option<f64>, Problem> {
        match self.positive(name)? {
            Some(number) if !(least..=most).contains(&number) => {
                let problem = format!("{number} is out of range; give {least} to {most}");
                Err(Problem::field(name, &problem))
            }
            number => Ok(number),
        }
    }

    /// `name` as a number from 0 to 1.
    pub(super) fn fraction(&self, name: &str) -> Result<Option<f64>, Problem> {
        let number =
            |text: &str| text.parse().ok().filter(|number: &f64| (0.0..=1.0).contains(number));
        let wrong =
            |text: &str| Problem::field(name, &format!("`{text}` is not a number from 0 to 1"));
        self.text(name).map(|text| number(text).ok_or_else(|| wrong(text))).transpose()
    }

    /// `name` as a count of at least 1.
    pub(super) fn count(&self, name: &str) -> Result<Option<u32>, Problem> {
        let count = |text: &str| text.parse().ok().filter(|count: &u32| *count > 0);
        let wrong = |text: &str| {
            Problem::field(name, &format!("`{text}` is not a whole number of at least 1"))
        };
        self.text(name).map(|text| count(text).ok_or_else(|| wrong(text))).transpose()
    }

    /// `name` as one of several names.
    pub(super) fn one_of<T>(
        &self,
        name: &str,
        from_name: impl Fn(&str) -> Option<T>,
        known: &str,
    ) -> Result<Option<T>, Problem> {
        let read = |given| from_name(given).ok_or_else(|| unknown(name, given, known));
        self.text(name).map(read).transpose()
    }
}

/// The error responses that are common to all routes with a JSON body.
#[derive(utoipa::IntoResponses)]
#[expect(dead_code, reason = "describes what `document` answers")]
pub(super) enum BodyRefusals {
    /// not JSON
    #[response(status = 400, content_type = "application/problem+json")]
    Syntax(Problem),
    /// it did not arrive within a minute, or nothing of it for ten seconds
    #[response(status = 408, content_type = "application/problem+json")]
    Slow(Problem),
    /// too large
    #[response(status = 413, content_type = "application/problem+json")]
    Large(Problem),
    /// another media type than JSON
    #[response(status = 415, content_type = "application/problem+json")]
    MediaType(Problem),
}

/// Reads the body as a document of at most `limit` bytes.
///
/// # Errors
/// 415 for another media type than JSON, 413 for more than `limit`, 408 for one that does not
/// arrive in time, 400 for a body that is not JSON, 422 for a field with an invalid value.
pub(super) async fn document<T: DeserializeOwned>(
    request: Request,
    limit: usize,
) -> Result<T, Problem> {
    json_only(request.headers())?;
    let body = body(request, limit, None).await?;
    parsed(&body.bytes)
}

/// Parses a body as a document.
///
/// # Errors
/// 400 for a body that is not JSON, 422 for a field with an invalid value.
pub(super) fn parsed<T: DeserializeOwned>(body: &[u8]) -> Result<T, Problem> {
    Ok(from_json(body)?)
}

/// # Errors
/// 415 for a body that says to be something else.
pub(super) fn json_only(headers: &HeaderMap) -> Result<(), Problem> {
    let Some(given) = headers.get(CONTENT_TYPE) else { return Ok(()) };
    let given = String::from_utf8_lossy(given.as_bytes());
    let essence = given.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    if essence == "application/json"
        || (essence.starts_with("application/") && essence.ends_with("+json"))
    {
        return Ok(());
    }
    let detail = format!(
        "the body is `{given}`; send JSON with the header `Content-Type: application/json`"
    );
    Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, detail))
}
