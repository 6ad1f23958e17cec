//! What the system's errors mean for a camera, and what to do.

use std::io;
use std::path::Path;

use crate::capture::CaptureError;
use crate::capture::v4l2::holder::holders_of;

/// What an error of an open or opening device means.
pub(super) fn lost(node: &Path, error: &io::Error) -> CaptureError {
    let device = node.display().to_string();
    let lost = |reason: String| CaptureError::Lost { device: device.clone(), reason };
    match error.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => failed(
            node,
            "permission denied; add the user to the group video (`sudo usermod -aG video $USER`) and log in again",
        ),
        // The attempt that was refused has the node open itself.
        Some(libc::EBUSY) => match holders_of(node, 1) {
            Some(holders) => lost(format!("in use by {holders}; close that first")),
            None => lost(
                "in use by another process that this user cannot see; close that first".to_owned(),
            ),
        },
        Some(libc::ENODEV | libc::ENXIO | libc::ENOENT) => lost("it was unplugged".to_owned()),
        _ => lost(format!("the driver answers: {error}")),
    }
}

/// What needs a person.
pub(super) fn failed(node: &Path, problem: &str) -> CaptureError {
    CaptureError::Failed { reason: format!("{}: {problem}", node.display()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn system_errors_say_what_to_do() {
        let message =
            |code| lost(Path::new("/dev/video9"), &io::Error::from_raw_os_error(code)).to_string();
        assert_eq!(message(libc::ENODEV), "/dev/video9 was lost: it was unplugged");
        assert!(message(libc::EACCES).contains("group video"));
        assert!(message(libc::EBUSY).contains("in use by"));
        assert!(message(libc::EIO).starts_with("/dev/video9 was lost: the driver answers: "));
    }
}
