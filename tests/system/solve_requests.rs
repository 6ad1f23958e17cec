//! What a solve can be asked for beyond a lens model, by file and over HTTP alike: a bowed board, a
//! known camera matrix, square pixels; and its calibration for other images than those it was
//! made with, in every format.

use std::path::PathBuf;

use nalgebra::{Point3, Vector3};
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pose::Pose;
use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::{Served, replaying};

/// The camera that saw [`problem`]: fx, fy, cx, cy, skew, k1, k2, p1, p2, k3.
const CAMERA: [f64; 10] = [600.0, 604.0, 328.0, 236.0, 0.0, -0.2, 0.08, 0.001, -0.0005, 0.0];

/// Ten exact views of a grid that is bowed by `bow_m` at its middle along its rows.
fn problem(bow_m: f64) -> Value {
    seen_by(&Lens::from_parameters(LensModel::Brown, &CAMERA).unwrap(), bow_m)
}

/// The same seen by a camera with another lens.
fn seen_by(lens: &Lens, bow_m: f64) -> Value {
    let grid: Vec<Point3<f64>> = (0..54)
        .map(|k| Point3::new(f64::from(k % 9) * 0.03, f64::from(k / 9) * 0.03, 0.0))
        .collect();
    let view = |k: u32| {
        let k = f64::from(k);
        let rotation =
            Vector3::new(0.5 * (1.7 * k).sin(), 0.5 * (2.3 * k).cos(), 0.2 * (0.9 * k).sin());
        let middle =
            Vector3::new(0.06 * (3.1 * k).cos(), 0.04 * (1.3 * k).sin(), 0.5 + 0.03 * (k % 4.0));
        let rotated = Pose::from_axis_angle(rotation, Vector3::zeros());
        let camera_from_board =
            Pose::new(rotated.rotation(), middle - rotated * Vector3::new(0.12, 0.075, 0.0));
        let seen = grid.iter().map(|point| {
            let bowed =
                Point3::new(point.x, point.y, bow_m * (1.0 - (point.x / 0.12 - 1.0).powi(2)));
            let pixel = lens.pixel_from_point(&(camera_from_board * bowed)).unwrap();
            [pixel.x, pixel.y]
        });
        json!({
            "name": format!("view {k}"),
            "object": grid.iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>(),
            "image": seen.collect::<Vec<_>>(),
        })
    };
    json!({"image_size": [640, 480], "lens": "brown", "views": (0..10).map(view).collect::<Vec<_>>()})
}

fn with(problem: &Value, fields: &Value) -> Value {
    let mut changed = problem.clone();
    for (name, value) in fields.as_object().unwrap() {
        changed[name] = value.clone();
    }
    changed
}

fn written(folder: &tempfile::TempDir, problem: &Value) -> PathBuf {
    let file = folder.path().join("problem.json");
    std::fs::write(&file, problem.to_string()).unwrap();
    file
}

#[track_caller]
fn near(sensor: &Value, pointer: &str, value: f64, by: f64) {
    let found = sensor
        .pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("no {pointer} in {sensor}"));
    assert!((found - value).abs() <= by, "{pointer}: {found}, not {value}");
}

/// What is expected of a solve of `problem(0.002)` with `warp`, and of `problem(0)` with K given or
/// square pixels.
fn check_all(solve: impl Fn(&Value, &Value) -> Value) {
    let bowed = solve(&problem(0.002), &json!({"warp": true}));
    near(&bowed, "/board_warp_m/0", 0.002, 1e-8);
    near(&bowed, "/board_warp_m/1", 0.0, 1e-8);
    near(&bowed, "/rms_px", 0.0, 1e-6);
    near(&bowed, "/lens/fx", 600.0, 1e-4);
    let measured = solve(&problem(0.002), &json!({}));
    near(&measured, "/board_warp_m/0", 0.002, 1e-9);
    let flat = solve(&problem(0.002), &json!({"board_shape": "flat"}));
    assert!(
        flat.get("board_warp_m").is_none() && flat["rms_px"].as_f64().unwrap() > 0.01,
        "{flat}"
    );

    let given = json!({"given": {"fx": 600.0, "fy": 604.0, "cx": 328.0, "cy": 236.0}});
    let known = solve(&problem(0.0), &given);
    for (name, value) in [("fx", 600.0), ("fy", 604.0), ("cx", 328.0), ("cy", 236.0)] {
        near(&known, &format!("/lens/{name}"), value, 0.0);
        near(&known, &format!("/lens_std/{name}"), 0.0, 0.0);
    }
    near(&known, "/lens/k1", -0.2, 1e-6);
    let square = solve(&problem(0.0), &json!({"square_pixels": true}));
    assert_eq!(square["lens"]["fx"], square["lens"]["fy"]);
    let skewed = solve(&problem(0.0), &json!({"skew": true}));
    near(&skewed, "/lens/skew", 0.0, 1e-4);
    assert!(skewed["lens_std"]["skew"].as_f64().unwrap() > 0.0, "{skewed}");
}

