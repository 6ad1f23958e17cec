//! `plumb calibrate --rig NAME=SOURCE …`: calibrates cameras that are fixed to each other in one
//! solve, each from its own folder or recording.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::result::{CalibratedView, Calibration};
use crate::calibration::same_view::is_same;
use crate::calibration::sensor::SensorId;
use crate::calibration::session::{CameraFrame, FrameContent, Session};
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::calibration::view::View;
use crate::calibration::{
    CameraFrameSets, InstrumentObservations, ObservedFrameSet, SolveOptions, solve,
};
use crate::cli::calibrate_rgbd;
use crate::cli::estimated::{self, GivenLens};
use crate::cli::files::{read_calibration, same_file};
use crate::cli::gather::{check_size, same_as, unused};
use crate::cli::in_order::in_order;
use crate::cli::search::{SearchedImage, searcher, warn_of_rotation};
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::{FrameSets, Unreadable};
use crate::cli::verified::same_size;
use crate::cli::{Failure, progress};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::{BoardView, LensChoice};
use crate::estimation::rig::FrameSetView;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// Frames of two recordings with a smaller time difference than this were taken together, in
/// nanoseconds: half of the interval between frames at 60 a second. A board that moves meanwhile is
/// not shared.
const TOGETHER_NS: i64 = 8_000_000;

/// A camera of the rig, as given on the command line.
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
/// When sources cannot be read or have no frames in common, or the views do not determine
/// everything.
pub fn calibrate(
    cameras: &[NamedSource],
    search: &SearchArgs,
    target: Target,
    options: &CameraOptions,
    given: &[GivenLens],
) -> Result<Calibration, Failure> {
    check_cameras(cameras)?;
    check_given(cameras, given)?;
    let sources = cameras.iter().map(|camera| SearchedSource::of(camera, search, &target));
    let mut sources: Vec<SearchedSource> = sources.collect::<Result<_, _>>()?;
    let searched: Vec<Vec<SearchedImage>> =
        sources.iter_mut().map(|source| std::mem::take(&mut source.images)).collect();
    let frame_sets = frame_sets(cameras, &searched)?;
    let kept = kept(cameras, &searched, &frame_sets, target)?;
    let views = searched.iter().zip(&kept).map(|(searched, kept)| views(searched, kept, &target));
    let (views, copies) = without_copies(views.collect());
    for (source, (searched, views)) in sources.iter_mut().zip(searched.iter().zip(&views)) {
        source.add_unused(searched, views, &copies);
    }
    let asked = AskedRig { search, target, given };
    let each = cameras.iter().zip(searched.iter().zip(views));
    let each = each.map(|(camera, (searched, views))| asked.observations(camera, searched, views));
    let observations = InstrumentObservations {
        board: Some(target),
        cameras: each.collect::<Result<_, Failure>>()?,
    };
    for (_, size) in observations.cameras.iter().flat_map(|camera| &camera.image_sensors) {
        estimated::check_given(&options.given, *size)?;
    }
    let options = SolveOptions { camera: options.clone(), ..SolveOptions::default() };
    let spinner = progress::spinner("solving");
    let solved = solve(&observations, &options);
    spinner.finish_and_clear();
    let mut solved = solved.map_err(Failure::failed)?;
    for (camera, source) in cameras.iter().zip(sources) {
        let id = SensorId::of(&camera.name, SensorKind::Color);
        let Some(color) = solved.image_mut(&id) else { continue };
        for (place, view) in source.unused {
            color.views.insert(place.min(color.views.len()), view);
        }
    }
    Ok(solved)
}

/// Refuses fewer than two cameras, names that occur twice, and sources that do.
fn check_cameras(cameras: &[NamedSource]) -> Result<(), Failure> {
    let names: BTreeSet<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    if cameras.len() < 2 || names.len() < cameras.len() {
        return Err(Failure::usage(
            "a rig is two cameras or more, each with a name of its own: --rig left=SOURCE --rig right=SOURCE",
        ));
    }
    for (k, camera) in cameras.iter().enumerate() {
        let is_same =
            |other: &&NamedSource| same_file(Path::new(&camera.source), Path::new(&other.source));
        if let Some(other) = cameras[..k].iter().find(is_same) {
            return Err(Failure::usage(format!(
                "--rig: {} and {} are one source, {}: give each camera its own",
                other.name, camera.name, camera.source
            )));
        }
    }
    Ok(())
}

