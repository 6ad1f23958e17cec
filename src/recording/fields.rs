//! Numbers, strings and sequences of a message or record, one after the other.
//!
//! Every length is compared with the bytes that are there before anything is allocated. Three
//! layouts share it: MCAP records and ROS 1 messages (packed, little-endian), and CDR, in which a
//! number of n bytes begins at a multiple of n from the first byte of the content and the first
//! two bytes state the order of bytes (OMG DDS-XTypes 1.3, 7.4).

/// What is read from, and how far it has been read.
#[derive(Debug, Clone)]
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    aligned: bool,
    big_endian: bool,
    /// CDR counts the zero at the end of a string as part of it.
    zero_ends_strings: bool,
}

/// The bytes ended before the fields did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a length inside it goes beyond its end")]
pub struct TooShort;

impl<'a> Fields<'a> {
    /// Fields without padding between them, least significant byte first.
    pub(super) fn packed(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, aligned: false, big_endian: false, zero_ends_strings: false }
    }

    /// The fields of a CDR message, after its four bytes that state the encoding.
    ///
    /// # Errors
    /// [`TooShort`] without these four bytes.
    pub(super) fn cdr(message: &'a [u8]) -> Result<Self, TooShort> {
        let (head, bytes) = message.split_at_checked(4).ok_or(TooShort)?;
        let big_endian = head[1] & 1 == 0;
        Ok(Self { bytes, at: 0, aligned: true, big_endian, zero_ends_strings: true })
    }

    /// The next `length` bytes.
    pub(super) fn take(&mut self, length: usize) -> Result<&'a [u8], TooShort> {
        let end = self.at.checked_add(length).ok_or(TooShort)?;
        let taken = self.bytes.get(self.at..end).ok_or(TooShort)?;
        self.at = end;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], TooShort> {
        if self.aligned {
            self.at = self.at.next_multiple_of(N);
        }
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(super) fn u8(&mut self) -> Result<u8, TooShort> {
        Ok(self.take(1)?[0])
    }

    pub(super) fn u16(&mut self) -> Result<u16, TooShort> {
        self.number().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, TooShort> {
        self.number().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, TooShort> {
        self.number().map(u64::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Result<f64, TooShort> {
        self.number().map(f64::from_le_bytes)
    }

    /// A length of 32 bits.
    pub(super) fn length(&mut self) -> Result<usize, TooShort> {
        self.u32().map(|length| length as usize)
    }

    /// Bytes after their number.
    pub(super) fn bytes(&mut self) -> Result<&'a [u8], TooShort> {
        let length = self.length()?;
        self.take(length)
    }

    /// Text after the number of its bytes; what is not UTF-8 is replaced.
    pub(super) fn text(&mut self) -> Result<String, TooShort> {
        let bytes = self.bytes()?;
        let text = match bytes.split_last() {
            Some((0, text)) if self.zero_ends_strings => text,
            _ => bytes,
        };
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    /// `count` doubles.
    pub(super) fn f64s(&mut self, count: usize) -> Result<Vec<f64>, TooShort> {
        if self.left() / 8 < count {
            return Err(TooShort);
        }
        (0..count).map(|_| self.f64()).collect()
    }

    /// How many bytes have not been read.
    pub(super) fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cdr_aligns_numbers_and_ends_strings_with_a_zero() {
        let little = b"\0\x01\0\0\x02\0\0\0a\0\0\0\x07\0\0\0\0\0\0\0\0\0\0\0\0\0\xf0\x3f";
        let mut fields = Fields::cdr(little).unwrap();
        assert_eq!(fields.text().unwrap(), "a");
        assert_eq!(fields.u32().unwrap(), 7);
        assert_eq!(fields.f64().unwrap(), 1.0);
        assert_eq!((fields.left(), fields.u8()), (0, Err(TooShort)));
        let mut big = Fields::cdr(b"\0\0\0\0\x05\0\0\0\0\0\0\x09").unwrap();
        assert_eq!((big.u8(), big.u32()), (Ok(5), Ok(9)));
    }

    #[test]
    fn a_length_beyond_the_end_allocates_nothing() {
        let mut fields = Fields::packed(b"\xff\xff\xff\xffabc");
        assert_eq!(fields.text(), Err(TooShort));
        assert_eq!(Fields::packed(&[0; 16]).f64s(usize::MAX), Err(TooShort));
        assert!(Fields::cdr(b"\0\x01\0").is_err());
    }
}
