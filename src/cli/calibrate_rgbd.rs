//! `plumb calibrate` of a recording with color and depth.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::result::Calibration;
use crate::calibration::session::Session;
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::calibration::solve::rgbd_input::DepthSensor;
use crate::calibration::view::{FrameFacts, View};
use crate::calibration::{
    CameraFrameSets, InstrumentObservations, ObservedFrameSet, SolveOptions, solve,
};
use crate::cli::calibration_output::named;
use crate::cli::estimated::check_given;
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::{FrameSets, SourcedFrames, TopicArgs, is_recording};
use crate::cli::{Failure, progress};
use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::finder::TargetFinder;
use crate::document::sensors_file::SensorsFile;
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{Correspondence, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::decode::luma;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::recording::Recording;

/// How many frame sets of a recording file are searched for a depth frame.
const SEARCHED_FOR_DEPTH: usize = 30;

/// Whether `source` is a recording with depth.
pub fn has_depth(source: &str, reading: &TopicArgs) -> bool {
    let path = Path::new(source);
    if path.is_dir() && !is_recording(path) {
        return path.join("depth").is_dir();
    }
    let depth = |frames: &SourcedFrames| frames.set.frame(SensorKind::Depth).is_some();
    is_recording(path)
        && FrameSets::new(std::iter::once(source.to_owned()))
            .reading(reading)
            .take(SEARCHED_FOR_DEPTH)
            .any(|frames| frames.is_ok_and(|f| depth(&f)))
}

/// Calibrates the color, infrared (left and right) and depth sensors of one recording. Also returns
/// the time of the solve in milliseconds.
///
/// # Errors
/// When the recording cannot be read, does not state its depth encoding, or shows too little.
pub fn calibrate(
    source: &str,
    reading: &TopicArgs,
    target: Target,
    options: &CameraOptions,
    detect: DetectOptions,
) -> Result<(Calibration, f64), Failure> {
    let depth = depth_sensor(source, reading)?;
    let mut gathered = RgbdGathering::new(source, target, detect);
    let spinner = progress::spinner("searching images");
    for frames in FrameSets::new(std::iter::once(source.to_owned())).reading(reading) {
        spinner.inc(1);
        let frames = frames.map_err(|unreadable| Failure::failed(unreadable.reason))?;
        gathered.add(&frames)?;
    }
    spinner.finish_and_clear();
    let gathered = gathered.finish(depth)?;
    if let Some(size) = gathered.image_size(SensorKind::Color) {
        check_given(&options.given, size)?;
    }
    let observations = InstrumentObservations::of_camera(Some(target), gathered);
    let options = SolveOptions { camera: options.clone(), ..SolveOptions::default() };
    let spinner = progress::spinner("solving");
    let started = Instant::now();
    let solved = solve(&observations, &options);
    let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
    spinner.finish_and_clear();
    let solved = solved.map_err(|error| Failure::failed(format!("{source}: {error}")))?;
    Ok((named(solved), elapsed_ms))
}

/// The views of the sensors of one recording in the frame sets with these paths, with their
/// numbers.
///
/// # Errors
/// As for [`calibrate`].
pub fn views_of(
    source: &str,
    search: &SearchArgs,
    target: Target,
    numbers: &BTreeMap<String, usize>,
) -> Result<CameraFrameSets, Failure> {
    let depth = depth_sensor(source, &search.reading)?;
    let mut gathered = RgbdGathering::new(source, target, search.detect_options());
    for frames in FrameSets::new(std::iter::once(source.to_owned())).reading(&search.reading) {
        let mut frames = frames.map_err(|unreadable| Failure::failed(unreadable.reason))?;
        let path = frames.path();
        if numbers.contains_key(&path) {
            // Treated like an image chosen by hand: it is a view, and its time is ignored.
            (frames.recording, frames.set.name) = (None, Some(path));
            gathered.add(&frames)?;
        }
    }
    let mut camera = gathered.finish(depth)?;
    for seen in &mut camera.frame_sets {
        seen.number = numbers.get(&seen.name).copied().unwrap_or(seen.number);
    }
    camera.frame_sets.sort_by_key(|seen| seen.number);
    Ok(camera)
}

/// What a recording states about its depth. Where it states no unit, 16-bit depth is in millimeters
/// (ROS REP 118).
pub(super) fn depth_sensor(source: &str, reading: &TopicArgs) -> Result<DepthSensor, Failure> {
    let path = Path::new(source);
    let (encoding, factory) = match SensorsFile::of_folder(path).map_err(Failure::failed)? {
        Some(stated) => {
            stated.warn_of_unused(path);
            let encoding = stated.depth.encoding().map_err(Failure::failed)?;
            (Some(encoding), stated.depth_factory().map_err(Failure::failed)?)
        }
        None if is_recording(path) => {
            let stated = Recording::open(path, &reading.read_options())
                .map_err(|error| Failure::failed(format!("{source}: {error}")))?
                .factory();
            let of_depth = stated.sensor(SensorKind::Depth);
            let factory = of_depth.and_then(|depth| depth.depth_lens(depth.image_size));
            (stated.depth_encoding, factory)
        }
        None => (None, None),
    };
    let DepthEncoding { reading, invalid } = encoding.unwrap_or(DepthEncoding::ORDINARY);
    Ok(DepthSensor { reading, invalid, factory, with_infrared: true })
}

struct RgbdGathering<'a> {
    source: &'a str,
    target: Target,
    detect: DetectOptions,
    finder: TargetFinder,
    image: GrayImage,
    sizes: BTreeMap<SensorKind, ImageSize>,
    session: Option<Session>,
    frame_sets: Vec<ObservedFrameSet>,
    first_reason: Option<String>,
    frames: usize,
}

