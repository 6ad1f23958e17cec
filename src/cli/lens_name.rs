//! The lens models by their names on the command line.

use clap::ValueEnum;

use crate::estimation::problem::LensChoice;
use crate::geometry::lens::LensModel;

/// Which lens model to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum LensName {
    /// the one with the smallest error on views that were not fitted to
    Auto,
    /// no distortion
    Pinhole,
    /// one coefficient
    Radial,
    /// OpenCV's 5 coefficients, ROS plumb_bob
    Brown,
    /// OpenCV's 8 coefficients, ROS rational_polynomial
    Rational,
    /// OpenCV's fisheye, ROS equidistant
    KannalaBrandt,
}

impl From<LensName> for LensChoice {
    fn from(name: LensName) -> Self {
        Self::Model(match name {
            LensName::Auto => return Self::Auto,
            LensName::Pinhole => LensModel::Pinhole,
            LensName::Radial => LensModel::Radial,
            LensName::Brown => LensModel::Brown,
            LensName::Rational => LensModel::Rational,
            LensName::KannalaBrandt => LensModel::KannalaBrandt,
        })
    }
}
