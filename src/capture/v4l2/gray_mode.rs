//! Gray images of a camera that another library of this process has open.
//!
//! nokhwa 0.10 asks for gray images by the code `GRAY`, which no driver has; theirs is `GREY`
//! (`V4L2_PIX_FMT_GREY`). A second descriptor cannot set it: `uvcvideo` gives that right to the
//! descriptor that set a format first (`uvc_acquire_privileges`). So it is set on the descriptor
//! that the library has open.

use std::fs;
use std::io;
use std::os::fd::RawFd;
use std::path::{Path, PathBuf};

use v4l::FourCC;

use crate::capture::v4l2::camera::open_device;
use crate::capture::v4l2::{kernel, mode};
use crate::geometry::pixel::ImageSize;

const GRAY: [u8; 4] = *b"GREY";

/// The sizes of the gray images that `/dev/video{number}` gives, each with its whole rates, frames
/// a second; none where it cannot be opened.
pub(in crate::capture) fn gray_modes(number: u32) -> Vec<(ImageSize, u32)> {
    let Ok(device) = open_device(&node(number)) else { return Vec::new() };
    let is_gray = |name: &str| name.as_bytes() == GRAY;
    let formats = mode::offered(&device).into_iter().filter(|format| is_gray(&format.name));
    let sizes = formats.flat_map(|format| format.sizes).filter(|size| size.range.is_none());
    let rates = sizes.flat_map(|listed| {
        let whole = listed.fps.into_iter().filter(|fps| fps.fract() == 0.0);
        whole.map(move |fps| (listed.size, fps as u32))
    });
    rates.collect()
}

/// Sets `/dev/video{number}` to gray images through a descriptor that this process has open.
///
/// # Errors
/// The last refusal, where no descriptor of this process may set it or the device gives something
/// else.
pub(in crate::capture) fn set_gray(number: u32, size: ImageSize, fps: u32) -> io::Result<()> {
    let mut refused = io::Error::from(io::ErrorKind::NotFound);
    for descriptor in descriptors_of(&node(number))? {
        // Another that is open for a moment, as for a list of devices, may be refused.
        match kernel::set_format(descriptor, size, FourCC::new(&GRAY)) {
            Ok(got) if got.fourcc.repr == GRAY && ImageSize::new(got.width, got.height) == size => {
                return kernel::set_rate(descriptor, fps);
            }
            Ok(got) => {
                let given = format!("it gives {}x{} {}", got.width, got.height, got.fourcc);
                refused = io::Error::other(given);
            }
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

fn node(number: u32) -> PathBuf {
    PathBuf::from(format!("/dev/video{number}"))
}

/// The descriptors that this process has open at `node`.
fn descriptors_of(node: &Path) -> io::Result<Vec<RawFd>> {
    let entries = fs::read_dir("/proc/self/fd")?;
    let opened = entries.filter_map(Result::ok).filter_map(|entry| {
        let is_at_node = fs::read_link(entry.path()).is_ok_and(|target| target == node);
        is_at_node.then(|| entry.file_name().to_str()?.parse().ok()).flatten()
    });
    Ok(opened.collect())
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::os::fd::AsRawFd;

    use super::*;

    #[test]
    fn the_descriptors_at_a_node_are_those_opened_there() {
        let place = tempfile::tempdir().unwrap();
        let node = place.path().canonicalize().unwrap().join("node");
        let other = place.path().canonicalize().unwrap().join("other");
        let writer = File::create(&node).unwrap();
        let reader = File::open(&node).unwrap();
        let _elsewhere = File::create(&other).unwrap();
        let mut found = descriptors_of(&node).unwrap();
        found.sort_unstable();
        let mut opened = [writer.as_raw_fd(), reader.as_raw_fd()];
        opened.sort_unstable();
        assert_eq!(found, opened);
        drop((writer, reader));
        assert!(descriptors_of(&node).unwrap().is_empty());
    }
}
