//! Plumb: a daemon beside a robot's cameras that detects a calibration board in the live image,
//! collects views, calibrates, and reports the uncertainty of the result.
//!
//! # The map
//!
//! Layers from the ground up; each uses only what is named (`tests/system/layering.rs` enforces
//! it):
//!
//! | layer | what it is | may use |
//! | --- | --- | --- |
//! | `locks` | locks that outlive a fault of a thread | nothing |
//! | [`geometry`] | poses, pixels, lenses, boards | nothing |
//! | [`imaging`] | frames, luma, decoding, undistortion | geometry |
//! | [`detection`] | one image → a board, or why not | geometry, imaging |
//! | [`features`] | scale-invariant keypoints, matches, tracks | geometry, imaging |
//! | [`estimation`] | correspondences → an estimate with uncertainty | geometry |
//! | [`calibration`] | sessions, admission, coverage, verdicts | geometry, imaging, estimation, detection, features |
//! | [`simulation`] | a rendered world with exact truth | geometry, imaging |
//! | [`recording`] | frames on disk | geometry, imaging |
//! | `dds` | DDS, as ROS 2 uses it: a domain's topics and services | locks |
//! | [`capture`] | where frames come from | locks, dds, geometry, imaging, recording, simulation |
//! | [`document`] | the contract's documents: one schema for CLI, HTTP and store | geometry, imaging, detection, estimation, calibration |
//! | [`export`] | other programs' formats | geometry, imaging, calibration, document |
//! | [`store`] | SQLite | locks, geometry, imaging, detection, calibration, document |
//! | [`pipeline`] | threads, channels, clocks | locks, geometry, imaging, detection, estimation, calibration, recording, capture, document, store |
//! | [`http`] | axum | locks, geometry, imaging, estimation (the stateless solve), calibration, document, export, store, pipeline |
//! | `graph` | results on the graph of ROS 2 | dds, geometry, recording, calibration, store, pipeline |
//! | `config`, `daemon`, `cli`, `main` | | anything; nothing uses them |
//!
//! # As a library
//!
//! [`detect`] finds a board in one luma image. Here the image is rendered, so the truth is known:
//!
//! ```
//! use plumb::geometry::pixel::ImageSize;
//! use plumb::simulation::{World, WorldOptions};
//!
//! let options = WorldOptions::new(7, ImageSize::new(640, 480));
//! let frame = World::new(&options).frame(0);
//! let detection = plumb::detect(frame.image.view(), options.board.size)?;
//! assert_eq!(detection.corners.len(), options.board.size.corner_count());
//! assert!(detection.corners.iter().all(|corner| corner.std_px < 0.1));
//! # Ok::<(), plumb::NoBoard>(())
//! ```
//!
//! [`calibrate`] solves lens and poses from correspondences of board points and pixels:
//!
//! ```
//! # use plumb::Chessboard;
//! # use plumb::geometry::pixel::ImageSize;
//! # use plumb::simulation::{World, WorldOptions};
//! use plumb::{BoardView, CameraOptions, CameraProblem, Correspondence, Detection};
//!
//! fn view(board: &Chessboard, name: String, detection: &Detection) -> BoardView {
//!     let correspondences = detection.corners.iter().map(|corner| Correspondence {
//!         point_in_board: board.corner_in_board(corner.index.col, corner.index.row),
//!         pixel: corner.pixel,
//!         std_px: corner.std_px,
//!     });
//!     BoardView { name, correspondences: correspondences.collect() }
//! }
//! # let options = WorldOptions::new(7, ImageSize::new(640, 480));
//! # let (board, mut world) = (options.board, World::new(&options));
//! # let views = (0..12).filter_map(|k| {
//! #     let image = world.frame(10 * k).image;
//! #     plumb::detect(image.view(), board.size).ok().map(|found| view(&board, k.to_string(), &found))
//! # }).collect();
//!
//! let problem = CameraProblem { image_size: ImageSize::new(640, 480), views };
//! let solved = plumb::calibrate(&problem, &CameraOptions::default())?;
//! assert!(solved.estimate.rms_px < 0.1);
//! # Ok::<(), plumb::EstimationError>(())
//! ```
//!
//! `examples/` has these as programs, a [`capture::FrameSource`] of one's own, and a client of the
//! daemon in Python.
//!
//! # Invariants
//!
//! 1. Below [`pipeline`] nothing is async and nothing reads a clock: time arrives inside frames.
//! 2. `unsafe` only in named device files.
//! 3. serde only at the edges: config, recording, document, export, store, http.
//! 4. The core is deterministic: same input, same bits, with any number of threads.
//! 5. A rejected frame is data with a reason; an error is something that needs a person.
//! 6. A calibration is immutable; a new solve is a new calibration.
//! 7. No silent default for a convention or a board size.
//! 8. Only `main` ends the process.
//! 9. Threads are named, channels bounded, drops counted.
//!
//! # Glossary
//!
//! The field's terms are used as in Hartley and Zisserman's *Multiple View Geometry* and OpenCV's
//! documentation: observation, correspondence, residual, reprojection error, inlier, outlier,
//! covariance, homography, occlusion. The project's own:
//!
//! | word | meaning |
//! | --- | --- |
//! | device, source | hardware; what yields frames (a device, a recording, the simulator) |
//! | sensor | one imager of a camera: color, infrared, second infrared or depth |
//! | frame, frame set | one image as it came; the frames that a camera took together |
//! | detection | a board found in an image: corners with indices and standard deviations |
//! | partial board | a detection without some of the board's corners |
//! | view | a detection that a session accepted |
//! | session | collects views towards one calibration |
//! | admission | the decision to accept a view, or to reject it with a reason |
//! | suggested pose | where the board should be shown next |
//! | solve | the computation from views to a calibration |
//! | calibration | the immutable result: lenses, poses, covariance, checks, verdict |
//! | verdict | good, usable or poor, with reasons to act on |
//! | rig | several cameras fixed to each other |
//! | auxiliary sensor | infrared or depth of a camera whose color image shows the board |
//! | noise floor | common standard deviation added in quadrature to every corner's own |
//! | variance inflation | factor on all variances because corners of one view err together |
//! | pose jitter | motion of one sensor relative to another between their exposures |
//! | occluder | what hides part of the board |
//! | recording | frames on disk: MCAP, a ROS bag, or a folder of images |
//! | space | where coordinates live: board, camera, color, depth, rig, image |
//!
//! A pose `a_from_b` maps coordinates in b to coordinates in a. `tests/system/words.rs` keeps
//! other words for these out.

pub mod calibration;
pub mod capture;
pub mod cli;
pub mod config;
pub mod daemon;
#[cfg(feature = "ros2")]
pub mod dds;
pub mod detection;
pub mod document;
pub mod estimation;
pub mod export;
pub mod features;
pub mod geometry;
#[cfg(feature = "ros2")]
pub mod graph;
pub mod http;
pub mod imaging;
mod locks;
pub mod pipeline;
pub mod recording;
pub mod simulation;
pub mod store;

pub use calibration::solve::{SolvedCamera, solve_views as calibrate};
pub use detection::board_detection::{DetectOptions, DetectedCorner, Detection, NoBoard};
pub use detection::detect;
pub use detection::detector::Detector;
pub use estimation::camera::{CameraEstimate, CameraOptions};
pub use estimation::error::EstimationError;
pub use estimation::problem::{BoardView, CameraProblem, Correspondence, LensChoice};
pub use geometry::board::{BoardError, BoardSize, Chessboard};
pub use imaging::gray::{GrayImage, GrayView};
