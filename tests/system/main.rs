//! The product as one test binary.

mod layering;
