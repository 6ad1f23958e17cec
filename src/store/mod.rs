//! Stores every session and calibration in one SQLite database in one folder. Uses geometry,
//! imaging, detection, calibration and document.
//!
//! Everything that a call wrote is on disk when the call returns. A process that was killed finds,
//! at its next start, everything that was acknowledged, and nothing half written. Images are stored
//! in the database with their views, so that neither exists without the other. Only one process at
//! a time may open it for writing; others may read, so that a store in use can be backed up. Rows
//! are added and sessions are updated; a calibration never changes. Each row has a checksum. A
//! damaged row affects no other row: it is reported, and the others stay usable.

mod calibrations;
mod checksum;
mod database;
pub mod error;
mod json;
mod reader;
mod retention;
mod salvage;
mod sessions;
mod upgrades;
mod views;

pub use crate::store::database::Store;
pub use crate::store::error::StoreError;
pub use crate::store::reader::{StoreCheck, StoreReader};
pub use crate::store::retention::{Pruned, Retention};
pub use crate::store::salvage::RepairReport;
pub use crate::store::views::{Picture, SensorView};

#[cfg(test)]
mod example_tests;
