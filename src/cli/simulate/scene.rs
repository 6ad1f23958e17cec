//! A simulated scene as TOML. Every key has a default.
//!
//! ```toml
//! seed = 1
//! frames = 150
//! fps = 15
//! seat = 0                       # of a rig: 1 is its second camera, whose board is carried about before its first one
//! clutter = 24                   # rectangles on the wall behind the board
//! [board]
//! cols = 9
//! rows = 6
//! square_m = 0.025
//! [camera]
//! width = 640
//! height = 480
//! blur_px = 0.7                  # σ of the optical blur
//! exposure_ms = 4.0
//! gain = 0.9                     # the level of white, 1 is full scale
//! full_well_e = 10000.0          # electrons at full scale: shot noise
//! read_noise_e = 6.0
//! gamma = 2.2
//! vignetting = 0.25
//! jpeg_quality = 90
//! lens = { model = "brown", fx = 560, fy = 560, cx = 320, cy = 240, k1 = -0.2, k2 = 0.05, p1 = 0, p2 = 0, k3 = 0 }   # default: follows from the seed
//! [walk]
//! still_s = 0.4                  # how long the board is held still at each place
//! travel_s = 0.6                 # how long it takes to the next
//! tilt_deg = 50.0
//! roll_deg = 25.0
//! width = [0.38, 0.8]            # the card's width over the image's, farthest and nearest
//! leaving = 0.0                  # part of the places with part of the board outside the image
//! [depth]                        # only if given: an infrared and a depth sensor beside the camera
//! time_offset_ms = 0.0           # by how much they are taken later than the color image they come with
//! noise_per_m = 0.0018           # σ of a reading's noise, in 1/m of inverse depth
//! step_per_m = 0.002             # steps of inverse depth, in 1/m
//! wall_m = 1.8                   # how far the wall behind the board is
//! error = 1.0                    # how much of the systematic error of an ordinary sensor it has
//! [scene]                        # only if given: no board, but a textured world that the camera is carried through
//! world = "room"                 # room, facade, plane, corridor, garden
//! path = "orbit"                 # orbit, sideways, forward, rotation
//! mover = false                  # whether something moves about in it
//! images = 150                   # along all of the path: as many as frames unless said
//! ```

use std::path::Path;

use serde::Deserialize;

use crate::cli::Failure;
use crate::document::lens::LensDocument;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::simulation::{
    CameraPath, RgbdOptions, Scenery, TexturedWorldOptions, WalkOptions, WorldOptions,
};

const FRAMES: u64 = 150;
const JPEG_QUALITY: u8 = 90;
const SIZE: ImageSize = ImageSize::new(640, 480);

