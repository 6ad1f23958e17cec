//! The file of tokens: read with its permissions, and written so that others cannot read it.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::http::tokens::{AccessTokens, TokenError};

/// Why a file of tokens cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenFileError {
    /// It is not there, say.
    #[error("`{}` cannot be read: {source}; `plumb token add` makes it", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The system's word.
        source: io::Error,
    },
    /// Anyone on this machine may read it.
    #[error("`{}` can be read or changed by others (mode {mode:03o}); chmod 600 it", file.display())]
    OpenToOthers {
        /// The file.
        file: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// What it says.
    #[error("`{}`: {source}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        source: TokenError,
    },
    /// The folder, say, is not the user's.
    #[error("`{}` cannot be written: {source}; check the folder", file.display())]
    Unwritable {
        /// The file.
        file: PathBuf,
        /// The system's word.
        source: io::Error,
    },
}

/// The tokens of `file`.
///
/// # Errors
/// [`TokenFileError`]: no file, one that others can read, or one that holds no tokens.
pub fn read_tokens(file: &Path) -> Result<AccessTokens, TokenFileError> {
    let unreadable = |source| TokenFileError::Unreadable { file: file.to_owned(), source };
    let text = fs::read_to_string(file).map_err(unreadable)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = fs::metadata(file).map_err(unreadable)?.permissions().mode() & 0o777;
        // A group is who runs the daemon; the rest of the machine is not.
        if mode & 0o007 != 0 {
            return Err(TokenFileError::OpenToOthers { file: file.to_owned(), mode });
        }
    }
    AccessTokens::parse(&text)
        .map_err(|source| TokenFileError::Content { file: file.to_owned(), source })
}

/// Writes `text` in place of `file`, whole or not at all, for its owner alone.
///
/// # Errors
/// [`TokenFileError::Unwritable`].
pub fn write_tokens(file: &Path, text: &str) -> Result<(), TokenFileError> {
    use std::io::Write as _;
    let unwritable = |source| TokenFileError::Unwritable { file: file.to_owned(), source };
    let mut beside = file.as_os_str().to_owned();
    beside.push(".part");
    let beside = PathBuf::from(beside);
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut written = options.open(&beside).map_err(unwritable)?;
    written.write_all(text.as_bytes()).and_then(|()| written.sync_all()).map_err(unwritable)?;
    fs::rename(&beside, file).map_err(unwritable)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_file_that_others_can_read_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens");
        write_tokens(&file, "s3cret-token-of-the-test\n").unwrap();
        let mode = |mode| fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(read_tokens(&file).is_ok());
        for (bits, is_read) in [(0o400, true), (0o640, true), (0o644, false), (0o602, false)] {
            mode(bits);
            let read = read_tokens(&file);
            assert_eq!(read.is_ok(), is_read, "{bits:o}: {read:?}");
            let message = read.err().map(|error| error.to_string()).unwrap_or_default();
            assert!(is_read || message.contains("chmod 600"), "{message}");
        }
    }
}
