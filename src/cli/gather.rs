//! Collects the views of a calibration from searched images.

use std::collections::BTreeMap;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::result::CalibratedView;
use crate::calibration::same_view::is_same;
use crate::calibration::session::Session;
use crate::calibration::session::camera::CameraPart;
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::calibration::view::View;
use crate::cli::board_check::BoardCheck;
use crate::cli::in_order::in_order;
use crate::cli::search::{SearchedImage, searcher, warn_of_rotation};
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::{FrameSets, Unreadable};
use crate::cli::{Failure, progress};
use crate::detection::board_detection::{BoardMarkers, Detection};
use crate::estimation::problem::{BoardView, CameraProblem, LensChoice};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;

/// Fewer corners cannot determine a board's pose and also add information about the lens.
const LEAST_CORNERS: usize = 6;

/// Collects views from images. An image that was chosen by hand (a file, or one of a folder) is a
/// view if the board is found in it. The frames of a recording go through a session, which keeps
/// those that are sharp, still and different from each other, as it would live.
#[derive(Debug)]
pub struct ImageGathering {
    target: Target,
    /// The first image's name and size.
    size: Option<(String, ImageSize)>,
    /// Every image in order: a view, or the reason why it is none. Frames of a recording that its
    /// session did not keep are not included.
    images: Vec<Result<BoardView, (String, String)>>,
    session: Option<(String, Session)>,
    searched: usize,
    /// How many of them state a rotation, which is not applied.
    rotated: usize,
    /// For each image without the target: the reason, and the line that also names the image.
    reasons: Vec<(String, String)>,
    /// The markers in the first image that shows the target.
    markers: Option<BoardMarkers>,
}

impl ImageGathering {
    /// Without any images.
    pub fn new(target: Target) -> Self {
        Self {
            target,
            size: None,
            images: Vec::new(),
            session: None,
            searched: 0,
            rotated: 0,
            reasons: Vec::new(),
            markers: None,
        }
    }

    /// Takes the next image.
    ///
    /// # Errors
    /// When its size is not that of the images before it.
    pub fn add(&mut self, image: Result<SearchedImage, Unreadable>) -> Result<(), Failure> {
        self.searched += 1;
        match image {
            Ok(image) => {
                check_size(&mut self.size, &image)?;
                self.rotated += usize::from(image.states_rotation);
                let seen = image.answer.as_ref().ok();
                self.markers = self.markers.or(seen.and_then(|seen| seen.markers));
                if let Err(no_board) = &image.answer {
                    let reason = no_board.to_string();
                    self.reasons.push((reason.clone(), format!("{}: {reason}", image.path)));
                }
                if image.recording.is_some() { self.observe(&image) } else { self.take(image) }
            }
            Err(Unreadable { path, reason, .. }) => {
                self.end_recording();
                self.reasons.push((reason.clone(), reason.clone()));
                self.images.push(Err((path, reason)));
            }
        }
        Ok(())
    }

    /// The problem with the views, and the images that are no views, each with its position among
    /// all images.
    ///
    /// # Errors
    /// When the board was found in none.
    pub fn finish(mut self) -> Result<(CameraProblem, Vec<(usize, CalibratedView)>), Failure> {
        self.end_recording();
        let (count, line) = self.commonest_reason();
        let (mut views, mut others) = (Vec::new(), Vec::new());
        for (place, image) in self.images.into_iter().enumerate() {
            match image {
                Ok(view) => views.push(view),
                Err((name, reason)) => others.push((place, unused(name, &reason))),
            }
        }
        let which =
            if count > 1 { format!("most often ({count})") } else { "the first".to_owned() };
        match self.size {
            Some((_, image_size)) if !views.is_empty() => {
                Ok((CameraProblem { image_size, views }, others))
            }
            _ if self.searched == 1 => Err(Failure::failed(line)),
            _ => Err(Failure::failed(format!(
                "no {} was seen in any of {} images; {which}: {line}",
                self.target, self.searched
            ))),
        }
    }

    /// The target, as printed according to its markers.
    pub fn target_as_seen(&self) -> Target {
        self.markers.map_or(self.target, |markers| markers.as_printed(&self.target))
    }

