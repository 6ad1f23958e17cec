//! Accuracy figures against exact truth: they may only tighten.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod allocations;
mod bad_views;
mod corner_accuracy;
mod detection;
mod estimation;
mod lens_choice;
mod misfit;
mod photographs;
mod predicted_scatter;
mod reasons;
mod rig;
mod seeded_camera;
#[path = "../system/shared_data.rs"]
mod shared_data;
mod textbook;
mod tracking;
mod walk;
