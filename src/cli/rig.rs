//! `plumb calibrate --rig NAME=SOURCE …`: cameras that are fixed to each other, each from its own
//! folder or recording, in one solve.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::result::Calibration;
use crate::calibration::sensor::SensorId;
use crate::calibration::session::{CameraFrame, FrameContent, Session};
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::calibration::view::View;
use crate::calibration::{
    CameraFrameSets, InstrumentObservations, ObservedFrameSet, SolveOptions, solve,
};
use crate::cli::calibrate_rgbd;
use crate::cli::estimated::GivenLens;
use crate::cli::files::read_calibration;
use crate::cli::in_order::in_order;
use crate::cli::search::{SearchedImage, searcher};
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::FrameSets;
use crate::cli::{Failure, progress};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{BoardView, LensChoice};
use crate::estimation::rig::FrameSetView;
use crate::geometry::lens::Lens;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// Frames of two recordings nearer in time than this were taken together, in nanoseconds: half of
/// what lies between frames at 60 a second. A board that moves meanwhile is not shared.
const TOGETHER_NS: i64 = 8_000_000;

/// A camera of the rig, as it is given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NamedSource {
    /// The camera's name.
    name: String,
    /// Its folder or recording.
    source: String,
}

/// Reads `NAME=SOURCE`.
pub fn named_source(text: &str) -> Result<NamedSource, String> {
    let (name, source) = text.split_once('=').ok_or("write NAME=SOURCE, as left=left/")?;
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if name.is_empty() || !name.chars().all(plain) || source.is_empty() {
        return Err("write NAME=SOURCE, the name of letters, digits, - and _".to_owned());
    }
    Ok(NamedSource { name: name.to_owned(), source: source.to_owned() })
}

/// Calibrates the rig.
///
/// # Errors
/// When sources cannot be read or have nothing in common, or the views leave something open.
pub fn calibrate(
    cameras: &[NamedSource],
    search: &SearchArgs,
    target: Target,
    options: &CameraOptions,
    given: &[GivenLens],
) -> Result<Calibration, Failure> {
    let names: BTreeSet<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    if cameras.len() < 2 || names.len() < cameras.len() {
        return Err(Failure::usage(
            "a rig is two cameras or more, each with a name of its own: --rig left=SOURCE --rig right=SOURCE",
        ));
    }
    if let Some(unknown) = given.iter().find(|given| !names.contains(given.camera.as_str())) {
        return Err(Failure::usage(format!(
            "--given {}: the rig has no such camera",
            unknown.camera
        )));
    }
    let searched = cameras.iter().map(|camera| searched(camera, search, &target));
    let searched: Vec<Vec<SearchedImage>> = searched.collect::<Result<_, _>>()?;
    let frame_sets = frame_sets(cameras, &searched)?;
    let kept = kept(cameras, &searched, &frame_sets, target)?;
    let each = cameras.iter().enumerate().map(|(place, camera)| {
        let views = views(&searched[place], &kept[place], &target);
        observations(camera, (search, target), (&searched[place], views), given)
    });
    let observations = InstrumentObservations {
        board: Some(target),
        cameras: each.collect::<Result<_, Failure>>()?,
    };
    let options = SolveOptions { camera: options.clone(), ..SolveOptions::default() };
    let spinner = progress::spinner("solving");
    let solved = solve(&observations, &options);
    spinner.finish_and_clear();
    solved.map_err(Failure::failed)
}

/// Every frame of a camera's source that could be read, with the board in it.
fn searched(
    camera: &NamedSource,
    search: &SearchArgs,
    target: &Target,
) -> Result<Vec<SearchedImage>, Failure> {
    let mut all = Vec::new();
    let spinner = progress::spinner("searching images");
    let source = std::iter::once(camera.source.clone());
    in_order(
        FrameSets::new(source).reading(&search.reading),
        search.thread_count(),
        || searcher(target, search.detect_options(), 1),
        |image| {
            spinner.inc(1);
            let image = image.map_err(|unreadable| {
                Failure::failed(format!("camera `{}`: {}", camera.name, unreadable.reason))
            })?;
            all.push(image);
            Ok::<(), Failure>(())
        },
    )?;
    spinner.finish_and_clear();
    Ok(all)
}