    /// How many images had the most frequent reason, and the line of the first of them.
    fn commonest_reason(&self) -> (usize, String) {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for (reason, _) in &self.reasons {
            *counts.entry(reason).or_default() += 1;
        }
        let most = counts.values().copied().max().unwrap_or(0);
        let first = self.reasons.iter().find(|(reason, _)| counts[reason.as_str()] == most);
        (most, first.map_or_else(String::new, |(_, line)| line.clone()))
    }

    fn take(&mut self, image: SearchedImage) {
        self.end_recording();
        let name = image.path;
        self.images.push(match image.answer {
            Ok(Detection { corners, .. }) if corners.len() < LEAST_CORNERS => {
                Err((name, format!("only {} corners are seen", corners.len())))
            }
            Ok(detection) => {
                let view = View { number: 0, frame: image.frame, detection };
                let view = BoardView { name, ..view.to_board_view(&self.target) };
                let mut earlier = self.images.iter().flatten();
                match earlier.find(|earlier| is_same(earlier, &view)) {
                    Some(earlier) => Err((view.name, same_as(&earlier.name))),
                    None => Ok(view),
                }
            }
            Err(no_board) => Err((name, no_board.to_string())),
        });
    }

    fn observe(&mut self, image: &SearchedImage) {
        let path = image.recording.as_deref().unwrap_or_default();
        if self.session.as_ref().is_some_and(|(open, _)| open != path) {
            self.end_recording();
        }
        let (_, session) = self.session.get_or_insert_with(|| {
            let request = SessionRequest {
                target: self.target.into(),
                lens: LensChoice::Auto,
                finish: None,
                given: Vec::new(),
            };
            let record = SessionRecord::begin("", "", request, image.frame.host_time_ns);
            (path.to_owned(), Session::begin(record, &[], &AdmissionOptions::default()))
        });
        session
            .observe_frame(image.frame.clone(), image.answer.clone().map_err(Rejection::NoBoard));
    }

    fn end_recording(&mut self) {
        let Some((path, session)) = self.session.take() else { return };
        let record = session.record();
        let kept = session.camera(0).map(CameraPart::views).unwrap_or_default();
        tracing::info!("{path}: {} of {} frames kept as views", kept.len(), record.frames_seen);
        self.images.extend(kept.iter().map(|view| Ok(view.to_board_view(&self.target))));
    }
}

/// The views of `target` in the images.
///
/// # Errors
/// When a source is not there, or images differ in size.
pub fn gather(args: &SearchArgs, target: Target) -> Result<ImageGathering, Failure> {
    args.check_sources()?;
    let options = args.detect_options();
    let (mut gathered, check) = (ImageGathering::new(target), BoardCheck::of(&target));
    let spinner = progress::spinner("searching images");
    in_order(
        FrameSets::new(args.sources.iter().cloned()).reading(&args.reading),
        args.thread_count(),
        || searcher(&target, options, 1, Some(&check)),
        |image| {
            spinner.inc(1);
            check.take(image.as_ref().ok().and_then(|image| image.compared.as_ref()));
            gathered.add(image)
        },
    )?;
    spinner.finish_and_clear();
    check.warn();
    warn_of_rotation(gathered.rotated, gathered.searched);
    Ok(gathered)
}

/// Checks that an image has the same size as the `first`, which it becomes if there is none yet.
///
/// # Errors
/// When the sizes differ, with both.
pub(super) fn check_size(
    first: &mut Option<(String, ImageSize)>,
    image: &SearchedImage,
) -> Result<(), Failure> {
    let size = image.frame.image_size;
    let (first, expected) = first.get_or_insert_with(|| (image.path.clone(), size));
    if *expected == size {
        return Ok(());
    }
    Err(Failure::failed(format!(
        "{} is {size}, but {first} is {expected}: calibrate each image size separately",
        image.path
    )))
}

/// The reason for an image that shows the same as another one.
pub(super) fn same_as(name: &str) -> String {
    format!("a duplicate of {name}: it counts once")
}

/// An image that is not a view; its reason is stored without the image's name, which is printed
/// before it.
pub(super) fn unused(name: String, reason: &str) -> CalibratedView {
    let reason = reason.strip_prefix(&format!("{name}: ")).unwrap_or(reason).to_owned();
    CalibratedView {
        name,
        used: false,
        reason: Some(reason),
        rms_px: None,
        camera_from_board: None,
        motion: None,
        camera_from_scene: None,
    }
}
