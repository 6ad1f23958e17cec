//! How far to trust a calibration, in words that a person can act on.

use crate::calibration::coverage::Coverage;
use crate::calibration::few_views::few_views;
use crate::calibration::given_misfit::contradiction;
use crate::calibration::known_image::KnownImage;
use crate::calibration::result::{Finding, Grade, Verdict};
use crate::calibration::rounded::{in_differing_digits, value_with_std};
use crate::calibration::tag_spacing::TagSpacing;
use crate::estimation::camera::CameraEstimate;
use crate::estimation::given_misfit::GivenCheck;
use crate::estimation::lens_choice::lens_misfit::LensMisfit;
use crate::estimation::lens_choice::other_minimum::OtherMinimum;
use crate::estimation::lens_pole::has_pole;
use crate::estimation::model_check::ModelCheck;
use crate::estimation::uncertainty::UncertaintyMap;
use crate::estimation::undetermined_coefficients::undetermined_coefficients;
use crate::geometry::lens::Lens;

/// The split-half ratio up to which a calibration is good, and usable: about 1 if the model is
/// right, and above 2.5 in one of two hundred such sets (3 of 600 simulated ones).
pub(super) const SPLIT_HALF: [f64; 2] = [2.5, 6.0];
/// The same limits for the correlation of neighboring corners' residuals; blur and pixels alone
/// cause some.
const CORRELATION: [f64; 2] = [0.5, 0.8];
/// The same limits for how many times greater the uncertainty is than if corners had independent
/// errors.
const SHARED_ERROR_FACTORS: [f64; 2] = [2.0, 8.0];
/// The same limits for the fraction of outliers among the corners.
const OUTLIERS: [f64; 2] = [0.02, 0.25];
/// The fraction of the image with corners from which a calibration is good, and usable.
const COVERAGE: [f64; 2] = [0.6, 0.15];
/// The greatest angle between the board's normals, in degrees, up to which its tilt counts as the
/// same in all views.
const SAME_TILT_DEG: f64 = 15.0;
/// If tilts vary by less than this in one of two directions, that direction is missing.
const LEAST_TILT_RANGE_DEG: f64 = 7.5;

/// The same limits for the fraction of an image outside a pinhole lens's valid region: the image's
/// corners alone are less than the first. Chosen, not swept.
const WITHOUT_RAY_FRACTIONS: [f64; 2] = [0.05, 0.25];

/// Uncertainties that are this many times greater are mentioned.
const NOTABLE_WIDENING: f64 = 1.2;

/// Grades a calibration, with reasons. `shutter_in_model`: whether the rolling shutter of
/// `estimate` was part of the solve; it is not where a sensor was solved with others.
pub(crate) fn judge(
    estimate: &CameraEstimate,
    uncertainty: Option<&UncertaintyMap>,
    check: &ModelCheck,
    coverage: &Coverage,
    shutter_in_model: bool,
) -> Verdict {
    let mut findings: Vec<Finding> = Vec::new();
    // Causes come before their effects: of findings with one grade, the first is to be fixed first.
    findings.extend(contradicted(check));
    findings.extend(misfit(estimate, check));
    findings.extend(bent_board(check));
    findings.extend(too_simple_lens(estimate, check));
    findings.extend(canceling_coefficients(estimate, uncertainty));
    let factor = if findings.is_empty() { 1.0 } else { estimate.variance_inflation.sqrt() };
    findings.extend(without_ray(&estimate.lens, uncertainty));
    findings.extend(self::uncertainty(uncertainty, factor));
    findings.extend(other_spacing(estimate));
    findings.extend(rejected_views(estimate));
    findings.extend(rejected_corners(estimate));
    findings.extend(few_views(estimate));
    findings.extend(missing_area(coverage));
    findings.extend(flat_board(estimate));
    findings.extend(accounted_for(estimate, shutter_in_model));
    findings.extend(correlated(estimate));
    Verdict::of(findings)
}

/// If a board's lengths along x and y differ by more than this, relatively, printing does not
/// explain it: half a millimeter over a meter.
const ASPECT_TOLERANCE: f64 = 5e-4;

