//! The bundled room through calibration without a target: its lens and its lengths against their
//! exact truth, and depth that gives no lengths.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use plumb::calibration::scene::correspondence::SceneImage;
use plumb::calibration::scene::{SceneCalibration, SceneDepth, SceneOptions, calibrate_scene};
use plumb::calibration::solve::rgbd_input::DepthSensor;
use plumb::estimation::problem::LensChoice;
use plumb::geometry::depth_camera::DepthReading;
use plumb::geometry::lens::LensModel;
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::decode;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::gray::GrayImage;
use plumb::recording::{ReadOptions, Recording};
use serde_json::Value;

fn recording(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings").join(name)
}

/// The center of a camera that is at this pose, as documents have it.
fn center(camera_from_scene: &Value) -> [f64; 3] {
    let number = |value: &Value| value.as_f64().unwrap();
    let rotation = &camera_from_scene["rotation"];
    let [w, x, y, z] = ["w", "x", "y", "z"].map(|name| number(&rotation[name]));
    let [a, b, c] = [0, 1, 2].map(|k| number(&camera_from_scene["translation"][k]));
    // The columns of the rotation against the translation.
    [
        -((1.0 - 2.0 * (y * y + z * z)) * a
            + 2.0 * (x * y + w * z) * b
            + 2.0 * (x * z - w * y) * c),
        -(2.0 * (x * y - w * z) * a
            + (1.0 - 2.0 * (x * x + z * z)) * b
            + 2.0 * (y * z + w * x) * c),
        -(2.0 * (x * z + w * y) * a
            + 2.0 * (y * z - w * x) * b
            + (1.0 - 2.0 * (x * x + y * y)) * c),
    ]
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn lens_and_lengths_of_the_room_are_as_certain_as_they_say() {
    let arguments = ["autocalibrate", "--lens", "brown", "--json"];
    let plumb = Command::new(env!("CARGO_BIN_EXE_plumb"))
        .args(arguments)
        .arg(recording("room.mcap"))
        .output()
        .unwrap();
    assert!(plumb.status.success(), "{}", String::from_utf8_lossy(&plumb.stderr));
    let found: Value = serde_json::from_slice(&plumb.stdout).unwrap();
    let truth: Value =
        serde_json::from_slice(&std::fs::read(recording("room.truth.json")).unwrap()).unwrap();
    let color = &found["sensors"]["color"];
    for name in ["fx", "fy", "cx", "cy"] {
        let [value, std] = ["lens", "lens_std"].map(|of| color[of][name].as_f64().unwrap());
        let exact = truth["sensors"]["color"]["lens"][name].as_f64().unwrap();
        assert!((value - exact).abs() < 3.0 * std && std < 0.6, "{name}: {value} ± {std}, {exact}");
    }
    assert_eq!(found["scene_unit"], "m");
    let std = found["scene_scale"]["relative_std"].as_f64().unwrap();
    let views = color["views"].as_array().unwrap().iter();
    let centers: Vec<[f64; 3]> = views.map(|view| center(&view["camera_from_scene"])).collect();
    let frames = truth["frames"].as_array().unwrap().iter();
    let exact: Vec<[f64; 3]> = frames.map(|frame| center(&frame["camera_from_scene"])).collect();
    assert_eq!((centers.len(), exact.len()), (10, 10));
    for k in 1..10 {
        let [length, exact] = [&centers, &exact].map(|of| distance(of[0], of[k]));
        let off = length / exact - 1.0;
        println!("camera {k}: {length:.4} m, truly {exact:.4} m: {:.3} % off", 100.0 * off);
        assert!(off.abs() < 3.0 * std && off.abs() < 0.005, "{off} ± {std}");
    }
    assert!((0.01..0.012).contains(&std), "{std}");
}

/// The first half of the room, with its depth as it was recorded.
fn depth_of(recording: &mut Recording) -> (Vec<SceneImage>, SceneDepth) {
    let (mut images, mut depth, mut luma) = (Vec::new(), Vec::new(), GrayImage::default());
    let stated = recording.factory();
    let of_depth = stated.sensor(SensorKind::Depth).unwrap();
    let factory = of_depth.depth_lens(of_depth.image_size);
    for _ in 0..6 {
        let set = recording.next_frame_set().unwrap().unwrap();
        decode::luma(set.frame(SensorKind::Color).unwrap(), &mut luma).unwrap();
        images.push(SceneImage::of(set.sequence.to_string(), luma.view()));
        let image = DepthImage::from_frame(set.frame(SensorKind::Depth).unwrap()).unwrap();
        depth.push(Some(Arc::new(image)));
    }
    let reading = Some(DepthReading::Metric { unit_m: 0.001 });
    let sensor = DepthSensor { reading, invalid: Some(0), factory, with_infrared: false };
    (images, SceneDepth { sensor, images: depth })
}

/// The same with other readings.
fn changed(depth: &SceneDepth, change: impl Fn(usize, u16) -> u16) -> SceneDepth {
    let image = |image: &Option<Arc<DepthImage>>| {
        let image = image.as_ref().unwrap();
        let readings = image.readings().iter().enumerate();
        let readings = readings.map(|(k, reading)| change(k, *reading)).collect();
        DepthImage::new(image.size(), readings).map(Arc::new)
    };
    SceneDepth { sensor: depth.sensor.clone(), images: depth.images.iter().map(image).collect() }
}

fn refused(scene: &SceneCalibration, depth: &SceneDepth, why: &str) {
    let without = scene.clone().in_meters(depth);
    let reasons = without.verdict.reasons.join("\n");
    assert_eq!((without.scale, &without.points), (None, &scene.points), "{reasons}");
    assert!(reasons.contains("lengths have no unit: ") && reasons.contains(why), "{reasons}");
}

#[test]
fn depth_that_gives_no_lengths_is_said_to_give_none() {
    let mut room = Recording::open(&recording("room.mcap"), &ReadOptions::default()).unwrap();
    let (images, depth) = depth_of(&mut room);
    let lens = LensChoice::Model(LensModel::Brown);
    let options = SceneOptions { lens, threads: 2, ..SceneOptions::default() };
    let scene = calibrate_scene(&images, &options).unwrap();
    let good = scene.clone().in_meters(&depth);
    assert!(good.scale.is_some_and(|scale| scale.views == 6 && scale.readings > 1000));
    assert_eq!(good.verdict, scene.verdict);

    refused(&scene, &changed(&depth, |_, _| 0), "only 0 scene points");
    let mut few = depth.clone();
    few.images.iter_mut().skip(2).for_each(|image| *image = None);
    refused(&scene, &few, "too few");
    refused(&scene, &changed(&depth, |k, _| (k * 7919 % 4096) as u16), "too few");
    let mut other = depth.clone();
    other.images.rotate_left(3);
    refused(&scene, &other, "does not fit the scene");
    let with = |change: &dyn Fn(&mut DepthSensor)| {
        let mut with = depth.clone();
        change(&mut with.sensor);
        with
    };
    let in_unit =
        |unit_m: f64| with(&|sensor| sensor.reading = Some(DepthReading::Metric { unit_m }));
    // Millimeters taken for meters; a factor that leaves depth plausible cannot be known.
    refused(&scene, &in_unit(1.0), "check their unit");
    refused(
        &scene,
        &with(&|sensor| sensor.reading = None),
        "the meaning of the depth readings is unknown",
    );
    refused(&scene, &with(&|sensor| sensor.factory = None), "are unknown");
    let mut sizes = depth.clone();
    sizes.images[3] = DepthImage::new(ImageSize::new(4, 2), vec![900; 8]).map(Arc::new);
    refused(&scene, &sizes, "different sizes (640x480 and 4x2)");
}
