//! Colour, infrared and depth as one instrument: lenses, where the sensors are, and the depth camera's systematic error, with
//! the covariance of what follows from it.
//!
//! Corners and planes are not weighed against each other: a depth camera's unknown systematic error is as large as what its
//! planes could add to corners, and would bend the lenses towards it. So corners (colour, and infrared where it sees the
//! board) come first and decide lenses, poses and the sensors' pose; planes then tell what is left: the correction, and for a
//! camera without an infrared picture its lens and pose. The covariance of the corners' answer is carried into the planes'.
//!
//! The depth picture is the infrared camera's where there is one: they share lens and pose.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::depth_error::{JudgedTile, Prior, Smoothness, TriedCorrection, choose_correction};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::depth_terms::{PlaneSight, add_planes, ray};
use crate::estimation::joint::minimize::{Minimum, Stop, walk};
use crate::estimation::joint::normal::{NormalEquations, Step};
use crate::estimation::joint::{FreeLens, Layout, SensorLayout, Sight, State};
use crate::estimation::problem::Correspondence;
use crate::estimation::robust::{Loss, median};
use crate::geometry::depth_camera::{DepthCamera, DepthTile};
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// What was seen at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdView {
    /// Its path or sequence number.
    pub name: String,
    /// The board's corners in the colour picture; empty where it wasn't found.
    pub color: Vec<Correspondence>,
    /// The board's corners in the infrared picture; empty where it wasn't found.
    pub infrared: Vec<Correspondence>,
    /// The board's surface in the depth picture; empty where it wasn't measured.
    pub tiles: Vec<DepthTile>,
    /// About where the board was.
    pub color_from_board: Pose,
}

/// How the depth camera's lens is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthLens {
    /// It is the infrared camera's too, whose corners are seen.
    Infrared,
    /// By planes alone: focal lengths and principal point.
    FromPlanes,
    /// Beforehand.
    Known,
}

/// A camera with colour and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdProblem {
    /// About the colour camera's lens; all of it is estimated, but for a skew of 0.
    pub color: Lens,
    /// Standard deviation of a colour corner relative to its own `std_px`.
    pub color_noise: f64,
    /// About the depth camera; its correction is ignored.
    pub depth: DepthCamera,
    /// How its lens is known.
    pub depth_lens: DepthLens,
    /// Standard deviation of an infrared corner relative to its own `std_px`.
    pub infrared_noise: f64,
    /// About where the sensors are.
    pub depth_from_color: Pose,
    /// In what a correction makes sense for this device; empty for none.
    pub corrected: Vec<CorrectedQuantity>,
    /// What was seen.
    pub views: Vec<RgbdView>,
}

/// A calibrated camera with colour and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdEstimate {
    /// The colour camera's lens.
    pub color: Lens,
    /// Covariance of its parameters.
    pub color_covariance: DMatrix<f64>,
    /// The depth camera: its lens, and its correction where one is better on views that were not fitted to.
    pub depth: DepthCamera,
    /// Covariance of its lens's parameters; zero where they were known.
    pub depth_covariance: DMatrix<f64>,
    /// Where the depth (and infrared) camera is.
    pub color_from_depth: Pose,
    /// Covariance of its turn about colour's axes and of its translation, in rad² and m².
    pub color_from_depth_covariance: Matrix6<f64>,
    /// Where the board was, view by view.
    pub color_from_board: Vec<Pose>,
    /// By how much tiles scatter more than their own readings do.
    pub tile_noise: f64,
    /// View by view, what each tile was and should have been, with its noise; without tiles that lie off the plane.
    pub judged: Vec<Vec<JudgedTile>>,
    /// How smooth the correction was taken to be.
    pub smoothness: Smoothness,
    /// Corrections that were tried.
    pub tried: Vec<TriedCorrection>,
}

/// Tiles further off than this many standard deviations of their own scatter take no part.
const LIMIT: f64 = 6.0;

/// How far a tile's own noise can be believed: readings next to each other err together.
const LEAST_READING_STDS: f64 = 0.1;

