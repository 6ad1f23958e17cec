//! The .bag files of ROS 1, format 2.0: records of named fields and data, in chunks that may be
//! compressed by bz2 or lz4 (wiki.ros.org/Bags/Format/2.0).

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use crate::recording::RecordingError;
use crate::recording::bag::storage::{
    BagMessage, BagStorage, BagTopic, FoundTopics, MessageEncoding, one_type_name,
};
use crate::recording::fields::Fields;
use crate::recording::records::{Broken, LONGEST_RECORD};
use crate::recording::unpack::{Compression, UnpackBudget, read_exactly};

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// The longest header of a record.
const LONGEST_HEADER: u64 = 1 << 16;
/// The longest description of a connection: with the text of its message's definition.
const LONGEST_CONNECTION: u64 = 1 << 20;
/// More connections than any robot has.
const MOST_CONNECTIONS: usize = 65_535;

const MESSAGE: u8 = 0x02;
const BAG_HEADER: u8 = 0x03;
const CHUNK: u8 = 0x05;
const CONNECTION: u8 = 0x07;

/// A .bag file.
pub(super) struct Ros1Storage {
    file: BufReader<File>,
    file_length: u64,
    chunk: Option<BagChunk>,
    budget: UnpackBudget,
    found: FoundTopics<u32>,
}

/// The chunk that is being read, with its bytes that are still to come.
struct BagChunk {
    left: u64,
    /// Unpacks it; `None` for one that is not compressed.
    unpacked: Option<Box<dyn Read + Send>>,
}

/// The fields of a record's header that matter.
#[derive(Debug, Default)]
struct RecordHeader {
    op: u8,
    connection: u32,
    time_ns: i64,
    index_pos: u64,
    compression: String,
    size: u32,
    topic: String,
}

impl Ros1Storage {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// [`RecordingError::NotARecording`], and what the system refuses.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let refused = |source| RecordingError::Io { path: path.to_owned(), source };
        let file = File::open(path).map_err(refused)?;
        let file_length = file.metadata().map_err(refused)?.len();
        let mut file = BufReader::new(file);
        if read_exactly(&mut file, MAGIC.len() as u64).map_err(refused)?.as_deref() != Some(MAGIC) {
            return Err(RecordingError::NotARecording { path: path.to_owned() });
        }
        let mut storage = Self {
            file,
            file_length,
            chunk: None,
            budget: UnpackBudget::of_file(file_length),
            found: FoundTopics::default(),
        };
        storage.read_connections().map_err(|error| error.at(path, 0))?;
        storage.rewind().map_err(|error| error.at(path, 0))?;
        Ok(storage)
    }

    /// Reads the connections from the index at the end; from the whole file where there is none.
    fn read_connections(&mut self) -> Result<(), Broken> {
        let index_pos = match self.next_record() {
            Ok(Some((header, length))) if header.op == BAG_HEADER => {
                self.skip(length)?;
                header.index_pos
            }
            _ => 0,
        };
        if (1..self.file_length).contains(&index_pos) {
            self.file.seek(SeekFrom::Start(index_pos)).map_err(Broken::Io)?;
            self.scan_connections();
        }
        if self.found.topics.is_empty() {
            self.rewind()?;
            self.scan_connections();
        }
        Ok(())
    }

    /// Takes in the connections from here to the end, or to what cannot be read: that is reported
    /// when the messages are read.
    fn scan_connections(&mut self) {
        while let Ok(Some((header, length))) = self.next_record() {
            let read = match header.op {
                CONNECTION => self.connection(&header, length),
                CHUNK => self.enter_chunk(&header, length),
                _ => self.skip(length),
            };
            if read.is_err() {
                break;
            }
        }
    }

    /// The next record's header and the length of its data; `None` at the end.
    fn next_record(&mut self) -> Result<Option<(RecordHeader, u64)>, Broken> {
        if self.chunk.as_ref().is_some_and(|chunk| chunk.left == 0) {
            self.chunk = None;
        }
        if self.chunk.is_none()
            && self.file.stream_position().map_err(Broken::Io)? >= self.file_length
        {
            return Ok(None);
        }
        if self.chunk.as_ref().is_some_and(|chunk| chunk.unpacked.is_some()) {
            self.budget.take_record()?;
        }
        let length = self.length(LONGEST_HEADER)?;
        let header = RecordHeader::read(&self.read(length)?)?;
        Ok(Some((header, self.length(LONGEST_RECORD)?)))
    }

    fn length(&mut self, longest: u64) -> Result<u64, Broken> {
        let length = u64::from(Fields::packed(&self.read(4)?).u32()?);
        if length > longest {
            return Err(damaged("a record is longer than any image"));
        }
        Ok(length)
    }

    fn enter_chunk(&mut self, header: &RecordHeader, length: u64) -> Result<(), Broken> {
        if self.chunk.is_some() {
            return Err(damaged("a chunk inside a chunk"));
        }
        if header.compression == "none" {
            self.chunk = Some(BagChunk { left: length, unpacked: None });
            return Ok(());
        }
        let compression = Compression::from_name(&header.compression)
            .filter(|compression| *compression != Compression::Zstd)
            .ok_or_else(|| {
                let name = &header.compression;
                damaged(&format!("chunks compressed by {name:?}, not bz2 or lz4"))
            })?;
        let packed = self.read(length)?;
        let size = u64::from(header.size);
        self.budget.take(size)?;
        let unpacked = compression.reader(Cursor::new(packed)).map_err(Broken::Io)?;
        self.chunk = Some(BagChunk { left: size, unpacked: Some(unpacked) });
        Ok(())
    }

    fn connection(&mut self, header: &RecordHeader, length: u64) -> Result<(), Broken> {
        if length > LONGEST_CONNECTION || self.found.of_ids.len() > MOST_CONNECTIONS {
            return Err(damaged("a connection that is longer than any message's definition"));
        }
        let data = self.read(length)?;
        let message_type =
            named_fields(&data, |name, value| (name == b"type").then(|| text(value)))?;
        let message_type = one_type_name(&message_type.unwrap_or_default());
        let layout = MessageEncoding::Ros1;
        let topic = BagTopic { name: header.topic.clone(), message_type, layout };
        self.found.add(header.connection, topic);
        Ok(())
    }

    /// Reads `length` bytes of the chunk or file; allocates no more than there really are.
    fn read(&mut self, length: u64) -> Result<Vec<u8>, Broken> {
        self.count(length)?;
        match self.chunk.as_mut().and_then(|chunk| chunk.unpacked.as_mut()) {
            Some(unpacked) => read_exactly(unpacked, length)
                .map_err(|error| damaged(&format!("a chunk does not unpack: {error}")))?
                .ok_or_else(|| damaged("a chunk's size contradicts itself")),
            None => read_exactly(&mut self.file, length).map_err(Broken::Io)?.ok_or(Broken::Cut),
        }
    }

    fn skip(&mut self, length: u64) -> Result<(), Broken> {
        self.count(length)?;
        match self.chunk.as_mut().and_then(|chunk| chunk.unpacked.as_mut()) {
            Some(unpacked) => std::io::copy(&mut unpacked.take(length), &mut std::io::sink())
                .map(|_| ())
                .map_err(|error| damaged(&format!("a chunk does not unpack: {error}"))),
            None => self.file.seek_relative(length as i64).map_err(Broken::Io),
        }
    }

    fn count(&mut self, length: u64) -> Result<(), Broken> {
        let Some(chunk) = &mut self.chunk else { return Ok(()) };
        let left = chunk.left.checked_sub(length);
        chunk.left = left.ok_or_else(|| damaged("a record is longer than its chunk"))?;
        Ok(())
    }
}

