//! How far to trust a calibration, in words that a person can act on.

use crate::calibration::calibration::{Grade, SensorCalibration, Verdict};
use crate::calibration::coverage::Coverage;
use crate::estimation::camera::CameraEstimate;
use crate::estimation::model_check::ModelCheck;

/// The worst uncertainty of the image for a good calibration, and for a usable one, as parts of the image's diagonal:
/// 0.4 and 4 px at 640x480.
const UNCERTAINTY: [f64; 2] = [0.0005, 0.005];
/// The split-half ratio likewise: about 1 where the model is right, and above 2 once in a hundred such sets.
const SPLIT_HALF: [f64; 2] = [2.5, 6.0];
/// The correlation of neighbouring corners' residuals; blur and pixels alone make some.
const CORRELATION: [f64; 2] = [0.5, 0.8];
/// How many times larger the uncertainty is than if each corner erred by itself.
const SHARED: [f64; 2] = [2.0, 8.0];
/// The part of the corners that took no part.
const OUTLIERS: [f64; 2] = [0.02, 0.25];
/// The part of the image with corners.
const COVERAGE: [f64; 2] = [0.6, 0.15];
/// The angle between the board's normals, in degrees, up to which it counts as flat in all views.
const FLAT_DEG: f64 = 15.0;

/// Grades a calibration and says why.
pub(crate) fn judge(
    estimate: &CameraEstimate,
    sensor: &SensorCalibration,
    check: &ModelCheck,
    coverage: &Coverage,
) -> Verdict {
    let mut findings: Vec<(Grade, String)> = Vec::new();
    findings.extend(uncertainty(sensor));
    findings.extend(misfit(estimate, check));
    findings.extend(bent_board(check));
    findings.extend(rejected_views(estimate));
    findings.extend(rejected_corners(estimate));
    findings.extend(missing_area(coverage));
    findings.extend(flat_board(estimate));
    let grade = findings.iter().map(|(grade, _)| *grade).min().unwrap_or(Grade::Good);
    findings.sort_by_key(|(grade, _)| *grade);
    Verdict { grade, reasons: findings.into_iter().map(|(_, reason)| reason).collect() }
}

/// The grade of a figure that should be low: `Good` up to the first limit, `Usable` up to the second.
fn graded(value: f64, [good, usable]: [f64; 2]) -> Grade {
    if value <= good {
        Grade::Good
    } else if value <= usable {
        Grade::Usable
    } else {
        Grade::Poor
    }
}

fn worse_than_good(grade: Grade, reason: String) -> Option<(Grade, String)> {
    (grade != Grade::Good).then_some((grade, reason))
}

fn uncertainty(sensor: &SensorCalibration) -> Option<(Grade, String)> {
    let worst = sensor.uncertainty_px.worst;
    let limits = UNCERTAINTY.map(|part| part * sensor.image_size.diagonal_px());
    let advice = "add views there, near and far, tilted";
    let reason = format!("projections are uncertain by up to {worst:.2} px (1 sigma) at the image's border: {advice}");
    worse_than_good(graded(worst, limits), reason)
}

/// That the model does not fit, and why, as far as it can be told.
fn misfit(estimate: &CameraEstimate, check: &ModelCheck) -> Vec<(Grade, String)> {
    let mut findings: Vec<(Grade, String)> =
        [halves(estimate, check), shared_error(estimate), smooth_residuals(check)].into_iter().flatten().collect();
    if let Some(worst) = findings.iter().map(|(grade, _)| *grade).min() {
        findings.push((worst, cause(estimate, check)));
    }
    findings
}

fn cause(estimate: &CameraEstimate, check: &ModelCheck) -> String {
    let shutter = check.misfit.rolling_shutter.map(|part| {
        let percent = part * 100.0;
        format!(
            "motion while the rows of the picture were read explains {percent:.0} % of what is left (rolling shutter): hold board and camera still for each view"
        )
    });
    let uneven = check.misfit.unevenness_m.map(|metres| {
        let millimetres = metres * 1000.0;
        format!(
            "the residuals turn with the board: it seems bent or uneven by {millimetres:.2} mm; use a flat, stiff one"
        )
    });
    let known: Vec<String> = shutter.into_iter().chain(uneven).collect();
    if !known.is_empty() {
        return known.join("; ");
    }
    let others = "check that the board is flat and held still, and that focus and zoom stay as they are";
    if estimate.compared.is_empty() {
        return format!("let the lens model be chosen (auto); else {others}");
    }
    others.to_owned()
}

fn halves(estimate: &CameraEstimate, check: &ModelCheck) -> Option<(Grade, String)> {
    let enough = estimate.views.iter().filter(|view| view.fault.is_none()).count() >= ModelCheck::MIN_VIEWS;
    let Some(ratio) = check.split_half_ratio else {
        let reason = "two halves of the views differ too much to be compared: the model does not fit".to_owned();
        return enough.then_some((Grade::Poor, reason));
    };
    let change = check.focal_change.unwrap_or(0.0) * 100.0;
    let reason = format!(
        "two halves of the views differ {ratio:.1} times as much as predicted (fx by {change:.2} %): the model does not fit"
    );
    worse_than_good(graded(ratio, SPLIT_HALF), reason)
}

