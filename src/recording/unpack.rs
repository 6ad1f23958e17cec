//! Compressed parts of recordings, unpacked as a stream: never more in memory than what is read
//! from it, and never more out of a file than its size can hold.

use std::io::{BufReader, Read};

/// What a small file may unpack to in all: two frames of 4K in color.
const LEAST_UNPACKED_BYTES: u64 = 48 << 20;
/// How much larger than the file its content may be beyond that. Frames of a sensor have noise:
/// they shrink tenfold, and rendered ones a hundredfold.
const LARGEST_RATIO: u64 = 1000;

/// What a small file may unpack to in records.
const LEAST_RECORDS: u64 = 100_000;
/// Bytes of the file that each record beyond that must have taken: ten times fewer than the
/// smallest message does when it is compressed well.
const LEAST_BYTES_PER_RECORD: u64 = 2;
/// What is unpacked at once.
const READ_AHEAD_BYTES: usize = 64 << 10;

/// A file that unpacks to more than a recording of its size can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum OverBudget {
    /// In bytes.
    #[error(
        "it decompresses to more than {LARGEST_RATIO} times its size, which no real recording does"
    )]
    Bytes,
    /// In records.
    #[error("it decompresses to more records than a file of its size can hold")]
    Records,
}

/// How much may still be unpacked from a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct UnpackBudget {
    left: u64,
    records: u64,
}

impl UnpackBudget {
    /// Of a file of `length` bytes.
    pub(super) fn of_file(length: u64) -> Self {
        Self {
            left: LEAST_UNPACKED_BYTES.saturating_add(length.saturating_mul(LARGEST_RATIO)),
            records: LEAST_RECORDS + length / LEAST_BYTES_PER_RECORD,
        }
    }

    /// How many bytes that is.
    pub(super) fn left(&self) -> u64 {
        self.left
    }

    /// Takes `length` bytes from it.
    pub(super) fn take(&mut self, length: u64) -> Result<(), OverBudget> {
        self.left = self.left.checked_sub(length).ok_or(OverBudget::Bytes)?;
        Ok(())
    }

    /// Takes one record from it.
    pub(super) fn take_record(&mut self) -> Result<(), OverBudget> {
        self.records = self.records.checked_sub(1).ok_or(OverBudget::Records)?;
        Ok(())
    }
}

/// How bytes are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compression {
    Zstd,
    Lz4,
    Bzip2,
}

impl Compression {
    /// The one that MCAP and ROS bags call `name`.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        match name {
            "zstd" => Some(Self::Zstd),
            "lz4" => Some(Self::Lz4),
            "bz2" => Some(Self::Bzip2),
            _ => None,
        }
    }

    /// What `packed` unpacks to, as it is read.
    ///
    /// # Errors
    /// When the system has no memory for a decoder.
    pub(super) fn reader(
        self,
        packed: impl Read + Send + 'static,
    ) -> Result<Box<dyn Read + Send>, std::io::Error> {
        let unpacked: Box<dyn Read + Send> = match self {
            Self::Zstd => Box::new(zstd::Decoder::new(packed)?),
            Self::Lz4 => Box::new(lz4_flex::frame::FrameDecoder::new(BufReader::new(packed))),
            Self::Bzip2 => Box::new(bzip2::read::BzDecoder::new(packed)),
        };
        Ok(Box::new(BufReader::with_capacity(READ_AHEAD_BYTES, unpacked)))
    }
}

/// Reads exactly `length` bytes; allocates no more than there really are. `None` where they end
/// before.
pub(super) fn read_exactly(
    from: &mut (impl Read + ?Sized),
    length: u64,
) -> Result<Option<Vec<u8>>, std::io::Error> {
    let mut bytes = Vec::with_capacity(length.min(1 << 16) as usize);
    let read = from.take(length).read_to_end(&mut bytes)?;
    Ok((read as u64 == length).then_some(bytes))
}
