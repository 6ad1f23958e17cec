//! What a camera's other sensors give together with a kept view: the board in infrared, the depth
//! picture.

use crate::calibration::second_infrared::{StereoCapture, StereoInput};
use crate::calibration::session::Session;
use crate::calibration::solve_rgbd::{DepthSensor, RgbdCapture, RgbdInput};
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::{DetectOptions, Detection};
use crate::detection::finder::TargetFinder;
use crate::estimation::problem::Correspondence;
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::target::Target;
use crate::imaging::decode;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::factory::FactorySensor;
use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::imaging::picture_file::frame_from_file;
use crate::pipeline::board_look::picture_of;
use crate::pipeline::view_picture::view_picture;
use crate::store::{Companion, Picture};

/// Depth in whole millimeters, as ROS has it (REP 118) and most devices, where nobody states
/// another unit.
const USUAL_UNIT_M: f64 = 0.001;

/// What goes with view `number` besides the picture that was searched; a sensor whose picture is
/// damaged is left out. `unit_m` is the unit of depth, where the device states it.
pub(super) fn companions_of(
    number: u32,
    frame_set: &FrameSet,
    board: &Target,
    unit_m: Option<f64>,
) -> Vec<Companion> {
    let searched = picture_of(frame_set).map(|frame| frame.sensor);
    let others = frame_set.frames.iter().filter(|frame| Some(frame.sensor) != searched);
    let companion = |frame: &Frame| match frame.sensor {
        SensorKind::Depth => {
            let depth = DepthImage::from_frame(frame).ok()?;
            let picture = Picture { media_type: "image/png".to_owned(), bytes: depth.to_png() };
            Some(Companion {
                number,
                sensor: frame.sensor,
                image_size: depth.size(),
                unit_m,
                detection: None,
                picture,
            })
        }
        SensorKind::Color | SensorKind::Infrared | SensorKind::Infrared2 => {
            let (media_type, bytes) = view_picture(frame)?;
            let picture = Picture { media_type: media_type.to_owned(), bytes: bytes.to_vec() };
            let detection = look(frame, board);
            Some(Companion {
                number,
                sensor: frame.sensor,
                image_size: frame.size,
                unit_m: None,
                detection,
                picture,
            })
        }
    };
    others.filter_map(companion).collect()
}

fn look(frame: &Frame, board: &Target) -> Option<Detection> {
    let mut luma = GrayImage::default();
    decode::luma(frame, &mut luma).ok()?;
    TargetFinder::new(board).find(luma.view(), &DetectOptions::default()).ok()
}

/// The joint problem of a session whose views have `companions`, with what the device states of its
/// depth sensor; `None` where none has depth.
pub(super) fn rgbd_input(
    session: &Session,
    companions: &[Companion],
    stated: Option<&FactorySensor>,
) -> Option<RgbdInput> {
    let board = session.record().request.target;
    let of = |number: u32, sensor: SensorKind| {
        companions.iter().find(|companion| companion.number == number && companion.sensor == sensor)
    };
    let first_depth = companions.iter().find(|companion| companion.sensor == SensorKind::Depth)?;
    let capture = |view: &View| RgbdCapture {
        name: view.frame.display_name(),
        time_s: None,
        is_view: true,
        color: view.to_board_view(&board).correspondences,
        infrared: of(view.number, SensorKind::Infrared)
            .map_or_else(Vec::new, |infrared| corners(infrared, view, &board)),
        depth: of(view.number, SensorKind::Depth).and_then(|depth| {
            let frame = frame_from_file(SensorKind::Depth, depth.picture.bytes.clone());
            DepthImage::from_frame(&frame)
                .ok()
                .filter(|picture| picture.size() == first_depth.image_size)
        }),
    };
    let same_camera = |companion: &Companion| companion.image_size == first_depth.image_size;
    let infrared = companions.iter().find(|companion| companion.sensor == SensorKind::Infrared);
    let unit_m = companions.iter().find_map(|companion| companion.unit_m).unwrap_or(USUAL_UNIT_M);
    let depth = DepthSensor {
        reading: Some(DepthReading::Metric { unit_m }),
        invalid: Some(0),
        factory: stated.filter(|stated| stated.image_size == first_depth.image_size).and_then(
            |stated| {
                let depth_from_color = stated.color_from_sensor?.inverse();
                Some((stated.lens?, depth_from_color))
            },
        ),
        with_infrared: infrared.is_some_and(same_camera),
    };
    let part = session.camera(0)?;
    let captures = part.views().iter().map(capture).collect();
    Some(RgbdInput { board, color_size: part.image_size()?, depth, captures })
}

/// Color and right infrared of a session whose views have `companions`; `None` where none has the
/// latter.
pub(super) fn stereo_input(session: &Session, companions: &[Companion]) -> Option<StereoInput> {
    let board = session.record().request.target;
    let infrared2: Vec<&Companion> =
        companions.iter().filter(|companion| companion.sensor == SensorKind::Infrared2).collect();
    let infrared2_size = infrared2.first()?.image_size;
    let of_view = |view: &View| {
        let companion = infrared2.iter().find(|companion| companion.number == view.number);
        companion.filter(|companion| companion.image_size == infrared2_size)
    };
    let capture = |view: &View| StereoCapture {
        name: view.frame.display_name(),
        color: view.to_board_view(&board).correspondences,
        infrared2: of_view(view)
            .map_or_else(Vec::new, |companion| corners(companion, view, &board)),
    };
    let part = session.camera(0)?;
    let captures = part.views().iter().map(capture).collect();
    Some(StereoInput { board, color_size: part.image_size()?, infrared2_size, captures })
}

fn corners(infrared: &Companion, view: &View, board: &Target) -> Vec<Correspondence> {
    let Some(detection) = infrared.detection.clone() else { return Vec::new() };
    let frame = FrameFacts { image_size: infrared.image_size, ..view.frame.clone() };
    View { number: view.number, frame, detection }.to_board_view(board).correspondences
}