const BASE_SMOOTHNESS: Smoothness = Smoothness { amplitude: 0.5, bend: 0.01 };

/// Calibrates colour and depth.
///
/// # Errors
/// [`EstimationError`] where views are too few or leave a lens or the sensors' pose open.
pub fn calibrate_rgbd(problem: &RgbdProblem) -> Result<RgbdEstimate, EstimationError> {
    let with_depth = problem.views.iter().filter(|view| !view.tiles.is_empty()).count();
    if with_depth < 3 {
        return Err(EstimationError::TooFewViews { usable: with_depth, needed: 3, rejected: String::new() });
    }
    let corners = Corners::fit(problem).ok_or(EstimationError::NoFit)?;
    let mut planes = Planes::of(problem, &corners);
    let size = problem.depth.image_size;
    let quantity = problem.corrected.first().copied().unwrap_or(CorrectedQuantity::InverseDepth);
    // A constant scale and offset first, so that a wrong unit moves neither the depth camera's lens nor its pose.
    let terms = if problem.corrected.is_empty() { 0 } else { 2 };
    let base = DepthCorrection::none(quantity, terms, SplineGrid::constant(size), planes.seen_m());
    let rounds = if problem.depth_lens == DepthLens::Infrared { 1 } else { 2 };
    let mut fit = planes.fit(&corners.state, base, BASE_SMOOTHNESS).ok_or(EstimationError::NoFit)?;
    let (mut smoothness, mut tried) = (BASE_SMOOTHNESS, Vec::new());
    for _ in 0..rounds {
        let (chosen, all) = choose_correction(&planes.judged(&fit), size, &problem.corrected);
        let none = DepthCorrection::none(quantity, 0, SplineGrid::constant(size), planes.seen_m());
        let (correction, smooth) = chosen.unwrap_or((none, BASE_SMOOTHNESS));
        fit = planes.fit(&fit.state, correction, smooth).ok_or(EstimationError::NoFit)?;
        (smoothness, tried) = (smooth, all);
    }
    planes.assemble(&corners, &fit, (smoothness, tried))
}

/// The answer of the corners: sensor 0 is colour and the rig, sensor 1 infrared and depth.
struct Corners {
    layout: Layout,
    state: State,
    equations: NormalEquations,
    covariance: DMatrix<f64>,
    center: Vector3<f64>,
}

impl Corners {
    fn fit(problem: &RgbdProblem) -> Option<Self> {
        let corners = || problem.views.iter().flat_map(|view| view.color.iter().chain(&view.infrared));
        let center = corners().map(|c| c.point_in_board.coords).sum::<Vector3<f64>>() / corners().count().max(1) as f64;
        let mut lenses = vec![free(&problem.color, usize::MAX)];
        if problem.depth_lens == DepthLens::Infrared {
            lenses.push(free(&problem.depth.lens, usize::MAX));
        }
        let layout = Layout::new(lenses, None);
        let mut sights = Vec::new();
        for (instant, view) in problem.views.iter().enumerate() {
            let seen = [(0, &view.color, problem.color_noise), (1, &view.infrared, problem.infrared_noise)];
            for (sensor, corners, noise) in seen {
                if corners.is_empty() || sensor >= layout.sensors.len() {
                    continue;
                }
                sights.push(Sight {
                    sensor,
                    instant,
                    points: corners.iter().map(|c| c.point_in_board - center).collect(),
                    pixels: corners.iter().map(|c| c.pixel).collect(),
                    inverse_std: corners.iter().map(|c| 1.0 / (c.std_px * noise)).collect(),
                    used: vec![true; corners.len()],
                });
            }
        }
        let start = State {
            lenses: vec![problem.color, problem.depth.lens],
            sensor_from_rig: vec![Pose::identity(), problem.depth_from_color],
            rig_from_board: problem.views.iter().map(|view| shifted(&view.color_from_board, &center)).collect(),
            warp: [0.0; 2],
        };
        let at_start: Vec<Vec<[f64; 2]>> = sights.iter().map(|sight| start.residuals(&layout, sight)).collect();
        let mut agreement = Agreement::of(&sights, &at_start);
        let mut weighted = agreement.applied(&sights, &at_start);
        let mut minimum = Minimum::start(&layout, start, &weighted, Loss::Squares)?;
        for _ in 0..8 {
            minimum = minimum.descend(&layout, &weighted, Loss::Squares, Stop::default());
            let residuals: Vec<Vec<[f64; 2]>> =
                sights.iter().map(|sight| minimum.state.residuals(&layout, sight)).collect();
            let next = Agreement::of(&sights, &residuals);
            let chosen = next.applied(&sights, &residuals);
            let settled = (next.infrared / agreement.infrared - 1.0).abs() < 0.02 && used(&chosen).eq(used(&weighted));
            if settled {
                break;
            }
            (agreement, weighted) = (next, chosen);
            minimum = Minimum::start(&layout, minimum.state, &weighted, Loss::Squares)?;
        }
        let covariance = minimum.equations.global_covariance()?;
        Some(Self { layout, state: minimum.state, equations: minimum.equations, covariance, center })
    }

