//! How a command ends when it does not succeed.

use std::fmt::Display;

/// One line that says what was wrong, where, and what to do; and the exit code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    line: Option<String>,
    exit_code: u8,
}

impl Failure {
    /// The request itself was wrong (a flag, a value, a configuration): exit code 2.
    pub fn usage(line: impl Display) -> Self {
        Self { line: Some(on_one_line(&line)), exit_code: 2 }
    }

    /// The request was right and could not be done: exit code 1.
    pub fn failed(line: impl Display) -> Self {
        Self { line: Some(on_one_line(&line)), exit_code: 1 }
    }

    /// Nobody reads the output any more (`plumb … | head`): nothing to say, exit code 1.
    pub fn output_closed() -> Self {
        Self { line: None, exit_code: 1 }
    }

    /// The line for the user, if any.
    pub fn line(&self) -> Option<&str> {
        self.line.as_deref()
    }

    /// What the process ends with.
    pub fn exit_code(&self) -> u8 {
        self.exit_code
    }
}

fn on_one_line(text: &impl Display) -> String {
    text.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
