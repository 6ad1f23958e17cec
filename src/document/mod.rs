//! The documents of the contract, one schema for the command line, HTTP and the store. Uses
//! geometry, imaging, estimation and calibration.
//!
//! Every shape is plain data with public fields, derives its JSON and its OpenAPI schema, and
//! converts to and from the domain's types. [`reading::from_json`] reads any of them and names the
//! field where something is wrong; [`reading::to_json`] writes them so that every bit of a double
//! survives.

pub mod board_shape;
pub mod calibration;
pub mod camera;
pub mod depth;
pub mod depth_encoding;
pub mod detection;
pub mod error;
pub mod focus;
pub mod image_sensor;
pub mod lens;
pub mod lens_model;
mod objects_only;
pub mod pose;
pub mod problem;
pub mod reading;
pub mod recording;
pub mod rig;
pub mod scene_scale;
pub mod sensors;
pub mod sensors_file;
pub mod session;
pub mod session_member;
pub mod session_progress;
pub mod target;
pub mod target_file;
pub mod target_in_view;
pub mod time;
pub mod truth;
pub mod uncertainty;
pub mod verdict;
pub mod view_motion;
