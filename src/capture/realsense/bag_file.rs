//! Whether a file is a whole ROS bag: the library takes any name, and later says only that it
//! "cannot be resolved".

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use crate::capture::CaptureError;

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// The bag's first record is padded to this.
const FIRST_RECORD_BYTES: u64 = 4096;

/// Refuses what is missing, is no bag, or was cut short.
///
/// The first record of a bag states where its index is; a recorder writes that last, so a bag
/// without it, or shorter than it, is not whole (ROS bag format 2.0, "Bag header").
pub(super) fn check_bag(path: &Path) -> Result<(), CaptureError> {
    let failed =
        |problem: &str| CaptureError::Failed { reason: format!("{}: {problem}", path.display()) };
    let unreadable = |error: io::Error| failed(&format!("{error}; give an existing .bag file"));
    let mut file = File::open(path).map_err(unreadable)?;
    let length = file.metadata().map_err(unreadable)?.len();
    let mut start = Vec::new();
    file.by_ref().take(FIRST_RECORD_BYTES).read_to_end(&mut start).map_err(unreadable)?;
    if !start.starts_with(MAGIC) {
        return Err(failed(
            "not a recording of a RealSense camera: it does not begin as a .bag file does",
        ));
    }
    let index = index_position(&start[MAGIC.len()..]).unwrap_or(0);
    if index == 0 || index >= length {
        return Err(failed(
            "the .bag was cut short: its index is missing; record or copy it again",
        ));
    }
    Ok(())
}

/// The field `index_pos` of the first record: fields are a length, a name, `=`, and a value.
fn index_position(record: &[u8]) -> Option<u64> {
    let mut fields = record.get(4..4 + word(record)?)?;
    while !fields.is_empty() {
        let length = word(fields)?;
        let field = fields.get(4..4 + length)?;
        if let Some(value) = field.strip_prefix(b"index_pos=") {
            return Some(u64::from_le_bytes(value.try_into().ok()?));
        }
        fields = &fields[4 + length..];
    }
    None
}

fn word(bytes: &[u8]) -> Option<usize> {
    Some(u32::from_le_bytes(bytes.get(..4)?.try_into().ok()?) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bag(index: u64, length: usize) -> Vec<u8> {
        let mut field = b"index_pos=".to_vec();
        field.extend(index.to_le_bytes());
        let mut header = 4_u32.to_le_bytes().to_vec();
        header.extend(b"op=\x03");
        header.extend((field.len() as u32).to_le_bytes());
        header.extend(field);
        let mut bytes = MAGIC.to_vec();
        bytes.extend((header.len() as u32).to_le_bytes());
        bytes.extend(header);
        bytes.resize(length, b' ');
        bytes
    }

    fn checked(bytes: &[u8]) -> Result<(), String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        check_bag(file.path()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_whole_bag_passes_and_a_cut_one_does_not() {
        assert_eq!(checked(&bag(5000, 5001)), Ok(()));
        assert!(checked(&bag(5000, 5000)).unwrap_err().contains("cut short"));
        assert!(checked(&bag(0, 9000)).unwrap_err().contains("cut short"));
        for end in MAGIC.len()..60 {
            assert!(
                checked(&bag(5000, 6000)[..end]).unwrap_err().contains("cut short"),
                "cut at {end}"
            );
        }
    }

    #[test]
    fn what_is_no_bag_is_refused() {
        assert!(checked(b"").unwrap_err().contains("does not begin as a .bag"));
        assert!(checked(b"hello").unwrap_err().contains("does not begin as a .bag"));
        let error = check_bag(Path::new("/not/there.bag")).unwrap_err().to_string();
        assert!(error.starts_with("/not/there.bag: "), "{error}");
    }
}
