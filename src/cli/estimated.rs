//! The options for what a solve estimates besides the lens, and what it takes as given: the same
//! for every command that solves.

use std::path::{Path, PathBuf};

use crate::cli::Failure;
use crate::cli::files::read_calibration;
use crate::estimation::camera::CameraOptions;
use crate::estimation::given_range::{check_given_range, check_given_value};
use crate::estimation::measured_board::MeasuredBoard;
use crate::estimation::problem::{BoardShape, GivenParameter, Shutter};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::SensorKind;

/// What is known of the board's shape.
#[derive(Debug, Clone, PartialEq, Eq)]
enum BoardShapeArgument {
    Named(BoardShape),
    /// As the calibration in this file measured it.
    Measured(PathBuf),
}

/// The names of [`Shutter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ShutterName {
    Auto,
    Global,
    Rolling,
}

/// What is estimated, and what is known.
#[derive(Debug, clap::Args)]
pub struct EstimatedArgs {
    /// Also estimate skew (otherwise 0).
    #[arg(long)]
    skew: bool,
    /// Constrain fx = fy.
    #[arg(long)]
    square_pixels: bool,
    /// Hold a lens parameter fixed, as in fx=600; for a rig, hold the whole lens of one camera
    /// fixed, as in left.color=calibration.json. May be repeated.
    #[arg(long, value_name = "NAME=VALUE", value_parser = given)]
    given: Vec<GivenArgument>,
    /// The board's shape. auto: as stated, unless the views show deviations; flat: as stated; free:
    /// always estimated; FILE: as measured in the calibration document FILE.
    #[arg(long, value_name = "auto|flat|free|FILE", default_value = "auto", value_parser = board_shape)]
    board_shape: BoardShapeArgument,
    /// The same as --board-shape free.
    #[arg(long, hide = true)]
    warp: bool,
    /// The shutter model. auto: global, unless the views show a rolling shutter; global: all rows
    /// at once; rolling: row after row.
    #[arg(long, value_name = "KIND", default_value = "auto")]
    shutter: ShutterName,
}

impl EstimatedArgs {
    /// Adds these options to `options`.
    ///
    /// # Errors
    /// When a parameter is given twice, or the file with a measured board cannot be read, or has none.
    pub fn add_to(&self, options: &mut CameraOptions) -> Result<(), Failure> {
        options.square_pixels |= self.square_pixels;
        options.skew |= self.skew;
        match &self.board_shape {
            _ if self.warp => options.board_shape = BoardShape::Free,
            BoardShapeArgument::Named(BoardShape::Auto) => {}
            BoardShapeArgument::Named(shape) => options.board_shape = *shape,
            BoardShapeArgument::Measured(file) => {
                options.measured_board = Some(measured_board(file)?);
            }
        }
        match self.shutter {
            ShutterName::Auto => {}
            ShutterName::Global => options.shutter = Shutter::Global,
            ShutterName::Rolling => options.shutter = Shutter::Rolling,
        }
        let parameters = self.given.iter().filter_map(|given| match given {
            GivenArgument::Parameter(parameter) => Some(parameter.clone()),
            GivenArgument::Lens(_) => None,
        });
        for parameter in parameters {
            if options.given.iter().any(|known| known.name == parameter.name) {
                let name = parameter.name;
                return Err(Failure::usage(format!("--given {name} twice: give one value")));
            }
            options.given.push(parameter);
        }
        Ok(())
    }

    /// Whether only defaults are requested.
    pub fn is_default(&self) -> bool {
        !(self.skew || self.square_pixels || self.warp)
            && self.given.is_empty()
            && self.board_shape == BoardShapeArgument::Named(BoardShape::Auto)
            && self.shutter == ShutterName::Auto
    }

    /// The known lenses of a rig's cameras.
    pub fn lenses(&self) -> Vec<GivenLens> {
        let lens = |given: &GivenArgument| match given {
            GivenArgument::Parameter(..) => None,
            GivenArgument::Lens(lens) => Some(lens.clone()),
        };
        self.given.iter().filter_map(lens).collect()
    }

