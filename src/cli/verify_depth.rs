//! `plumb verify` for depth, which is compared with the planes of the boards that color sees.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::calibration::depth_check::{CheckedRange, DepthCheck, DepthView};
use crate::calibration::result::Calibration;
use crate::calibration::sensor::SensorId;
use crate::calibration::view::View;
use crate::cli::Failure;
use crate::cli::calibrate_rgbd::depth_sensor;
use crate::cli::search::{SearchedImage, searcher};
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::FrameSets;
use crate::estimation::board_pose::board_poses;
use crate::estimation::rgbd::motion::{MovingBoard, TimedPose, boards_after};
use crate::geometry::depth_camera::{DepthCamera, DepthReading};
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::SensorKind;

/// If a motion of the depth camera is detectable only from this much on, in meters, the images
/// count as not showing it. Chosen, as an overlay is visibly off from there on.
const CERTAIN_M: f64 = 0.02;

/// The result for depth.
#[derive(Debug, Serialize)]
pub struct VerifiedDepth {
    /// Whether depth is still as calibrated, wherever it was measured.
    pub holds: bool,
    /// Views with readings on the board.
    pub views: usize,
    /// The error of depth, in standard deviations predicted by the calibration: more than 3 is a
    /// change.
    pub off_sigmas: f64,
    /// The smallest motion of the depth camera that is detectable in these views; null if there is
    /// a direction of motion that they do not show.
    pub visible_m: Option<f64>,
    /// By distance, nearest first.
    pub ranges: Vec<VerifiedRange>,
    /// In words.
    #[serde(skip)]
    pub reasons: Vec<String>,
}

/// Depth in one range of distances, in meters.
#[derive(Debug, Serialize)]
pub struct VerifiedRange {
    seen_m: [f64; 2],
    bias_m: f64,
    bias_std_m: Option<f64>,
    spread_m: f64,
    allowed_m: f64,
    views: usize,
}

impl VerifiedDepth {
    /// Whether every possible change would have been detected.
    pub fn saw_all(&self) -> bool {
        self.visible_m.is_some_and(|visible_m| visible_m <= CERTAIN_M)
    }

    /// A line for each range of distances.
    pub fn lines(&self) -> Vec<String> {
        let line = |range: &VerifiedRange| {
            let [from, to] = range.seen_m;
            let mm = |meters: f64| meters * 1000.0;
            let std = range.bias_std_m.map(|std_m| format!(" ± {:.1}", mm(std_m)));
            format!(
                "depth, {from:.2} to {to:.2} m: {:+.1}{} mm error on the board (mean), {:.1} mm (std), limit {:.1} mm",
                mm(range.bias_m),
                std.unwrap_or_default(),
                mm(range.spread_m),
                mm(range.allowed_m)
            )
        };
        self.ranges.iter().map(line).collect()
    }

    fn of(check: &DepthCheck, views: usize) -> Self {
        let mut reasons = Vec::new();
        if !check.holds() {
            reasons.push(change(check));
        }
        let without_depth = views.saturating_sub(check.views + check.moving);
        if without_depth > 0 {
            reasons.push(format!(
                "{without_depth} of {views} views have no depth on the board: check the depth images' unit, times and size"
            ));
        }
        if check.moving > 0 {
            reasons.push(format!(
                "in {} of {views} views the board moved between color and depth, so that they say nothing of depth: hold it still",
                check.moving
            ));
        }
        let what = match check.views {
            1 => "one view with depth".to_owned(),
            count => format!("these {count} views with depth"),
        };
        match check.visible_m {
            Some(visible_m) if visible_m > CERTAIN_M => reasons.push(format!(
                "{what} can only show a motion of the depth camera of {:.0} mm or more: show the board in more poses, tilted",
                visible_m * 1000.0
            )),
            None => reasons.push(format!(
                "{what} cannot show every motion of the depth camera (for example, parallel to an untilted board): show the board in at least 3 poses, tilted"
            )),
            Some(_) => {}
        }
        let range = |range: &CheckedRange| VerifiedRange {
            seen_m: range.seen_m,
            bias_m: range.bias_m,
            bias_std_m: range.bias_std_m.is_finite().then_some(range.bias_std_m),
            spread_m: range.robust_std_m,
            allowed_m: range.allowed_m(),
            views: range.views,
        };
        Self {
            holds: check.holds() && check.views + check.moving > 0,
            views: check.views,
            off_sigmas: check.off_sigmas,
            visible_m: check.visible_m,
            ranges: check.ranges.iter().map(range).collect(),
            reasons,
        }
    }
}

/// What changed, as far as the errors determine it.
fn change(check: &DepthCheck) -> String {
    let sigmas = check.off_sigmas;
    if check.is_scaled() {
        let percent = 100.0 * check.relative_bias;
        return format!(
            "depth differs from the board by {percent:+.1} % in all views, {sigmas:.0} times the predicted uncertainty: check the square size and the unit of the depth images; if both are as at calibration, calibrate again"
        );
    }
    format!(
        "depth differs from the board by {sigmas:.0} times the predicted uncertainty: check that depth and color are of the same device, time and orientation; if they are, the sensors have moved: calibrate again"
    )
}

