//! The board's shape, with the lens under which the views show it.

use nalgebra::{Matrix3, SVector, Vector3};

use crate::geometry::lens::MAX_PARAMETERS;

/// The posterior of the offsets of the board's corners, and of the lens.
#[derive(Clone)]
pub(super) struct CornerOffsets {
    /// In meters.
    pub(super) offsets: Vec<Vector3<f64>>,
    /// 1 over their variances, with all else held.
    pub(super) weights: Vec<Matrix3<f64>>,
    /// The lens, relative to the estimate's.
    pub(super) lens: LensVector,
}

impl CornerOffsets {
    /// Offsets that are known.
    pub(super) fn of(offsets: Vec<Vector3<f64>>) -> Self {
        Self { offsets, weights: Vec::new(), lens: LensVector::zeros() }
    }
}

/// Parameters of a lens; those that its model lacks are 0.
pub(super) type LensVector = SVector<f64, MAX_PARAMETERS>;
