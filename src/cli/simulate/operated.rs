//! `plumb simulate --operator …`: complete sessions with a simulated operator, as fast as they can
//! be computed. Corners are projected through the true lens, with the detector's noise added;
//! nothing is rendered.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::calibration::admission::AdmissionOptions;
use crate::calibration::guidance::advise;
use crate::calibration::information::candidate_views::BoardPoints;
use crate::calibration::information::corner_noise::side_px;
use crate::calibration::placement::Placement;
use crate::calibration::running_estimate::{EstimateSoFar, estimate_so_far};
use crate::calibration::session::camera::CameraPart;
use crate::calibration::session::{Action, Session};
use crate::calibration::session_record::{Finish, RunningEstimate, SessionRecord, SessionRequest};
use crate::calibration::view::FrameFacts;
use crate::cli::simulate::operated_outcome::{OperatedOutcome, summary};
use crate::cli::{Failure, output};
use crate::detection::board_detection::{DetectedCorner, Detection, GridIndex, NoBoard};
use crate::estimation::board_pose::board_poses;
use crate::estimation::camera::{CameraEstimate, CameraOptions, calibrate_camera};
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence, LensChoice};
use crate::estimation::uncertainty::{
    Distance, MedianAndWorst, PixelGrid, projection_difference, projection_uncertainty,
};
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::homography::Homography;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::simulation::{Operator, OperatorKind};

/// Sessions with a simulated operator.
#[derive(Debug, clap::Args)]
pub struct OperatedArgs {
    /// Instead of rendering, run sessions with a simulated operator who follows the guidance,
    /// follows the fixed list of placements, moves at random, or fills the bars of ROS's
    /// camera_calibration
    #[arg(long, value_name = "WHAT", conflicts_with_all = ["out", "config"])]
    operator: Option<OperatorName>,
    /// The projection uncertainty to reach, the median over the image, in pixels
    #[arg(long, value_name = "PX", requires = "operator", default_value_t = 0.05)]
    goal: f64,
    /// The goal is the worst uncertainty in the image
    #[arg(long, requires = "operator")]
    worst: bool,
    /// How many seeds; lenses (ordinary, wide, fisheye) and boards alternate
    #[arg(long, value_name = "N", requires = "operator", default_value_t = 9)]
    seeds: u64,
}

/// What an operator does, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum OperatorName {
    /// Follows what is asked for.
    Follows,
    /// Follows the fixed list of placements.
    List,
    /// Wanders.
    Wanders,
    /// Fills the bars of ROS's calibrator.
    Bars,
}

impl OperatorName {
    fn kind(self) -> OperatorKind {
        match self {
            Self::Follows | Self::List => OperatorKind::Follows,
            Self::Wanders => OperatorKind::Wanders,
            Self::Bars => OperatorKind::Bars,
        }
    }
}

/// One session to run.
#[derive(Debug, Clone)]
pub struct OperatedSession {
    /// The seed of everything random.
    pub seed: u64,
    /// The operator, who holds the board.
    pub operator: OperatorName,
    /// The goal in pixels, and whether it is for the worst uncertainty in the image instead of the
    /// median.
    pub goal: (f64, bool),
    /// The true lens.
    pub lens: Lens,
    /// The size of its images.
    pub size: ImageSize,
    /// The board.
    pub board: Chessboard,
}

/// As in sessions: with fewer views they do not stop.
const LEAST_VIEWS: u32 = 8;
const FRAME_S: f64 = 0.1;
const LONGEST_S: f64 = 400.0;
/// The detector's limits: squares of 6 px, tilts up to 55°.
const LEAST_SIDE_PX: f64 = 6.0;
const LEAST_FACING: f64 = 0.57;
/// The noise of a corner whose edges are one pixel long, with a blur of one pixel; and the blur.
const NOISE_PX: f64 = 0.5;
const BLUR_PX: f64 = 0.8;

