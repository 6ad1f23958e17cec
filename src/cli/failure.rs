//! The failure of a command.

use std::fmt::Display;

/// One line that states what was wrong, where, and what to do; and the exit code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    line: Option<String>,
    exit_code: u8,
}

impl Failure {
    /// The request itself was wrong (a flag, a value, the configuration): exit code 2.
    pub fn usage(line: impl Display) -> Self {
        Self { line: Some(on_one_line(&line)), exit_code: 2 }
    }

    /// The request was valid, but could not be carried out: exit code 1.
    pub fn failed(line: impl Display) -> Self {
        Self { line: Some(on_one_line(&line)), exit_code: 1 }
    }

    /// The reader of the output has closed it (`plumb … | head`): no message, exit code 1.
    pub fn output_closed() -> Self {
        Self { line: None, exit_code: 1 }
    }

    /// The line for the user, if any.
    pub fn line(&self) -> Option<&str> {
        self.line.as_deref()
    }

    /// The exit code of the process.
    pub fn exit_code(&self) -> u8 {
        self.exit_code
    }
}

fn on_one_line(text: &impl Display) -> String {
    text.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
