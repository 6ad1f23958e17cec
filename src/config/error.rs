//! Why a configuration is refused.

use std::path::PathBuf;

/// Why a configuration is refused: one line that names the file, the line and the key.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {detail}; give an existing TOML file with --config", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system said.
        detail: String,
    },
    /// The file says something that cannot be.
    #[error("{}:{line}: {key}: {problem}", file.display())]
    Refused {
        /// The file.
        file: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// The key, as `table.key`.
        key: String,
        /// What is wrong with it, and what to write instead.
        problem: String,
    },
    /// The address given on the command line cannot be.
    #[error("--listen {listen}: {problem}")]
    Listen {
        /// What was given.
        listen: String,
        /// What is wrong with it.
        problem: String,
    },
}
