//! The input of an estimate: points of the board with their pixels, view by view, and the
//! parameters to estimate.

use nalgebra::Point3;

use crate::estimation::error::EstimationError;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::measured_board::MeasuredBoard;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

/// A point of the board and its pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// In meters.
    pub point_in_board: Point3<f64>,
    /// Where it was observed.
    pub pixel: Pixel,
    /// Standard deviation of `pixel` per axis, in pixels. Only ratios matter: the noise level
    /// itself is estimated.
    pub std_px: f64,
}

impl Correspondence {
    /// The same corner at its position on a measured `board`; at its stated position, if that was
    /// not measured.
    #[must_use]
    pub fn placed_on(&self, board: &MeasuredBoard) -> Self {
        let offset_m = board.offset_at(&self.point_in_board).unwrap_or_default();
        Self { point_in_board: self.point_in_board + offset_m, ..*self }
    }
}

/// One image of the board.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// The name of the view in errors and results: a path or a sequence number.
    pub name: String,
    /// The observed corners.
    pub correspondences: Vec<Correspondence>,
}

/// Which lens model to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensChoice {
    /// This one.
    Model(LensModel),
    /// The simplest one that no larger one beats on held-out views; without these, in the fit.
    Auto,
}

/// A camera to calibrate.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraProblem {
    /// The size of its images.
    pub image_size: ImageSize,
    /// The observed views.
    pub views: Vec<BoardView>,
}

/// The shape that a flat board may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BoardShape {
    /// Exactly as stated, unless the views show that it is not: then its shape is estimated.
    #[default]
    Auto,
    /// Exactly as stated.
    Flat,
    /// Estimated, whether or not the views show that it has one.
    Free,
}

/// How the rows of an image are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shutter {
    /// All at once, unless the views show that the board moved from row to row.
    #[default]
    Auto,
    /// All at once.
    Global,
    /// One after another, while the board or the camera moves.
    Rolling,
}

/// What to estimate, and the start.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraOptions {
    /// The lens model. Default: chosen by held-out error.
    pub lens: LensChoice,
    /// Whether skew is estimated; else it is 0. Default: no.
    pub skew: bool,
    /// Whether fx = fy. Default: no.
    pub square_pixels: bool,
    /// The shape that the board may have. Default: detected from the views.
    pub board_shape: BoardShape,
    /// The board as measured before: its corners have the measured positions, and its shape is not
    /// estimated again. Default: none.
    pub measured_board: Option<MeasuredBoard>,
    /// How the sensor reads its rows. Default: detected from the views.
    pub shutter: Shutter,
    /// Lens parameters that are known. Default: none.
    pub given: Vec<GivenParameter>,
    /// An earlier estimate to start from. Default: none.
    pub start: Option<CameraStart>,
    /// Whether an exact copy of another view counts again, as where another sensor had a different
    /// view then. Default: no.
    pub copies_count: bool,
    /// Ends the estimate early. Default: nothing does.
    pub interrupt: Interrupt,
}

/// A lens parameter that is known.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenParameter {
    /// Its name, as in [`Lens::parameter_names`].
    pub name: String,
    /// Its value; focal lengths and the principal point are in pixels.
    pub value: f64,
}

impl GivenParameter {
    /// Every parameter of `lens`.
    pub fn all_of(lens: &Lens) -> Vec<Self> {
        let names = Lens::parameter_names(lens.model()).into_iter();
        let given = |(name, value): (&str, f64)| Self { name: name.to_owned(), value };
        names.zip(lens.parameters()).map(given).collect()
    }
}

impl CameraOptions {
    /// Options that fix every parameter of `lens`; `interrupt` ends the estimate.
    pub fn holding(lens: &Lens, interrupt: &Interrupt) -> Self {
        Self {
            lens: LensChoice::Model(lens.model()),
            given: GivenParameter::all_of(lens),
            interrupt: interrupt.clone(),
            ..Self::default()
        }
    }

    /// The same without the given coefficients of `model`. Other models have no such coefficients,
    /// or different ones of the same name.
    #[must_use]
    pub(crate) fn without_given_coefficients(mut self, model: LensModel) -> Self {
        self.given.retain(|given| !model.coefficient_names().contains(&given.name.as_str()));
        self
    }

    /// The same with the board as stated and all rows read at once.
    #[must_use]
    pub fn as_stated(self) -> Self {
        Self { board_shape: BoardShape::Flat, shutter: Shutter::Global, ..self }
    }
}

impl Default for CameraOptions {
    fn default() -> Self {
        Self {
            lens: LensChoice::Auto,
            skew: false,
            square_pixels: false,
            board_shape: BoardShape::Auto,
            measured_board: None,
            shutter: Shutter::Auto,
            given: Vec::new(),
            start: None,
            copies_count: false,
            interrupt: Interrupt::default(),
        }
    }
}

/// An estimate of nearly the same problem.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraStart {
    /// Its lens; used where it is of the model to fit.
    pub lens: Lens,
    /// Its `camera_from_board` for the problem's first views; the poses of further views, and of
    /// views without one, are estimated from scratch.
    pub camera_from_board: Vec<Option<Pose>>,
    /// Its [`crate::estimation::camera_estimate::CameraEstimate::noise_floor_px`].
    pub noise_floor_px: f64,
}

pub(crate) fn check(problem: &CameraProblem) -> Result<(), EstimationError> {
    let ImageSize { width, height } = problem.image_size;
    if width == 0 || height == 0 {
        return Err(EstimationError::ImageSize { width, height });
    }
    for view in &problem.views {
        for (point, c) in view.correspondences.iter().enumerate() {
            let not_finite =
                |what| EstimationError::NotFinite { view: view.name.clone(), point, what };
            if !c.point_in_board.coords.iter().all(|v| v.is_finite()) {
                return Err(not_finite("the board point"));
            }
            if !c.pixel.is_finite() {
                return Err(not_finite("the pixel"));
            }
            if !(c.std_px > 0.0 && c.std_px.is_finite()) {
                return Err(EstimationError::Std {
                    view: view.name.clone(),
                    point,
                    std_px: c.std_px,
                });
            }
        }
    }
    Ok(())
}