#[test]
fn a_file_may_ask_for_a_bowed_board_a_known_matrix_and_square_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let solve = |problem: &Value, fields: &Value| {
        let file = written(&folder, &with(problem, fields));
        let solved = plumb(["solve", "--json", file.to_str().unwrap()]);
        assert_eq!(solved.code, Some(0), "{}", solved.stderr);
        serde_json::from_str::<Value>(&solved.stdout).unwrap()["sensors"]["color"].take()
    };
    check_all(solve);
}

#[test]
fn and_so_may_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let solve = |problem: &Value, fields: &Value| {
        let file = written(&folder, problem);
        let mut arguments =
            vec!["solve".to_owned(), "--json".to_owned(), file.display().to_string()];
        for flag in ["warp", "square_pixels", "skew"] {
            arguments.extend(fields.get(flag).map(|_| format!("--{}", flag.replace('_', "-"))));
        }
        let shape = fields.get("board_shape").and_then(Value::as_str);
        arguments.extend(shape.map(|shape| format!("--board-shape={shape}")));
        for (name, value) in fields.get("given").and_then(Value::as_object).into_iter().flatten() {
            arguments.extend(["--given".to_owned(), format!("{name}={value}")]);
        }
        let solved = plumb(&arguments);
        assert_eq!(solved.code, Some(0), "{}", solved.stderr);
        serde_json::from_str::<Value>(&solved.stdout).unwrap()["sensors"]["color"].take()
    };
    check_all(solve);
    let file = written(&folder, &problem(0.0));
    let of_no_lens = plumb(["solve", "--given", "k9=0", file.to_str().unwrap()]);
    assert_eq!(of_no_lens.code, Some(2));
    let refused = plumb(["solve", "--given", "k6=0", file.to_str().unwrap()]);
    assert_eq!(refused.code, Some(1));
    assert!(refused.stderr.contains("k6") && refused.stderr.contains("k3"), "{}", refused.stderr);
}

#[test]
fn and_so_may_a_request() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let solve = |problem: &Value, fields: &Value| {
        let answer = served.post("/v1/solve", &with(problem, fields));
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()["sensors"]["color"].take()
    };
    check_all(solve);
    let refused = served.post("/v1/solve", &with(&problem(0.0), &json!({"given": {"k9": 0.0}})));
    assert_eq!(refused.status, 422);
    assert!(refused.text().contains("k9"), "{}", refused.text());
}

