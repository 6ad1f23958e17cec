//! Browser sessions: a browser sends the number of its session in a cookie, instead of a token.

use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use crate::http::tokens::TokenHash;
use crate::locks::lock;

/// How many sessions may be open at once: one for each browser that opened the page. A new one
/// replaces the oldest.
const MOST: usize = 256;
/// How long a session lasts: one week.
const LASTS: Duration = Duration::from_secs(7 * 24 * 3600);

/// The open sessions of browsers. They end with the daemon, and with their token.
#[derive(Debug, Default)]
pub(super) struct BrowserSessions(Mutex<Vec<BrowserSession>>);

#[derive(Debug)]
struct BrowserSession {
    number: String,
    token: TokenHash,
    since: Instant,
}

impl BrowserSessions {
    /// Opens a session of the bearer of `token`. Returns its number, or `None` where the system has
    /// no random numbers.
    pub(super) fn open(&self, token: TokenHash, now: Instant) -> Option<String> {
        let mut random = [0_u8; 32];
        getrandom::fill(&mut random).ok()?;
        let number: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
        let mut sessions = self.lock();
        sessions.retain(|session| now.saturating_duration_since(session.since) < LASTS);
        if sessions.len() >= MOST {
            sessions.remove(0);
        }
        sessions.push(BrowserSession { number: number.clone(), token, since: now });
        Some(number)
    }

    /// The token that the session belongs to.
    pub(super) fn token_of(&self, number: &str, now: Instant) -> Option<TokenHash> {
        let sessions = self.lock();
        let session = sessions.iter().find(|session| is_same(&session.number, number))?;
        (now.saturating_duration_since(session.since) < LASTS).then_some(session.token)
    }

    fn lock(&self) -> MutexGuard<'_, Vec<BrowserSession>> {
        lock(&self.0)
    }
}

/// Compares in a time that does not depend on how much is equal.
fn is_same(one: &str, other: &str) -> bool {
    let (one, other) = (one.as_bytes(), other.as_bytes());
    one.len() == other.len()
        && one.iter().zip(other).fold(0, |difference, (a, b)| difference | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_belongs_to_its_token_for_a_week() {
        let sessions = BrowserSessions::default();
        let (token, now) = (TokenHash::of("token"), Instant::now());
        let number = sessions.open(token, now).unwrap();
        assert_eq!(number.len(), 64);
        assert_eq!(sessions.token_of(&number, now + LASTS / 2), Some(token));
        assert_eq!(sessions.token_of(&number, now + LASTS), None);
        assert_eq!(sessions.token_of(&number[1..], now), None);
        assert_ne!(sessions.open(token, now).unwrap(), number);
    }

    #[test]
    fn the_oldest_makes_room() {
        let sessions = BrowserSessions::default();
        let now = Instant::now();
        let first = sessions.open(TokenHash::of("first"), now).unwrap();
        for _ in 1..MOST {
            sessions.open(TokenHash::of("others"), now).unwrap();
        }
        assert!(sessions.token_of(&first, now).is_some());
        sessions.open(TokenHash::of("last"), now).unwrap();
        assert!(sessions.token_of(&first, now).is_none());
    }
}
