//! Compares the factory's calibration of a depth camera with the estimate: which of the two
//! measures the board better in views that the estimate was not fitted to.
//!
//! The views are split into two halves. Each half is measured with the estimate from the other
//! half, and with the factory's calibration, which was fitted to neither. The factory's depth is
//! compared with the board's poses from the joint solve of all views, which if anything favors the
//! factory; the estimate of a half is compared with the poses by its own color lens. An error of
//! the color lens scales all planes alike, and the estimate with them; so the estimate must be
//! better by more than the color lens is uncertain.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::board_pose::board_poses;
use crate::estimation::depth_error::ComparedTile;
use crate::estimation::problem::BoardView;
use crate::estimation::rgbd::halves::RgbdHalves;
use crate::estimation::rgbd::{RgbdEstimate, RgbdProblem, RgbdView};
use crate::geometry::depth_camera::{DepthCamera, DepthTile, PosedDepthLens};
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// The comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct FactoryCheck {
    /// Root mean square relative distance of depth from the board, with the factory's lens, pose
    /// and depth.
    pub factory: f64,
    /// The same on the same views with the estimate from the other half of the views; infinite if
    /// there are too few views for one.
    pub own: f64,
    /// How many views were compared.
    pub views: usize,
    /// The relative uncertainty of all distances due to color's own lens: one standard deviation.
    pub open: f64,
    /// The estimate with the factory's lens, pose and error of depth, if these are no worse.
    pub kept: Option<Box<RgbdEstimate>>,
}

/// The estimate must be better by this many standard deviations of the uncertainty due to color's
/// lens.
const EXCESS_SIGMAS: f64 = 2.0;

impl FactoryCheck {
    /// Compares `estimate`, and what `halves` of its views give, with the factory's lens and pose.
    /// `None` where no view has both color and depth of the board.
    pub fn of(
        problem: &RgbdProblem,
        estimate: &RgbdEstimate,
        halves: &RgbdHalves,
        factory: PosedDepthLens,
    ) -> Option<Self> {
        let PosedDepthLens { lens, depth_from_color } = factory;
        let camera = DepthCamera { lens, correction: None, ..problem.depth.clone() };
        let color_from_depth = depth_from_color.inverse();
        let (mut factory, mut own) = (Squares::default(), Squares::default());
        for (held_out, half) in halves.views.iter().zip(halves.estimates.iter().rev()) {
            for index in held_out {
                let view = &problem.views[*index];
                // The factory's depth is compared with the joint solve; that of the other half with
                // the board's pose by its own color lens.
                let board = estimate.color_from_board[*index];
                factory.add(view, &board, &camera, &color_from_depth);
                match half.as_ref().map(|half| (half, board_under(&half.color, view))) {
                    Some((half, Some(board))) => {
                        own.add(view, &board, &half.depth, &half.color_from_depth);
                    }
                    Some((_, None)) => {}
                    None => own.sum = f64::INFINITY,
                }
            }
        }
        let (factory, own) = (factory.rms()?, own.rms().unwrap_or(f64::INFINITY));
        let std = |k: usize| {
            estimate.color_covariance[(k, k)].max(0.0).sqrt() / estimate.color.parameters()[k]
        };
        let open = std(0).max(std(1));
        let is_better = factory * factory > own * own + (EXCESS_SIGMAS * open).powi(2);
        let kept = (!is_better)
            .then(|| Box::new(as_the_factory_has_it(problem, estimate, camera, color_from_depth)));
        let views = halves.views.iter().map(Vec::len).sum();
        Some(Self { factory, own, views, open, kept })
    }

    /// The comparison in one line.
    pub fn line(&self) -> String {
        let views = self.views;
        let percent = |part: f64| format!("{:.2} %", 100.0 * part);
        let factory = percent(self.factory);
        match (self.kept.is_some(), self.own.is_finite()) {
            (true, true) => format!(
                "the factory's depth calibration is kept: over {views} views its depth error on the board is {factory} of the distance, against {} with a calibration from the other views (color's focal length is uncertain by {})",
                percent(self.own),
                percent(self.open)
            ),
            (true, false) => format!(
                "the factory's depth calibration is kept: {views} views are too few to establish a better one (depth error {factory} of the distance)"
            ),
            (false, _) => format!(
                "the factory's depth calibration is replaced: over {views} views its depth error on the board is {factory} of the distance, against {} with a calibration from the other views",
                percent(self.own)
            ),
        }
    }
}

#[derive(Default)]
struct Squares {
    sum: f64,
    count: usize,
}

impl Squares {
    fn add(
        &mut self,
        view: &RgbdView,
        color_from_board: &Pose,
        camera: &DepthCamera,
        color_from_depth: &Pose,
    ) {
        for (tile, plane) in planes(view, color_from_board, &camera.lens, color_from_depth) {
            let measured = tile.inverse_depth;
            let corrected = camera
                .correction
                .as_ref()
                .map_or(Some(measured), |c| c.correct(tile.pixel, measured));
            let off = corrected.map_or(1.0, |corrected| (corrected / plane - 1.0).abs().min(1.0));
            self.sum += off * off;
            self.count += 1;
        }
    }

    fn rms(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum / self.count as f64).sqrt())
    }
}

/// The board's pose from a view's corners, with `lens`.
fn board_under(lens: &Lens, view: &RgbdView) -> Option<Pose> {
    let view = BoardView { name: view.name.clone(), correspondences: view.color.clone() };
    board_poses(lens, &view).ok()?.first().map(|found| found.camera_from_board)
}

/// Each patch of the board, with the 1/z of its plane there.
fn planes<'a>(
    view: &'a RgbdView,
    color_from_board: &Pose,
    lens: &'a Lens,
    color_from_depth: &Pose,
) -> impl Iterator<Item = (&'a DepthTile, f64)> + use<'a> {
    let depth_from_board = color_from_depth.inverse() * *color_from_board;
    let normal = depth_from_board * Vector3::z();
    let distance = normal.dot(&depth_from_board.translation());
    view.tiles.iter().filter_map(move |tile| {
        let bearing = lens.bearing_from_pixel(tile.pixel).filter(|bearing| bearing.z > 1e-3)?;
        let plane = normal.dot(&(bearing.into_inner() / bearing.z)) / distance;
        (plane.is_finite() && plane > 0.0).then_some((tile, plane))
    })
}

fn as_the_factory_has_it(
    problem: &RgbdProblem,
    estimate: &RgbdEstimate,
    camera: DepthCamera,
    color_from_depth: Pose,
) -> RgbdEstimate {
    let compared = |(view, color_from_board): (&RgbdView, &Pose)| {
        let compared =
            planes(view, color_from_board, &camera.lens, &color_from_depth).map(|(tile, plane)| {
                ComparedTile {
                    tile: *tile,
                    plane,
                    inverse_std: 1.0 / tile.reading_std.max(f64::MIN_POSITIVE),
                }
            });
        compared.collect()
    };
    let compared = problem.views.iter().zip(&estimate.color_from_board).map(compared).collect();
    let count = camera.lens.parameters().len();
    RgbdEstimate {
        depth: camera,
        depth_covariance: DMatrix::zeros(count, count),
        color_from_depth,
        color_from_depth_covariance: Matrix6::zeros(),
        compared,
        tried: Vec::new(),
        ..estimate.clone()
    }
}
