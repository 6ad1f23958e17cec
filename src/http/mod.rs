//! The daemon's face: routes in `router`, one file a resource. Uses geometry, imaging,
//! estimation, calibration, document, export, store and pipeline; never a camera.
//!
//! Every answer is read from the newest state; only a `stop` waits, and only for its solve. Every
//! refusal, of whatever cause, is a [`problem::Problem`]. A request can be too large, too slow or
//! too many, never fatal.

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