impl OperatedSession {
    /// The session of `seed`: three lenses (57°, 100° and 140° horizontally) and three boards
    /// alternate, and each lens varies with the seed.
    pub fn of_seed(seed: u64, operator: OperatorName, goal: (f64, bool)) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut vary = |value: f64, part: f64| value * (1.0 + part * rng.random_range(-1.0..1.0));
        let (model, size, parameters) = match seed % 3 {
            0 => (
                LensModel::Brown,
                ImageSize::new(640, 480),
                vec![560.0, 560.0, 319.5, 239.5, 0.0, -0.2, 0.08, 4e-4, -4e-4, -0.01],
            ),
            1 => (
                LensModel::Brown,
                ImageSize::new(1280, 720),
                vec![540.0, 540.0, 639.5, 359.5, 0.0, -0.28, 0.09, 3e-4, -2e-4, -0.012],
            ),
            _ => (
                LensModel::KannalaBrandt,
                ImageSize::new(1280, 960),
                vec![520.0, 520.0, 639.5, 479.5, 0.0, -0.012, -0.004, 0.002, -6e-4],
            ),
        };
        let focal = vary(parameters[0], 0.05);
        let parameters: Vec<f64> = (parameters.into_iter().enumerate())
            .map(|(k, value)| match k {
                0 | 1 => focal * if k == 0 { 1.0 } else { 1.001 },
                2 | 3 => vary(value, 0.02),
                _ => value,
            })
            .collect();
        let (cols, rows, square_m) =
            [(9, 6, 0.025), (11, 8, 0.03), (7, 5, 0.04)][(seed / 3 % 3) as usize];
        let lens = Lens::from_parameters(model, &parameters);
        let center = size.center();
        let plain = crate::geometry::camera_matrix::CameraMatrix {
            fx: focal,
            fy: focal,
            cx: center.x,
            cy: center.y,
            skew: 0.0,
        };
        Self {
            seed,
            operator,
            goal,
            lens: lens.unwrap_or_else(|| Lens::pinhole(plain)),
            size,
            board: Chessboard { size: BoardSize { cols, rows }, square_m },
        }
    }

    /// Runs the session to its end; `None` if its views do not determine the lens.
    pub fn run(&self) -> Option<OperatedOutcome> {
        let (goal_px, of_worst) = self.goal;
        let lens = LensChoice::Model(self.lens.model());
        let finish =
            (!of_worst).then_some(Finish { uncertainty_px: Some(goal_px), ..Finish::default() });
        let request = SessionRequest { target: self.board.into(), lens, finish, given: Vec::new() };
        let record = SessionRecord::begin("", "", request, 0);
        let mut session = Session::begin(record, &[], &AdmissionOptions::default());
        let mut operator =
            Operator::before(self.seed, self.operator.kind(), &self.board, &self.lens, self.size);
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ 0x006e_6f69_7365);
        let (mut reached, mut frames, mut course) = (false, 0_u64, Vec::new());
        let mut to_go: Vec<(u32, [u32; 2])> = Vec::new();
        while !reached && (frames as f64) * FRAME_S < LONGEST_S {
            operator.ask(self.asked(&session).as_ref());
            let camera_from_board = operator.step(FRAME_S);
            let seen = self.seen(&camera_from_board, &mut rng);
            let frame = FrameFacts {
                sequence: frames,
                name: None,
                host_time_ns: (frames as f64 * FRAME_S * 1e9) as i64,
                device_time_ns: None,
                image_size: self.size,
            };
            frames += 1;
            let rejected = crate::calibration::admission::Rejection::NoBoard;
            let observed = session.observe_frame(frame, seen.map_err(rejected))?;
            let record = session.record();
            let said = record.guidance.views_to_go.filter(|_| !observed.kept.is_empty());
            to_go.extend(said.map(|said| (record.views_kept, said)));
            let mut actions = observed.actions;
            while let Some(action) = actions.pop() {
                match action {
                    Action::Estimate(camera) => {
                        let so_far = self.estimated(&session, camera);
                        if let Some(so_far) = &so_far {
                            let ([median, worst], views) = figures(&so_far.running);
                            course.push((views, frames as f64 * FRAME_S, median, worst));
                            reached |= of_worst
                                && views >= LEAST_VIEWS
                                && worst <= goal_px
                                && so_far.model_holds;
                        }
                        actions.extend(session.estimated(camera, so_far));
                    }
                    Action::Solve => reached = true,
                    Action::Announce | Action::Close => {}
                }
            }
        }
        let options = CameraOptions { lens, ..CameraOptions::default() };
        let estimate = calibrate_camera(&self.problem(&session), &options).ok()?;
        let mut outcome = self.outcome(&estimate, &session, reached, frames as f64 * FRAME_S)?;
        (outcome.course, outcome.to_go) = (course, to_go);
        Some(outcome)
    }

    fn problem(&self, session: &Session) -> CameraProblem {
        let views = session.camera(0).map(CameraPart::views).unwrap_or_default();
        let views = views.iter().map(|view| view.to_board_view(&self.board.into())).collect();
        CameraProblem { image_size: self.size, views }
    }

    fn estimated(&self, session: &Session, camera: usize) -> Option<EstimateSoFar> {
        let continuation = session.camera(camera).and_then(CameraPart::continuation).cloned();
        let lens = LensChoice::Model(self.lens.model());
        let symmetries = self.board.symmetries();
        estimate_so_far(&self.problem(session), &symmetries, lens, continuation.as_ref()).ok()
    }

    /// The board's pose for the requested outline. It is derived from the outline in the image,
    /// through the true lens, because people follow what they see and not the pose estimated with
    /// the present lens.
    fn asked(&self, session: &Session) -> Option<Pose> {
        let guidance = match self.operator {
            OperatorName::List => {
                let views = session.camera(0).map(CameraPart::views).unwrap_or_default();
                let kept: Vec<Placement> = (views.iter())
                    .filter_map(|view| Placement::of(&view.detection, self.size))
                    .collect();
                advise(&self.board, self.size, &kept, None)
            }
            OperatorName::Follows => session.record().guidance.clone(),
            OperatorName::Wanders | OperatorName::Bars => return None,
        };
        self.pose_seen_at(&<[Pixel; 4]>::try_from(guidance.outline_px).ok()?)
    }

    /// The pose of a board whose outer corners are seen at these pixels. Four points are too few to
    /// verify a pose; points of the plane between them are added.
    fn pose_seen_at(&self, outline_px: &[Pixel; 4]) -> Option<Pose> {
        const STEPS: u32 = 4;
        let bearings = outline_px.map(|pixel| self.lens.bearing_from_pixel(pixel));
        let [a, b, c, d] = bearings;
        let bearings = [a?, b?, c?, d?];
        let mean = bearings.iter().map(|bearing| bearing.into_inner()).sum::<Vector3<f64>>();
        let ahead_from_camera = UnitQuaternion::rotation_between(&mean, &Vector3::z())?;
        let ahead = bearings.map(|bearing| ahead_from_camera * bearing.into_inner());
        let square_to_ahead = Homography::of_unit_square(ahead.map(|v| v.xy() / v.z))?;
        let [least, _, greatest, _] = BoardPoints::of_chessboard(&self.board).outline(0.0);
        let parts = (0..=STEPS).flat_map(|row| (0..=STEPS).map(move |col| [col, row]));
        let correspondences: Option<Vec<Correspondence>> = parts
            .map(|part| {
                let [u, v] = part.map(|steps| f64::from(steps) / f64::from(STEPS));
                let toward = square_to_ahead * Vector3::new(u, v, 1.0);
                let in_camera = ahead_from_camera.inverse() * (toward * toward.z.signum());
                let across = greatest - least;
                Some(Correspondence {
                    point_in_board: least + Vector3::new(u * across.x, v * across.y, 0.0),
                    pixel: self.lens.pixel_from_point(&Point3::from(in_camera))?,
                    std_px: 1.0,
                })
            })
            .collect();
        let view = BoardView { name: String::new(), correspondences: correspondences? };
        Some(board_poses(&self.lens, &view).ok()?.first()?.camera_from_board)
    }

    /// The simulated detection.
    fn seen(&self, camera_from_board: &Pose, rng: &mut ChaCha8Rng) -> Result<Detection, NoBoard> {
        let points = BoardPoints::of_chessboard(&self.board);
        let facing = {
            let middle = (*camera_from_board * points.middle()).coords.normalize();
            (*camera_from_board * Vector3::z()).dot(&middle)
        };
        let inside = |point: &Point3<f64>| {
            let pixel = self.lens.pixel_from_point(&(*camera_from_board * *point));
            pixel.filter(|pixel| self.size.contains(*pixel))
        };
        let is_whole = points.outline(1.0).iter().all(|corner| inside(corner).is_some());
        if !is_whole || facing < LEAST_FACING {
            return Err(NoBoard::NoCorners);
        }
        let cols = self.board.size.cols as usize;
        let corner = |(k, point): (usize, &Point3<f64>)| {
            let side = side_px(&self.lens, camera_from_board, point, self.board.square_m)?;
            let pixel = inside(point).filter(|_| side >= LEAST_SIDE_PX)?;
            let std_px = NOISE_PX * (BLUR_PX / side.min(40.0)).sqrt();
            let mut off = || std_px * rng.sample::<f64, _>(StandardNormal);
            Some(DetectedCorner {
                index: GridIndex { col: (k % cols) as i32, row: (k / cols) as i32 },
                pixel: Pixel::new(pixel.x + off(), pixel.y + off()),
                std_px,
            })
        };
        let corners: Option<Vec<_>> = points.points.iter().enumerate().map(corner).collect();
        Ok(Detection {
            board: self.board.size,
            corners: corners.ok_or(NoBoard::NoCorners)?,
            partial: false,
            position_known: true,
            markers: None,
            orientation_ambiguous: false,
            blur_px: BLUR_PX,
        })
    }

    fn outcome(
        &self,
        estimate: &CameraEstimate,
        session: &Session,
        reached: bool,
        seconds: f64,
    ) -> Option<OperatedOutcome> {
        let grid = PixelGrid::over(self.size, 12);
        let covariance = &estimate.lens_covariance;
        let map = projection_uncertainty(&estimate.lens, covariance, grid, Distance::Infinity)?;
        let off = projection_difference(&self.lens, &estimate.lens, grid, &map.weights);
        let (mut ratios, mut lengths) = (Vec::new(), Vec::new());
        for (off, covariance) in off.iter().zip(&map.covariance_px2) {
            let (Some(off), Some(covariance)) = (off, covariance) else { continue };
            let off = nalgebra::Vector2::from(*off);
            let principal = covariance.symmetric_eigen();
            let along = principal.eigenvectors.transpose() * off;
            ratios.extend((0..2).map(|k| along[k].abs() / principal.eigenvalues[k].sqrt()));
            lengths.push(off.norm());
        }
        lengths.sort_unstable_by(f64::total_cmp);
        let part = |limit: f64| {
            ratios.iter().filter(|ratio| **ratio <= limit).count() as f64 / ratios.len() as f64
        };
        let MedianAndWorst { median_px: median, worst_px: worst } = map.median_and_worst()?;
        let across = ["57°", "100°", "140°"][(self.seed % 3) as usize];
        Some(OperatedOutcome {
            seed: self.seed,
            setting: format!("{across} {}", self.board.size),
            reached,
            views: session.record().views_kept,
            seconds,
            predicted_px: [median, worst],
            error_px: [*lengths.get(lengths.len() / 2)?, *lengths.last()?],
            focal_ratio: (estimate.lens.matrix.fx - self.lens.matrix.fx) / estimate.lens_std()[0],
            within: [part(1.0), part(2.0)],
            course: Vec::new(),
            to_go: Vec::new(),
        })
    }
}