/// A finding if the board seems longer one way while pixels were taken as square: pixels that are
/// not square have the same effect.
pub(crate) fn square_pixels(estimate: &CameraEstimate) -> Option<String> {
    let shape = estimate.board_shape.as_ref()?;
    let percent = 100.0 * shape.aspect();
    (percent.abs() > 100.0 * ASPECT_TOLERANCE).then(|| {
        format!(
            "assuming square pixels, the board is {percent:+.2} % longer along its rows than along its columns: measure the board, or omit --square-pixels, because non-square pixels have the same effect"
        )
    })
}

/// How much of the image is known well enough; a model that does not fit makes it `factor` times as
/// uncertain.
fn uncertainty(map: Option<&UncertaintyMap>, factor: f64) -> Option<Finding> {
    let worst_px = map.and_then(UncertaintyMap::median_and_worst).map(|known| known.worst_px);
    let (Some(map), Some(worst_px)) = (map, worst_px) else {
        let reason = "the projection uncertainty cannot be computed: add views in all parts of the image, with the board tilted".to_owned();
        return Some(Finding { grade: Grade::Poor, reason });
    };
    let known = KnownImage::of(map);
    let (grade, good_px) = (known.grade(), known.good_px());
    let unknown = |col: usize, row: usize| {
        let std_px = map.std_px[row * map.grid.cols as usize + col];
        f64::from(u8::from(std_px.is_some_and(|std_px| std_px > good_px)))
    };
    let is_worst = |col: usize, row: usize| {
        let std_px = map.std_px[row * map.grid.cols as usize + col];
        f64::from(u8::from(std_px == Some(worst_px)))
    };
    let counts = [map.grid.cols, map.grid.rows].map(|count| count as usize);
    let (place, of_worst) = (region_with_most(counts, unknown), region_with_most(counts, is_worst));
    let there = if of_worst == place { String::new() } else { format!(" in the {of_worst}") };
    let percent = known.beyond_good_percent();
    let remedy = if known.grade_widened(factor) > grade {
        "mainly because the model does not fit: correct that first, then add views there"
    } else {
        "add views there, near and far, tilted"
    };
    let reason = format!(
        "the projection uncertainty exceeds {good_px:.2} px (1 sigma) in {percent:.0} % of the image, mostly in the {place}, and reaches {worst_px:.2} px{there}: {remedy}"
    );
    Finding::worse_than_good(grade, reason)
}

/// A finding if part of the image is outside the valid region of a lens model that should cover it.
fn without_ray(lens: &Lens, map: Option<&UncertaintyMap>) -> Option<Finding> {
    let std_px = &map.filter(|_| lens.distortion.as_rational().is_some())?.std_px;
    let unseen = std_px.iter().filter(|std_px| std_px.is_none()).count();
    let part = unseen as f64 / std_px.len().max(1) as f64;
    let reason = format!(
        "the estimated lens model cannot be inverted in {:.0} % of the image, and the stated uncertainty does not apply there: add views there",
        100.0 * part
    );
    Finding::worse_than_good(Grade::of_figure(part, WITHOUT_RAY_FRACTIONS), reason)
}

/// Findings that the model does not fit: first the cause, if it can be determined, then the signs.
fn misfit(estimate: &CameraEstimate, check: &ModelCheck) -> Vec<Finding> {
    let signs: Vec<Finding> =
        [halves(estimate, check), variance_inflation(estimate), smooth_residuals(check)]
            .into_iter()
            .flatten()
            .collect();
    let Some(grade) = signs.iter().map(|sign| sign.grade).min() else { return Vec::new() };
    let signs: Vec<String> = signs.into_iter().map(|sign| sign.reason).collect();
    let cause = cause(estimate, check).map(|reason| Finding { grade, reason });
    let signs = format!("the model does not fit: {}", signs.join("; "));
    cause.into_iter().chain([Finding { grade, reason: signs }]).collect()
}

/// A finding if the views contradict given lens parameters.
fn contradicted(check: &ModelCheck) -> Option<Finding> {
    let GivenCheck::Contradicted(misfit) = &check.given else { return None };
    Some(Finding { grade: Grade::Poor, reason: contradiction(misfit, "views") })
}

