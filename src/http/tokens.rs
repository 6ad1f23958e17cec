//! Access tokens: who may do what. They are stored as hashes, in a file with one line for each.
//!
//! ```text
//! # name     role     hash of the token
//! tablet     operate  sha256:9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08
//! dashboard  view     sha256:…
//! ```
//!
//! `plumb token` writes such lines. A file whose first line is a single word is one token in plain
//! text, with every right.

use std::fmt;

use axum::http::Method;
use sha2::{Digest, Sha256};

/// What a token allows, from least to most.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum TokenRole {
    /// To read everything and to change nothing.
    View,
    /// Also to run and delete sessions and recordings.
    Operate,
    /// Also to approve and delete calibrations.
    Approve,
}

impl TokenRole {
    /// All roles, from least to most.
    pub const ALL: [Self; 3] = [Self::View, Self::Operate, Self::Approve];

    /// Its name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Operate => "operate",
            Self::Approve => "approve",
        }
    }

    /// The role with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.name() == name)
    }

    /// The least role that a request needs.
    pub(super) fn needed(method: &Method, path: &str) -> Self {
        let of_calibration = path.starts_with("/v1/calibrations/");
        match *method {
            Method::GET | Method::HEAD | Method::OPTIONS => Self::View,
            Method::POST if of_calibration && path.ends_with("/approve") => Self::Approve,
            Method::DELETE if of_calibration => Self::Approve,
            _ => Self::Operate,
        }
    }
}

/// SHA-256 of a token.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct TokenHash([u8; 32]);

impl TokenHash {
    pub(super) fn of(token: &str) -> Self {
        Self(Sha256::digest(token.as_bytes()).into())
    }

    fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix("sha256:")?;
        if digits.len() != 64 || !digits.is_ascii() {
            return None;
        }
        let mut hash = [0; 32];
        for (byte, at) in hash.iter_mut().zip((0..64).step_by(2)) {
            *byte = u8::from_str_radix(&digits[at..at + 2], 16).ok()?;
        }
        Some(Self(hash))
    }
}

impl fmt::Display for TokenHash {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("sha256:")?;
        self.0.iter().try_for_each(|byte| write!(out, "{byte:02x}"))
    }
}

impl fmt::Debug for TokenHash {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("sha256:…")
    }
}

/// A token that grants access to its bearer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AccessToken {
    /// The name of its bearer.
    pub name: String,
    /// What it allows.
    pub role: TokenRole,
    pub(super) hash: TokenHash,
}

impl AccessToken {
    /// The token `token` of the bearer `name`.
    pub fn new(name: &str, role: TokenRole, token: &str) -> Self {
        Self { name: name.to_owned(), role, hash: TokenHash::of(token) }
    }
}

impl fmt::Display for AccessToken {
    /// Writes it as a line of the file.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} {} {}", self.name, self.role.name(), self.hash)
    }
}

/// Why a file of tokens, or a token, cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TokenError {
    /// The file is empty.
    #[error("it is empty; `plumb token add` makes a token")]
    Empty,
    /// A line of another form.
    #[error(
        "line {line} is not `NAME ROLE sha256:HASH`, with the role view, operate or approve; `plumb token add` writes such lines"
    )]
    Line {
        /// The line's number, from 1.
        line: usize,
    },
    /// A name that occurs twice.
    #[error("line {line}: `{name}` has a token already; revoke one of the two")]
    NameTwice {
        /// The line's number, from 1.
        line: usize,
        /// The name.
        name: String,
    },
    /// A token that can be guessed.
    #[error(
        "the token can be guessed: at least {LEAST_BITS} bits of entropy are needed, this has at most {bits:.0}; `plumb token add` makes one"
    )]
    Guessable {
        /// The largest entropy that a token of this length and these kinds of characters can have.
        bits: f64,
    },
    /// A character that is not allowed in a header, a cookie or an address.
    #[error(
        "the token's character `{character}` is not allowed in an HTTP header; use letters, digits and -._~ (RFC 6750)"
    )]
    Character {
        /// The first such character.
        character: char,
    },
}

/// The least entropy of a token, in bits: it cannot be guessed in any time (NIST SP 800-63B demands
/// 64 of secrets that are tried online; a session's cookie is expected to have 128).
const LEAST_BITS: f64 = 128.0;

/// With fewer different characters than this, they alone are taken as the alphabet.
const FEW_CHARACTERS: usize = 8;

/// The tokens of one file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct AccessTokens(Vec<AccessToken>);

impl AccessTokens {
    /// Reads the content of a file. If it contains only comments because all tokens were revoked,
    /// nobody gets access.
    ///
    /// # Errors
    /// [`TokenError`] for the first line that is invalid, and for a plain token that can be
    /// guessed.
    pub fn parse(text: &str) -> Result<Self, TokenError> {
        if text.trim().is_empty() {
            return Err(TokenError::Empty);
        }
        let first = text.lines().next().unwrap_or_default().trim();
        if !first.is_empty() && !first.starts_with('#') && !first.contains(char::is_whitespace) {
            check_token(first)?;
            return Ok(Self(vec![AccessToken::new("token", TokenRole::Approve, first)]));
        }
        let mut tokens = Self::default();
        for (line, text) in (1..).zip(text.lines()) {
            let text = text.trim();
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            let words: Vec<&str> = text.split_whitespace().collect();
            let &[name, role, hash] = words.as_slice() else {
                return Err(TokenError::Line { line });
            };
            let (Some(role), Some(hash)) = (TokenRole::from_name(role), TokenHash::parse(hash))
            else {
                return Err(TokenError::Line { line });
            };
            if tokens.0.iter().any(|token| token.name == name) {
                return Err(TokenError::NameTwice { line, name: name.to_owned() });
            }
            tokens.0.push(AccessToken { name: name.to_owned(), role, hash });
        }
        Ok(tokens)
    }