impl<'a> RgbdGathering<'a> {
    fn new(source: &'a str, target: Target, detect: DetectOptions) -> Self {
        Self {
            source,
            target,
            detect,
            finder: TargetFinder::new(&target),
            image: GrayImage::default(),
            sizes: BTreeMap::new(),
            session: None,
            frame_sets: Vec::new(),
            first_reason: None,
            frames: 0,
        }
    }

    fn add(&mut self, frames: &SourcedFrames) -> Result<(), Failure> {
        self.frames += 1;
        let path = frames.path();
        let color = self.detect_in(&frames.set, SensorKind::Color, &path)?;
        if let Some((size, _)) = &color {
            self.same_size(*size, SensorKind::Color, &path)?;
        }
        let is_view = frames.recording.is_none() || self.keep(&frames.set, color.as_ref());
        let mut corners = vec![(SensorKind::Color, self.corners(color))];
        // Between views, infrared is used with color to determine the time offset of depth.
        let others = SensorKind::ALL.into_iter().filter(|kind| {
            kind.is_image() && *kind != SensorKind::Color && (is_view || kind.is_of_depth())
        });
        for kind in others {
            let seen = self.detect_in(&frames.set, kind, &path)?;
            if let Some((size, _)) = &seen {
                self.same_size(*size, kind, &path)?;
            }
            corners.push((kind, self.corners(seen)));
        }
        let depth = match frames.set.frame(SensorKind::Depth).filter(|_| is_view) {
            Some(frame) => {
                let image = DepthImage::from_frame(frame)
                    .map_err(|error| Failure::failed(format!("{path}: depth: {error}")))?;
                self.same_size(image.size(), SensorKind::Depth, &path)?;
                Some(image)
            }
            None => None,
        };
        let time =
            frames.set.device_time.map_or(frames.set.host_time.utc_ns, |time| time.monotonic_ns);
        let time_s = frames.recording.is_some().then_some(time as f64 * 1e-9);
        let seen_with_depth = |(kind, corners): &(SensorKind, Vec<Correspondence>)| {
            (*kind == SensorKind::Color || kind.is_of_depth()) && !corners.is_empty()
        };
        if corners.iter().any(seen_with_depth) || (is_view && depth.is_some()) {
            let number = self.frame_sets.len();
            self.frame_sets.push(ObservedFrameSet {
                number,
                name: path,
                time_s,
                is_view,
                corners,
                depth,
            });
        }
        Ok(())
    }