/// `None` where another finding has it.
fn cause(estimate: &CameraEstimate, check: &ModelCheck) -> Option<String> {
    if matches!(check.given, GivenCheck::Contradicted(_)) {
        return None;
    }
    let is_doubtful = check.given == GivenCheck::Unknown;
    let is_estimated = estimate.lens_std().iter().any(|std| *std > 0.0);
    let shutter = check.misfit.rolling_shutter.map(|part| {
        let percent = part * 100.0;
        format!(
            "board or camera moved during readout (rolling shutter), which explains {percent:.0} % of the residuals: hold both still for each view"
        )
    });
    let uneven = check.misfit.peak_to_valley_m.map(|meters| {
        let millimeters = meters * 1000.0;
        format!(
            "residuals follow the board, which seems bent or uneven by {millimeters:.2} mm: mount it on something flat and stiff"
        )
    });
    let known: Vec<String> = shutter.into_iter().chain(uneven).collect();
    if !known.is_empty() {
        let or = if is_doubtful {
            "; or the given lens parameters are those of another camera"
        } else {
            ""
        };
        return Some(known.join("; ") + or);
    }
    let others = "check that the board is flat and held still, and that focus and zoom are fixed";
    Some(if is_doubtful {
        format!(
            "the cause is unknown: the given lens parameters may be those of another camera (the views do not determine them); otherwise {others}"
        )
    } else if estimate.compared.is_empty() && is_estimated {
        format!("the cause is unknown: let the lens model be chosen (auto); otherwise {others}")
    } else {
        format!("the cause is unknown: {others}")
    })
}

fn halves(estimate: &CameraEstimate, check: &ModelCheck) -> Option<Finding> {
    let enough =
        estimate.views.iter().filter(|view| view.fault.is_none()).count() >= ModelCheck::MIN_VIEWS;
    // If the lens is given completely, halves cannot differ.
    let is_estimated = estimate.lens_covariance.diagonal().iter().any(|value| *value > 0.0);
    let Some(ratio) = check.split_half_ratio else {
        return (enough && is_estimated).then(|| Finding {
            grade: Grade::Poor,
            reason: "two halves of the views differ too much to be compared".to_owned(),
        });
    };
    let change = check.focal_change.unwrap_or(0.0) * 100.0;
    let sign = format!(
        "the solutions of two halves of the views differ by {ratio:.1} times their predicted uncertainty (fx by {change:.2} %)"
    );
    Finding::worse_than_good(Grade::of_figure(ratio, SPLIT_HALF), sign)
}

fn variance_inflation(estimate: &CameraEstimate) -> Option<Finding> {
    let factor = estimate.variance_inflation.sqrt();
    let sign = format!(
        "residuals are correlated within views, which makes the result {factor:.1} times as uncertain as independent corner noise would"
    );
    Finding::worse_than_good(Grade::of_figure(factor, SHARED_ERROR_FACTORS), sign)
}

fn smooth_residuals(check: &ModelCheck) -> Option<Finding> {
    let correlation = check.residual_correlation?;
    let sign = format!(
        "the residuals of neighboring corners are correlated ({correlation:.2}; independent noise gives about 0)"
    );
    Finding::worse_than_good(Grade::of_figure(correlation, CORRELATION), sign)
}

fn too_simple_lens(estimate: &CameraEstimate, check: &ModelCheck) -> Option<Finding> {
    let LensMisfit { model, held_out_rms_px: [own_px, larger_px], fx, widening } =
        check.lens_misfit?;
    let own = estimate.lens.model();
    let off =
        |px: Option<f64>| px.map_or("too large to compute".to_owned(), |px| format!("{px:.3} px"));
    let (own_px, larger_px) = match (own_px, larger_px) {
        (Some(own_px), Some(larger_px)) => {
            in_differing_digits([own_px, larger_px], 3).map(|px| format!("{px} px")).into()
        }
        (own_px, larger_px) => (off(own_px), off(larger_px)),
    };
    let mut reason = if estimate.compared.is_empty() {
        format!(
            "the lens model {own} is too simple for this lens: the held-out error is {own_px} with {own} and {larger_px} with {model}, which gives fx {fx:.1}: use {model}, or let the model be chosen (auto)"
        )
    } else {
        format!(
            "the views do not discriminate between lens models: {own} was chosen (held-out error {own_px}), but {model} ({larger_px}) would give fx {fx:.1}: add tilted views near the edges of the image"
        )
    };
    if widening > NOTABLE_WIDENING {
        reason += &format!(
            "; the stated uncertainties are increased by a factor of {widening:.1} to cover this"
        );
    }
    Some(Finding { grade: Grade::Usable, reason })
}

