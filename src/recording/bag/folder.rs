//! A bag's files: one, or a folder of several that follow each other, each of which may be
//! compressed as a whole; messages may be compressed each by itself.
//!
//! `metadata.yaml` is read for the files that it names, so that a missing one is noticed.
//! Everything else that it says the files say themselves.

use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::recording::bag::mcap_storage::McapStorage;
use crate::recording::bag::ros1_storage::Ros1Storage;
use crate::recording::bag::sqlite_storage::SqliteStorage;
use crate::recording::bag::storage::{BagMessage, BagStorage, BagTopic};
use crate::recording::records::{Broken, LONGEST_RECORD};
use crate::recording::unpack::{Compression, UnpackBudget};
use crate::recording::{RecordingError, natural_order};

const METADATA: &str = "metadata.yaml";
/// The longest `metadata.yaml` that is read.
const LONGEST_METADATA: u64 = 16 << 20;
/// What a zstd frame begins with; no CDR message does.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A format of bag files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum BagFormat {
    Mcap,
    Sqlite,
    Ros1,
}

/// The format by a file's name, and whether it is compressed as a whole.
fn format_of(path: &Path) -> Option<(BagFormat, bool)> {
    let name = path.file_name()?.to_str()?.to_ascii_lowercase();
    let (name, packed) = match name.strip_suffix(".zstd") {
        Some(name) => (name, true),
        None => (name.as_str(), false),
    };
    let format = match name.rsplit_once('.')?.1 {
        "mcap" => BagFormat::Mcap,
        "db3" => BagFormat::Sqlite,
        "bag" => BagFormat::Ros1,
        _ => return None,
    };
    Some((format, packed))
}

/// Whether `path` is named like a file of a bag.
pub(in crate::recording) fn is_bag_file(path: &Path) -> bool {
    format_of(path).is_some()
}

/// Whether the folder at `path` holds the files of a bag.
pub(in crate::recording) fn holds_bag(path: &Path) -> bool {
    path.join(METADATA).is_file() || !files_in(path).unwrap_or_default().is_empty()
}

/// Opens the file or folder at `path`.
///
/// # Errors
/// [`RecordingError`] for what is no bag or is not whole.
pub(super) fn open(path: &Path) -> Result<Box<dyn BagStorage>, RecordingError> {
    let files = if path.is_dir() {
        let named = files_in_metadata(path)?;
        let files = if named.is_empty() { files_in(path)? } else { named };
        if let Some(missing) = files.iter().find(|file| !file.is_file()) {
            return Err(RecordingError::Missing { path: missing.clone() });
        }
        files
    } else {
        vec![path.to_owned()]
    };
    let not_one = || RecordingError::NotARecording { path: path.to_owned() };
    let first = BagFile::open(files.first().ok_or_else(not_one)?)?;
    let topics = first.storage.topics().to_vec();
    let places = (0..topics.len()).map(Some).collect();
    Ok(Box::new(Parts { files, at: 0, part: first, topics, places }))
}

/// The bag files of a folder, in natural order.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let refused = |source| RecordingError::Io { path: folder.to_owned(), source };
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(refused)? {
        let path = entry.map_err(refused)?.path();
        if let (true, Some(name)) =
            (is_bag_file(&path), path.file_name().and_then(|name| name.to_str()))
        {
            names.push(name.to_owned());
        }
    }
    names.sort_by(|a, b| natural_order(a, b));
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

/// The files that `metadata.yaml` names under `relative_file_paths`; none where there is no such
/// file.
fn files_in_metadata(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let path = folder.join(METADATA);
    let mut text = String::new();
    match File::open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(RecordingError::Io { path, source }),
        Ok(file) => {
            let read = file.take(LONGEST_METADATA).read_to_string(&mut text);
            read.map_err(|source| RecordingError::Io { path, source })?;
        }
    }
    let names = listed(&text, "relative_file_paths");
    // A name that leads out of the folder is none of the bag's.
    Ok(names.filter_map(|name| Some(folder.join(Path::new(&name).file_name()?))).collect())
}

/// The items of the list `key` in YAML as rosbag2 writes it: one a line, or all in brackets.
fn listed(yaml: &str, key: &str) -> impl Iterator<Item = String> {
    let after = yaml.lines().skip_while(move |line| {
        line.trim().strip_prefix(key).is_none_or(|rest| !rest.trim_start().starts_with(':'))
    });
    let mut lines = after;
    let head = lines.next().and_then(|line| line.split_once(':')).map_or("", |(_, rest)| rest);
    let inline = head.trim().trim_start_matches('[').trim_end_matches(']').split(',');
    let items = lines.map_while(|line| line.trim().strip_prefix("- "));
    inline.chain(items).map(|name| unquoted(name.trim())).filter(|name| !name.is_empty())
}

/// A YAML string without its quotes. In single quotes, a quote is written twice.
fn unquoted(text: &str) -> String {
    match text.strip_prefix('\'').and_then(|rest| rest.strip_suffix('\'')) {
        Some(inner) => inner.replace("''", "'"),
        None => text.trim_matches('"').to_owned(),
    }
}

/// The files of a bag, one after the other.
struct Parts {
    files: Vec<PathBuf>,
    /// The file that is open.
    at: usize,
    part: BagFile,
    /// The first file's topics: rosbag2 repeats them in each.
    topics: Vec<BagTopic>,
    /// Of each topic of the open file its place among these.
    places: Vec<Option<usize>>,
}

/// A file of a bag, open.
struct BagFile {
    storage: Box<dyn BagStorage>,
    budget: UnpackBudget,
    file_length: u64,
    /// What it was unpacked to; deleted with it.
    _unpacked: Option<NamedTempFile>,
}

