//! The product as one test binary.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends by panicking")]

mod decoding;
mod layering;
mod lens_conformance;
mod shared_data;
