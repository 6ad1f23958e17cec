//! Access control: requests are authorized by a token in a header, or by a browser session.

use std::sync::{Arc, RwLock};
use std::time::{Duration, Instant};

use axum::http::header::{AUTHORIZATION, COOKIE, LOCATION, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use tokio::sync::{Semaphore, watch};

use crate::http::browser_sessions::BrowserSessions;
use crate::http::problem::Problem;
use crate::http::tokens::{AccessTokens, TokenRole};
use crate::locks::{read, write};

/// How many wrong tokens may wait for their answer at once; further ones are refused without a
/// comparison.
const GUESSES: usize = 8;
/// The delay of the answer to a wrong token: with eight at once, 32 a second can be tried.
const GUESS_TIME: Duration = Duration::from_millis(250);

/// Who has access: the bearers of tokens, or everyone who can reach the address.
#[derive(Debug)]
pub struct Access {
    /// `None` gives everyone access, which is only allowed on a loopback address.
    tokens: RwLock<Option<Arc<AccessTokens>>>,
    sessions: BrowserSessions,
    /// All ports of a host share their cookies, so the name of the cookie contains the port.
    cookie_name: String,
    /// Whether TLS is used: then the cookie is sent over TLS only.
    is_secured: bool,
    guesses: Semaphore,
    /// Signals that the tokens were replaced.
    replaced: watch::Sender<()>,
}

impl Access {
    /// For a daemon that listens on `port`, with TLS if `is_secured`; without `tokens`, everyone
    /// has access.
    pub fn new(tokens: Option<AccessTokens>, port: u16, is_secured: bool) -> Self {
        Self {
            tokens: RwLock::new(tokens.map(Arc::new)),
            sessions: BrowserSessions::default(),
            cookie_name: format!("plumb_session_{port}"),
            is_secured,
            guesses: Semaphore::new(GUESSES),
            replaced: watch::Sender::new(()),
        }
    }

    /// Replaces the tokens. Browser sessions end with their token.
    pub fn replace(&self, tokens: Option<AccessTokens>) {
        *write(&self.tokens) = tokens.map(Arc::new);
        self.replaced.send_replace(());
    }

    /// Resolves when a client with these headers no longer has access.
    pub(super) async fn withdrawn(&self, headers: &HeaderMap) {
        let mut replaced = self.replaced.subscribe();
        loop {
            // Without tokens, everyone has access.
            let is_known =
                |tokens: Arc<AccessTokens>| matches!(self.bearer(&tokens, headers), Bearer::Of(_));
            if !self.tokens().is_none_or(is_known) {
                return;
            }
            // The sender is owned by `self`, so this cannot fail.
            let _ = replaced.changed().await;
        }
    }

    pub(super) fn tokens(&self) -> Option<Arc<AccessTokens>> {
        read(&self.tokens).clone()
    }

    /// The client that a request comes from, according to its headers.
    pub(super) fn bearer(&self, tokens: &AccessTokens, headers: &HeaderMap) -> Bearer {
        // The scheme's name is case-insensitive (RFC 9110, 11.1).
        let given = headers.get(AUTHORIZATION).and_then(|value| {
            let (scheme, token) = value.to_str().ok()?.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
        });
        if let Some(given) = given {
            return tokens.of_bearer(given).map_or(Bearer::Unknown, |token| Bearer::Of(token.role));
        }
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let number = cookies
            .flat_map(|cookies| cookies.split(';'))
            .find_map(|cookie| cookie.trim().strip_prefix(&self.cookie_name)?.strip_prefix('='));
        let token = number
            .and_then(|number| self.sessions.token_of(number, Instant::now()))
            .and_then(|hash| tokens.of_hash(hash));
        token.map_or(Bearer::None, |token| Bearer::Of(token.role))
    }

    /// Opens a browser session for the bearer of `given`, and redirects the browser to the page.
    pub(super) fn open_session(&self, tokens: &AccessTokens, given: &str) -> Option<Response> {
        let number = self.sessions.open(tokens.of_bearer(given)?.hash, Instant::now())?;
        let secure = if self.is_secured { "; Secure" } else { "" };
        let name = &self.cookie_name;
        let cookie = format!("{name}={number}; HttpOnly; SameSite=Strict; Path=/{secure}");
        let headers = [(LOCATION, "/".to_owned()), (SET_COOKIE, cookie)];
        Some((StatusCode::SEE_OTHER, headers).into_response())
    }

    /// The answer to a wrong token, after a delay; if too many wait already, at once.
    pub(super) async fn refuse_guess(&self) -> Problem {
        let Ok(_place) = self.guesses.try_acquire() else {
            return Problem::too_many("too many wrong tokens; wait a moment");
        };
        tokio::time::sleep(GUESS_TIME).await;
        Problem::unauthorized("unknown token; create one with `plumb token add`")
    }
}

/// The client that a request comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Bearer {
    /// The bearer of a token of this role.
    Of(TokenRole),
    /// A token that does not exist.
    Unknown,
    /// No token, or a browser session that has ended.
    None,
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt;

    use super::*;

    fn headers(pairs: &[(axum::http::HeaderName, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (name.clone(), value.parse().unwrap())).collect()
    }

    #[test]
    fn a_bearer_is_known_by_header_or_by_a_browsers_session() {
        let tokens = AccessTokens::parse("s3cret-token-of-the-test").unwrap();
        let access = Access::new(Some(tokens.clone()), 8600, false);
        let of = |pairs: &[(axum::http::HeaderName, &str)]| access.bearer(&tokens, &headers(pairs));
        let known = Bearer::Of(TokenRole::Approve);
        assert_eq!(of(&[(AUTHORIZATION, "Bearer s3cret-token-of-the-test")]), known);
        assert_eq!(of(&[(AUTHORIZATION, "bearer s3cret-token-of-the-test")]), known);
        for wrong in ["Bearer s3cret-token-of-the-tes", "Bearer x", "Bearer "] {
            assert_eq!(of(&[(AUTHORIZATION, wrong)]), Bearer::Unknown, "{wrong}");
        }
        for none in ["s3cret-token-of-the-test", "Basic s3cret-token-of-the-test"] {
            assert_eq!(of(&[(AUTHORIZATION, none)]), Bearer::None, "{none}");
        }
        let opened = access.open_session(&tokens, "s3cret-token-of-the-test").unwrap();
        let cookie = opened.headers()[SET_COOKIE].to_str().unwrap();
        assert!(!cookie.contains("s3cret"), "{cookie}");
        assert!(cookie.ends_with("; HttpOnly; SameSite=Strict; Path=/"), "{cookie}");
        let (number, _) = cookie.split_once(';').unwrap();
        assert_eq!(of(&[(COOKIE, &format!("a=b; {number}"))]), known);
        assert_eq!(of(&[(COOKIE, &number.replace("8600", "8601"))]), Bearer::None, "other port");
        assert_eq!(of(&[(COOKIE, "plumb_session_8600=s3cret-token-of-the-test")]), Bearer::None);
        assert!(access.open_session(&tokens, "another").is_none());
        // The token is revoked.
        let others = AccessTokens::parse("another-t0ken-of-the-test").unwrap();
        assert_eq!(access.bearer(&others, &headers(&[(COOKIE, number)])), Bearer::None);
    }

    #[tokio::test]
    async fn a_stream_ends_with_the_token_that_it_was_asked_for_with() {
        let tokens = |text: &str| Some(AccessTokens::parse(text).unwrap());
        let access = Access::new(tokens("s3cret-token-of-the-test"), 8600, false);
        let asked = headers(&[(AUTHORIZATION, "Bearer s3cret-token-of-the-test")]);
        let mut watching = std::pin::pin!(access.withdrawn(&asked));
        assert!(watching.as_mut().now_or_never().is_none());
        access.replace(tokens("s3cret-token-of-the-test"));
        assert!(watching.as_mut().now_or_never().is_none(), "it is good still");
        access.replace(tokens("another-t0ken-of-the-test"));
        assert!(watching.as_mut().now_or_never().is_some());
    }

    #[tokio::test]
    async fn wrong_tokens_are_not_answered_all_at_once() {
        let access = Access::new(None, 8600, false);
        let places: Vec<_> = (0..GUESSES).map(|_| access.guesses.try_acquire().unwrap()).collect();
        assert_eq!(access.refuse_guess().await.status(), 429);
        drop(places);
        assert_eq!(access.refuse_guess().await.status(), 401);
    }
}