#[test]
fn a_calibration_is_exported_for_a_part_of_its_images_and_for_other_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, &problem(0.0));
    let calibration = folder.path().join("camera.json").display().to_string();
    let known =
        ["--given", "fx=600", "--given", "fy=604", "--given", "cx=328", "--given", "cy=236"];
    let mut arguments = vec!["solve", "--out", &calibration, file.to_str().unwrap()];
    arguments.extend(known);
    assert_eq!(plumb(&arguments).code, Some(0));
    let export = |format: &str, change: &[&str]| {
        let mut arguments = vec!["export", "--calibration", &calibration, "--format", format];
        arguments.extend(change);
        plumb(&arguments)
    };
    for format in ["json", "ros", "opencv", "kalibr", "mrcal", "colmap"] {
        // fx 600 → 300; cx (328 + ½ − 80) / 2 − ½ = 123.75; COLMAP counts from the corner, half a
        // pixel more.
        let part =
            export(format, &["--crop", "80,60,480,360", "--width", "240", "--height", "180"]);
        assert_eq!(part.code, Some(0), "{format}: {}", part.stderr);
        let cx = if format == "colmap" { "124.25" } else { "123.75" };
        // Kalibr has no fifth coefficient: a refit is off in the last digits.
        let [fx, fy] = if format == "kalibr" { [cx, cx] } else { ["300", "302"] };
        for number in ["240", "180", fx, fy, cx] {
            assert!(part.stdout.contains(number), "{format} lacks {number}: {}", part.stdout);
        }
        let half = export(format, &["--width", "320", "--height", "240"]);
        let cx = if format == "colmap" { "164.25" } else { "163.75" };
        for number in ["320", "240", cx] {
            assert!(half.stdout.contains(number), "{format} lacks {number}: {}", half.stdout);
        }
        for (change, words) in [
            (["--width", "640", "--height", "360"].as_slice(), "would stretch"),
            (&["--crop", "400,0,320,240"], "is not inside the image of 640x480"),
            (&["--crop", "0,0,0,240"], "has no pixels"),
        ] {
            let refused = export(format, change);
            assert_eq!(
                (refused.code, refused.stdout.as_str()),
                (Some(1), ""),
                "{format} {change:?}"
            );
            assert!(
                refused.stderr.contains(words) && refused.stderr.contains("color"),
                "{}",
                refused.stderr
            );
        }
        assert_eq!(export(format, &["--crop", "1,2,3"]).code, Some(2), "{format}");
    }
}

#[test]
fn a_measured_board_is_drawn_and_given_to_the_next_solve() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, &problem(0.001)).display().to_string();
    let [calibration, png] =
        ["camera.json", "board.png"].map(|name| folder.path().join(name).display().to_string());
    let solve = ["solve", "--board-shape", "free", "--out", &calibration, &file];
    assert_eq!(plumb(solve).code, Some(0));
    let drawn = plumb(["board", "--calibration", &calibration, "--out", &png]);
    assert_eq!(drawn.code, Some(0), "{}", drawn.stderr);
    assert!(drawn.stdout.contains("the board is uneven by 0.3"), "{}", drawn.stdout);
    assert_eq!(image::open(&png).unwrap().width(), 800);

    let again = plumb(["solve", "--json", "--board-shape", &calibration, &file]);
    assert_eq!(again.code, Some(0), "{}", again.stderr);
    let solved: Value = serde_json::from_str(&again.stdout).unwrap();
    let sensor = &solved["sensors"]["color"];
    assert!((sensor["lens"]["fx"].as_f64().unwrap() - CAMERA[0]).abs() < 0.01, "{sensor}");
    assert!(sensor["rms_px"].as_f64().unwrap() < 0.01, "{}", sensor["rms_px"]);

    let flat = written(&folder, &problem(0.0)).display().to_string();
    let of_flat = folder.path().join("flat.json").display().to_string();
    assert_eq!(plumb(["solve", "--out", &of_flat, &flat]).code, Some(0));
    let none = plumb(["board", "--calibration", &of_flat, "--out", &png]);
    assert_eq!(none.code, Some(1));
    assert!(none.stderr.contains("no measured board shape"), "{}", none.stderr);
}