    /// All tokens, in the file's order.
    pub fn iter(&self) -> impl Iterator<Item = &AccessToken> {
        self.0.iter()
    }

    /// The stored token that equals `token`. The hashes are compared, so the time of a comparison
    /// reveals nothing about the token.
    pub(super) fn of_bearer(&self, token: &str) -> Option<&AccessToken> {
        self.of_hash(TokenHash::of(token))
    }

    pub(super) fn of_hash(&self, hash: TokenHash) -> Option<&AccessToken> {
        self.0.iter().find(|token| token.hash == hash)
    }
}

/// Refuses a token that can be guessed or contains characters that are not allowed.
fn check_token(token: &str) -> Result<(), TokenError> {
    let travels = |c: char| c.is_ascii_alphanumeric() || "-._~+/=".contains(c);
    if let Some(character) = token.chars().find(|&c| !travels(c)) {
        return Err(TokenError::Character { character });
    }
    // The largest entropy of this number of characters of its own alphabet; repeated ones have
    // less.
    let has = |is: fn(&char) -> bool| token.chars().any(|c| is(&c));
    let kinds = [
        (has(char::is_ascii_digit), 10),
        (has(char::is_ascii_lowercase), 26),
        (has(char::is_ascii_uppercase), 26),
        (has(|c| !c.is_ascii_alphanumeric()), 7),
    ];
    let alphabet: usize = kinds.iter().filter(|(has, _)| *has).map(|(_, size)| size).sum();
    let distinct = token.chars().collect::<std::collections::BTreeSet<_>>().len();
    let alphabet = if distinct < FEW_CHARACTERS { distinct } else { alphabet };
    let bits = token.len() as f64 * (alphabet as f64).log2();
    if bits < LEAST_BITS { Err(TokenError::Guessable { bits }) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_a_line_for_each_bearer() {
        let tablet = AccessToken::new("tablet", TokenRole::Operate, "of the tablet");
        let wall = AccessToken::new("wall", TokenRole::View, "of the wall");
        let file = format!("# who may\n\n{tablet}\n  {wall}  \n");
        let tokens = AccessTokens::parse(&file).unwrap();
        assert_eq!(tokens.iter().cloned().collect::<Vec<_>>(), [tablet.clone(), wall.clone()]);
        assert_eq!(tokens.of_bearer("of the wall"), Some(&wall));
        assert_eq!(tokens.of_bearer("of the hall"), None);
        assert_eq!(AccessTokens::parse("# all revoked\n").unwrap().iter().count(), 0);
        assert!(!format!("{tokens:?}").contains(&format!("{}", wall.hash)), "nothing is printed");
    }

    #[test]
    fn a_single_token_has_every_right() {
        let tokens = AccessTokens::parse("s3cret-token-of-the-test\n").unwrap();
        let token = tokens.of_bearer("s3cret-token-of-the-test").unwrap();
        assert_eq!((token.name.as_str(), token.role), ("token", TokenRole::Approve));
    }

    #[test]
    fn what_cannot_be_used_is_refused_with_its_cause() {
        let line = AccessToken::new("a", TokenRole::View, "x").to_string();
        let cases = [
            (String::new(), TokenError::Empty),
            ("\n\n".to_owned(), TokenError::Empty),
            ("a view\n".to_owned(), TokenError::Line { line: 1 }),
            (format!("{line}\nb see {}", &line[7..]), TokenError::Line { line: 2 }),
            (line.replace("sha256:", "sha1:"), TokenError::Line { line: 1 }),
            (line.replace("sha256:", "sha256:é"), TokenError::Line { line: 1 }),
            (format!("{line}\n{line}"), TokenError::NameTwice { line: 2, name: "a".to_owned() }),
            ("tökens-of-some-length-and-more".to_owned(), TokenError::Character { character: 'ö' }),
        ];
        for (file, expected) in cases {
            assert_eq!(AccessTokens::parse(&file), Err(expected), "{file}");
        }
        let repeated = "a".repeat(60);
        for guessable in ["hunter2", "12345678901234567890", repeated.as_str()] {
            let refused = AccessTokens::parse(guessable);
            assert!(matches!(refused, Err(TokenError::Guessable { .. })), "{guessable}");
        }
    }

    #[test]
    fn each_role_may_what_the_one_below_may() {
        let table = [
            (Method::GET, "/v1/calibrations/c1", TokenRole::View),
            (Method::POST, "/v1/cameras/front/sessions", TokenRole::Operate),
            (Method::DELETE, "/v1/sessions/s1", TokenRole::Operate),
            (Method::POST, "/v1/solve", TokenRole::Operate),
            (Method::POST, "/v1/calibrations/c1/approve", TokenRole::Approve),
            (Method::DELETE, "/v1/calibrations/c1", TokenRole::Approve),
        ];
        for (method, path, role) in table {
            assert_eq!(TokenRole::needed(&method, path), role, "{method} {path}");
        }
        assert!(TokenRole::View < TokenRole::Operate && TokenRole::Operate < TokenRole::Approve);
    }
}
