//! The records of an MCAP file, one after the other, out of chunks or not: as much as a damaged or
//! unfinished file holds.
//!
//! Framing and the few kinds of records that matter are read here and not by the `mcap` crate,
//! whose reader trusts the lengths inside records: 42 bytes can make it ask for 4 GB. At most one
//! record is in memory, and a compressed chunk is unpacked as its records are read.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::op;

use crate::recording::fields::{Fields, TooShort};
use crate::recording::unpack::{Compression, OverBudget, UnpackBudget, read_exactly};

/// The longest record that is believed: above an uncompressed image of 120 megapixels in 16 bits.
pub(super) const LONGEST_RECORD: u64 = 256 << 20;
/// The longest record that describes others: schemas and metadata.
const LONGEST_DESCRIPTION: u64 = 16 << 20;
/// The most entries that a metadata record may have.
const MOST_ENTRIES: usize = 10_000;
/// The longest name of a topic, schema or encoding.
const LONGEST_NAME: usize = 1024;
/// Opcode and length.
const RECORD_HEADER: u64 = 9;

/// Why the records end before the file says so.
#[derive(Debug)]
pub(super) enum Broken {
    /// In the middle of a record, or before the end mark.
    Cut,
    /// A length or a content that cannot be.
    Damaged(String),
    /// The system refused.
    Io(std::io::Error),
}

impl From<OverBudget> for Broken {
    fn from(error: OverBudget) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// A record, as far as recordings are read for it.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum McapRecord {
    /// The type of messages.
    Schema { id: u16, name: String },
    /// A topic.
    Channel { id: u16, schema_id: u16, topic: String, encoding: String },
    /// A message on a topic.
    Message { header: MessageHeader, data: Vec<u8> },
    /// Named pairs of texts.
    Metadata { name: String, entries: BTreeMap<String, String> },
    /// How many messages each channel has.
    Statistics { message_counts: BTreeMap<u16, u64> },
    /// Anything else.
    Other,
}

/// What precedes a message's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MessageHeader {
    pub channel_id: u16,
    pub sequence: u32,
    pub log_time: u64,
    pub publish_time: u64,
}

/// Reads records from front to back.
pub(super) struct RecordReader {
    file: BufReader<File>,
    file_length: u64,
    chunk: Option<Chunk>,
    budget: UnpackBudget,
}

/// The chunk that is being read.
struct Chunk {
    /// Bytes of records that are still to come.
    left: u64,
    /// Unpacks it; `None` for one that is not compressed and is read from the file itself.
    unpacked: Option<Box<dyn Read + Send>>,
}

impl RecordReader {
    /// Opens the file at `path`; `None` unless it begins as an MCAP file does.
    pub(super) fn open(path: &Path) -> Result<Option<Self>, std::io::Error> {
        let file = File::open(path)?;
        let file_length = file.metadata()?.len();
        let mut file = BufReader::new(file);
        let mut magic = [0; mcap::MAGIC.len()];
        match file.read_exact(&mut magic) {
            Err(error) if error.kind() != std::io::ErrorKind::UnexpectedEof => return Err(error),
            Err(_) => return Ok(None),
            Ok(()) if magic != mcap::MAGIC => return Ok(None),
            Ok(()) => {}
        }
        let budget = UnpackBudget::of_file(file_length);
        Ok(Some(Self { file, file_length, chunk: None, budget }))
    }

    /// Goes to the record at byte `offset`, outside any chunk.
    pub(super) fn seek(&mut self, offset: u64) -> Result<(), std::io::Error> {
        self.chunk = None;
        self.budget = UnpackBudget::of_file(self.file_length);
        self.file.seek(SeekFrom::Start(offset)).map(|_| ())
    }

    /// Goes to the first record.
    pub(super) fn rewind(&mut self) -> Result<(), std::io::Error> {
        self.seek(mcap::MAGIC.len() as u64)
    }