/// Camera by camera, which of its frames is in the frame set.
type FrameSetOf = Vec<Option<usize>>;

/// The frames that were taken together: those of equal names in folders, of equal times in
/// recordings.
fn frame_sets(
    cameras: &[NamedSource],
    searched: &[Vec<SearchedImage>],
) -> Result<Vec<FrameSetOf>, Failure> {
    let is_timed =
        |frames: &Vec<SearchedImage>| frames.first().is_some_and(|frame| frame.recording.is_some());
    let timed = searched.iter().filter(|frames| is_timed(frames)).count();
    if timed != 0 && timed != searched.len() {
        return Err(Failure::usage(
            "a rig's sources are all folders, whose names say what was taken together, or all recordings, whose times do",
        ));
    }
    let frame_sets = if timed > 0 { by_time(searched) } else { by_name(searched) };
    let is_shared = |frames: &&FrameSetOf| frames.iter().flatten().count() > 1;
    if frame_sets.iter().any(|frames| is_shared(&frames)) {
        return Ok(frame_sets);
    }
    let first = |(camera, frames): (&NamedSource, &Vec<SearchedImage>)| {
        let frame = frames.first().map_or("no frames", |frame| frame.path.as_str());
        format!("{}: {frame}", camera.name)
    };
    let firsts: Vec<String> = cameras.iter().zip(searched).map(first).collect();
    let how = if timed > 0 { "times" } else { "names" };
    Err(Failure::failed(format!(
        "no two cameras have frames of equal {how} ({}): give frames that were taken together equal {how}",
        firsts.join(", ")
    )))
}

fn by_name(searched: &[Vec<SearchedImage>]) -> Vec<FrameSetOf> {
    let mut sets: BTreeMap<String, FrameSetOf> = BTreeMap::new();
    for (camera, frames) in searched.iter().enumerate() {
        for (index, frame) in frames.iter().enumerate() {
            let stem = Path::new(&frame.path).file_stem().unwrap_or_default();
            let set = sets.entry(stem.to_string_lossy().into_owned());
            set.or_insert_with(|| vec![None; searched.len()])[camera] = Some(index);
        }
    }
    let mut sets: Vec<(String, FrameSetOf)> = sets.into_iter().collect();
    sets.sort_by(|a, b| crate::recording::natural_order(&a.0, &b.0));
    sets.into_iter().map(|(_, frames)| frames).collect()
}

/// Goes through all recordings in time; a frame set ends where a camera gives its second frame, or
/// with a frame that is later than its first by [`TOGETHER_NS`].
fn by_time(searched: &[Vec<SearchedImage>]) -> Vec<FrameSetOf> {
    let mut frames: Vec<(i64, usize, usize)> = Vec::new();
    for (camera, own) in searched.iter().enumerate() {
        let timed = own.iter().enumerate();
        frames.extend(timed.map(|(index, frame)| (frame.frame.host_time_ns, camera, index)));
    }
    frames.sort_unstable();
    let mut sets: Vec<(i64, FrameSetOf)> = Vec::new();
    for (time_ns, camera, index) in frames {
        match sets.last_mut() {
            Some((first_ns, set)) if time_ns - *first_ns < TOGETHER_NS && set[camera].is_none() => {
                set[camera] = Some(index);
            }
            _ => {
                let mut set = vec![None; searched.len()];
                set[camera] = Some(index);
                sets.push((time_ns, set));
            }
        }
    }
    sets.into_iter().map(|(_, frames)| frames).collect()
}

