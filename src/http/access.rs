//! Who may ask: with a token, who knows it; without one, only this machine, and no page of another
//! site in its browser.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, COOKIE, HOST, LOCATION, ORIGIN, SET_COOKIE};
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::http::problem::Problem;
use crate::http::shared::Shared;

/// The cookie that a browser carries the token in.
const COOKIE_NAME: &str = "plumb_token";

/// Lets a request through, or refuses it.
pub(super) async fn check(
    State(shared): State<Arc<Shared>>,
    request: Request,
    next: Next,
) -> Response {
    let path = request.uri().path();
    if path == "/healthz" {
        return next.run(request).await;
    }
    if let Err(problem) = same_site(request.method(), request.headers(), shared.token.is_some()) {
        return problem.into_response();
    }
    let Some(token) = &shared.token else { return next.run(request).await };
    if path == "/" && query_token(request.uri()).is_some_and(|given| is_same(given, token)) {
        return with_cookie(token);
    }
    if carries(request.headers(), token) {
        return next.run(request).await;
    }
    let detail =
        "a token is needed: send `Authorization: Bearer TOKEN`, or open /?token=TOKEN in a browser";
    Problem::unauthorized(detail).into_response()
}

/// Refuses what a page of another site sends: by its `Origin` for requests that change something,
/// and by a `Host` that is a foreign name where no token protects (a foreign name that was made to
/// point here).
fn same_site(method: &Method, headers: &HeaderMap, has_token: bool) -> Result<(), Problem> {
    // RFC 9112, 3.2: none, or several, are answered by 400.
    if headers.get_all(HOST).iter().count() != 1 {
        return Err(Problem::new(StatusCode::BAD_REQUEST, "one `Host` header is needed; send one"));
    }
    let host = headers.get(HOST).and_then(|host| host.to_str().ok());
    if !has_token && host.is_some_and(|host| !is_local(host)) {
        let detail = "this daemon answers to localhost or an IP address only; use one of these in the address";
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
    Err(Problem::new(StatusCode::FORBIDDEN, "a page of another site may not change anything here"))
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

fn carries(headers: &HeaderMap, token: &str) -> bool {
    // The scheme's name is the same in any case (RFC 9110, 11.1).
    let bearer = headers.get(AUTHORIZATION).and_then(|value| {
        let (scheme, token) = value.to_str().ok()?.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then_some(token)
    });
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let cookie = cookies
        .flat_map(|cookies| cookies.split(';'))
        .find_map(|cookie| cookie.trim().strip_prefix(COOKIE_NAME)?.strip_prefix('='));
    bearer.into_iter().chain(cookie).any(|given| is_same(given.trim(), token))
}

fn query_token(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("token="))
}

fn with_cookie(token: &str) -> Response {
    let cookie = format!("{COOKIE_NAME}={token}; HttpOnly; SameSite=Strict; Path=/");
    (StatusCode::SEE_OTHER, [(LOCATION, "/".to_owned()), (SET_COOKIE, cookie)]).into_response()
}

/// Compares in a time that does not reveal how much was right.
fn is_same(given: &str, token: &str) -> bool {
    let (given, token) = (given.as_bytes(), token.as_bytes());
    given.len() == token.len()
        && given.iter().zip(token).fold(0, |difference, (a, b)| difference | (a ^ b)) == 0
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

    #[test]
    fn the_token_is_carried_by_header_or_cookie() {
        assert!(carries(&headers(&[(AUTHORIZATION, "Bearer s3cret")]), "s3cret"));
        assert!(carries(&headers(&[(AUTHORIZATION, "bearer s3cret")]), "s3cret"));
        assert!(carries(&headers(&[(COOKIE, "a=b; plumb_token=s3cret")]), "s3cret"));
        for wrong in ["Bearer s3cre", "Bearer s3cretx", "Bearer ", "s3cret", "Basic s3cret"] {
            assert!(!carries(&headers(&[(AUTHORIZATION, wrong)]), "s3cret"), "{wrong}");
        }
        assert!(!carries(&headers(&[(COOKIE, "plumb_tokens3cret; plumb_token=")]), "s3cret"));
    }
}