fn canceling_coefficients(
    estimate: &CameraEstimate,
    map: Option<&UncertaintyMap>,
) -> Option<Finding> {
    has_pole(&estimate.lens, map?.grid.size).then(|| {
        let model = estimate.lens.model();
        let reason = format!(
            "numerator and denominator of the {model} lens nearly cancel, leaving a pole inside the image, which no real lens has: the views do not determine that many coefficients; use brown, or let the model be chosen (auto)"
        );
        Finding { grade: Grade::Poor, reason }
    })
}

fn bent_board(check: &ModelCheck) -> Option<Finding> {
    let [x, y] =
        check.board_bow_m.filter(|_| check.misfit.peak_to_valley_m.is_none())?.map(|m| m * 1000.0);
    let reason = format!(
        "residuals follow the board, which seems bent by {x:.1} mm along its rows and {y:.1} mm along its columns: mount it on something flat and stiff, or have its warp estimated"
    );
    Some(Finding { grade: Grade::Usable, reason })
}

fn other_spacing(estimate: &CameraEstimate) -> Option<Finding> {
    let TagSpacing { stated, measured, std } =
        TagSpacing::off_stated(estimate.board_shape.as_ref()?)?;
    let percent = 100.0 * ((1.0 + stated) / (1.0 + measured) - 1.0).abs();
    let measured = value_with_std(measured, std);
    let reason = format!(
        "the gap between tags is {measured} of a tag's side, not {stated:.3} as stated: correct the target's `spacing`; with the stated value distances are wrong by {percent:.1} %"
    );
    Some(Finding { grade: Grade::Usable, reason })
}

/// Deviations from what was stated that were measured and modeled; they do not lower the grade.
fn accounted_for(estimate: &CameraEstimate, shutter_in_model: bool) -> Vec<Finding> {
    let board = estimate.board_shape.as_ref().map(|shape| {
        let [rms, std] = [shape.unevenness_m, shape.unevenness_std_m].map(|m| m * 1000.0);
        let rms = value_with_std(rms, std);
        format!("the board is uneven by {rms} mm (rms); its shape is estimated and corrected for")
    });
    let shutter = estimate.rolling_shutter.map(|shutter| {
        let (millimeters, degrees) =
            (shutter.translation_m * 1000.0, shutter.rotation_rad.to_degrees());
        if !shutter_in_model {
            return format!(
                "rolling shutter: the board moved by {millimeters:.2} mm and {degrees:.2} degrees during readout; the joint solve of all sensors assumes a global shutter, and the uncertainty includes the difference: hold board and camera still for a better result"
            );
        }
        if shutter.agreement < 1.0 {
            let percent = 100.0 * shutter.agreement;
            return format!(
                "possible rolling shutter: the views disagree about it, so it is weighted by {percent:.0} % and the rest is included in the uncertainty; hold board and camera still for a better result"
            );
        }
        format!(
            "rolling shutter: the board moved by {millimeters:.2} mm and {degrees:.2} degrees during readout; this is estimated and corrected for; hold board and camera still for a better result"
        )
    });
    let known = |reason| Finding { grade: Grade::Good, reason };
    board.into_iter().chain(shutter).map(known).collect()
}

