//! Numbers in, an estimate with its uncertainty out. Pure; uses geometry.

pub mod problem;