    /// Goes to the first record of the summary; false if the file has none.
    pub(super) fn seek_to_summary(&mut self) -> Result<bool, std::io::Error> {
        const FOOTER_AND_MAGIC: i64 = 9 + 20 + 8;
        let mut end = [0; FOOTER_AND_MAGIC as usize];
        if self
            .file
            .seek(SeekFrom::End(-FOOTER_AND_MAGIC))
            .and_then(|_| self.file.read_exact(&mut end))
            .is_err()
        {
            return Ok(false);
        }
        let start = u64::from_le_bytes(std::array::from_fn(|i| end[9 + i]));
        let whole = end[0] == op::FOOTER && end.ends_with(mcap::MAGIC) && start != 0;
        if whole {
            self.seek(start)?;
        }
        Ok(whole)
    }

    /// The next record, out of chunks; `None` after the footer.
    pub(super) fn next_record(&mut self) -> Result<Option<McapRecord>, Broken> {
        loop {
            if self.chunk.as_ref().is_some_and(|chunk| chunk.left == 0) {
                self.chunk = None;
            }
            let (opcode, length) = self.next_header()?;
            match opcode {
                op::FOOTER if self.chunk.is_none() => return Ok(None),
                op::CHUNK if self.chunk.is_none() => self.enter_chunk(length)?,
                op::MESSAGE => {
                    return message(self.read_vec(length, LONGEST_RECORD)?).map(Some);
                }
                op::SCHEMA | op::CHANNEL | op::METADATA | op::STATISTICS => {
                    let body = self.read_vec(length, LONGEST_DESCRIPTION)?;
                    return described(opcode, &body).map(Some);
                }
                _ => {
                    self.skip(length)?;
                    return Ok(Some(McapRecord::Other));
                }
            }
        }
    }

    /// Opcode and length of the next record, which is not longer than the chunk that it is in.
    fn next_header(&mut self) -> Result<(u8, u64), Broken> {
        let longer = || damaged("a record is longer than its chunk");
        if let Some(chunk) = &mut self.chunk {
            chunk.left = chunk.left.checked_sub(RECORD_HEADER).ok_or_else(longer)?;
            if chunk.unpacked.is_some() {
                self.budget.take_record()?;
            }
        }
        let header = self.read_exact(RECORD_HEADER)?;
        let length = u64::from_le_bytes(std::array::from_fn(|i| header[1 + i]));
        if let Some(chunk) = &mut self.chunk {
            chunk.left = chunk.left.checked_sub(length).ok_or_else(longer)?;
        }
        Ok((header[0], length))
    }

    fn enter_chunk(&mut self, length: u64) -> Result<(), Broken> {
        const FIXED: u64 = 8 + 8 + 8 + 4 + 4;
        let fixed = self.read_exact(FIXED)?;
        let mut fields = Fields::packed(&fixed[16..]);
        let (unpacked_size, _crc, name_length) = (fields.u64()?, fields.u32()?, fields.u32()?);
        let name_length = u64::from(name_length);
        if name_length > 64 {
            return Err(damaged("a chunk with a compression of no name"));
        }
        let name = String::from_utf8_lossy(&self.read_exact(name_length)?).into_owned();
        let packed_size = Fields::packed(&self.read_exact(8)?).u64()?;
        if Some(packed_size) != length.checked_sub(FIXED + name_length + 8) {
            return Err(damaged("a chunk's size contradicts itself"));
        }
        if name.is_empty() {
            self.chunk = Some(Chunk { left: packed_size, unpacked: None });
            return Ok(());
        }
        let compression = Compression::from_name(&name)
            .ok_or_else(|| damaged(&format!("chunks compressed by {name:?}, not zstd or lz4")))?;
        let packed = self.read_vec(packed_size, LONGEST_RECORD)?;
        self.budget.take(unpacked_size)?;
        let unpacked = compression.reader(Cursor::new(packed)).map_err(Broken::Io)?;
        self.chunk = Some(Chunk { left: unpacked_size, unpacked: Some(unpacked) });
        Ok(())
    }

