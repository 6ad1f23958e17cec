//! The information of views: the information matrix of a lens, what one more view would add to it,
//! and how much that lowers the uncertainty of projections. The suggested next view, the choice of
//! images from a pool and the choice of a session's frames all maximize that gain.
//!
//! ```text
//! Λ = Σ over views of (A − B H⁻¹ Bᵀ) / σ²      goal(Λ) = median or worst σ of a projection
//! gain of a view v = 1 − goal(Λ + Λ_v) / goal(Λ)
//! ```
//!
//! A, B and H are the blocks (lens, lens × pose, pose) of the view's normal matrix; the unknown
//! pose of the view is eliminated by the Schur complement. To first order Λ⁻¹ is the covariance of
//! a solve of the same views. Choosing views by it is optimal experimental design (V. V. Fedorov,
//! *Theory of Optimal Experiments*, 1972), here with the projection as the criterion.
//!
//! | question | where |
//! | --- | --- |
//! | the information in one view about a lens | [`view_information`] |
//! | what is known of a lens, from views, an estimate or nothing | [`lens_information`] |
//! | how uncertain projections are then | [`projection_goal`] |
//! | how exact the corners of a future view will be | [`corner_noise`] |
//! | which views a detector could see | [`candidate_views`] |
//! | which of them to request, and how many more, whatever they determine | `view_search` |
//! | which view to ask for so that a lens is known | [`next_view`] |
//! | how to get there, in words | [`movement`] |
//! | the information in a session's views so far, frame by frame | [`camera_information`] |
//! | what shared views say of two cameras and their relative pose | [`pair_information`] |
//! | how uncertain it is where one camera sees what another sees | [`transfer_goal`] |
//! | which view to ask for that both see | [`next_shared_view`] |
//! | the information in a session's views about two cameras together | [`camera_pair_information`] |
//! | what planes say of a depth camera beside color | [`depth_information`] |
//! | what corners that infrared sees say of it | [`infrared_corners`] |
//! | how uncertain it is where color sees what depth measures | [`depth_goal`] |
//! | what depth would measure of a board | [`expected_depth`] |
//! | which view to ask for so that depth is known | [`next_depth_view`] |
//! | a session's information on depth | [`depth_camera_information`], [`board_in_depth`], `depth_fit` |
//! | which images of a pool to take | [`pool`] |

pub mod board_in_depth;
pub mod camera_information;
pub mod camera_pair_information;
pub mod candidate_views;
pub mod corner_noise;
pub mod depth_camera_information;
mod depth_fit;
pub mod depth_goal;
pub mod depth_information;
pub mod expected_depth;
pub mod infrared_corners;
pub mod lens_information;
pub mod movement;
pub mod next_depth_view;
pub mod next_shared_view;
pub mod next_view;
pub mod pair_information;
pub mod pool;
pub mod projection_goal;
pub mod transfer_goal;
pub mod view_information;
mod view_search;

#[cfg(test)]
mod information_tests;
#[cfg(test)]
mod pair_tests;
