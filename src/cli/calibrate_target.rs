//! From pictures of a board with markers to the views of a calibration.

use crate::calibration::result::CalibratedView;
use crate::cli::gather::unused;
use crate::cli::in_order::{all_cores, in_order};
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::{FrameSets, Unreadable};
use crate::cli::target_search::{TargetSearched, target_searcher};
use crate::cli::{Failure, progress};
use crate::detection::coded::answer::TargetDetection;
use crate::detection::coded::detector::TargetDetector;
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence};
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;

/// Fewer corners do not determine a board's pose and say anything about the lens.
const LEAST_CORNERS: usize = 6;
/// A frame of a recording is a view if its corners lie this far from those of the view before, as
/// a part of the image's width; or if it shares none with it.
const LEAST_MOTION: f64 = 0.04;

/// The problem that pictures of `target` pose, and the pictures that are no views, each with its
/// place among all.
///
/// # Errors
/// When a source is not there, pictures differ in size, or none shows the target.
pub fn gather_target(
    args: &SearchArgs,
    target: &Target,
) -> Result<(CameraProblem, Vec<(usize, CalibratedView)>), Failure> {
    args.check_sources()?;
    let mut views = TargetViews {
        target: *target,
        size: None,
        views: Vec::new(),
        others: Vec::new(),
        last: None,
        searched: 0,
    };
    let spinner = progress::spinner("searching pictures");
    in_order(
        FrameSets::new(args.sources.iter().cloned()).reading(&args.reading),
        args.threads.map_or_else(all_cores, usize::from),
        || {
            let mut search = TargetDetector::new(*target).map(|it| target_searcher(it, 1));
            move |frames| search.as_mut().map(|search| search(frames))
        },
        |searched| {
            spinner.inc(1);
            searched.map_or(Ok(()), |searched| views.add(searched))
        },
    )?;
    spinner.finish_and_clear();
    views.finish()
}

/// What the pictures amount to.
struct TargetViews {
    target: Target,
    /// The first picture's name and size.
    size: Option<(String, ImageSize)>,
    views: Vec<BoardView>,
    others: Vec<(usize, CalibratedView)>,
    last: Option<TargetDetection>,
    searched: usize,
}

impl TargetViews {
    fn add(&mut self, searched: Result<TargetSearched, Unreadable>) -> Result<(), Failure> {
        self.searched += 1;
        let searched = match searched {
            Ok(searched) => searched,
            Err(Unreadable { path, reason }) => return self.leave_out(path, reason),
        };
        let size = searched.frame.image_size;
        let (first, expected) = self.size.get_or_insert_with(|| (searched.path.clone(), size));
        if *expected != size {
            return Err(Failure::failed(format!(
                "{} is {size}, but {first} is {expected}: calibrate each size of picture by itself",
                searched.path
            )));
        }
        let detection = match searched.answer {
            Ok(detection) => detection,
            Err(none) => return self.leave_out(searched.path, none.to_string()),
        };
        if detection.corners.len() < LEAST_CORNERS {
            let reason = format!("only {} corners are seen", detection.corners.len());
            return self.leave_out(searched.path, reason);
        }
        if searched.recording.is_some() && !self.moved(&detection, size) {
            return Ok(());
        }
        let correspondences = detection.corners.iter().filter_map(|corner| {
            Some(Correspondence {
                point_in_board: self.target.corner_in_board(corner.id)?,
                pixel: corner.pixel,
                std_px: corner.std_px,
            })
        });
        let view = BoardView { name: searched.path, correspondences: correspondences.collect() };
        self.views.push(view);
        self.last = Some(detection);
        Ok(())
    }

    #[expect(clippy::unnecessary_wraps, reason = "the answer of the one place that calls it")]
    fn leave_out(&mut self, path: String, reason: String) -> Result<(), Failure> {
        let place = self.views.len() + self.others.len();
        self.others.push((place, unused(path, reason)));
        Ok(())
    }

    /// Whether the target is elsewhere in the image than in the last view.
    fn moved(&self, detection: &TargetDetection, size: ImageSize) -> bool {
        let Some(last) = &self.last else { return true };
        let (mut sum, mut count) = (0.0, 0.0);
        for corner in &detection.corners {
            if let Ok(found) = last.corners.binary_search_by_key(&corner.id, |other| other.id) {
                sum += corner.pixel.distance_px(last.corners[found].pixel);
                count += 1.0;
            }
        }
        count == 0.0 || sum / count > LEAST_MOTION * f64::from(size.width)
    }

    fn finish(self) -> Result<(CameraProblem, Vec<(usize, CalibratedView)>), Failure> {
        match self.size {
            Some((_, image_size)) if !self.views.is_empty() => {
                Ok((CameraProblem { image_size, views: self.views }, self.others))
            }
            _ => {
                let first = self
                    .others
                    .into_iter()
                    .find_map(|(_, view)| Some(format!("{}: {}", view.name, view.reason?)));
                Err(Failure::failed(format!(
                    "no {} was seen in any of {} pictures; the first: {}",
                    self.target,
                    self.searched,
                    first.unwrap_or_default()
                )))
            }
        }
    }
}
