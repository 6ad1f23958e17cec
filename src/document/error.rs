//! What is wrong with a document, and in which of its fields.

use crate::geometry::physical::PhysicalRange;

/// A document that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DocumentError {
    /// Not JSON: the text itself is broken.
    #[error("not JSON at line {line}, column {column}: {problem}")]
    Syntax {
        /// The line, counted from 1.
        line: usize,
        /// The column, counted from 1.
        column: usize,
        /// What the parser met.
        problem: String,
    },
    /// A field that is missing, of the wrong shape or of an impossible value.
    #[error("{field}: {problem}")]
    Field {
        /// Its path, as in `views[3].image[0]`.
        field: String,
        /// What is wrong with it and what would be right.
        problem: String,
    },
}

/// The `value` of `field`, if it can be.
///
/// # Errors
/// [`DocumentError::Field`] with the physical range.
pub(super) fn physical(
    field: &str,
    value: f64,
    range: &PhysicalRange,
) -> Result<f64, DocumentError> {
    range.check(value).map_err(|error| DocumentError::field(field, error.to_string()))
}

impl DocumentError {
    /// An impossible value in `field`.
    pub fn field(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Field { field: field.into(), problem: problem.into() }
    }

    /// The path of the field at fault, where it is one field's.
    pub fn path(&self) -> Option<&str> {
        match self {
            Self::Syntax { .. } => None,
            Self::Field { field, .. } => Some(field),
        }
    }

    /// The same error, seen from a document that holds this one as `parent`.
    pub fn inside(self, parent: &str) -> Self {
        match self {
            Self::Field { field, problem } => {
                Self::Field { field: format!("{parent}.{field}"), problem }
            }
            syntax @ Self::Syntax { .. } => syntax,
        }
    }
}
