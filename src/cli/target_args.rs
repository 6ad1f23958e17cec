//! The target to search for, as arguments.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::cli::Failure;
use crate::cli::length::Length;
use crate::document::target_file::target_from_text;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::target::Target;

/// A target by its size or in a file.
#[derive(Debug, clap::Args)]
pub struct TargetArgs {
    /// Inner corners of the board, COLSxROWS, as in 9x6: where four squares meet, along a row and
    /// along a column.
    #[arg(long, required_unless_present = "target")]
    board: Option<BoardSize>,
    /// The side of one square, with its unit, as in 25mm.
    #[arg(long, required_unless_present = "target")]
    square: Option<Length>,
    /// Read the target from FILE instead of --board and --square: a chessboard, ChArUco board or
    /// AprilGrid as JSON or TOML, or Kalibr's YAML.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["board", "square"])]
    target: Option<PathBuf>,
}

/// A target whose size does not matter.
#[derive(Debug, clap::Args)]
pub struct ShapeArgs {
    /// Inner corners of the board, COLSxROWS, as in 9x6: where four squares meet, along a row and
    /// along a column.
    #[arg(long, required_unless_present = "target")]
    board: Option<BoardSize>,
    /// Read the target from FILE instead of --board: a chessboard, ChArUco board or AprilGrid as
    /// JSON or TOML, or Kalibr's YAML. For `plumb detect`, `auto` recognizes the board in the
    /// image.
    #[arg(long, value_name = "FILE", conflicts_with = "board")]
    target: Option<PathBuf>,
}

/// A target whose size does not matter, or none.
#[derive(Debug, clap::Args)]
pub struct ShapeOrSceneArgs {
    /// Inner corners of the board, COLSxROWS, as in 9x6: where four squares meet, along a row and
    /// along a column.
    #[arg(long, required_unless_present_any = ["target", "scene"])]
    board: Option<BoardSize>,
    /// Read the target from FILE instead of --board: a chessboard, ChArUco board or AprilGrid as
    /// JSON or TOML, or Kalibr's YAML.
    #[arg(long, value_name = "FILE", conflicts_with = "board")]
    target: Option<PathBuf>,
    /// Use what the images show of a static scene with texture, taken from different places, in
    /// place of a board.
    #[arg(long, conflicts_with_all = ["board", "target", "allow_partial"])]
    scene: bool,
}

impl ShapeOrSceneArgs {
    /// The target, as from [`ShapeArgs::read`]; `None` for a scene.
    ///
    /// # Errors
    /// As [`TargetArgs::read`].
    pub fn read(&self, square_m: f64) -> Result<Option<Target>, Failure> {
        let shape = ShapeArgs { board: self.board, target: self.target.clone() };
        (!self.scene).then(|| shape.read(square_m)).transpose()
    }
}

impl TargetArgs {
    /// The target.
    ///
    /// # Errors
    /// When the file cannot be read, or the target cannot be used.
    pub fn read(&self) -> Result<Target, Failure> {
        match (self.board, self.square, &self.target) {
            (Some(board), Some(square), _) => {
                Ok(Chessboard::new(board, square.meters).map_err(Failure::usage)?.into())
            }
            (_, _, Some(file)) => read_target(file),
            _ => Err(Failure::usage("give --board and --square, or --target")),
        }
    }
}

impl ShapeArgs {
    /// Whether the target is to be recognized.
    pub fn is_auto(&self) -> bool {
        self.target.as_deref() == Some(Path::new("auto"))
    }

    /// The target; a board that is given by its size alone has squares of `square_m` meters.
    ///
    /// # Errors
    /// As [`TargetArgs::read`].
    pub fn read(&self, square_m: f64) -> Result<Target, Failure> {
        if self.is_auto() {
            return Err(Failure::usage("only `plumb detect` takes --target auto: give the target"));
        }
        match (self.board, &self.target) {
            (Some(board), _) => {
                Ok(Chessboard::new(board, square_m).map_err(Failure::usage)?.into())
            }
            (_, Some(file)) => read_target(file),
            _ => Err(Failure::usage("give --board or --target")),
        }
    }
}

/// The target in a file.
///
/// # Errors
/// When it cannot be read, or is not a usable target.
pub fn read_target(path: &Path) -> Result<Target, Failure> {
    let name = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| {
        let remedy = match error.kind() {
            ErrorKind::InvalidData => "save it as UTF-8",
            _ => "check the path",
        };
        Failure::failed(format!("{name}: cannot be read ({error}); {remedy}"))
    })?;
    target_from_text(&text).map_err(|error| Failure::usage(format!("{name}: {error}")))
}