/// A finding if some coefficients are not meaningful by themselves; projections are not affected.
fn correlated(estimate: &CameraEstimate) -> Option<Finding> {
    let lens = &estimate.lens;
    if let Some(OtherMinimum { lens: other, .. }) = &estimate.other_minimum {
        let [own, other] = [lens, other].map(numbers_of);
        let reason = format!(
            "two solutions of the {} model fit these views equally well, {own} and {other}: use the parameters of one solution together; the projection uncertainty is not affected",
            lens.model()
        );
        return Some(Finding { grade: Grade::Good, reason });
    }
    let names = undetermined_coefficients(lens, &estimate.lens_std(), estimate.image_size);
    let which = match names.as_slice() {
        [one] => format!("{one} of the {} lens is", lens.model()),
        _ => format!("{} of the {} lens are", names.join(", "), lens.model()),
    };
    let reason = format!(
        "{which} not determined individually: use all coefficients together, never one alone; the projection uncertainty is not affected"
    );
    (!names.is_empty()).then_some(Finding { grade: Grade::Good, reason })
}

/// The focal length and the coefficients of a lens.
fn numbers_of(lens: &Lens) -> String {
    let coefficients = lens.distortion.coefficients();
    let named = lens.model().coefficient_names().iter().zip(coefficients);
    let coefficients: String = named.map(|(name, value)| format!(", {name} {value:.3}")).collect();
    format!("(fx {:.1}{coefficients})", lens.matrix.fx)
}

fn rejected_views(estimate: &CameraEstimate) -> Option<Finding> {
    let rejected: Vec<_> =
        estimate.views.iter().filter_map(|view| Some((&view.name, view.fault?))).collect();
    let (name, fault) = rejected.first()?;
    let (count, all) = (rejected.len(), estimate.views.len());
    let grade = if 2 * count > all { Grade::Poor } else { Grade::Usable };
    let which = if count == 1 { "view was" } else { "views were" };
    let reason = format!("{count} of {all} {which} not used; view `{name}`: {fault}");
    Some(Finding { grade, reason })
}

fn rejected_corners(estimate: &CameraEstimate) -> Option<Finding> {
    let used_views = || estimate.views.iter().filter(|view| view.fault.is_none());
    let all = used_views().map(|view| view.used.len()).sum::<usize>();
    let rejected = used_views().flat_map(|view| &view.used).filter(|used| !**used).count();
    let worst = used_views().max_by_key(|view| view.used.iter().filter(|used| !**used).count())?;
    let part = rejected as f64 / all.max(1) as f64;
    let reason = format!(
        "{rejected} of {all} corners are outliers and were not used, most of them in view `{}`: check focus, reflections and occlusions of the board",
        worst.name
    );
    Finding::worse_than_good(Grade::of_figure(part, OUTLIERS), reason)
}

fn missing_area(coverage: &Coverage) -> Option<Finding> {
    let fraction = coverage.fraction();
    let grade = Grade::of_figure(1.0 - fraction, COVERAGE.map(|part| 1.0 - part));
    let emptiest = emptiest_region(coverage);
    let seen = fraction * 100.0;
    Finding::worse_than_good(
        grade,
        format!(
            "corners were seen in {seen:.0} % of the image, fewest in the {emptiest}: hold the board there"
        ),
    )
}

/// The third of the image, across and down, with the most cells without a corner.
fn emptiest_region(coverage: &Coverage) -> String {
    let cells = coverage.cells();
    let empty = |col: usize, row: usize| f64::from(u8::from(cells[row][col] == 0));
    region_with_most([cells[0].len(), cells.len()], empty)
}

/// The third of the image, across and down, with the greatest sum of `count` over a grid of columns
/// and rows.
fn region_with_most([cols, rows]: [usize; 2], count: impl Fn(usize, usize) -> f64) -> String {
    let third = |at: usize, count: usize| at * 3 / count;
    let mut sums = [[0.0_f64; 3]; 3];
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        sums[third(row, rows)][third(col, cols)] += count(col, row);
    }
    let regions = (0..9).map(|k| (k / 3, k % 3));
    let (row, col) =
        regions.max_by(|a, b| sums[a.0][a.1].total_cmp(&sums[b.0][b.1])).unwrap_or((1, 1));
    match (["upper", "", "lower"][row], ["left", "", "right"][col]) {
        ("", "") => "middle".to_owned(),
        ("", side) => format!("{side} middle"),
        (side, "") => format!("{side} middle"),
        (vertical, horizontal) => format!("{vertical} {horizontal}"),
    }
}