impl BagStorage for Ros1Storage {
    fn topics(&self) -> &[BagTopic] {
        &self.found.topics
    }

    fn next_message(&mut self, wanted: &[bool]) -> Result<Option<BagMessage>, Broken> {
        while let Some((header, length)) = self.next_record()? {
            match header.op {
                CHUNK => self.enter_chunk(&header, length)?,
                MESSAGE => {
                    let topic = self.found.of_ids.get(&header.connection).copied();
                    match topic.filter(|topic| wanted.get(*topic) == Some(&true)) {
                        Some(topic) => {
                            let (log_time_ns, bytes) = (header.time_ns, self.read(length)?);
                            return Ok(Some(BagMessage { topic, log_time_ns, bytes }));
                        }
                        None => self.skip(length)?,
                    }
                }
                _ => self.skip(length)?,
            }
        }
        if self.file.stream_position().map_err(Broken::Io)? > self.file_length {
            return Err(Broken::Cut);
        }
        Ok(None)
    }

    fn rewind(&mut self) -> Result<(), Broken> {
        self.chunk = None;
        self.budget = UnpackBudget::of_file(self.file_length);
        self.file.seek(SeekFrom::Start(MAGIC.len() as u64)).map(|_| ()).map_err(Broken::Io)
    }
}

impl RecordHeader {
    fn read(bytes: &[u8]) -> Result<Self, Broken> {
        let mut header = Self::default();
        named_fields(bytes, |name, value| {
            let number = |length: usize| {
                let mut bytes = [0; 8];
                bytes[..length].copy_from_slice(value.get(..length).unwrap_or(&[0; 8][..length]));
                u64::from_le_bytes(bytes)
            };
            match name {
                b"op" => header.op = number(1) as u8,
                b"conn" => header.connection = number(4) as u32,
                b"index_pos" => header.index_pos = number(8),
                b"size" => header.size = number(4) as u32,
                b"compression" => header.compression = text(value),
                b"topic" => header.topic = text(value),
                b"time" => {
                    let (seconds, nanoseconds) = (number(4) as i64, (number(8) >> 32) as i64);
                    header.time_ns = seconds * 1_000_000_000 + nanoseconds;
                }
                _ => {}
            }
            None::<()>
        })?;
        Ok(header)
    }
}

/// Goes through `name=value` fields, each after its length, until `take` gives something.
fn named_fields<T>(
    bytes: &[u8],
    mut take: impl FnMut(&[u8], &[u8]) -> Option<T>,
) -> Result<Option<T>, Broken> {
    let mut fields = Fields::packed(bytes);
    while fields.left() > 0 {
        let field = fields.bytes()?;
        let equals = field.iter().position(|byte| *byte == b'=');
        let equals = equals.ok_or_else(|| damaged("a field without a value"))?;
        if let Some(taken) = take(&field[..equals], &field[equals + 1..]) {
            return Ok(Some(taken));
        }
    }
    Ok(None)
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn damaged(reason: &str) -> Broken {
    Broken::Damaged(reason.split_whitespace().collect::<Vec<_>>().join(" "))
}