    /// Reads `length` bytes, at most `longest`; allocates no more than there really are.
    fn read_vec(&mut self, length: u64, longest: u64) -> Result<Vec<u8>, Broken> {
        if length > longest {
            return Err(damaged("a record is longer than any image"));
        }
        self.read_exact(length)
    }

    fn read_exact(&mut self, length: u64) -> Result<Vec<u8>, Broken> {
        match self.chunk.as_mut().and_then(|chunk| chunk.unpacked.as_mut()) {
            Some(unpacked) => read_exactly(unpacked, length)
                .map_err(|error| damaged(&format!("a chunk does not unpack: {error}")))?
                .ok_or_else(|| damaged("a chunk's size contradicts itself")),
            None => read_exactly(&mut self.file, length).map_err(Broken::Io)?.ok_or(Broken::Cut),
        }
    }

    fn skip(&mut self, length: u64) -> Result<(), Broken> {
        match self.chunk.as_mut().and_then(|chunk| chunk.unpacked.as_mut()) {
            Some(unpacked) => std::io::copy(&mut unpacked.take(length), &mut std::io::sink())
                .map(|_| ())
                .map_err(|error| damaged(&format!("a chunk does not unpack: {error}"))),
            None => {
                let length = i64::try_from(length).map_err(|_| Broken::Cut)?;
                self.file.seek_relative(length).map_err(Broken::Io)
            }
        }
    }
}

fn message(mut body: Vec<u8>) -> Result<McapRecord, Broken> {
    const HEADER: usize = 2 + 4 + 8 + 8;
    let mut fields = Fields::packed(&body);
    let header = MessageHeader {
        channel_id: fields.u16()?,
        sequence: fields.u32()?,
        log_time: fields.u64()?,
        publish_time: fields.u64()?,
    };
    body.drain(..HEADER);
    Ok(McapRecord::Message { header, data: body })
}

fn described(opcode: u8, body: &[u8]) -> Result<McapRecord, Broken> {
    let mut fields = Fields::packed(body);
    Ok(match opcode {
        op::SCHEMA => McapRecord::Schema { id: fields.u16()?, name: name(&mut fields)? },
        op::CHANNEL => McapRecord::Channel {
            id: fields.u16()?,
            schema_id: fields.u16()?,
            topic: name(&mut fields)?,
            encoding: name(&mut fields)?,
        },
        op::METADATA => {
            let name = name(&mut fields)?;
            let mut entries = BTreeMap::new();
            let mut pairs = Fields::packed(fields.bytes()?);
            while pairs.left() > 0 && entries.len() < MOST_ENTRIES {
                entries.insert(pairs.text()?, pairs.text()?);
            }
            McapRecord::Metadata { name, entries }
        }
        op::STATISTICS => {
            let _totals = fields.take(8 + 2 + 4 + 4 + 4 + 4 + 8 + 8)?;
            let mut pairs = Fields::packed(fields.bytes()?);
            let mut message_counts = BTreeMap::new();
            while pairs.left() > 0 {
                message_counts.insert(pairs.u16()?, pairs.u64()?);
            }
            McapRecord::Statistics { message_counts }
        }
        _ => McapRecord::Other,
    })
}

fn name(fields: &mut Fields<'_>) -> Result<String, Broken> {
    let name = fields.text()?;
    if name.len() > LONGEST_NAME {
        return Err(damaged("a topic or a schema with a name of more than 1024 letters"));
    }
    Ok(name)
}

impl From<TooShort> for Broken {
    fn from(_: TooShort) -> Self {
        damaged("a length inside a record goes beyond its end")
    }
}

fn damaged(reason: &str) -> Broken {
    Broken::Damaged(reason.split_whitespace().collect::<Vec<_>>().join(" "))
}
