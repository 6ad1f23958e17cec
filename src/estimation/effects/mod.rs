//! What the plain problem leaves out: the board's true shape as printed and mounted, and its motion
//! during the read-out of a rolling shutter. Both are random effects of the joint problem:
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
//! | the walk to the minimum, and which effects stay | `search` |
//! | views readmitted beside effects | `readmit` |
//! | a view that moves as no other does | `odd_motion` |
//! | corners chosen anew beside effects, with and without motion | `fit` |
//! | covariances at the end | `finish` |
//! | what was found | `effects_fit` |
//! | whether effects are plausible at all | `hints` |
//! | whether motion is a rolling shutter's | `shutter`, `read_by_rows` |
//! | the mean of two models that views do not decide between | `averaged` |
//! | what each view does to the lens | `influence` |
//! | what another lens would explain beside effects | `lens_score` |
//! | dense factors | `dense` |
//! | six columns at a time: what poses and motions are coupled with | `six_columns` |

pub(crate) mod apply;
mod averaged;
pub(crate) mod board_basis;
mod dense;
pub(crate) mod effect;
pub(crate) mod effects_fit;
pub(crate) mod evidence;
mod finish;
pub(crate) mod fit;
mod hints;
mod influence;
#[cfg(test)]
mod jacobian_tests;
pub(crate) mod lens_score;
mod measured;
mod odd_motion;
mod read_by_rows;
mod readmit;
mod search;
mod shape_products;
mod shutter;
mod six_columns;
pub(crate) mod state;
mod system;
mod view_columns;
