//! Thirty photographs taken from nearly one place: what a lens model leaves over is the same in
//! all of them, so its own residuals do not show that the focal length is wrong.

use std::fs;
use std::path::Path;

use nalgebra::Point3;
use plumb::calibration::solve::solve_views;
use plumb::estimation::camera::CameraOptions;
use plumb::estimation::problem::{BoardView, CameraProblem, Correspondence, LensChoice};
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::{ImageSize, Pixel};

use crate::shared_data::shared_data;

/// The focal length that EuRoC publishes for its left camera, in pixels.
const PUBLISHED_FX: f64 = 458.654;

/// The corners of one photograph: columns 6 to 10 are the pixel and the point, in meters.
fn view(file: &Path) -> BoardView {
    let text = fs::read_to_string(file).unwrap();
    let correspondence = |line: &str| {
        let numbers: Vec<f64> =
            line.split(',').skip(5).take(5).map(|field| field.trim().parse().unwrap()).collect();
        Correspondence {
            point_in_board: Point3::new(numbers[2], numbers[3], numbers[4]),
            pixel: Pixel::new(numbers[0], numbers[1]),
            std_px: 1.0,
        }
    };
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
    BoardView {
        name: file.file_stem().unwrap().to_string_lossy().into_owned(),
        correspondences: lines.map(correspondence).collect(),
    }
}

fn problem() -> Option<CameraProblem> {
    let folder = shared_data("aprilgrid-euroc-corners")?.join("cam0");
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> =
        entries.filter(|path| path.extension().is_some_and(|end| end == "csv")).collect();
    files.sort();
    assert_eq!(files.len(), 30);
    let views = files.iter().map(|file| view(file)).collect();
    Some(CameraProblem { image_size: ImageSize::new(752, 480), views })
}

#[test]
fn a_lens_model_that_is_chosen_states_at_least_its_error() {
    let Some(problem) = problem() else { return };
    let solved = solve_views(&problem, &CameraOptions::default()).unwrap();
    let off = (solved.estimate.lens.matrix.fx - PUBLISHED_FX).abs();
    let std = solved.estimate.lens_covariance[(0, 0)].sqrt();
    let case = format!("{}: {:?}", solved.estimate.lens.model(), solved.verdict.reasons);
    assert!(off <= std, "fx is {off:.2} px off, {std:.2} px stated: {case}");
}

#[test]
fn a_lens_model_that_is_too_simple_states_at_least_its_error() {
    let Some(problem) = problem() else { return };
    for model in [LensModel::Brown, LensModel::KannalaBrandt] {
        let options = CameraOptions { lens: LensChoice::Model(model), ..CameraOptions::default() };
        let solved = solve_views(&problem, &options).unwrap();
        let off = (solved.estimate.lens.matrix.fx - PUBLISHED_FX).abs();
        let std = solved.estimate.lens_covariance[(0, 0)].sqrt();
        assert!(off <= std, "{model:?}: fx is {off:.2} px off, {std:.2} px stated");
        let reasons = &solved.verdict.reasons;
        assert!(reasons.iter().any(|reason| reason.contains("too simple")), "{reasons:?}");
    }
}