    fn lens_covariance(&self, sensor: usize) -> DMatrix<f64> {
        let layout = &self.layout.sensors[sensor];
        let (at, count) = (layout.lens_at, layout.lens.free.len());
        let spread = layout.lens.spread(&self.state.lenses[sensor]);
        &spread * self.covariance.view((at, at), (count, count)) * spread.transpose()
    }
}

/// Corners further off than this many standard deviations take no part.
const CORNER_LIMIT: f64 = 5.0;

/// Infrared pictures that disagree with colour by this many times what they do in the middle take no part: the board moved
/// between the two.
const VIEW_LIMIT: f64 = 3.0;

/// How well infrared agrees with colour, in standard deviations of its own corners; at least 1.
struct Agreement {
    infrared: f64,
}

impl Agreement {
    fn of(sights: &[Sight], residuals: &[Vec<[f64; 2]>]) -> Self {
        let infrared = sights.iter().zip(residuals).filter(|(sight, _)| sight.sensor == 1);
        let middle = median(infrared.map(|(_, residuals)| rms(residuals)).collect());
        Self { infrared: middle.unwrap_or(1.0).max(1.0) }
    }

    /// The sights with the weights and the corners that it leaves.
    fn applied(&self, sights: &[Sight], residuals: &[Vec<[f64; 2]>]) -> Vec<Sight> {
        let each = sights.iter().zip(residuals).map(|(sight, residuals)| {
            let scale = if sight.sensor == 1 { self.infrared } else { 1.0 };
            let together = sight.sensor == 0 || rms(residuals) <= VIEW_LIMIT * scale;
            let near = |[x, y]: &[f64; 2]| together && x.hypot(*y) <= CORNER_LIMIT * scale;
            Sight {
                inverse_std: sight.inverse_std.iter().map(|inverse| inverse / scale).collect(),
                used: residuals.iter().map(near).collect(),
                ..sight.clone()
            }
        });
        each.collect()
    }
}

/// Root mean square per axis.
fn rms(residuals: &[[f64; 2]]) -> f64 {
    let sum: f64 = residuals.iter().map(|[x, y]| x * x + y * y).sum();
    (sum / (2 * residuals.len().max(1)) as f64).sqrt()
}

fn used(sights: &[Sight]) -> impl Iterator<Item = bool> + '_ {
    sights.iter().flat_map(|sight| &sight.used).copied()
}

/// All parameters of a lens but the skew, up to number `end`.
fn free(lens: &Lens, end: usize) -> FreeLens {
    let free = (0..lens.parameters().len().min(end)).filter(|k| *k != 4).collect();
    FreeLens { model: lens.model(), free, square_pixels: false }
}

/// The pose of a board whose points are counted from `center`.
fn shifted(camera_from_board: &Pose, center: &Vector3<f64>) -> Pose {
    Pose::new(camera_from_board.rotation(), camera_from_board.translation() + *camera_from_board * *center)
}

