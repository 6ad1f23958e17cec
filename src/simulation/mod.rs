//! A rendered world with exact truth: a chessboard that is carried about before one camera or
//! several, or a textured scene that a camera is carried through.
//!
//! ```text
//! Walk ──pose at a time──▶ Renderer ──light on the sensor──▶ ImageSensor::develop ──▶ image
//!   │                        ▲ BoardPattern: exact area integrals of the squares
//!   └── FrameTruth           ▲ Background, Optics (blur), rays of any Lens
//! ```
//!
//! Every pixel is an integral: the squares over its quarters exactly (polygon areas, no point
//! samples), the optical blur over a finer grid than the pixels, the exposure over several poses.
//! What is true of an image is therefore known to about a thousandth of a pixel, and everything
//! random comes from a seed: same world, same bytes.

mod background;
mod board_pattern;
mod depth_sensor;
mod image_sensor;
mod light_filter;
mod noise;
mod operator;
mod rays;
mod renderer;
mod rgbd_world;
mod seat;
mod textured_depth;
mod textured_solids;
mod textured_world;
mod tremor;
mod walk;
mod world;

pub use background::Background;
pub use board_pattern::{BoardPattern, Shade};
pub use depth_sensor::{DepthError, SimulatedDepthSensor};
pub use image_sensor::ImageSensor;
pub use operator::{Operator, OperatorKind, Skill};
pub use renderer::Renderer;
pub use rgbd_world::{RgbdFrame, RgbdOptions, RgbdWorld};
pub use seat::Seat;
pub use textured_depth::TexturedDepth;
pub use textured_solids::smooth_noise;
pub use textured_world::{CameraPath, Scenery, TexturedWorld, TexturedWorldOptions};
pub use walk::{Walk, WalkOptions};
pub use world::{FrameTruth, SimulatedFrame, World, WorldOptions};
