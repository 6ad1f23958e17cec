//! What each format holds, refuses and says.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

use super::*;
use crate::calibration::result::{CalibratedSensor, Extrinsics};
use crate::calibration::sensor::SensorId;
use crate::document::calibration::tests::{example, with_infrared};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

fn with_lens(model: LensModel, parameters: &[f64]) -> Calibration {
    let mut calibration = example();
    let sensor = calibration.image_mut(&SensorId::own(SensorKind::Color)).unwrap();
    sensor.lens = Lens::from_parameters(model, parameters).unwrap();
    sensor.lens_std = vec![0.0; parameters.len()];
    calibration
}

fn text(calibration: &Calibration, format: Format) -> String {
    String::from_utf8(export(calibration, format, &ExportOptions::default()).unwrap().bytes)
        .unwrap()
}

fn refused(calibration: &Calibration, format: Format) -> ExportError {
    export(calibration, format, &ExportOptions::default()).unwrap_err()
}

/// Those that hold a lens.
fn lens_formats() -> impl Iterator<Item = Format> {
    Format::ALL
        .into_iter()
        .filter(|format| !matches!(format, Format::Urdf | Format::Tf | Format::Depth))
        .filter(|format| !matches!(format, Format::RosStereo | Format::OpencvStereo))
}

#[test]
fn every_digit_reaches_every_format() {
    let calibration =
        with_lens(LensModel::Radial, &[532.123_456_789_012_3, 531.0, 319.5, 239.5, 0.0, -1e-7]);
    for format in lens_formats() {
        let text = text(&calibration, format);
        assert!(text.contains("532.1234567890123"), "{format}: {text}");
        assert!(format == Format::Json || text.contains("-0.0000001"), "{format}: {text}");
    }
}

#[test]
fn what_a_format_lacks_is_refused_by_name() {
    let fisheye = with_lens(
        LensModel::KannalaBrandt,
        &[200.0, 200.0, 320.0, 240.0, 0.0, 0.01, 0.0, 0.0, 0.0],
    );
    let line = refused(&fisheye, Format::Mrcal).to_string();
    assert!(line.contains("mrcal") && line.contains("kannala_brandt"), "{line}");

    let skewed = with_lens(LensModel::Pinhole, &[470.0, 430.0, 290.0, 220.0, 8.0]);
    for format in lens_formats().filter(|format| *format != Format::Json) {
        assert_eq!(refused(&skewed, format), ExportError::Skew { format, skew_px: 8.0 });
    }

    // What rounding leaves of no skew, as a linear solve does, is none.
    let rounded = with_lens(LensModel::Pinhole, &[470.0, 430.0, 290.0, 220.0, -3e-9]);
    let exact = with_lens(LensModel::Pinhole, &[470.0, 430.0, 290.0, 220.0, 0.0]);
    for format in lens_formats().filter(|format| *format != Format::Json) {
        assert_eq!(text(&rounded, format), text(&exact, format));
    }

    let two = with_infrared(example(), fisheye.color().unwrap());
    assert_eq!(
        text(&two, Format::Colmap).lines().filter(|line| line.contains("640 480")).count(),
        2
    );

    let none = Calibration { sensors: Vec::new(), ..example() };
    for format in lens_formats().filter(|format| *format != Format::Json) {
        assert_eq!(refused(&none, format), ExportError::NoSensor { format });
    }
}

#[test]
fn a_refit_states_its_error_or_is_refused() {
    let parameters = [532.8, 532.9, 342.5, 233.9, 0.0, -0.281, 0.08, 0.0012, -0.0014, -0.01];
    let brown = with_lens(LensModel::Brown, &parameters);
    let exported = export(&brown, Format::Kalibr, &ExportOptions::default()).unwrap();
    let note = exported.note.unwrap();
    assert!(note.contains("px at worst"), "{note}");
    assert!(String::from_utf8(exported.bytes).unwrap().starts_with(&format!("# {note}\n")));

    let mut strong = parameters;
    strong[9] = 3.0;
    let line = refused(&with_lens(LensModel::Brown, &strong), Format::Kalibr);
    assert!(matches!(line, ExportError::Refit { worst_px, .. } if worst_px > 0.5), "{line}");
}

/// Two cameras of a rig, a quarter of a meter from each other.
fn rig() -> Calibration {
    let id = |camera: &str| SensorId::of(camera, SensorKind::Color);
    let camera = |name: &str| CalibratedSensor::image(id(name), example().color().unwrap().clone());
    let target_from_source =
        Pose::from_axis_angle(Vector3::z() * FRAC_PI_2, Vector3::new(0.25, 0.0, -0.5));
    let extrinsics = Extrinsics {
        target: id("left"),
        source: id("right"),
        target_from_source,
        rotation_std: [0.0; 3],
        translation_std_m: [0.0; 3],
    };
    let sensors = vec![camera("left"), camera("right"), camera("isolated")];
    Calibration { camera: Some("head".into()), sensors, extrinsics: vec![extrinsics], ..example() }
}

#[test]
fn one_sensor_of_several_is_asked_for_by_name() {
    let of =
        |sensor: &str| ExportOptions { sensor: Some(sensor.into()), ..ExportOptions::default() };
    let known = || "left, right, isolated".to_owned();
    let several = ExportError::SeveralSensors { format: Format::Ros, known: known() };
    assert_eq!(refused(&rig(), Format::Ros), several);
    let ros = export(&rig(), Format::Ros, &of("right")).unwrap();
    assert!(String::from_utf8(ros.bytes).unwrap().contains("camera_name: \"right\""));
    assert_eq!(ros.file_name, "right.yaml");
    let unknown = ExportError::UnknownSensor { sensor: "rear".into(), known: known() };
    assert_eq!(export(&rig(), Format::Opencv, &of("rear")), Err(unknown));

    let two = with_infrared(example(), example().color().unwrap());
    let color = export(&two, Format::Ros, &ExportOptions::default()).unwrap();
    assert!(color.note.unwrap().contains("color, infrared"), "what is left out is stated");
    let infrared = export(&two, Format::Ros, &of("infrared")).unwrap();
    assert!(String::from_utf8(infrared.bytes).unwrap().contains("camera_name: \"front_infrared\""));
}

