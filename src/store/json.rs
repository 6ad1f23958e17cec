//! Documents in columns: what is written is sure to be readable.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::document::reading;
use crate::store::error::StoreError;

/// `document` as JSON, after a check that it reads back equal. JSON cannot represent NaN or
/// infinity: a document that contains one is refused here, instead of being found unreadable later.
///
/// # Errors
/// [`StoreError::Unstorable`].
pub(super) fn write<T>(document: &T, row: impl Fn() -> String) -> Result<String, StoreError>
where
    T: Serialize + DeserializeOwned + PartialEq,
{
    let unstorable = |detail: String| StoreError::Unstorable { row: row(), detail };
    let json = reading::to_json(document).map_err(|e| unstorable(e.to_string()))?;
    let back: T = reading::from_json(json.as_bytes()).map_err(|e| unstorable(e.to_string()))?;
    if back == *document {
        Ok(json)
    } else {
        Err(unstorable("it does not read back as it is".into()))
    }
}

/// The document in a column.
///
/// # Errors
/// [`StoreError::Unreadable`].
pub(super) fn read<T: DeserializeOwned>(
    json: &str,
    row: impl Fn() -> String,
) -> Result<T, StoreError> {
    reading::from_json(json.as_bytes())
        .map_err(|e| StoreError::Unreadable { row: row(), detail: e.to_string() })
}
