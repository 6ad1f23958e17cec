//! What corners tell: lenses, the board's poses, and where the infrared camera is.

use nalgebra::{DMatrix, Vector3};

use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::normal::NormalEquations;
use crate::estimation::joint::{Layout, Sight, State};
use crate::estimation::rgbd::{DepthLens, RgbdProblem, free, shifted};
use crate::estimation::robust::{Loss, median};
use crate::geometry::pose::Pose;

/// The answer of the corners: sensor 0 is colour and the rig, sensor 1 infrared and depth.
pub(super) struct Corners {
    pub(super) layout: Layout,
    pub(super) state: State,
    pub(super) equations: NormalEquations,
    pub(super) covariance: DMatrix<f64>,
    /// What points are counted from, in the board frame.
    pub(super) center: Vector3<f64>,
}

impl Corners {
    pub(super) fn fit(problem: &RgbdProblem) -> Option<Self> {
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

    pub(super) fn lens_covariance(&self, sensor: usize) -> DMatrix<f64> {
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