/// Compares depth with the boards at the poses `views`, by name; `None` if the calibration or the
/// sources have no depth. If the calibration states how much later depth is taken, boards in a
/// recording are also expected where they may have moved by then.
///
/// # Errors
/// For depth in other units than the calibration's, or images of another size.
pub fn verify_depth(
    calibration: &Calibration,
    board: &Target,
    search: &SearchArgs,
    views: &BTreeMap<String, Pose>,
) -> Result<Option<VerifiedDepth>, Failure> {
    let [target, source] = [SensorKind::Color, SensorKind::Depth].map(SensorId::own);
    let pose = calibration.pose(&target, &source);
    let Some((depth, color_from_depth)) = calibration.depth().zip(pose) else { return Ok(None) };
    let mut depth = depth.clone();
    let boards = Boards {
        board,
        views,
        lens: calibration.image(SensorKind::Color).map(|color| color.lens),
        delay_s: depth.time_offset.map_or(0.0, |delay| delay.seconds),
    };
    let mut seen = Vec::new();
    for source in &search.sources {
        seen.extend(boards.with_depth(source, search, &mut depth.camera)?);
    }
    let check = DepthCheck::of(&depth, color_from_depth, board, &seen);
    Ok((!seen.is_empty()).then(|| VerifiedDepth::of(&check, views.len())))
}

/// The boards as color sees them.
struct Boards<'a> {
    board: &'a Target,
    /// The poses of views, by name.
    views: &'a BTreeMap<String, Pose>,
    /// Color's lens, for frames between views.
    lens: Option<Lens>,
    /// How much later depth is taken.
    delay_s: f64,
}

impl Boards<'_> {
    /// The views of a source that have a depth image, in the unit that it states for `camera`.
    fn with_depth(
        &self,
        source: &str,
        search: &SearchArgs,
        camera: &mut DepthCamera,
    ) -> Result<Vec<DepthView>, Failure> {
        let mut detect = searcher(self.board, search.detect_options(), 1, None);
        let (mut moments, mut images, mut stated) = (Vec::new(), Vec::new(), None);
        for frames in FrameSets::new(std::iter::once(source.to_owned())).reading(&search.reading) {
            let frames = frames.map_err(|unreadable| Failure::failed(unreadable.reason))?;
            let path = frames.path();
            let of_depth = frames.set.frame(SensorKind::Depth).cloned();
            // A frame set without a color image was reported when the views were collected.
            let Ok(searched) = detect(Ok(frames)) else { continue };
            let view = self.views.get(&searched.frame.display_name()).copied();
            let time_s = searched.frame.time_ns() as f64 * 1e-9;
            let Some(camera_from_board) = view.or_else(|| self.between_views(searched)) else {
                continue;
            };
            moments.push(TimedPose { time_s, camera_from_board });
            let image = match of_depth.filter(|_| view.is_some()) {
                Some(frame) => Some(
                    DepthImage::from_frame(&frame)
                        .map_err(|error| Failure::failed(format!("{path}: depth: {error}")))?,
                ),
                None => None,
            };
            if let (Some(_), None) = (&image, &stated) {
                let sensor = stated.insert(depth_sensor(source, &search.reading)?);
                as_stated(&mut camera.reading, sensor.reading);
            }
            let expected = camera.image_size;
            if let Some(size) =
                image.as_ref().map(DepthImage::size).filter(|size| *size != expected)
            {
                return Err(Failure::failed(format!(
                    "{path}: its depth image is {size}, the calibration is of {expected}: give images of that size"
                )));
            }
            images.push(image);
        }
        let moving = boards_after(&moments, self.delay_s);
        let view = |(image, board): (Option<DepthImage>, MovingBoard)| {
            Some(DepthView { board, image: image? })
        };
        Ok(images.into_iter().zip(moving).filter_map(view).collect())
    }

    /// The board's pose in a frame of a recording that is not a view, from which the board's motion
    /// follows.
    fn between_views(&self, image: SearchedImage) -> Option<Pose> {
        let lens = self.lens.filter(|_| image.recording.is_some())?;
        let view = View { number: 0, frame: image.frame, detection: image.answer.ok()? };
        let poses = board_poses(&lens, &view.to_board_view(self.board)).ok()?;
        poses.first().map(|found| found.camera_from_board)
    }
}

/// Depth in the unit that the source states, where it states one.
fn as_stated(reading: &mut DepthReading, stated: Option<DepthReading>) {
    if let (DepthReading::Metric { unit_m }, Some(DepthReading::Metric { unit_m: stated_m })) =
        (&mut *reading, stated)
    {
        *unit_m = stated_m;
    }
}