/// Camera by camera, the frames that become views, each with its frame set: all with a board of
/// folders, of recordings what a session keeps.
fn kept(
    cameras: &[NamedSource],
    searched: &[Vec<SearchedImage>],
    frame_sets: &[FrameSetOf],
    target: Target,
) -> Result<Vec<Vec<(usize, usize)>>, Failure> {
    let mut kept: Vec<Vec<(usize, usize)>> = vec![Vec::new(); cameras.len()];
    let names: Vec<String> = cameras.iter().map(|camera| camera.name.clone()).collect();
    let is_timed = searched.iter().flatten().any(|frame| frame.recording.is_some());
    let request = SessionRequest {
        target: target.into(),
        lens: LensChoice::Auto,
        finish: None,
        given: Vec::new(),
    };
    let record = SessionRecord::begin("", "", request, 0);
    let mut session = Session::begin(record, &names, &AdmissionOptions::default());
    for (number, frames) in frame_sets.iter().enumerate() {
        let each = frames.iter().enumerate();
        let frame = |(camera, index): (usize, &Option<usize>)| {
            let image = &searched[camera][(*index)?];
            let seen = image.answer.clone().map(FrameContent::from).map_err(Rejection::NoBoard);
            Some(CameraFrame { frame: image.frame.clone(), seen, depth: None })
        };
        let given: Vec<Option<CameraFrame>> = each.map(frame).collect();
        let is_view = |camera: usize| match (&given[camera], is_timed) {
            (Some(frame), false) => frame.seen.is_ok(),
            _ => false,
        };
        let mut views: Vec<usize> = (0..cameras.len()).filter(|camera| is_view(*camera)).collect();
        if is_timed && let Some(observed) = session.observe(&given) {
            views.extend(observed.kept.iter().map(|kept| kept.camera));
        }
        for camera in views {
            kept[camera].extend(frames[camera].map(|index| (number, index)));
        }
    }
    let without = kept.iter().position(Vec::is_empty);
    match without {
        Some(camera) => Err(Failure::failed(format!(
            "camera `{}`: no {} was seen in any of {} frames",
            cameras[camera].name,
            target,
            searched[camera].len()
        ))),
        None => Ok(kept),
    }
}

fn views(
    searched: &[SearchedImage],
    kept: &[(usize, usize)],
    target: &Target,
) -> Vec<FrameSetView> {
    let view = |(frame_set, index): &(usize, usize)| {
        let image = &searched[*index];
        let detection = image.answer.as_ref().ok()?.clone();
        let view = View { number: 0, frame: image.frame.clone(), detection };
        let view = BoardView { name: image.path.clone(), ..view.to_board_view(target) };
        Some(FrameSetView { frame_set: *frame_set, view })
    };
    kept.iter().filter_map(view).collect()
}

fn observations(
    camera: &NamedSource,
    (search, target): (&SearchArgs, Target),
    (searched, views): (&[SearchedImage], Vec<FrameSetView>),
    given: &[GivenLens],
) -> Result<CameraFrameSets, Failure> {
    let given = given.iter().find(|given| given.camera == camera.name);
    let given = given.map(given_lens).transpose()?;
    let name = Some(camera.name.clone());
    if calibrate_rgbd::has_depth(&camera.source, &search.reading) {
        let number = |seen: &FrameSetView| (seen.view.name.clone(), seen.frame_set);
        let numbers: BTreeMap<String, usize> = views.iter().map(number).collect();
        let source = (camera.source.as_str(), &search.reading);
        let seen = calibrate_rgbd::views_of(source, target, search.detect_options(), &numbers)?;
        return Ok(CameraFrameSets { name, given, ..seen });
    }
    Ok(CameraFrameSets {
        name,
        image_sensors: vec![(SensorKind::Color, searched[0].frame.image_size)],
        given,
        depth: None,
        frame_sets: views.into_iter().map(ObservedFrameSet::of_view).collect(),
    })
}

/// The lens of a calibration that is to be held.
fn given_lens(given: &GivenLens) -> Result<Lens, Failure> {
    let file = given.calibration.display();
    if given.sensor != SensorKind::Color {
        return Err(Failure::usage(format!(
            "--given {}.{}: only a color lens can be held",
            given.camera,
            given.sensor.name()
        )));
    }
    let calibration = read_calibration(&given.calibration)?;
    let own = calibration.sensor(&SensorId::of(&given.camera, given.sensor));
    let lens = own.and_then(|sensor| sensor.as_image()).or_else(|| calibration.color());
    let none = || Failure::failed(format!("{file}: it has no color lens of `{}`", given.camera));
    lens.map(|sensor| sensor.lens).ok_or_else(none)
}
