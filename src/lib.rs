//! Plumb: a daemon beside a robot's cameras that finds chessboards live, gathers views, calibrates,
//! and says how far to trust the result.
//!
//! # The map
//!
//! Layers from the ground up; each uses only what is named (`tests/system/layering.rs` enforces
//! it):
//!
//! | layer | what it is | may use |
//! | --- | --- | --- |
//! | [`geometry`] | poses, pixels, lenses, boards | nothing |
//! | [`imaging`] | frames, luma, decoding, undistortion | geometry |
//! | [`detection`] | one image → a board, or why not | geometry, imaging |
//! | [`estimation`] | correspondences → an estimate with uncertainty | geometry |
//! | [`calibration`] | sessions, admission, coverage, verdicts | geometry, imaging, estimation, detection |
//! | [`simulation`] | a rendered world with exact truth | geometry, imaging |
//! | [`recording`] | frames on disk | geometry, imaging |
//! | [`capture`] | where frames come from | geometry, imaging, recording, simulation |
//! | [`document`] | the contract's documents: one schema for CLI, HTTP and store | geometry, imaging, detection, estimation, calibration |
//! | [`export`] | other programs' formats | geometry, calibration, document |
//! | [`store`] | SQLite | geometry, imaging, detection, calibration, document |
//! | [`pipeline`] | threads, channels, clocks | all of the above |
//! | [`http`] | axum | geometry, imaging, detection, estimation, calibration, document, export, store, pipeline |
//! | `config`, `daemon`, `cli`, `main` | | anything; nothing uses them |
//!
//! # Invariants
//!
//! 1. Below [`pipeline`] nothing is async and nothing reads a clock: time arrives inside frames.
//! 2. `unsafe` only in named device files.
//! 3. serde only at the edges: config, recording, document, export, store, http.
//! 4. The core is deterministic: same input, same bits, with any number of threads.
//! 5. A rejected frame is data with a reason; an error is something that needs a person.
//! 6. A calibration is immutable; a new solve is a new calibration.
//! 7. No silent default for a convention or a board size.
//! 8. Only `main` ends the process.
//! 9. Threads are named, channels bounded, drops counted.
//!
//! # Words
//!
//! *device* (hardware), *source* (yields frames), *sensor* (color, infrared, depth), *frame* (one
//! image), *frame set* (taken together), *detection* (a board found), *view* (a detection kept),
//! *session* (collecting towards one result), *solve* (the computation), *calibration* (the
//! result), *recording* (frames on disk), *space* (where coordinates live).

pub mod calibration;
pub mod capture;
pub mod cli;
pub mod config;
pub mod daemon;
pub mod detection;
pub mod document;
pub mod estimation;
pub mod export;
pub mod geometry;
pub mod http;
pub mod imaging;
pub mod pipeline;
pub mod recording;
pub mod simulation;
pub mod store;