/// What the planes tell, with the board's poses held at the corners' answer.
struct Planes<'a> {
    problem: &'a RgbdProblem,
    layout: Layout,
    planes: Vec<PlaneSight>,
}

/// The planes' parameters.
#[derive(Clone)]
struct Whole {
    rig: State,
    correction: DepthCorrection,
}

struct Fit {
    state: State,
    correction: DepthCorrection,
    equations: NormalEquations,
    tile_noise: f64,
}

impl<'a> Planes<'a> {
    fn of(problem: &'a RgbdProblem, corners: &Corners) -> Self {
        let known = |lens: &Lens| free(lens, 0);
        let depth_lens = &corners.state.lenses[1];
        let color = SensorLayout { lens: known(&problem.color), lens_at: 0, pose_at: None };
        let depth = match problem.depth_lens {
            DepthLens::Infrared => SensorLayout { lens: known(depth_lens), lens_at: 0, pose_at: None },
            DepthLens::FromPlanes => SensorLayout { lens: free(depth_lens, 4), lens_at: 0, pose_at: Some(4) },
            DepthLens::Known => SensorLayout { lens: known(depth_lens), lens_at: 0, pose_at: Some(0) },
        };
        let len = depth.lens.free.len() + if depth.pose_at.is_some() { 6 } else { 0 };
        let inverse_std = |tile: &DepthTile| {
            let step = problem.depth.reading.inverse_depth_step(tile.inverse_depth);
            let reading_std = tile.reading_std.hypot(step / 12.0_f64.sqrt());
            1.0 / (reading_std * (1.0 / f64::from(tile.count)).sqrt().max(LEAST_READING_STDS))
        };
        let with_depth = problem.views.iter().enumerate().filter(|(_, view)| !view.tiles.is_empty());
        let planes = with_depth.map(|(instant, view)| PlaneSight {
            sensor: 1,
            instant,
            inverse_std: view.tiles.iter().map(inverse_std).collect(),
            used: vec![true; view.tiles.len()],
            tiles: view.tiles.clone(),
        });
        Self { problem, layout: Layout { sensors: vec![color, depth], warp: None, len }, planes: planes.collect() }
    }

    /// The nearest and the farthest depth that was measured.
    fn seen_m(&self) -> [f64; 2] {
        let depths = || self.planes.iter().flat_map(|plane| &plane.tiles).map(|tile| 1.0 / tile.inverse_depth);
        [depths().fold(f64::INFINITY, f64::min), depths().fold(0.0, f64::max)]
    }

    /// Fits a correction of this form, and lens and pose where they are the planes' to tell. Tiles are weighted by what
    /// they turn out to scatter, and those off the plane left out.
    fn fit(&mut self, start: &State, correction: DepthCorrection, smoothness: Smoothness) -> Option<Fit> {
        let at = self.layout.len;
        let prior = Prior::of(&correction, smoothness);
        let layout = Layout { len: at + correction.coefficients.len(), ..self.layout.clone() };
        let mut whole = Whole { rig: start.clone(), correction };
        let (mut tile_noise, mut equations) = (1.0, None);
        for round in 0..6 {
            let planes: Vec<PlaneSight> = self.planes.iter().map(|plane| scaled(plane, tile_noise)).collect();
            let linearized = |whole: &Whole| linearized(&layout, (whole, &prior), at, &planes).map(|found| found.0);
            let stepped = |whole: &Whole, step: &Step| {
                let rig = whole.rig.stepped(&layout, &step.global, &step.instants)?;
                let mut correction = whole.correction.clone();
                for (coefficient, step) in correction.coefficients.iter_mut().zip(&step.global[at..]) {
                    *coefficient += step;
                }
                Some(Whole { rig, correction })
            };
            let count = planes.iter().map(|plane| plane.tiles.len()).sum::<usize>();
            if layout.len > 0 {
                let start = linearized(&whole)?;
                whole = walk((whole, start), count, Stop::default(), (linearized, stepped)).0;
            }
            let (at_end, residuals) = self::linearized(&layout, (&whole, &prior), at, &planes)?;
            equations = Some(at_end);
            let before = tile_noise;
            let changed = self.select(&residuals, if round == 0 { 2.0 } else { 1.0 });
            tile_noise = (self.scatter(&residuals) * before).max(1e-3);
            if !changed && (tile_noise / before - 1.0).abs() < 0.02 {
                break;
            }
        }
        Some(Fit { state: whole.rig, correction: whole.correction, equations: equations?, tile_noise })
    }

