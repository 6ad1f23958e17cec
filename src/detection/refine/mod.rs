//! Sub-pixel corners: a parametric model of the blurred corner, fitted to its pixels, with a
//! calibrated standard deviation.
//!
//! | stage | file | what it does |
//! | --- | --- | --- |
//! | window | `window`, `samples` | gathers the pixels along the cells' own axes, short of the next edges |
//! | model | `corner_model`, `gaussian` | two crossing edges, each a Gaussian's integral across |
//! | fit | `fit`, `normal_equations`, `elimination` | weighted least squares, robust against outliers |
//! | two fits | `first_fit`, `second_fit`, `fitted` | each corner by itself, then with what the board knows; whether it is a corner |
//! | print | `print`, `printed`, `print_blur`, `transfer` | takes off the window what is printed beside the two edges, where blur brings it in |
//! | alignment | `aligned`, `alignment`, `rendering_search` | where blur runs edges into each other: moves the whole print until it is most like the image |
//! | shading | `shading`, `local_light`, `power` | takes off light that changes over a corner's window; fits corner and light together, in light |
//! | board | `lattice`, `field`, `noise` | what all corners estimate together: the curvature of the edges, the change of light, the noise |
//! | standard deviation | `corner_std`, `halves`, `scatter`, `misfit`, `straightness` | the fit's own, times one factor for each sign of a larger error: edge halves differ, one corner fits worse than the others, corners leave their lines |
//!
//! Every corner is fitted twice: in a small window by itself, then in a large one, where the board
//! gives the curvature of the edges, the change of light and the noise. Then it is moved by the
//! additional curvature that all large windows together show. `README.md` beside this file has the
//! measurements.

mod aligned;
mod alignment;
mod corner_model;
mod corner_std;
mod edge_curvature;
mod elimination;
mod field;
mod field_sums;
mod first_fit;
mod fit;
mod fitted;
mod gaussian;
mod grid_corner;
mod halves;
mod lattice;
mod local_light;
mod misfit;
mod noise;
mod normal_equations;
mod power;
pub mod print;
mod print_blur;
mod printed;
mod refined_corner;
mod refiner;
mod rendering_search;
mod samples;
mod scatter;
mod second_fit;
mod shading;
mod stepped_field;
mod straightness;
mod transfer;
mod window;
mod window_context;

pub use crate::detection::refine::grid_corner::GridCorner;
pub use crate::detection::refine::refined_corner::RefinedCorner;
pub use crate::detection::refine::refiner::Refiner;
