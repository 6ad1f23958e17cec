//! Checks every request. With tokens, it must come from the bearer of one whose role is sufficient.
//! Without tokens, it must come from this machine, and not from another site's page in its browser.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::http::access::Bearer;
use crate::http::problem::Problem;
use crate::http::shared::Shared;
use crate::http::tokens::TokenRole;

/// Passes a request on, or refuses it.
pub(super) async fn check(
    State(shared): State<Arc<Shared>>,
    request: Request,
    next: Next,
) -> Response {
    let path = request.uri().path();
    if path == "/healthz" {
        return next.run(request).await;
    }
    let access = &shared.access;
    let tokens = access.tokens();
    if let Err(problem) = same_site(request.method(), request.headers(), tokens.is_some()) {
        return problem.into_response();
    }
    let Some(tokens) = tokens else { return next.run(request).await };
    if path == "/"
        && let Some(given) = query_token(request.uri())
    {
        return match access.open_session(&tokens, given) {
            Some(response) => response,
            None => access.refuse_guess().await.into_response(),
        };
    }
    let needed = TokenRole::needed(request.method(), path);
    match access.bearer(&tokens, request.headers()) {
        Bearer::Of(role) if role >= needed => next.run(request).await,
        Bearer::Of(role) => {
            let (role, needed) = (role.name(), needed.name());
            let detail = format!("this token's role is `{role}`; `{needed}` is needed for this");
            Problem::new(StatusCode::FORBIDDEN, detail).into_response()
        }
        Bearer::Unknown => access.refuse_guess().await.into_response(),
        Bearer::None => {
            let detail = "a token is needed: send `Authorization: Bearer TOKEN`, or open /?token=TOKEN in a browser";
            Problem::unauthorized(detail).into_response()
        }
    }
}

/// Refuses requests from pages of other sites: by `Origin` if the request changes something; and,
/// where no token is required, by a `Host` that is not local, because another site's name may have
/// been made to resolve to this address (DNS rebinding).
fn same_site(method: &Method, headers: &HeaderMap, has_token: bool) -> Result<(), Problem> {
    // RFC 9112, 3.2: a request with no `Host`, or several, is answered with 400.
    if headers.get_all(HOST).iter().count() != 1 {
        return Err(Problem::new(StatusCode::BAD_REQUEST, "one `Host` header is needed; send one"));
    }
    let host = headers.get(HOST).and_then(|host| host.to_str().ok());
    if !has_token && host.is_some_and(|host| !is_local(host)) {
        let detail = "without a token, this daemon accepts only localhost or an IP address as its host name; use one of these in the URL";
        return Err(Problem::new(StatusCode::MISDIRECTED_REQUEST, detail));
    }
    if matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS) {
        return Ok(());
    }
    let Some(origin) = headers.get(ORIGIN) else { return Ok(()) };
    let origin_host =
        origin.to_str().ok().and_then(|origin| origin.split_once("://")).map(|(_, host)| host);
    if origin_host.is_some() && origin_host == host {
        return Ok(());
    }
    Err(Problem::new(StatusCode::FORBIDDEN, "cross-site requests that change state are refused"))
}

fn is_local(host: &str) -> bool {
    let without_port = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    let name = without_port.trim_start_matches('[').trim_end_matches(']');
    name.eq_ignore_ascii_case("localhost")
        || name.ends_with(".localhost")
        || name.parse::<IpAddr>().is_ok()
}

fn query_token(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("token="))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(axum::http::HeaderName, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (name.clone(), value.parse().unwrap())).collect()
    }

    #[test]
    fn a_foreign_page_may_not_change_anything() {
        let table = [
            (Method::POST, "localhost:8600", None, true),
            (Method::POST, "localhost:8600", Some("http://localhost:8600"), true),
            (Method::POST, "localhost:8600", Some("http://evil.example"), false),
            (Method::POST, "localhost:8600", Some("null"), false),
            (Method::DELETE, "127.0.0.1:8600", Some("http://localhost:8600"), false),
            (Method::GET, "[::1]:8600", Some("http://evil.example"), true),
            (Method::GET, "evil.example", None, false),
            (Method::GET, "localhost.evil.example:8600", None, false),
            (Method::GET, "192.168.0.7", None, true),
        ];
        for (method, host, origin, let_in) in table {
            let mut headers = headers(&[(HOST, host)]);
            if let Some(origin) = origin {
                headers.insert(ORIGIN, origin.parse().unwrap());
            }
            assert_eq!(
                same_site(&method, &headers, false).is_ok(),
                let_in,
                "{method} {host} {origin:?}"
            );
        }
        assert!(same_site(&Method::GET, &headers(&[(HOST, "robot.example")]), true).is_ok());
        let mut twice = headers(&[(HOST, "localhost")]);
        twice.append(HOST, "localhost".parse().unwrap());
        for wrong in [HeaderMap::new(), twice] {
            let problem = same_site(&Method::GET, &wrong, false).unwrap_err();
            assert!(format!("{problem:?}").contains("one `Host` header is needed"), "{problem:?}");
        }
    }
}
