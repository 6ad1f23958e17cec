//! The record of every session and calibration: one SQLite database in one folder. Uses geometry,
//! imaging, detection, calibration and document.
//!
//! What a call wrote is on disk when it returns: a process killed at any moment finds on its next
//! start everything that was acknowledged, and nothing half. Kept pictures live in the database
//! with their views, so neither is ever without the other. One process at a time: a second one is
//! refused, but may read: a backup is made of a store that is in use. Rows are added and sessions
//! updated; a calibration never changes. Each row has a checksum, and one that is damaged is one
//! row: the others are served, and it is named.

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
