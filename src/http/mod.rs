//! The HTTP interface of the daemon: routes in `router`, one file for each resource. Uses geometry,
//! imaging, calibration, document, export, store, pipeline, and estimation for the stateless solve;
//! never a camera.
//!
//! Every answer is computed from the newest state; only a `stop` waits, and only for its solve.
//! Every error, whatever its cause, is a [`problem::Problem`]. No request can bring the daemon
//! down: those that are too large, too slow or too many are refused.

mod access;
mod board;
mod bodies;
mod browser_sessions;
mod calibrations;
mod cameras;
mod connections;
mod events;
mod focus;
mod frames;
mod gate;
mod health;
mod openapi;
mod page;
mod pages;
pub mod problem;
mod recordings;
mod request;
mod rigs;
mod router;
mod schemas;
mod serve;
mod sessions;
mod shared;
mod solve;
mod target;
pub mod tls;
pub mod tokens;
mod uncertainty;
mod views;

pub use crate::http::access::Access;
pub use crate::http::serve::serve;
pub use crate::http::shared::Service;