#[test]
fn places_are_written_from_the_first_sensor_and_what_has_none_is_stated() {
    let urdf = export(&rig(), Format::Urdf, &ExportOptions::default()).unwrap();
    assert!(urdf.note.as_ref().unwrap().contains("isolated"), "{urdf:?}");
    let text = String::from_utf8(urdf.bytes).unwrap();
    assert!(text.contains("<parent link=\"left_optical_frame\"/>"), "{text}");
    assert!(text.contains("<child link=\"right_optical_frame\"/>"), "{text}");
    let numbers = |start: &str| -> Vec<f64> {
        let rest = text.split_once(start).unwrap().1;
        rest.split_once('"').unwrap().0.split(' ').map(|number| number.parse().unwrap()).collect()
    };
    assert_eq!(numbers("xyz=\""), [0.25, 0.0, -0.5]);
    assert!((numbers("rpy=\"")[2] - FRAC_PI_2).abs() < 1e-12, "{text}");
    let tf = self::text(&rig(), Format::Tf);
    assert!(tf.contains("child_frame_id: \"right_optical_frame\""), "{tf}");
    assert_eq!(refused(&example(), Format::Urdf), ExportError::NoPlaces { format: Format::Urdf });
}

#[test]
fn a_chain_says_where_each_camera_is_from_the_one_before() {
    let two = Calibration { sensors: rig().sensors[..2].to_vec(), ..rig() };
    let chain = text(&two, Format::Kalibr);
    let cam1 = chain.split_once("cam1:").unwrap().1;
    assert!(cam1.contains("rostopic: \"/right/color\""), "{chain}");
    let rows: Vec<Vec<f64>> = cam1
        .lines()
        .filter_map(|line| line.trim().strip_prefix("- [")?.strip_suffix(']'))
        .map(|row| row.split(", ").map(|number| number.parse().unwrap()).collect())
        .collect();
    // right_from_left: a point at the right camera's place in the left one's frame is its origin.
    let at = |row: &[f64]| row[0] * 0.25 + row[2] * -0.5 + row[3];
    assert!(rows.len() == 4 && rows[..3].iter().all(|row| at(row).abs() < 1e-12), "{chain}");
    assert_eq!(rows[3], [0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn a_chain_states_which_cameras_it_leaves_out() {
    let exported = export(&rig(), Format::Kalibr, &ExportOptions::default()).unwrap();
    let note = exported.note.unwrap();
    assert_eq!(note, "left out, because the pose relative to left is unknown: isolated");
    let chain = String::from_utf8(exported.bytes).unwrap();
    assert!(chain.starts_with(&format!("# {note}\ncam0:\n")), "{chain}");
    assert!(chain.contains("cam1:") && !chain.contains("cam2:"), "{chain}");
    let urdf = export(&rig(), Format::Urdf, &ExportOptions::default()).unwrap();
    assert_eq!(urdf.note, Some(note));
    let placed = Calibration { sensors: rig().sensors[..2].to_vec(), ..rig() };
    assert_eq!(export(&placed, Format::Kalibr, &ExportOptions::default()).unwrap().note, None);
}

#[test]
fn sensors_are_in_the_order_asked_for_or_the_order_is_refused() {
    let mut pair = Calibration { sensors: rig().sensors[..2].to_vec(), ..rig() };
    pair.extrinsics[0].target_from_source =
        Pose::from_axis_angle(Vector3::zeros(), Vector3::x() * 0.25);
    let written = |names: &str, format| {
        let options = ExportOptions { sensor: Some(names.into()), ..ExportOptions::default() };
        export(&pair, format, &options)
            .map(|exported| String::from_utf8(exported.bytes).unwrap())
            .map_err(|error| error.to_string())
    };
    let reversed = written("right, left", Format::Kalibr).unwrap();
    let (cam0, cam1) = reversed.split_once("cam1:").unwrap();
    assert!(cam0.contains("/right/color") && cam1.contains("/left/color"), "{reversed}");
    assert!(cam1.contains("- [1.0, 0.0, 0.0, 0.25]"), "{reversed}");
    assert_eq!(written("left,right", Format::Kalibr).unwrap(), text(&pair, Format::Kalibr));
    assert!(written("left,rear", Format::Kalibr).unwrap_err().contains("no sensor `rear`"));

    for format in [Format::RosStereo, Format::OpencvStereo] {
        assert_eq!(written("left,right", format).unwrap(), text(&pair, format));
        let refused = written("right,left", format).unwrap_err();
        assert!(refused.contains("takes the left camera first, which is `left`"), "{refused}");
        assert!(refused.contains("write left,right"), "{refused}");
    }
    for format in [Format::Json, Format::Colmap, Format::Urdf, Format::Tf] {
        let refused = written("right,left", format).unwrap_err();
        assert!(refused.contains("leave out `right,left`"), "{refused}");
    }
}

#[test]
fn colmap_counts_from_the_image_s_corner() {
    let calibration = with_lens(LensModel::Pinhole, &[530.0, 531.0, 319.5, 239.5, 0.0]);
    assert!(
        text(&calibration, Format::Colmap).ends_with("1 PINHOLE 640 480 530.0 531.0 320.0 240.0\n")
    );
}
