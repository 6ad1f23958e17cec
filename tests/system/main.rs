//! The product as one test binary.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends by panicking")]

mod autocalibrate;
mod bad_input;
mod changed_source;
mod cli;
mod coded_session;
mod config_examples;
mod crowds;
mod decoding;
mod depth_file;
mod detect_reasons;
#[cfg(target_os = "linux")]
mod full_disk;
mod fuzz_corpus;
mod greedy_solves;
mod http_api;
mod import_circles;
mod layering;
mod lens_conformance;
mod live_session;
mod not_tested;
mod one_place;
mod outputs;
mod program;
mod properties;
mod recordings;
mod rgbd_bent;
mod rgbd_disparity;
mod rgbd_recorded_unit;
mod rgbd_rig;
mod rgbd_session;
mod rgbd_wrong;
#[cfg(unix)]
mod rig_faults;
mod rig_folders;
mod rig_session;
mod room;
mod scene_session;
mod served;
#[cfg(target_os = "linux")]
mod service;
mod shared_data;
mod snapshots;
mod solve_requests;
mod stated_lenses;
mod store_upkeep;
mod thresholds_document;
#[cfg(unix)]
mod tls;
#[cfg(unix)]
mod tokens;
mod undistort;
mod words;