fn shared_error(estimate: &CameraEstimate) -> Option<(Grade, String)> {
    let factor = estimate.shared_error.sqrt();
    let reason = format!(
        "the corners of a view err together, which makes the uncertainty {factor:.1} times what it were if each erred by itself: the model does not fit"
    );
    worse_than_good(graded(factor, SHARED), reason)
}

fn smooth_residuals(check: &ModelCheck) -> Option<(Grade, String)> {
    let correlation = check.residual_correlation?;
    let reason =
        format!("neighbouring corners are off together (correlation {correlation:.2}): the model does not fit");
    worse_than_good(graded(correlation, CORRELATION), reason)
}

fn bent_board(check: &ModelCheck) -> Option<(Grade, String)> {
    let [x, y] = check.bow_m.filter(|_| check.misfit.unevenness_m.is_none())?.map(|m| m * 1000.0);
    let reason = format!(
        "the residuals turn with the board: it seems bent by {x:.1} mm along its rows and {y:.1} mm along its columns; use a flat, stiff one"
    );
    Some((Grade::Usable, reason))
}

fn rejected_views(estimate: &CameraEstimate) -> Option<(Grade, String)> {
    let rejected: Vec<_> = estimate.views.iter().filter_map(|view| Some((&view.name, view.fault?))).collect();
    let (name, fault) = rejected.first()?;
    let (count, all) = (rejected.len(), estimate.views.len());
    let grade = if 2 * count > all { Grade::Poor } else { Grade::Usable };
    let which = if count == 1 { "view was" } else { "views were" };
    Some((grade, format!("{count} of {all} {which} not used; view `{name}`: {fault}")))
}

fn rejected_corners(estimate: &CameraEstimate) -> Option<(Grade, String)> {
    let used_views = || estimate.views.iter().filter(|view| view.fault.is_none());
    let all = used_views().map(|view| view.used.len()).sum::<usize>();
    let rejected = used_views().flat_map(|view| &view.used).filter(|used| !**used).count();
    let worst = used_views().max_by_key(|view| view.used.iter().filter(|used| !**used).count())?;
    let part = rejected as f64 / all.max(1) as f64;
    let reason = format!(
        "{rejected} of {all} corners are far off and were not used, most in view `{}`: check focus, reflections and what covers the board",
        worst.name
    );
    worse_than_good(graded(part, OUTLIERS), reason)
}

fn missing_area(coverage: &Coverage) -> Option<(Grade, String)> {
    let fraction = coverage.fraction();
    let grade = graded(1.0 - fraction, COVERAGE.map(|part| 1.0 - part));
    let emptiest = emptiest_region(coverage);
    let seen = fraction * 100.0;
    worse_than_good(
        grade,
        format!("corners were seen in {seen:.0} % of the image, fewest in the {emptiest}: hold the board there"),
    )
}

/// Which third of the image, across and down, has the most cells without a corner.
fn emptiest_region(coverage: &Coverage) -> String {
    let cells = coverage.cells();
    let (rows, cols) = (cells.len(), cells[0].len());
    let third = |at: usize, count: usize| at * 3 / count;
    let mut empty = [[0.0_f64; 3]; 3];
    for (row, line) in cells.iter().enumerate() {
        for (col, count) in line.iter().enumerate() {
            if *count == 0 {
                empty[third(row, rows)][third(col, cols)] += 1.0;
            }
        }
    }
    let regions = (0..9).map(|k| (k / 3, k % 3));
    let (row, col) = regions.max_by(|a, b| empty[a.0][a.1].total_cmp(&empty[b.0][b.1])).unwrap_or((1, 1));
    match (["upper", "", "lower"][row], ["left", "", "right"][col]) {
        ("", "") => "middle".to_owned(),
        ("", side) => format!("{side} middle"),
        (side, "") => format!("{side} middle"),
        (vertical, horizontal) => format!("{vertical} {horizontal}"),
    }
}

fn flat_board(estimate: &CameraEstimate) -> Option<(Grade, String)> {
    let used = estimate.views.iter().filter(|view| view.fault.is_none());
    let normals: Vec<_> = used.filter_map(|view| Some(view.camera_from_board? * nalgebra::Vector3::z())).collect();
    let mean: nalgebra::Vector3<f64> = normals.iter().sum();
    let widest = normals.iter().map(|normal| 2.0 * normal.angle(&mean)).fold(0.0, f64::max).to_degrees();
    let reason = format!(
        "the board's tilt differs by at most {widest:.0} degrees between views, which leaves the focal length weak: tilt it by 20 to 45 degrees in different directions"
    );
    (normals.len() > 1 && widest < FLAT_DEG).then_some((Grade::Usable, reason))
}
