//! The focal length to start with: each likely one is tried on the longest tracks, and the one that
//! explains most of them is used.

use crate::estimation::scene::bundle::BundleStop;
use crate::estimation::scene::problem::{SceneProblem, Track};
use crate::estimation::scene::reconstruction::{ImagePair, Reconstruction, reconstruct};
use crate::estimation::two_view::focal::{focal_votes, likely_focals};
use crate::geometry::lens::{Lens, LensModel};

/// Tracks on which focal lengths are tried.
const TRIED_TRACKS: usize = 400;

/// Focal lengths tried in addition to the likely ones, over the longer side: fields of view of 80,
/// 45, 26 and 14 degrees. Iterations from one reach as far as the next.
const TRIED_FOCALS: [f64; 4] = [0.6, 1.2, 2.2, 4.0];

/// How many of the best votes for a focal length are tried.
const BEST_VOTES: usize = 2;

/// Two focal lengths within this ratio are one hypothesis.
const SAME_FOCAL_RATIO: f64 = 1.25;

/// An unexplained observation costs as much as one with a residual of this many standard
/// deviations.
const UNEXPLAINED_STDS: f64 = 10.0;

/// Cauchy's limit in the comparison, in expected standard deviations.
const CAUCHY_LIMIT_STDS: f64 = 3.0;

const TRIAL_STOP: BundleStop = BundleStop { max_steps: 25, least_decrease: 1e-3 };

/// The reconstruction of all tracks from the focal length that explains the longest tracks best. If
/// `given`, only that one is tried. `None` where no reconstruction can be started.
pub fn reconstruct_best(
    problem: &SceneProblem,
    pairs: &[ImagePair],
    given: Option<f64>,
) -> Option<Reconstruction> {
    let focals = given.map_or_else(|| hypotheses(problem, pairs), |focal| vec![focal]);
    let mut by_length: Vec<&Track> = problem.tracks.iter().collect();
    by_length.sort_by_key(|track| std::cmp::Reverse(track.len()));
    let tracks: Vec<Track> = by_length.into_iter().take(TRIED_TRACKS).cloned().collect();
    let few = SceneProblem { tracks, ..problem.clone() };
    let tried = focals.into_iter().filter_map(|focal| tried(&few, pairs, focal));
    let (lens, _) = tried.min_by(|a, b| a.1.total_cmp(&b.1))?;
    reconstruct(problem, pairs, lens)
}

fn hypotheses(problem: &SceneProblem, pairs: &[ImagePair]) -> Vec<f64> {
    let size = problem.image_size;
    let weighted: Vec<_> =
        pairs.iter().map(|pair| (pair.fundamental, (pair.matches.len() as f64).sqrt())).collect();
    let votes = likely_focals(&focal_votes(&weighted, size));
    let mut focals: Vec<f64> = votes.iter().take(BEST_VOTES).map(|vote| vote.focal_px).collect();
    let longer = f64::from(size.width.max(size.height));
    for focal in TRIED_FOCALS.map(|part| part * longer) {
        if focals.iter().all(|other| (other / focal).ln().abs() > SAME_FOCAL_RATIO.ln()) {
            focals.push(focal);
        }
    }
    focals
}

/// A lens that starts from this focal length after bundle adjustment, and the mean loss of all
/// observations.
fn tried(few: &SceneProblem, pairs: &[ImagePair], focal: f64) -> Option<(Lens, f64)> {
    let center = few.image_size.center();
    let parameters = [focal, focal, center.x, center.y, 0.0, 0.0];
    let lens = Lens::from_parameters(LensModel::Radial, &parameters)?;
    let Reconstruction { mut bundle, state, .. } = reconstruct(few, pairs, lens)?;
    bundle.free = vec![Lens::FX, Lens::FY, Lens::FIRST_COEFFICIENT];
    bundle.robust_limit = CAUCHY_LIMIT_STDS;
    let state = bundle.minimize(state, TRIAL_STOP);
    let explained: usize = bundle.observations.iter().map(Vec::len).sum();
    let all: usize = few.tracks.iter().map(Vec::len).sum();
    let limit = CAUCHY_LIMIT_STDS * CAUCHY_LIMIT_STDS;
    let unexplained = limit * (1.0 + UNEXPLAINED_STDS * UNEXPLAINED_STDS / limit).ln();
    let cost = bundle.cost(&state) + (all - explained) as f64 * unexplained;
    Some((state.lens, cost / all.max(1) as f64))
}