/// The scene to render.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SceneFile {
    pub world: WorldOptions,
    pub frames: u64,
    pub jpeg_quality: u8,
    /// The depth and infrared sensors, if there are any.
    pub rgbd: Option<RgbdOptions>,
    /// The textured world that the camera moves through, if there is no board.
    pub textured: Option<TexturedWorldOptions>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenScene {
    seed: Option<u64>,
    frames: Option<u64>,
    fps: Option<f64>,
    seat: Option<u32>,
    clutter: Option<usize>,
    board: WrittenBoard,
    camera: WrittenCamera,
    walk: WrittenWalk,
    depth: Option<WrittenDepth>,
    scene: Option<WrittenWorld>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenWorld {
    world: Option<String>,
    path: Option<String>,
    mover: Option<bool>,
    images: Option<u64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenDepth {
    time_offset_ms: Option<f64>,
    noise_per_m: Option<f64>,
    step_per_m: Option<f64>,
    wall_m: Option<f64>,
    error: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenBoard {
    cols: Option<u32>,
    rows: Option<u32>,
    square_m: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenCamera {
    width: Option<u32>,
    height: Option<u32>,
    blur_px: Option<f64>,
    exposure_ms: Option<f64>,
    gain: Option<f64>,
    full_well_e: Option<f64>,
    read_noise_e: Option<f64>,
    gamma: Option<f64>,
    vignetting: Option<f64>,
    jpeg_quality: Option<u8>,
    lens: Option<LensDocument>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenWalk {
    still_s: Option<f64>,
    travel_s: Option<f64>,
    tilt_deg: Option<f64>,
    roll_deg: Option<f64>,
    width: Option<[f64; 2]>,
    leaving: Option<f64>,
}

impl SceneFile {
    /// Reads the scene at `path`, or takes the default one; `seed` overrides the seed in the file.
    pub(super) fn load(path: Option<&Path>, seed: Option<u64>) -> Result<Self, Failure> {
        let Some(path) = path else {
            return WrittenScene::default().check(seed).map_err(Failure::usage);
        };
        let refused =
            |line: &dyn std::fmt::Display| Failure::usage(format!("{}: {line}", path.display()));
        let text = std::fs::read_to_string(path)
            .map_err(|error| refused(&format!("cannot be read: {error}")))?;
        let written: WrittenScene = toml::from_str(&text).map_err(|error| {
            let line = error
                .span()
                .map_or(0, |span| 1 + text[..span.start.min(text.len())].matches('\n').count());
            Failure::usage(format!("{}:{line}: {}", path.display(), error.message()))
        })?;
        written.check(seed).map_err(|problem| refused(&problem))
    }
}

impl WrittenScene {
    fn check(&self, seed: Option<u64>) -> Result<SceneFile, String> {
        let seed = seed.or(self.seed).unwrap_or(1);
        let camera = &self.camera;
        let side = |key, given: Option<u32>, default| {
            ranged(key, given.map(f64::from), f64::from(default), [16.0, 8192.0])
        };
        let width = side("camera.width", camera.width, SIZE.width)? as u32;
        let height = side("camera.height", camera.height, SIZE.height)? as u32;
        let seat = ranged("seat", self.seat.map(f64::from), 0.0, [0.0, 7.0])? as u32;
        let mut world = WorldOptions::on_rig(seed, ImageSize::new(width, height), seat);
        world.fps = ranged("fps", self.fps, world.fps, [0.1, 1000.0])?;
        world.clutter = self.clutter.unwrap_or(world.clutter).min(10_000);
        let size = BoardSize::new(
            self.board.cols.unwrap_or(world.board.size.cols),
            self.board.rows.unwrap_or(world.board.size.rows),
        );
        let square_m = self.board.square_m.unwrap_or(world.board.square_m);
        let size = size.map_err(|error| format!("board: {error}"))?;
        world.board =
            Chessboard::new(size, square_m).map_err(|error| format!("board.square_m: {error}"))?;
        self.camera.apply(&mut world)?;
        self.walk.apply(&mut world.walk)?;
        let jpeg_quality = ranged(
            "camera.jpeg_quality",
            camera.jpeg_quality.map(f64::from),
            f64::from(JPEG_QUALITY),
            [1.0, 100.0],
        )? as u8;
        let frames =
            ranged("frames", self.frames.map(|frames| frames as f64), FRAMES as f64, [1.0, 1e6])?
                as u64;
        let rgbd = self
            .depth
            .as_ref()
            .map(|depth| depth.apply(RgbdOptions::new(world.clone())))
            .transpose()?;
        let textured = self.scene.as_ref().map(|scene| scene.check(&world, frames)).transpose()?;
        Ok(SceneFile { world, frames, jpeg_quality, rgbd, textured })
    }
}

impl WrittenWorld {
    /// The textured world for the camera of `world`, which takes `frames` frames.
    fn check(&self, world: &WorldOptions, frames: u64) -> Result<TexturedWorldOptions, String> {
        let named = |given: &Option<String>, default: &str| {
            given.clone().unwrap_or_else(|| default.to_owned())
        };
        let (scenery, path) = (named(&self.world, "room"), named(&self.path, "orbit"));
        let given = self.images.map(|images| images as f64);
        let images = ranged("scene.images", given, frames as f64, [frames as f64, 1e6])? as u64;
        let unknown = |key: &str, name: &str, known: &str| {
            format!("scene.{key}: `{name}` is unknown; write {known}")
        };
        Ok(TexturedWorldOptions {
            seed: world.seed,
            scenery: Scenery::from_name(&scenery).ok_or_else(|| {
                unknown("world", &scenery, "room, facade, plane, corridor or garden")
            })?,
            path: CameraPath::from_name(&path)
                .ok_or_else(|| unknown("path", &path, "orbit, sideways, forward or rotation"))?,
            images: images as usize,
            sensor: world.sensor.clone(),
            has_mover: self.mover.unwrap_or(false),
        })
    }
}

impl WrittenCamera {
    fn apply(&self, world: &mut WorldOptions) -> Result<(), String> {
        let sensor = &mut world.sensor;
        sensor.blur_px = ranged("camera.blur_px", self.blur_px, sensor.blur_px, [0.0, 30.0])?;
        let exposure_ms =
            ranged("camera.exposure_ms", self.exposure_ms, sensor.exposure_s * 1e3, [0.0, 1000.0])?;
        sensor.exposure_s = exposure_ms * 1e-3;
        sensor.exposure_gain =
            ranged("camera.gain", self.gain, sensor.exposure_gain, [0.0, 100.0])?;
        sensor.full_well_e =
            ranged("camera.full_well_e", self.full_well_e, sensor.full_well_e, [1.0, 1e12])?;
        sensor.read_noise_e =
            ranged("camera.read_noise_e", self.read_noise_e, sensor.read_noise_e, [0.0, 1e6])?;
        sensor.gamma = ranged("camera.gamma", self.gamma, sensor.gamma, [0.2, 5.0])?;
        sensor.vignetting =
            ranged("camera.vignetting", self.vignetting, sensor.vignetting, [0.0, 1.0])?;
        if let Some(lens) = &self.lens {
            sensor.lens = Lens::try_from(lens).map_err(|error| format!("camera.lens: {error}"))?;
        }
        Ok(())
    }
}

impl WrittenDepth {
    fn apply(&self, mut rgbd: RgbdOptions) -> Result<RgbdOptions, String> {
        let offset_ms =
            ranged("depth.time_offset_ms", self.time_offset_ms, 0.0, [-1000.0, 1000.0])?;
        rgbd.time_offset_s = offset_ms * 1e-3;
        let sensor = &mut rgbd.depth;
        sensor.noise_per_m =
            ranged("depth.noise_per_m", self.noise_per_m, sensor.noise_per_m, [0.0, 1.0])?;
        sensor.step_per_m =
            ranged("depth.step_per_m", self.step_per_m, sensor.step_per_m, [0.0, 1.0])?;
        let part = ranged("depth.error", self.error, 1.0, [0.0, 10.0])?;
        let fields = [&mut sensor.error.scale, &mut sensor.error.offset];
        fields.into_iter().flatten().for_each(|coefficient| *coefficient *= part);
        rgbd.wall[0] = ranged("depth.wall_m", self.wall_m, rgbd.wall[0], [0.1, 1000.0])?;
        Ok(rgbd)
    }
}

impl WrittenWalk {
    fn apply(&self, walk: &mut WalkOptions) -> Result<(), String> {
        walk.still_s = ranged("walk.still_s", self.still_s, walk.still_s, [0.0, 3600.0])?;
        walk.travel_s = ranged("walk.travel_s", self.travel_s, walk.travel_s, [0.01, 3600.0])?;
        walk.tilt = ranged("walk.tilt_deg", self.tilt_deg, walk.tilt.to_degrees(), [0.0, 85.0])?
            .to_radians();
        walk.roll = ranged("walk.roll_deg", self.roll_deg, walk.roll.to_degrees(), [0.0, 180.0])?
            .to_radians();
        walk.leaving = ranged("walk.leaving", self.leaving, walk.leaving, [0.0, 1.0])?;
        let [far, near] = self.width.unwrap_or(walk.width);
        walk.width = [
            ranged("walk.width[0]", Some(far), far, [0.01, 5.0])?,
            ranged("walk.width[1]", Some(near), near, [0.01, 5.0])?,
        ];
        Ok(())
    }
}

/// The given number, or the default; a number outside `low` to `high` is refused, and so is NaN.
fn ranged(
    key: &str,
    given: Option<f64>,
    default: f64,
    [low, high]: [f64; 2],
) -> Result<f64, String> {
    let value = given.unwrap_or(default);
    let fits = value >= low && value <= high;
    if fits {
        Ok(value)
    } else {
        Err(format!("{key}: {value} is impossible; write {low} to {high}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<SceneFile, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        let line = |failure: Failure| {
            failure.line().unwrap().split_once("scene.toml").unwrap().1.to_owned()
        };
        SceneFile::load(Some(&path), None).map_err(line)
    }

    #[test]
    fn the_keys_of_the_page_above_are_read() {
        let page = include_str!("scene.rs");
        let toml: Vec<&str> =
            page.lines().skip_while(|line| *line != "//! ```toml").skip(1).collect();
        let toml: Vec<&str> = toml.into_iter().take_while(|line| *line != "//! ```").collect();
        let text =
            toml.iter().map(|line| line.trim_start_matches("//!")).collect::<Vec<_>>().join("\n");
        let scene = load(&text).unwrap();
        let defaults = SceneFile::load(None, None).unwrap();
        assert_eq!(scene.world.walk, defaults.world.walk);
        let sensor = crate::simulation::ImageSensor {
            lens: defaults.world.sensor.lens,
            ..scene.world.sensor.clone()
        };
        assert_eq!(sensor, defaults.world.sensor);
        let world = scene.world.clone();
        assert_eq!(scene.rgbd, Some(RgbdOptions::new(world)));
        let textured = scene.textured.unwrap();
        assert_eq!((textured.scenery, textured.path), (Scenery::Room, CameraPath::Orbit));
        assert_eq!((textured.images, textured.has_mover), (150, false));
        assert_eq!((scene.frames, scene.jpeg_quality, scene.world.fps), (150, 90, 15.0));
    }

    #[test]
    fn what_cannot_be_is_refused_at_its_line_or_key() {
        let table = [
            ("fps = 0", ": fps: 0 is impossible; write 0.1 to 1000"),
            ("\npaint = 1", ":2: unknown field `paint`"),
            ("[board]\ncols = 2", ": board: a board of 2x6 inner corners cannot be used"),
            ("[camera]\nwidth = 1", ": camera.width: 1 is impossible"),
            ("[camera]\nblur_px = nan", ": camera.blur_px: NaN is impossible"),
            (
                "[camera]\nlens = { model = \"brown\", fx = 1, fy = 1, cx = 0, cy = 0 }",
                ": camera.lens: k1",
            ),
            ("fps = [", ":1: "),
            ("[scene]\nworld = \"sea\"", ": scene.world: `sea` is unknown; write room, facade"),
        ];
        for (text, expected) in table {
            let line = load(text).unwrap_err();
            assert!(line.starts_with(expected), "{line:?} for {text:?}");
        }
    }
}