    /// Lets those tiles take part that lie on the plane; answers whether that changed.
    fn select(&mut self, residuals: &[Vec<f64>], slack: f64) -> bool {
        let sizes = residuals.iter().flatten().filter(|r| r.is_finite()).map(|r| r.abs()).collect();
        let limit = slack * LIMIT * median(sizes).unwrap_or(0.0) / 0.6745;
        let mut changed = false;
        for (plane, residuals) in self.planes.iter_mut().zip(residuals) {
            for (used, residual) in plane.used.iter_mut().zip(residuals) {
                let next = residual.abs() <= limit;
                changed |= next != *used;
                *used = next;
            }
        }
        changed
    }

    /// Root mean square of the residuals of tiles that take part.
    fn scatter(&self, residuals: &[Vec<f64>]) -> f64 {
        let pairs = self.planes.iter().zip(residuals).flat_map(|(p, r)| p.used.iter().zip(r));
        let (sum, count) =
            pairs.filter(|(used, _)| **used).fold((0.0, 0), |(sum, count), (_, r)| (sum + r * r, count + 1));
        (sum / f64::from(count.max(1))).sqrt()
    }

    /// What each tile should have been.
    fn judged(&self, fit: &Fit) -> Vec<Vec<JudgedTile>> {
        let mut views = vec![Vec::new(); self.problem.views.len()];
        for plane in &self.planes {
            let depth_from_board = fit.state.sensor_from_board(1, plane.instant);
            let normal = depth_from_board * Vector3::z();
            let distance = normal.dot(&depth_from_board.translation());
            for ((tile, inverse_std), used) in plane.tiles.iter().zip(&plane.inverse_std).zip(&plane.used) {
                if let (true, Some(ray)) = (used, ray(&fit.state.lenses[1], tile)) {
                    let inverse_std = inverse_std / fit.tile_noise;
                    views[plane.instant].push(JudgedTile {
                        tile: *tile,
                        plane: normal.dot(&ray) / distance,
                        inverse_std,
                    });
                }
            }
        }
        views
    }

    /// The covariance of lens and pose by planes: by the tiles' scatter, and by that of the corners' answer, which moves
    /// all planes of a view together and, through colour's lens, those of all views.
    fn covariance(&self, corners: &Corners, fit: &Fit) -> Option<DMatrix<f64>> {
        let own = fit.equations.global_covariance()?;
        let size = own.nrows();
        let mut spread = DMatrix::zeros(size, size);
        let mut by_lens = DMatrix::zeros(size, corners.covariance.nrows());
        for (instant, block) in corners.equations.instants.iter().enumerate() {
            let Some(factor) = Matrix6::from_fn(|a, b| block.hessian[a][b]).cholesky() else { continue };
            let (planes, corners) = (fit.equations.coupling_of(instant), corners.equations.coupling_of(instant));
            let inverse = factor.inverse();
            let coupled = DMatrix::from_fn(size, 6, |k, a| planes[k][a]);
            let inverse = DMatrix::from_fn(6, 6, |a, b| inverse[(a, b)]);
            spread += &coupled * &inverse * coupled.transpose();
            let through = DMatrix::from_fn(6, by_lens.ncols(), |a, k| corners[k][a]);
            by_lens += &coupled * inverse * through;
        }
        spread += &by_lens * &corners.covariance * by_lens.transpose();
        Some(&own + &own * spread * &own)
    }