/// Refuses a lens that is given twice, or of a camera that the rig has not.
fn check_given(cameras: &[NamedSource], given: &[GivenLens]) -> Result<(), Failure> {
    for (k, lens) in given.iter().enumerate() {
        let sensor = (&lens.camera, lens.sensor);
        if given[..k].iter().any(|earlier| (&earlier.camera, earlier.sensor) == sensor) {
            let (camera, sensor) = (&lens.camera, lens.sensor.name());
            return Err(Failure::usage(format!("--given {camera}.{sensor} twice: give one lens")));
        }
    }
    let is_known = |given: &&GivenLens| cameras.iter().any(|camera| camera.name == given.camera);
    match given.iter().find(|given| !is_known(given)) {
        Some(unknown) => {
            Err(Failure::usage(format!("--given {}: the rig has no such camera", unknown.camera)))
        }
        None => Ok(()),
    }
}

/// The search results of a camera's folder or recording.
#[derive(Default)]
struct SearchedSource {
    images: Vec<SearchedImage>,
    /// Images of a folder that are no views, each with its position among all images.
    unused: Vec<(usize, CalibratedView)>,
}

impl SearchedSource {
    /// Every frame of a camera's source, with the board in it.
    fn of(camera: &NamedSource, search: &SearchArgs, target: &Target) -> Result<Self, Failure> {
        let (mut all, mut first) = (Self::default(), None);
        let mut unreadable = Vec::new();
        let spinner = progress::spinner("searching images");
        in_order(
            FrameSets::new(std::iter::once(camera.source.clone())).reading(&search.reading),
            search.thread_count(),
            || searcher(target, search.detect_options(), 1, None),
            |image| {
                spinner.inc(1);
                match image {
                    Ok(image) => {
                        check_size(&mut first, &image)?;
                        all.images.push(image);
                    }
                    Err(Unreadable { path, reason, .. }) => {
                        let place = all.images.len() + unreadable.len();
                        unreadable.push((place, unused(path, &reason)));
                    }
                }
                Ok::<(), Failure>(())
            },
        )?;
        spinner.finish_and_clear();
        let rotated = all.images.iter().filter(|image| image.states_rotation).count();
        warn_of_rotation(rotated, all.images.len());
        if let (true, Some((_, view))) = (all.images.is_empty(), unreadable.first()) {
            let reason = view.reason.as_deref().unwrap_or_default();
            return Err(Failure::failed(format!(
                "camera `{}`: {}: {reason}",
                camera.name, view.name
            )));
        }
        all.unused = unreadable;
        Ok(all)
    }

    /// Adds the images of a folder that became none of `views`, with the reasons.
    fn add_unused(
        &mut self,
        searched: &[SearchedImage],
        views: &[FrameSetView],
        copies: &BTreeMap<String, String>,
    ) {
        let is_view: BTreeSet<&str> = views.iter().map(|seen| seen.view.name.as_str()).collect();
        let mut unreadable = std::mem::take(&mut self.unused).into_iter().peekable();
        let mut place = 0;
        for image in searched.iter().filter(|image| image.recording.is_none()) {
            while let Some(view) = unreadable.next_if(|(at, _)| *at == place) {
                self.unused.push(view);
                place += 1;
            }
            if !is_view.contains(image.path.as_str()) {
                let reason = match (copies.get(&image.path), &image.answer) {
                    (Some(original), _) => same_as(original),
                    (None, Err(no_board)) => no_board.to_string(),
                    (None, Ok(_)) => "no pose can be estimated from its corners".to_owned(),
                };
                self.unused.push((place, unused(image.path.clone(), &reason)));
            }
            place += 1;
        }
        self.unused.extend(unreadable);
    }
}