    /// Refuses a complete lens where there is no rig.
    ///
    /// # Errors
    /// When one is given.
    pub fn check_no_lens(&self) -> Result<(), Failure> {
        match self.lenses().first() {
            None => Ok(()),
            Some(lens) => Err(Failure::usage(format!(
                "--given {}.{}: a whole lens is for a camera of a rig, named with --rig; give single parameters, as fx=600",
                lens.camera,
                lens.sensor.name()
            ))),
        }
    }
}

/// A known parameter or lens.
#[derive(Debug, Clone, PartialEq)]
enum GivenArgument {
    /// One parameter.
    Parameter(GivenParameter),
    /// A lens.
    Lens(GivenLens),
}

/// A known lens of a rig's camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GivenLens {
    /// The camera's name.
    pub camera: String,
    /// Which of its sensors.
    pub sensor: SensorKind,
    /// The calibration document that has it.
    pub calibration: PathBuf,
}

/// Reads `PARAMETER=VALUE` or `CAMERA.SENSOR=FILE`.
fn given(text: &str) -> Result<GivenArgument, String> {
    let Some(((camera, sensor), file)) =
        text.split_once('=').and_then(|(name, file)| Some((name.rsplit_once('.')?, file)))
    else {
        return parameter(text).map(GivenArgument::Parameter);
    };
    let kind = SensorKind::from_name(sensor)
        .ok_or_else(|| format!("`{sensor}` is no sensor; write CAMERA.SENSOR, as left.color"))?;
    let calibration = PathBuf::from(file);
    Ok(GivenArgument::Lens(GivenLens { camera: camera.to_owned(), sensor: kind, calibration }))
}

fn board_shape(text: &str) -> Result<BoardShapeArgument, String> {
    let named =
        [("auto", BoardShape::Auto), ("flat", BoardShape::Flat), ("free", BoardShape::Free)];
    if let Some((_, shape)) = named.into_iter().find(|(name, _)| *name == text) {
        return Ok(BoardShapeArgument::Named(shape));
    }
    let file = PathBuf::from(text);
    file.is_file().then_some(BoardShapeArgument::Measured(file)).ok_or_else(|| {
        "write auto, flat, free, or the file of a calibration that measured the board".to_owned()
    })
}

/// The board that a calibration measured.
fn measured_board(file: &Path) -> Result<MeasuredBoard, Failure> {
    let calibration = read_calibration(file)?;
    let mut shapes = calibration.image_sensors().filter_map(|(_, s)| s.board_shape.clone());
    shapes.next().ok_or_else(|| {
        Failure::failed(format!(
            "{}: it has no measured board shape; calibrate with --board-shape free to estimate it",
            file.display()
        ))
    })
}

/// Reads `NAME=VALUE`.
pub(crate) fn parameter(text: &str) -> Result<GivenParameter, String> {
    let (name, value) = text.split_once('=').ok_or("write NAME=VALUE, as fx=600")?;
    let value = value
        .parse()
        .map_err(|_| format!("`{value}` is not a number; write NAME=VALUE, as fx=600"))?;
    let is_known = |model: &LensModel| Lens::parameter_names(*model).contains(&name);
    if !LensModel::ALL.iter().any(is_known) {
        return Err(format!("no lens has a parameter `{name}`; write NAME=VALUE, as fx=600"));
    }
    let given = GivenParameter { name: name.to_owned(), value };
    check_given_value(&given).map_err(|error| error.to_string())?;
    Ok(given)
}

/// Checks that lenses for images of `size` may have the given values.
///
/// # Errors
/// A usage error that names the option.
pub(crate) fn check_given(given: &[GivenParameter], size: ImageSize) -> Result<(), Failure> {
    check_given_range(given, size).map_err(|error| Failure::usage(format!("--given: {error}")))
}
