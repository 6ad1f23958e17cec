//! The outcome of sessions with a simulated operator, in readable form.

use serde::Serialize;

/// The outcome of a session.
#[derive(Debug, Clone, Serialize)]
pub struct OperatedOutcome {
    /// Its seed.
    pub seed: u64,
    /// The lens and the board.
    pub setting: String,
    /// Whether it reached its goal in time.
    pub reached: bool,
    /// Views kept.
    pub views: u32,
    /// Seconds of the operator's time.
    pub seconds: f64,
    /// The median and the worst predicted uncertainty over the image, in pixels.
    pub predicted_px: [f64; 2],
    /// The true projection errors over the image: their median and their maximum, in pixels.
    pub error_px: [f64; 2],
    /// The error of fx divided by its standard deviation.
    pub focal_ratio: f64,
    /// The fractions of the errors, along the principal axes of their predicted covariance and over
    /// the image, that are within one and two standard deviations.
    pub within: [f64; 2],
    /// After each estimate: number of views, seconds, and the median and the worst predicted
    /// uncertainty over the image, in pixels.
    pub course: Vec<(u32, f64, f64, f64)>,
    /// The predicted numbers of further views, at least and at most, each with the number of views
    /// before it.
    pub to_go: Vec<(u32, [u32; 2])>,
}

impl OperatedOutcome {
    /// For each prediction, whether the number of views that were needed lay within it.
    fn held(&self) -> impl Iterator<Item = bool> {
        let needed = |views: u32| self.views.saturating_sub(views);
        self.to_go
            .iter()
            .map(move |(views, [few, many])| *few <= needed(*views) && needed(*views) <= *many)
    }

    /// The outcome in one line.
    pub fn line(&self) -> String {
        let Self { seed, setting, views, seconds, predicted_px, error_px, .. } = self;
        let [median, worst] = predicted_px;
        let [error, greatest] = error_px;
        let end = if self.reached { "" } else { "  not reached" };
        format!(
            "seed {seed:>4}  {setting:<10} {views:>4} views {seconds:>6.1} s  predicted {median:.3} px, at worst {worst:.3}  true {error:.3}, at worst {greatest:.3}{end}"
        )
    }
}

/// The medians over all sessions, and a comparison of the true errors with their predictions.
pub fn summary(outcomes: &[OperatedOutcome]) -> String {
    let median = |value: fn(&OperatedOutcome) -> f64| {
        let mut values: Vec<f64> = outcomes.iter().map(value).collect();
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let mean = |value: fn(&OperatedOutcome) -> f64| {
        outcomes.iter().map(value).sum::<f64>() / outcomes.len().max(1) as f64
    };
    let within = |limit: f64| {
        let count = outcomes.iter().filter(|outcome| outcome.focal_ratio.abs() <= limit).count();
        100.0 * count as f64 / outcomes.len().max(1) as f64
    };
    let said = outcomes.iter().filter(|outcome| outcome.reached).flat_map(OperatedOutcome::held);
    let said: Vec<bool> = said.collect();
    let held = said.iter().filter(|held| **held).count();
    let said = if said.is_empty() {
        String::new()
    } else {
        format!("; of {} numbers of views still needed {held} held", said.len())
    };
    format!(
        "{} sessions, {} reached: median {} views, {:.1} s; errors of projections within 1 and 2 sigma: {:.0} % and {:.0} %; of fx: {:.0} % and {:.0} %{said}",
        outcomes.len(),
        outcomes.iter().filter(|outcome| outcome.reached).count(),
        median(|outcome| f64::from(outcome.views)),
        median(|outcome| outcome.seconds),
        100.0 * mean(|outcome| outcome.within[0]),
        100.0 * mean(|outcome| outcome.within[1]),
        within(1.0),
        within(2.0)
    )
}
