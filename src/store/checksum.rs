//! Checksums of rows, which detect bytes that changed on the disk when a row is read.

use crate::store::error::StoreError;

/// The CRC-32 (IEEE 802.3) of a row's columns in order. The length of each column is included, so
/// that bytes cannot move from one column to the next undetected.
pub(super) fn of_columns(columns: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    for column in columns {
        hasher.update(&(column.len() as u64).to_le_bytes());
        hasher.update(column);
    }
    hasher.finalize()
}

/// Checks that a row is unchanged since it was written; `stored` is `None` for rows of older
/// stores.
///
/// # Errors
/// [`StoreError::Unreadable`].
pub(super) fn check(
    stored: Option<u32>,
    computed: u32,
    row: impl Fn() -> String,
) -> Result<(), StoreError> {
    match stored {
        Some(stored) if stored != computed => Err(StoreError::Unreadable {
            row: row(),
            detail: format!("its checksum is {computed:08x} and was {stored:08x} when written"),
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_known_function_and_separates_columns() {
        // An empty length of eight zero bytes: CRC-32 of those, as zlib has it.
        assert_eq!(of_columns(&[b""]), 0x6522_df69);
        assert_ne!(of_columns(&[b"ab", b"c"]), of_columns(&[b"a", b"bc"]));
    }

    #[test]
    fn rows_without_one_are_taken_as_they_are() {
        let row = || "session s1".to_owned();
        assert!(check(None, 7, row).is_ok());
        assert!(check(Some(7), 7, row).is_ok());
        let error = check(Some(6), 7, row).unwrap_err().to_string();
        assert!(error.starts_with("store: session s1 cannot be read: its checksum is"), "{error}");
    }
}