/// Views by camera, without the frame sets that every camera sees as it sees an earlier one
/// ([`is_same`]); and, for each view left out, the name of the earlier one.
fn without_copies(
    mut cameras: Vec<Vec<FrameSetView>>,
) -> (Vec<Vec<FrameSetView>>, BTreeMap<String, String>) {
    let mut sets: BTreeMap<usize, Vec<(usize, &FrameSetView)>> = BTreeMap::new();
    for (camera, views) in cameras.iter().enumerate() {
        for seen in views {
            sets.entry(seen.frame_set).or_default().push((camera, seen));
        }
    }
    let (mut kept, mut copies) = (Vec::new(), BTreeMap::new());
    for (frame_set, views) in sets {
        let original = kept.iter().find(|(_, before): &&(usize, Vec<(usize, &FrameSetView)>)| {
            views.len() == before.len()
                && views.iter().zip(before).all(|((camera, seen), (of, before))| {
                    camera == of && is_same(&before.view, &seen.view)
                })
        });
        match original {
            Some((_, before)) => {
                let name = |seen: &FrameSetView| seen.view.name.clone();
                let pairs = views.iter().zip(before);
                copies.extend(pairs.map(|((_, seen), (_, before))| (name(seen), name(before))));
            }
            None => kept.push((frame_set, views)),
        }
    }
    let kept: BTreeSet<usize> = kept.into_iter().map(|(frame_set, _)| frame_set).collect();
    cameras.iter_mut().for_each(|views| views.retain(|seen| kept.contains(&seen.frame_set)));
    (cameras, copies)
}

/// The index of each camera's frame in the frame set, camera by camera.
type FrameSetOf = Vec<Option<usize>>;

/// The frames that were taken together: in folders those with equal names, in recordings those with
/// equal times.
fn frame_sets(
    cameras: &[NamedSource],
    searched: &[Vec<SearchedImage>],
) -> Result<Vec<FrameSetOf>, Failure> {
    let is_timed =
        |frames: &Vec<SearchedImage>| frames.first().is_some_and(|frame| frame.recording.is_some());
    let timed = searched.iter().filter(|frames| is_timed(frames)).count();
    if timed != 0 && timed != searched.len() {
        return Err(Failure::usage(
            "the sources of a rig must be all folders (frames are matched by name) or all recordings (matched by time)",
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
        "no two cameras have frames with the same {how} ({}): frames taken together must have the same {how}",
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

/// Goes through all recordings in order of time; a frame set ends where a camera has its second
/// frame, or at a frame that is later than the first by [`TOGETHER_NS`].
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

/// Camera by camera, the frames that become views, each with its frame set: from folders all with a
/// board, from recordings those that a session keeps.
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

/// What is asked of every camera of the rig.
struct AskedRig<'a> {
    search: &'a SearchArgs,
    target: Target,
    given: &'a [GivenLens],
}

impl AskedRig<'_> {
    /// What `camera` observed in its `views`, which are of the `searched` images.
    fn observations(
        &self,
        camera: &NamedSource,
        searched: &[SearchedImage],
        views: Vec<FrameSetView>,
    ) -> Result<CameraFrameSets, Failure> {
        let given = self.given.iter().find(|given| given.camera == camera.name);
        let size = searched.first().map(|image| image.frame.image_size);
        let given = given.map(|given| given_lens(given, size)).transpose()?;
        let name = Some(camera.name.clone());
        if calibrate_rgbd::has_depth(&camera.source, &self.search.reading) {
            let number = |seen: &FrameSetView| (seen.view.name.clone(), seen.frame_set);
            let numbers: BTreeMap<String, usize> = views.iter().map(number).collect();
            let seen =
                calibrate_rgbd::views_of(&camera.source, self.search, self.target, &numbers)?;
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
}

/// The lens of a calibration that is to be held fixed.
fn given_lens(given: &GivenLens, size: Option<ImageSize>) -> Result<Lens, Failure> {
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
    let sensor = lens.ok_or_else(none)?;
    size.map_or(Ok(()), |size| same_size(size, &file.to_string(), sensor))?;
    Ok(sensor.lens)
}
