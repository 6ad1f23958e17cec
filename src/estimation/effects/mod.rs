//! What the plain problem leaves out: the board's true shape as printed and mounted, and its motion
//! during the readout of a rolling shutter. Both are random effects of the joint problem:
//! Gaussian, with variances estimated from the data (`evidence`), and exactly zero where the data
//! show none.
//!
//! | question | where |
//! | --- | --- |
//! | which kinds of effect there are | `effect` |
//! | which shapes a board can have | `board_basis` |
//! | values of everything | `state` |
//! | normal equations, poses eliminated | `system` |
//! | products with the board's shape | `shape_products` |
//! | one view's Jacobian, dense | `view_columns` |
//! | posterior and variances | `evidence` |
//! | the search for the minimum, and which effects stay | `search` |
//! | views readmitted under the model with effects | `readmit` |
//! | a view whose motion is incompatible with the others' | `odd_motion` |
//! | the residuals of all corners of a view, rejected ones included | `capped_squares` |
//! | corners selected again under effects, with and without motion | `fit` |
//! | covariances at the end | `finish` |
//! | the result | `effects_fit` |
//! | whether effects are plausible at all | `score_tests` |
//! | whether motion is a rolling shutter's | `shutter`, `rolling_shutter_test` |
//! | the mean of two models that views do not decide between | `averaged` |
//! | the influence of each view on the lens | `influence` |
//! | how another lens would fit with effects | `lens_score` |
//! | dense factors | `dense` |
//! | six columns at a time: the couplings of poses and motions | `six_columns` |

pub(crate) mod apply;
mod averaged;
pub(crate) mod board_basis;
mod capped_squares;
mod dense;
pub(crate) mod effect;
pub(crate) mod effects_fit;
pub(crate) mod evidence;
mod finish;
pub(crate) mod fit;
mod influence;
#[cfg(test)]
mod jacobian_tests;
mod left_out;
pub(crate) mod lens_score;
mod measured;
mod odd_motion;
mod readmit;
mod rolling_shutter_test;
mod score_tests;
mod search;
mod shape_products;
mod shutter;
mod six_columns;
pub(crate) mod state;
mod system;
mod view_columns;