impl BagFile {
    fn open(path: &Path) -> Result<Self, RecordingError> {
        let refused = |source| RecordingError::Io { path: path.to_owned(), source };
        let not_one = || RecordingError::NotARecording { path: path.to_owned() };
        let (format, packed) = format_of(path).ok_or_else(not_one)?;
        let file_length = fs::metadata(path).map_err(refused)?.len();
        let unpacked = if packed { Some(unpack(path, file_length)?) } else { None };
        let readable = unpacked.as_ref().map_or(path, |file| file.path());
        let opened: Result<Box<dyn BagStorage>, RecordingError> = match format {
            BagFormat::Mcap => McapStorage::open(readable).map(|storage| Box::new(storage) as _),
            BagFormat::Sqlite => {
                SqliteStorage::open(readable).map(|storage| Box::new(storage) as _)
            }
            BagFormat::Ros1 => Ros1Storage::open(readable).map(|storage| Box::new(storage) as _),
        };
        let storage = opened.map_err(|error| error.of(path))?;
        let budget = UnpackBudget::of_file(file_length);
        Ok(Self { storage, budget, file_length, _unpacked: unpacked })
    }
}

/// Unpacks the file at `path`, of `length` bytes, beside the system's temporary files.
fn unpack(path: &Path, length: u64) -> Result<NamedTempFile, RecordingError> {
    let refused = |source| RecordingError::Io { path: path.to_owned(), source };
    let damaged = |reason| RecordingError::Damaged { path: path.to_owned(), frame_sets: 0, reason };
    let file = BufReader::new(File::open(path).map_err(refused)?);
    let reader = Compression::Zstd.reader(file).map_err(refused)?;
    let mut budget = UnpackBudget::of_file(length);
    let mut unpacked = NamedTempFile::with_prefix("plumb-bag-").map_err(refused)?;
    // One byte more than may be, so that too much is noticed.
    let copied = io::copy(&mut reader.take(budget.left().saturating_add(1)), &mut unpacked)
        .map_err(|error| damaged(format!("it does not unpack: {error}")))?;
    budget.take(copied).map_err(|error| damaged(error.to_string()))?;
    Ok(unpacked)
}

impl BagStorage for Parts {
    fn topics(&self) -> &[BagTopic] {
        &self.topics
    }

    fn next_message(&mut self, wanted: &[bool]) -> Result<Option<BagMessage>, Broken> {
        loop {
            let wanted_of_part: Vec<bool> = (self.places.iter())
                .map(|place| place.is_some_and(|place| wanted.get(place) == Some(&true)))
                .collect();
            if let Some(mut message) = self.part.storage.next_message(&wanted_of_part)? {
                let Some(topic) = self.places.get(message.topic).copied().flatten() else {
                    continue;
                };
                message.topic = topic;
                if message.bytes.starts_with(&ZSTD_MAGIC) {
                    message.bytes = unpacked_message(message.bytes, &mut self.part.budget)?;
                }
                return Ok(Some(message));
            }
            if self.at + 1 >= self.files.len() {
                return Ok(None);
            }
            self.go_to(self.at + 1)?;
        }
    }

    fn rewind(&mut self) -> Result<(), Broken> {
        if self.at != 0 {
            return self.go_to(0);
        }
        self.part.budget = UnpackBudget::of_file(self.part.file_length);
        self.part.storage.rewind()
    }
}

impl Parts {
    fn go_to(&mut self, at: usize) -> Result<(), Broken> {
        let opened = BagFile::open(&self.files[at]);
        self.part = opened.map_err(|error| Broken::Damaged(error.to_string()))?;
        self.at = at;
        let place = |topic: &BagTopic| self.topics.iter().position(|known| known == topic);
        self.places = self.part.storage.topics().iter().map(place).collect();
        Ok(())
    }
}

fn unpacked_message(packed: Vec<u8>, budget: &mut UnpackBudget) -> Result<Vec<u8>, Broken> {
    let damaged = |error: io::Error| Broken::Damaged(format!("a message does not unpack: {error}"));
    let reader = Compression::Zstd.reader(io::Cursor::new(packed)).map_err(damaged)?;
    let most = budget.left().min(LONGEST_RECORD);
    let mut bytes = Vec::new();
    reader.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(damaged)?;
    budget.take(bytes.len() as u64)?;
    if bytes.len() as u64 > LONGEST_RECORD {
        return Err(Broken::Damaged("a message is longer than any image".into()));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_names_the_files_in_either_form() {
        let block = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - a_0.mcap\n    - 'a_1.mcap'\n  files: 3\n";
        assert_eq!(
            listed(block, "relative_file_paths").collect::<Vec<_>>(),
            ["a_0.mcap", "a_1.mcap"]
        );
        let inline = "  relative_file_paths: [a_0.db3, \"a_1.db3\"]\n  - no\n";
        assert!(listed(inline, "relative_file_paths").take(2).eq(["a_0.db3", "a_1.db3"]));
        assert_eq!(listed("nothing: [1]\n", "relative_file_paths").count(), 0);
    }

    #[test]
    fn formats_follow_from_names() {
        let of = |name: &str| format_of(Path::new(name));
        assert_eq!(of("x/a.DB3"), Some((BagFormat::Sqlite, false)));
        assert_eq!(of("a.mcap.zstd"), Some((BagFormat::Mcap, true)));
        assert_eq!(
            (of("a.bag"), of("a.png"), of("zstd")),
            (Some((BagFormat::Ros1, false)), None, None)
        );
    }
}