    /// Detects the board in one sensor's image.
    #[expect(clippy::type_complexity, reason = "an image's size and what was seen in it")]
    fn detect_in(
        &mut self,
        set: &FrameSet,
        sensor: SensorKind,
        path: &str,
    ) -> Result<Option<(ImageSize, Result<Detection, NoBoard>)>, Failure> {
        let Some(frame) = set.frame(sensor) else { return Ok(None) };
        luma(frame, &mut self.image)
            .map_err(|error| Failure::failed(format!("{path}: {}: {error}", sensor.name())))?;
        let seen = self.finder.find(self.image.view(), &self.detect);
        if let (Err(no_board), None) = (&seen, &self.first_reason) {
            self.first_reason = Some(format!("{path}: {}: {no_board}", sensor.name()));
        }
        Ok(Some((self.image.size(), seen)))
    }

    fn same_size(
        &mut self,
        size: ImageSize,
        sensor: SensorKind,
        path: &str,
    ) -> Result<(), Failure> {
        let expected = *self.sizes.entry(sensor).or_insert(size);
        if expected == size {
            return Ok(());
        }
        let sensor = sensor.name();
        Err(Failure::failed(format!(
            "{path}: its {sensor} image is {size}, those before it are {expected}: calibrate each size by itself"
        )))
    }

    /// Whether the session that a recording goes through keeps this frame set.
    fn keep(
        &mut self,
        set: &FrameSet,
        color: Option<&(ImageSize, Result<Detection, NoBoard>)>,
    ) -> bool {
        let Some((image_size, seen)) = color else { return false };
        let target = self.target;
        let session = self.session.get_or_insert_with(|| {
            let request = SessionRequest {
                target: target.into(),
                lens: LensChoice::Auto,
                finish: None,
                given: Vec::new(),
            };
            Session::begin(
                SessionRecord::begin("", "", request, set.host_time.utc_ns),
                &[],
                &AdmissionOptions::default(),
            )
        });
        let frame = FrameFacts {
            sequence: set.sequence,
            name: set.name.clone(),
            host_time_ns: set.host_time.utc_ns,
            device_time_ns: set.device_time.map(|time| time.monotonic_ns),
            image_size: *image_size,
        };
        let observed = session.observe_frame(frame, seen.clone().map_err(Rejection::NoBoard));
        observed.is_some_and(|observed| !observed.kept.is_empty())
    }

    fn corners(
        &self,
        seen: Option<(ImageSize, Result<Detection, NoBoard>)>,
    ) -> Vec<Correspondence> {
        let Some((image_size, Ok(detection))) = seen else { return Vec::new() };
        let frame = FrameFacts {
            sequence: 0,
            name: None,
            host_time_ns: 0,
            device_time_ns: None,
            image_size,
        };
        View { number: 0, frame, detection }.to_board_view(&self.target).correspondences
    }

    fn finish(self, mut depth: DepthSensor) -> Result<CameraFrameSets, Failure> {
        let mut of_depth = SensorKind::ALL.iter().filter(|kind| kind.is_of_depth());
        let infrared = of_depth.find_map(|kind| self.sizes.get(kind));
        depth.with_infrared =
            infrared.is_none_or(|size| self.sizes.get(&SensorKind::Depth) == Some(size));
        let saw = |seen: &ObservedFrameSet| !seen.corners(SensorKind::Color).is_empty();
        match self.sizes.get(&SensorKind::Color).copied() {
            Some(_) if self.frame_sets.iter().any(saw) => Ok(CameraFrameSets {
                name: None,
                image_sensors: self.sizes.into_iter().filter(|(kind, _)| kind.is_image()).collect(),
                given: None,
                depth: Some(depth),
                frame_sets: self.frame_sets,
            }),
            Some(_) => Err(Failure::failed(format!(
                "{}: no {} was seen in any of {} frames; the first: {}",
                self.source,
                self.target,
                self.frames,
                self.first_reason.unwrap_or_default()
            ))),
            None => Err(Failure::failed(format!(
                "{}: it has depth but no color images, and the board is detected in color: {}",
                self.source,
                if Path::new(self.source).is_dir() {
                    "put them into its folder color/, named as those in depth/ that were taken with them"
                } else {
                    "record the topic of color too"
                }
            ))),
        }
    }
}
