//! The outside's view: axum routes over the pipeline and the store.