#[test]
fn its_uncertainty_is_given_in_numbers_and_as_an_image() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, &problem(0.0));
    let calibration = folder.path().join("camera.json").display().to_string();
    assert_eq!(plumb(["solve", "--out", &calibration, file.to_str().unwrap()]).code, Some(0));
    let png = folder.path().join("map.png").display().to_string();
    let mut medians = Vec::new();
    for distance in [None, Some("0.5m")] {
        let mut arguments =
            vec!["uncertainty", "--json", "--calibration", &calibration, "--out", &png];
        arguments.extend(distance.iter().flat_map(|distance| ["--distance", *distance]));
        let finished = plumb(&arguments);
        assert_eq!(finished.code, Some(0), "{}", finished.stderr);
        let map: Value = serde_json::from_str(&finished.stdout).unwrap();
        assert_eq!((&map["image_size"], &map["sensor"]), (&json!([640, 480]), &json!("color")));
        assert_eq!(map["distance_m"].as_f64(), distance.map(|_| 0.5));
        let rows = map["std_px"].as_array().unwrap();
        assert_eq!(rows.len(), map["y_px"].as_array().unwrap().len());
        let mut all: Vec<f64> =
            rows.iter().flat_map(|row| row.as_array().unwrap()).filter_map(Value::as_f64).collect();
        all.sort_by(f64::total_cmp);
        medians.push(all[all.len() / 2]);
        assert_eq!(image::open(&png).unwrap().width(), 800);
    }
    assert!(medians.iter().all(|median| *median > 0.0) && medians[0] != medians[1], "{medians:?}");
    let unknown = plumb(["uncertainty", "--calibration", &calibration, "--sensor", "left"]);
    assert_eq!(unknown.code, Some(1));
    assert!(unknown.stderr.contains("it has color"), "{}", unknown.stderr);
}

/// The linear solve leaves of no skew what rounding leaves.
#[test]
fn what_the_direct_linear_transform_finds_is_exported() {
    let folder = tempfile::tempdir().unwrap();
    let camera_from_object =
        Pose::from_axis_angle(Vector3::new(0.3, -0.4, 0.1), Vector3::new(-0.1, -0.1, 0.9));
    let lens = Lens::from_parameters(LensModel::Pinhole, &CAMERA[..5]).unwrap();
    let object: Vec<Point3<f64>> = (0..27)
        .map(|k| Point3::new(f64::from(k % 3), f64::from(k / 3 % 3), f64::from(k / 9)) * 0.1)
        .collect();
    let image = object.iter().map(|point| lens.pixel_from_point(&(camera_from_object * *point)));
    let view = json!({
        "object": object.iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>(),
        "image": image.map(|pixel| pixel.map(|p| [p.x, p.y]).unwrap()).collect::<Vec<_>>(),
    });
    let problem = json!({"image_size": [640, 480], "method": "dlt", "views": [view]});
    let file = written(&folder, &problem).display().to_string();
    let found = folder.path().join("found.json").display().to_string();
    let solved = plumb(["solve", "--out", &found, &file]);
    assert_eq!(solved.code, Some(0), "{}", solved.stderr);
    let document: Value = serde_json::from_slice(&std::fs::read(&found).unwrap()).unwrap();
    let skew = document["sensors"]["color"]["lens"]["skew"].as_f64().unwrap();
    assert!(skew != 0.0 && skew.abs() < 1e-8, "{skew}");
    for format in ["ros", "opencv", "kalibr", "mrcal", "colmap"] {
        let exported = plumb(["export", "--calibration", &found, "--format", format]);
        assert_eq!(exported.code, Some(0), "{format}: {}", exported.stderr);
        assert!(!exported.stdout.contains(&format!("{skew}")), "{format}");
    }
}

/// Where its two spheres are one, a double sphere lens is the same to first order for every ξ.
#[test]
fn a_lens_model_that_the_views_leave_open_is_named_with_one_that_they_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let lens = Lens::from_parameters(LensModel::Pinhole, &CAMERA[..5]).unwrap();
    let file = written(&folder, &seen_by(&lens, 0.0)).display().to_string();
    let solve = |extra: &[&str]| plumb([&["solve", "--json"], extra, &[&file]].concat());
    let refused = solve(&["--lens", "double_sphere"]);
    assert_eq!(refused.code, Some(1), "{}", refused.stdout);
    for words in ["do not determine xi", "nearly a pinhole", "--given xi=0"] {
        assert!(refused.stderr.contains(words), "{words}: {}", refused.stderr);
    }
    let instead = refused.stderr.split_once("--lens ").unwrap().1.split(',').next().unwrap();
    for extra in [&["--lens", instead][..], &["--lens", "double_sphere", "--given", "xi=0"]] {
        let solved = solve(extra);
        assert_eq!(solved.code, Some(0), "{extra:?}: {}", solved.stderr);
        let solved: Value = serde_json::from_str(&solved.stdout).unwrap();
        near(&solved, "/sensors/color/lens/fx", CAMERA[0], 0.1);
    }
}
