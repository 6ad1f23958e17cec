//! Accuracy figures against exact truth: they may only tighten.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(clippy::print_stdout, reason = "figures are worth reading when all is well, too")]

mod allocations;
mod bad_views;
mod board_border;
mod boards_on_floors;
mod coded_motion;
mod coded_targets;
mod coded_tracking;
mod corner_accuracy;
mod depth_guidance;
mod depth_information;
mod detection;
mod estimation;
mod fisheye_boards;
mod lens_choice;
mod misfit;
mod named_boards;
mod nearly_equal_views;
#[path = "../system/not_tested.rs"]
mod not_tested;
mod occluders;
mod photographs;
mod predicted_scatter;
mod printed_images;
mod real_boards;
mod reasons;
mod rgbd;
mod rgbd_kinect;
mod rgbd_time;
mod rgbd_wrong;
mod rig;
mod rig_of_devices;
mod running_estimate;
mod scene_depth;
mod scene_photographs;
mod seeded_camera;
mod seeded_rgbd;
#[path = "../system/shared_data.rs"]
mod shared_data;
mod stored_corners;
mod tag_prints;
mod textbook;
mod tracking;
mod walk;
mod weights;