impl OperatedArgs {
    /// Runs the sessions, and prints the outcome of each, then their medians.
    ///
    /// # Errors
    /// When stdout cannot be written to.
    pub fn run(&self, first: u64, json: bool) -> Result<(), Failure> {
        let Some(operator) = self.operator else {
            return Err(Failure::usage("give --out FILE.mcap, or --operator"));
        };
        let mut outcomes: Vec<OperatedOutcome> = Vec::new();
        for seed in first..first.saturating_add(self.seeds) {
            let session = OperatedSession::of_seed(seed, operator, (self.goal, self.worst));
            let Some(outcome) = session.run() else {
                tracing::warn!("seed {seed}: its views leave the lens open");
                continue;
            };
            if json {
                output::print_json(&outcome)?;
            } else {
                output::print_line(&outcome.line())?;
            }
            outcomes.push(outcome);
        }
        if json { Ok(()) } else { output::print_line(&summary(&outcomes)) }
    }
}

fn figures(estimate: &RunningEstimate) -> ([f64; 2], u32) {
    let uncertainty = &estimate.uncertainty_px;
    ([uncertainty.median, uncertainty.worst], estimate.views)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::information::candidate_views::{CandidateSpace, PlacementInImage};
    use crate::calibration::information::corner_noise::CornerNoise;

    #[test]
    fn who_follows_sees_where_the_board_is_asked_for() {
        for seed in 0..9 {
            let session = OperatedSession::of_seed(seed, OperatorName::Follows, (0.4, true));
            let (board, noise) =
                (BoardPoints::of_chessboard(&session.board), CornerNoise::default());
            let space = CandidateSpace {
                lens: &session.lens,
                size: session.size,
                board: &board,
                noise: &noise,
                base: UnitQuaternion::identity(),
                avoided: &[],
            };
            let views =
                (0..30).filter_map(|index| space.view(&PlacementInImage::of_sequence(index)));
            let mut seen = 0;
            for view in views {
                let outline_px = space.outline_px(&view.camera_from_board).unwrap();
                let pose = session.pose_seen_at(&outline_px).unwrap();
                let middle = board.middle();
                let off = (pose * middle - view.camera_from_board * middle).norm();
                assert!(off < 1e-3 * (pose * middle).coords.norm(), "seed {seed}: {off} m off");
                seen += 1;
            }
            assert!(seen > 10, "seed {seed}: {seen} views");
        }
    }

    #[test]
    fn who_follows_reaches_the_goal_in_a_few_views() {
        let session = OperatedSession::of_seed(40, OperatorName::Follows, (1.0, true));
        let outcome = session.run().unwrap();
        assert!(outcome.reached && outcome.views < 30, "{outcome:?}");
        assert!(outcome.predicted_px[1] < 1.1 && outcome.within[1] > 0.5, "{outcome:?}");
    }
}
