//! Where in the file something stands.

use std::ops::Range;
use std::path::PathBuf;

use crate::config::error::ConfigError;

/// The file, for saying where in it something stands.
#[derive(Debug)]
pub(super) struct Place {
    pub(super) file: PathBuf,
    pub(super) text: String,
}

impl Place {
    /// A refusal of what stands at `span` under `key`.
    pub(super) fn refuse(
        &self,
        span: &Range<usize>,
        key: &str,
        problem: impl Into<String>,
    ) -> ConfigError {
        let before = &self.text.as_bytes()[..span.start.min(self.text.len())];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        ConfigError::Refused {
            file: self.file.clone(),
            line,
            key: key.to_owned(),
            problem: problem.into(),
        }
    }

    /// The key that the value at `span` is given to: what stands before the `=` before it.
    pub(super) fn key_before(&self, span: &Range<usize>) -> Option<String> {
        let before = self.text.get(..span.start)?.trim_end().strip_suffix('=')?.trim_end();
        let key = before
            .rsplit(|c: char| !(c.is_alphanumeric() || c == '_' || c == '-' || c == '.'))
            .next()?;
        (!key.is_empty()).then(|| key.to_owned())
    }
}
