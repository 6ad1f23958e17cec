//! The records of an MCAP file, one after the other, out of chunks or not: as much as a damaged or
//! unfinished file holds.
//!
//! Framing is done here and not by the `mcap` crate's reader, whose arithmetic trusts the lengths
//! inside a chunk (of a compressed one too: a wrong one would ask for all memory there is); a
//! record's own contents are parsed by the crate.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::{Record, op};

/// The longest record that is believed: above an uncompressed picture of 120 megapixels in 16 bits.
const LONGEST_RECORD: u64 = 256 << 20;
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

/// Reads records from front to back.
#[derive(Debug)]
pub(super) struct RecordReader {
    file: BufReader<File>,
    /// Bytes left of the uncompressed chunk that is being read.
    chunk_left: Option<u64>,
    /// Records of a compressed chunk that has been unpacked.
    unpacked: VecDeque<Record<'static>>,
}

impl RecordReader {
    /// Opens the file at `path`; `None` unless it begins as an MCAP file does.
    pub(super) fn open(path: &Path) -> Result<Option<Self>, std::io::Error> {
        let mut file = BufReader::new(File::open(path)?);
        let mut magic = [0; mcap::MAGIC.len()];
        match file.read_exact(&mut magic) {
            Err(error) if error.kind() != std::io::ErrorKind::UnexpectedEof => return Err(error),
            Err(_) => return Ok(None),
            Ok(()) if magic != mcap::MAGIC => return Ok(None),
            Ok(()) => {}
        }
        Ok(Some(Self { file, chunk_left: None, unpacked: VecDeque::new() }))
    }

    /// Goes to the record at byte `offset`, outside any chunk.
    pub(super) fn seek(&mut self, offset: u64) -> Result<(), std::io::Error> {
        self.chunk_left = None;
        self.unpacked.clear();
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
    pub(super) fn next_record(&mut self) -> Result<Option<Record<'static>>, Broken> {
        loop {
            if let Some(record) = self.unpacked.pop_front() {
                return Ok(Some(record));
            }
            if self.chunk_left == Some(0) {
                self.chunk_left = None;
            }
            let header: [u8; RECORD_HEADER as usize] = self.read_array()?;
            let length = u64::from_le_bytes(std::array::from_fn(|i| header[1 + i]));
            match header[0] {
                op::FOOTER if self.chunk_left.is_none() => return Ok(None),
                op::CHUNK if self.chunk_left.is_none() => self.enter_chunk(length)?,
                opcode => {
                    if let Some(left) = &mut self.chunk_left {
                        let taken = length.saturating_add(RECORD_HEADER);
                        *left = left
                            .checked_sub(taken)
                            .ok_or_else(|| damaged("a record is longer than its chunk"))?;
                    }
                    let body = self.read_vec(length)?;
                    return parsed(opcode, &body).map(Some);
                }
            }
        }
    }

    fn enter_chunk(&mut self, length: u64) -> Result<(), Broken> {
        const FIXED: u64 = 8 + 8 + 8 + 4 + 4;
        let fixed: [u8; FIXED as usize] = self.read_array()?;
        let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| fixed[at + i]));
        let name_length = u64::from(u32::from_le_bytes(std::array::from_fn(|i| fixed[28 + i])));
        if name_length > 64 {
            return Err(damaged("a chunk with a compression of no name"));
        }
        let compression = String::from_utf8_lossy(&self.read_vec(name_length)?).into_owned();
        let compressed_size = u64::from_le_bytes(self.read_array()?);
        if Some(compressed_size) != length.checked_sub(FIXED + name_length + 8) {
            return Err(damaged("a chunk's size contradicts itself"));
        }
        if compression.is_empty() {
            self.chunk_left = Some(compressed_size);
            return Ok(());
        }
        let packed = self.read_vec(compressed_size)?;
        let chunk = unpack(&compression, &packed, word(16))?;
        let mut rest = chunk.as_slice();
        while !rest.is_empty() {
            let longer = || damaged("a record is longer than its chunk");
            let (header, after) =
                rest.split_at_checked(RECORD_HEADER as usize).ok_or_else(longer)?;
            let length = u64::from_le_bytes(std::array::from_fn(|i| header[1 + i]));
            let length = usize::try_from(length)
                .ok()
                .filter(|length| *length <= after.len())
                .ok_or_else(longer)?;
            let (body, after) = after.split_at(length);
            self.unpacked.push_back(parsed(header[0], body)?);
            rest = after;
        }
        Ok(())
    }

    fn read_array<const N: usize>(&mut self) -> Result<[u8; N], Broken> {
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(ended)?;
        Ok(bytes)
    }

    /// Reads `length` bytes; allocates no more than the file really holds.
    fn read_vec(&mut self, length: u64) -> Result<Vec<u8>, Broken> {
        if length > LONGEST_RECORD {
            return Err(damaged("a record is longer than any picture"));
        }
        let mut bytes = Vec::with_capacity(length.min(1 << 16) as usize);
        let read = (&mut self.file).take(length).read_to_end(&mut bytes).map_err(Broken::Io)?;
        if (read as u64) < length { Err(Broken::Cut) } else { Ok(bytes) }
    }
}

/// The records of a compressed chunk, of which its header says that they are `length` bytes.
fn unpack(compression: &str, packed: &[u8], length: u64) -> Result<Vec<u8>, Broken> {
    if length > LONGEST_RECORD {
        return Err(damaged("a chunk is longer than any picture"));
    }
    let mut bytes = Vec::new();
    let read = match compression {
        "zstd" => zstd::Decoder::with_buffer(packed)
            .and_then(|chunk| chunk.take(length).read_to_end(&mut bytes)),
        "lz4" => {
            lz4::Decoder::new(packed).and_then(|chunk| chunk.take(length).read_to_end(&mut bytes))
        }
        other => return Err(damaged(&format!("chunks compressed by {other:?}, not zstd or lz4"))),
    };
    match read {
        Ok(read) if read as u64 == length => Ok(bytes),
        Ok(_) => Err(damaged("a chunk's size contradicts itself")),
        Err(error) => Err(damaged(&format!("a chunk does not unpack: {error}"))),
    }
}

fn parsed(opcode: u8, body: &[u8]) -> Result<Record<'static>, Broken> {
    mcap::parse_record(opcode, body)
        .map(Record::into_owned)
        .map_err(|error| damaged(&error.to_string()))
}

fn damaged(reason: &str) -> Broken {
    Broken::Damaged(reason.split_whitespace().collect::<Vec<_>>().join(" "))
}

fn ended(error: std::io::Error) -> Broken {
    if error.kind() == std::io::ErrorKind::UnexpectedEof { Broken::Cut } else { Broken::Io(error) }
}
