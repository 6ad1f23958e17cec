//! Accuracy figures against exact truth: they may only tighten.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod estimation;
mod seeded_camera;
