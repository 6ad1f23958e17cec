//! Estimation: numbers in, an estimate with its uncertainty out. Pure; uses geometry.
//!
//! | question | where |
//! | --- | --- |
//! | what is given, and whether it fits | [`problem`], [`given_range`], [`given_misfit`] |
//! | in which order views are solved | `view_order` |
//! | one camera, lens and poses, from views of a board | [`camera`] |
//! | several sensors fixed to each other | [`rig`], [`consistent_labels`] |
//! | a symmetric board that views label from different ends | [`labels_by_shape`], [`relabeled`] |
//! | a camera from one view of points in space | [`dlt`] |
//! | the pose of a board, the lens known | [`board_pose`] |
//! | a start without an initial guess | [`zhang`] (closed form), `start` |
//! | the least-squares problem itself | `joint` |
//! | matrices over parameters of different orders of magnitude | `scaled_factor` |
//! | which corners and views are inliers | `robust`, `robust_fit`, [`view_fault`] |
//! | whether the model is right at all, and if not, why | [`model_check`], [`split_halves`],
//! `misfit` |
//! | whether the errors of a view's corners are correlated | `view_influence`,
//! `clustered_covariance`, `jackknife` |
//! | color and depth as one camera | [`rgbd`], [`depth_error`] |
//! | how far to trust a projection | [`uncertainty`] |
//! | which lens model, and whether another lens of it fits as closely | [`lens_choice`] |
//! | why there is no estimate | [`error`] |
//! | how an estimate is ended early | [`interrupt`] |

pub mod board_pose;
pub mod board_surface;
pub mod camera;
pub(crate) mod camera_estimate;
pub(crate) mod camera_fit;
mod clustered_covariance;
pub mod consistent_labels;
pub mod depth_error;
pub mod dlt;
mod effects;
pub mod error;
pub mod given_misfit;
pub mod given_range;
pub mod interrupt;
mod jackknife;
mod joint;
pub mod labels_by_shape;
pub mod lens_choice;
pub(crate) mod lens_pole;
pub mod measured_board;
mod misfit;
pub mod model_check;
mod model_error;
mod normal_probability;
pub(crate) mod planar_pose;
pub mod problem;
mod refit;
pub mod relabeled;
pub mod rgbd;
pub mod rig;
pub(crate) mod robust;
mod robust_fit;
mod row_products;
pub(crate) mod scaled_factor;
pub mod scene;
mod shape_widening;
pub mod split_halves;
mod start;
pub(crate) mod student;
pub mod two_view;
pub mod uncertainty;
pub mod undetermined_coefficients;
pub mod view_fault;
mod view_influence;
pub mod view_motion;
mod view_order;
pub mod zhang;