/// A finding if the board's tilt hardly varies between views, or in one direction only. Each
/// direction of tilt determines the focal length by itself; if one is missing, the lens model's
/// residual errors resemble a tilt in it.
fn flat_board(estimate: &CameraEstimate) -> Option<Finding> {
    let used = estimate.views.iter().filter(|view| view.fault.is_none());
    let normals: Vec<_> =
        used.filter_map(|view| Some(view.camera_from_board? * nalgebra::Vector3::z())).collect();
    let mean: nalgebra::Vector3<f64> = normals.iter().sum();
    let widest =
        normals.iter().map(|normal| 2.0 * normal.angle(&mean)).fold(0.0, f64::max).to_degrees();
    if normals.len() < 2 {
        return None;
    }
    if widest < SAME_TILT_DEG {
        let reason = format!(
            "the board's tilt varies by at most {widest:.0} degrees, so the focal length is poorly determined: tilt it by 20 to 45 degrees in different directions"
        );
        return Some(Finding { grade: Grade::Usable, reason });
    }
    let [wide, narrow] = tilt_ranges(&normals, &mean)?;
    let named = if narrow.axis.x.abs() > narrow.axis.y.abs() {
        "its right and its left side"
    } else {
        "its top and its bottom"
    };
    let reason = format!(
        "the board's tilt varies by {:.0} degrees about one axis and by {:.0} about the other, so the focal length is poorly determined: also tilt {named} towards the camera, by 20 to 45 degrees",
        wide.range_deg, narrow.range_deg
    );
    (narrow.range_deg < LEAST_TILT_RANGE_DEG).then_some(Finding { grade: Grade::Usable, reason })
}

/// The range of directions along one axis.
#[derive(Debug, Clone, Copy)]
struct TiltRange {
    /// From the least to the greatest, in degrees.
    range_deg: f64,
    /// The axis that tilts differ along, a unit vector in the camera frame.
    axis: nalgebra::Vector3<f64>,
}

/// The ranges of directions around their mean, along the axis of the greatest scatter and across
/// it.
fn tilt_ranges(
    directions: &[nalgebra::Vector3<f64>],
    mean: &nalgebra::Vector3<f64>,
) -> Option<[TiltRange; 2]> {
    let mean = mean.try_normalize(1e-12)?;
    let off = || directions.iter().map(|direction| direction - mean * direction.dot(&mean));
    let scatter: nalgebra::Matrix3<f64> = off().map(|off| off * off.transpose()).sum();
    let along = scatter.symmetric_eigen();
    let greatest = along.eigenvectors.column(along.eigenvalues.imax()).into_owned();
    let range = |axis: nalgebra::Vector3<f64>| {
        let at = || off().map(|off| off.dot(&axis).clamp(-1.0, 1.0).asin());
        let [least, most] =
            [at().fold(f64::INFINITY, f64::min), at().fold(f64::NEG_INFINITY, f64::max)];
        TiltRange { range_deg: (most - least).to_degrees(), axis }
    };
    Some([range(greatest), range(mean.cross(&greatest))])
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn the_direction_in_which_the_tilt_hardly_differs_is_found() {
        // Right and left sides nearer by rotations about y, top and bottom by those about x.
        let normal = |about_x: f64, about_y: f64| {
            let rotation = Vector3::new(about_x.to_radians(), about_y.to_radians(), 0.0);
            UnitQuaternion::from_scaled_axis(rotation) * Vector3::z()
        };
        // Those about x come alike on both sides of those about y: the axes are x and y.
        let normals: Vec<_> = (0..9)
            .map(|k| normal(f64::from(k % 2) * 2.0 - 1.0, 5.0 * f64::from(k) - 20.0))
            .collect();
        let [wide, narrow] = tilt_ranges(&normals, &normals.iter().sum()).unwrap();
        assert!((wide.range_deg - 40.0).abs() < 1.0 && wide.axis.x.abs() > 0.99, "{wide:?}");
        assert!((narrow.range_deg - 2.0).abs() < 0.2 && narrow.axis.y.abs() > 0.99, "{narrow:?}");
    }
}
