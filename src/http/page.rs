//! The live web page: three files, embedded.

use std::sync::LazyLock;

use axum::http::header::{CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::IntoResponse;

use crate::geometry::lens::LensModel;
use crate::http::problem::Problem;
use crate::http::request::Address;

const STYLE: &str = include_str!("page/style.css");
const SCRIPT: &str = include_str!("page/script.js");

/// The page, with one option for each lens model.
static INDEX: LazyLock<String> = LazyLock::new(|| {
    let choice = |model: LensModel| {
        let (name, summary) = (model.name(), model.facts().summary);
        format!("<option value=\"{name}\">{name} ({summary})</option>")
    };
    let choices = LensModel::ALL.map(choice).join("\n          ");
    include_str!("page/index.html").replace("<!-- lens models -->", &choices)
});

/// Everything is loaded from this daemon, nothing from other sites.
const POLICY: &str =
    "default-src 'self'; img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'";

/// The page.
pub(super) async fn index() -> impl IntoResponse {
    (
        [(CONTENT_TYPE, "text/html; charset=utf-8"), (CONTENT_SECURITY_POLICY, POLICY)],
        INDEX.as_str(),
    )
}

/// The files that the page loads.
pub(super) async fn file(Address(name): Address<String>) -> Result<impl IntoResponse, Problem> {
    let (media_type, text) = match name.as_str() {
        "style.css" => ("text/css; charset=utf-8", STYLE),
        "script.js" => ("text/javascript; charset=utf-8", SCRIPT),
        _ => return Err(Problem::not_found(format!("the page has no part `{name}`"))),
    };
    Ok(([(CONTENT_TYPE, media_type)], text))
}
