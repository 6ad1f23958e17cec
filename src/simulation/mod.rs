//! A rendered world with exact ground truth: a chessboard that is moved in front of one or several
//! cameras, or a textured scene that a camera moves through.
//!
//! ```text
//! Walk ──pose at a time──▶ Renderer ──light on the sensor──▶ ImageSensor::develop ──▶ image
//!   │                        ▲ BoardPattern: exact area integrals of the squares
//!   └── FrameTruth           ▲ Background, Optics (blur), rays of any Lens
//! ```
//!
//! Every pixel is an integral: over its sub-pixels for the squares (exact polygon areas, no point
//! samples), over a finer grid than the pixels for the optical blur, over several poses for the
//! exposure. The ground truth of an image is therefore known to about a thousandth of a pixel.
//! Everything random comes from a seed: the same options give the same bytes.

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