    fn assemble(
        &self,
        corners: &Corners,
        fit: &Fit,
        (smoothness, tried): (Smoothness, Vec<TriedCorrection>),
    ) -> Result<RgbdEstimate, EstimationError> {
        let lens = fit.state.lenses[1];
        let (depth_covariance, pose_covariance) = match corners.layout.sensors.get(1) {
            Some(sensor) => {
                let pose_at = sensor.pose_at.unwrap_or(0);
                (corners.lens_covariance(1), Matrix6::from_fn(|a, b| corners.covariance[(pose_at + a, pose_at + b)]))
            }
            None => {
                let covariance = self.covariance(corners, fit).ok_or(EstimationError::NoFit)?;
                let sensor = &self.layout.sensors[1];
                let (at, count, pose_at) = (sensor.lens_at, sensor.lens.free.len(), sensor.pose_at.unwrap_or(0));
                let spread = sensor.lens.spread(&lens);
                let of_lens = &spread * covariance.view((at, at), (count, count)) * spread.transpose();
                (of_lens, Matrix6::from_fn(|a, b| covariance[(pose_at + a, pose_at + b)]))
            }
        };
        let depth_from_color = fit.state.sensor_from_rig[1];
        let by_step = inverse_step(&depth_from_color);
        let correction = (fit.correction.terms > 0).then(|| fit.correction.clone());
        let uncentered = |color_from_board: &Pose| shifted(color_from_board, &-corners.center);
        Ok(RgbdEstimate {
            color: fit.state.lenses[0],
            color_covariance: corners.lens_covariance(0),
            depth: DepthCamera { lens, correction, ..self.problem.depth.clone() },
            depth_covariance,
            color_from_depth: depth_from_color.inverse(),
            color_from_depth_covariance: by_step * pose_covariance * by_step.transpose(),
            color_from_board: fit.state.rig_from_board.iter().map(uncentered).collect(),
            tile_noise: fit.tile_noise,
            judged: self.judged(fit),
            smoothness,
            tried,
        })
    }
}

/// The planes' normal equations with the prior of the correction, whose coefficients begin at global parameter `at`, and
/// every tile's residual.
fn linearized(
    layout: &Layout,
    (whole, prior): (&Whole, &Prior),
    at: usize,
    planes: &[PlaneSight],
) -> Option<(NormalEquations, Vec<Vec<f64>>)> {
    let mut equations = NormalEquations::empty(layout.len, whole.rig.rig_from_board.len());
    let residuals = add_planes(&mut equations, (layout, &whole.rig), (&whole.correction, at), planes);
    let size = whole.correction.coefficients.len();
    let coefficients = nalgebra::DVector::from_column_slice(&whole.correction.coefficients);
    let pull = &prior.hessian * &coefficients;
    equations.cost += coefficients.dot(&pull);
    for i in 0..size {
        equations.global_gradient[at + i] += pull[i];
        for j in 0..size {
            equations.global[(at + i, at + j)] += prior.hessian[(i, j)];
        }
    }
    let lost = |(residuals, plane): (&Vec<f64>, &PlaneSight)| {
        residuals.iter().zip(&plane.used).any(|(residual, used)| *used && !residual.is_finite())
    };
    let usable = equations.cost.is_finite() && !residuals.iter().zip(planes).any(lost);
    usable.then_some((equations, residuals))
}

fn scaled(plane: &PlaneSight, noise: f64) -> PlaneSight {
    PlaneSight { inverse_std: plane.inverse_std.iter().map(|s| s / noise).collect(), ..plane.clone() }
}

/// How the inverse of a pose moves when the pose is moved by (ω, τ): ω' = −Rᵀω, τ' = −Rᵀτ + t' × Rᵀω with t' the
/// inverse's translation.
fn inverse_step(a_from_b: &Pose) -> Matrix6<f64> {
    let inverse = a_from_b.inverse();
    let rotation = inverse.rotation_matrix();
    let mut by_step = Matrix6::zeros();
    by_step.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rotation);
    by_step.fixed_view_mut::<3, 3>(3, 3).copy_from(&-rotation);
    let lever = crate::estimation::joint::linearize::cross(&inverse.translation()) * rotation;
    by_step.fixed_view_mut::<3, 3>(3, 0).copy_from(&lever);
    by_step
}
