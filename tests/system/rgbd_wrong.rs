//! What can be wrong with a folder of color and depth images: `plumb calibrate` says each in one
//! clear line.

use std::fs;
use std::path::Path;

use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::frame::SensorKind;
use plumb::recording::{ReadOptions, Recording};
use serde_json::{Value, json};

use crate::program::{Finished, plumb};
use crate::served::{Served, recording, repeating};

const STATED: &str = "[depth]\nkind = \"depth\"\nunit_m = 0.001\n";

/// One frame set of the folder.
struct Taken {
    color: Vec<u8>,
    infrared: Vec<u8>,
    depth: DepthImage,
}

/// Every third frame set of the bundled recording.
fn taken() -> Vec<Taken> {
    let mut recording = Recording::open(&recording("rgbd.mcap"), &ReadOptions::default()).unwrap();
    let mut sets = Vec::new();
    while let Some(set) = recording.next_frame_set().unwrap() {
        let bytes = |sensor| set.frame(sensor).unwrap().bytes.to_vec();
        let depth = DepthImage::from_frame(set.frame(SensorKind::Depth).unwrap()).unwrap();
        sets.push(Taken {
            color: bytes(SensorKind::Color),
            infrared: bytes(SensorKind::Infrared),
            depth,
        });
    }
    sets.into_iter().step_by(3).collect()
}

/// What is done to what was taken.
#[derive(Clone, Copy)]
enum Change {
    Nothing,
    Depth(fn(&DepthImage) -> DepthImage),
    DepthOfOtherMoments,
    Swapped,
    ColorInHalf,
    /// There is no color image at all.
    NoColor,
    /// Every second depth image is missing.
    DepthInHalf,
    /// The fourth depth image has zeros only.
    OneBlank,
    Stated(&'static str),
}

fn write(folder: &Path, sets: &[Taken], change: Change, with_infrared: bool) {
    for sensor in
        ["color", "infrared", "depth"].iter().filter(|name| with_infrared || **name != "infrared")
    {
        fs::create_dir(folder.join(sensor)).unwrap();
    }
    for (index, set) in sets.iter().enumerate() {
        let put = |sensor: &str, ending: &str, bytes: &[u8]| {
            fs::write(folder.join(sensor).join(format!("{index:02}.{ending}")), bytes).unwrap();
        };
        let depth = match change {
            Change::Depth(changed) => changed(&set.depth),
            Change::OneBlank if index == 3 => zeros(&set.depth),
            Change::DepthOfOtherMoments => sets[(index + 5) % sets.len()].depth.clone(),
            _ => set.depth.clone(),
        };
        match change {
            Change::Swapped => {
                put("color", "png", &depth.to_png());
                put("depth", "jpg", &set.color);
            }
            Change::ColorInHalf if index % 2 == 1 => put("depth", "png", &depth.to_png()),
            Change::NoColor => put("depth", "png", &depth.to_png()),
            Change::DepthInHalf if index % 2 == 1 => put("color", "jpg", &set.color),
            _ => {
                put("color", "jpg", &set.color);
                put("depth", "png", &depth.to_png());
            }
        }
        if with_infrared {
            put("infrared", "jpg", &set.infrared);
        }
    }
    let stated = if let Change::Stated(stated) = change { stated } else { STATED };
    fs::write(folder.join("sensors.toml"), stated).unwrap();
}

fn calibrated(sets: &[Taken], change: Change, with_infrared: bool) -> Finished {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), sets, change, with_infrared);
    let place = folder.path().display().to_string();
    plumb(["calibrate", "--json", "--lens", "brown", "--board", "9x6", "--square", "40mm", &place])
}

fn of(depth: &DepthImage, readings: impl Fn(usize, usize) -> u16) -> DepthImage {
    let (width, height) = (depth.size().width as usize, depth.size().height as usize);
    let all =
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| readings(x, y));
    DepthImage::new(depth.size(), all.collect()).unwrap()
}

fn zeros(depth: &DepthImage) -> DepthImage {
    of(depth, |_, _| 0)
}

fn mirrored(depth: &DepthImage) -> DepthImage {
    of(depth, |x, y| depth.row(y)[depth.size().width as usize - 1 - x])
}

/// Of a device whose depth camera sees half as much.
fn of_another_lens(depth: &DepthImage) -> DepthImage {
    of(depth, |x, y| depth.row(120 + y / 2)[160 + x / 2])
}

/// In waves of a tenth of the distance.
fn uneven(depth: &DepthImage) -> DepthImage {
    of(depth, |x, y| (f64::from(depth.row(y)[x]) * (1.0 + 0.1 * (x as f64 / 15.0).sin())) as u16)
}

#[test]
fn each_wrong_thing_is_one_clear_line() {
    let sets = taken();
    let other_unit = "[depth]\nkind = \"depth\"\nunit_m = 0.01\n";
    let table: [(&str, Change, &str); 10] = [
        ("no color", Change::NoColor, "into its folder color/"),
        ("depth and color swapped", Change::Swapped, "not swapped"),
        (
            "depth mirrored",
            Change::Depth(mirrored),
            "the depth images are mirrored (left and right exchanged) relative to color",
        ),
        (
            "depth of other moments",
            Change::DepthOfOtherMoments,
            "check that depth and color are of the same device",
        ),
        (
            "depth of another lens",
            Change::Depth(of_another_lens),
            "that depth and color are of the same device",
        ),
        ("a surface that is not flat", Change::Depth(uneven), "not flat"),
        (
            "zeros",
            Change::Depth(zeros),
            "none of 14 depth images has a valid reading (every pixel is 0)",
        ),
        ("no unit", Change::Stated("[depth]\nkind = \"depth\"\n"), "unit_m"),
        ("another unit", Change::Stated(other_unit), "check the depth unit"),
        ("no kind", Change::Stated("[depth]\nunit_m = 0.001\n"), "kind"),
    ];
    for with_infrared in [true, false] {
        for (name, change, word) in table {
            let finished = calibrated(&sets, change, with_infrared);
            assert_eq!(
                (finished.code, finished.stdout.as_str()),
                (Some(1), ""),
                "{name}: {}",
                finished.stderr
            );
            assert_eq!(
                finished.stderr.trim_end().lines().count(),
                1,
                "{name}: {}",
                finished.stderr
            );
            assert!(
                finished.stderr.contains(word),
                "{name}, infrared {with_infrared}: {}",
                finished.stderr
            );
        }
    }
}

/// Units that are 8 % too large.
const LARGE_UNITS: &str = "[depth]\nkind = \"depth\"\nunit_m = 0.00108\n";

#[test]
fn what_is_missing_blank_or_of_another_scale_is_reported() {
    let sets = taken();
    let table: [(Change, [&str; 2]); 3] = [
        (Change::DepthInHalf, ["have no depth", "01"]),
        (Change::OneBlank, ["reads 0 everywhere", "03"]),
        (Change::Stated(LARGE_UNITS), ["% in every view", "a square is"]),
    ];
    for (change, words) in table {
        let finished = calibrated(&sets, change, true);
        assert_eq!(finished.code, Some(0), "{}", finished.stderr);
        let document: Value = serde_json::from_str(&finished.stdout).unwrap();
        let reasons = document["verdict"]["reasons"].to_string();
        assert!(words.iter().all(|word| reasons.contains(word)), "{words:?}: {reasons}");
        let right = calibrated(&sets, Change::Nothing, true);
        let right: Value = serde_json::from_str(&right.stdout).unwrap();
        let reasons = right["verdict"]["reasons"].to_string();
        assert!(!reasons.contains(words[0]), "{reasons}");
    }
}

#[test]
fn what_is_right_is_calibrated_and_color_in_half_the_views_reported() {
    let sets = taken();
    for (change, is_reported) in [(Change::Nothing, false), (Change::ColorInHalf, true)] {
        let finished = calibrated(&sets, change, true);
        assert_eq!(finished.code, Some(0), "{}", finished.stderr);
        let document: Value = serde_json::from_str(&finished.stdout).unwrap();
        assert!(document["sensors"]["depth"].is_object(), "{}", document["verdict"]);
        let reported =
            document["verdict"].to_string().contains("the board was not seen in color in");
        assert_eq!(reported, is_reported, "{}", document["verdict"]);
    }
}

/// Moved by a fiftieth of the image.
fn moved(depth: &DepthImage) -> DepthImage {
    let width = depth.size().width as usize;
    of(depth, |x, y| depth.row(y)[(x + width / 50) % width])
}

/// Three parts in a hundred too long.
fn scaled(depth: &DepthImage) -> DepthImage {
    of(depth, |x, y| (f64::from(depth.row(y)[x]) * 1.03).round() as u16)
}

/// Calibrated with every second frame set, verified with the others.
#[test]
fn verify_compares_depth_with_the_board_and_says_what_it_saw() {
    let (calibrated, verified): (Vec<_>, Vec<_>) =
        taken().into_iter().enumerate().partition(|(index, _)| index % 2 == 0);
    let sets = |indexed: Vec<(usize, Taken)>| indexed.into_iter().map(|(_, set)| set).collect();
    let (calibrated, verified): (Vec<Taken>, Vec<Taken>) = (sets(calibrated), sets(verified));
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &calibrated, Change::Nothing, true);
    let file = folder.path().join("found.json").display().to_string();
    let place = folder.path().display().to_string();
    let board = ["--board", "9x6", "--square", "40mm", "--lens", "brown", "--out", &file];
    let found = plumb(["calibrate", &place].into_iter().chain(board));
    assert_eq!(found.code, Some(0), "{}", found.stderr);
    let verify = |sets: &[Taken], change: Change| {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), sets, change, false);
        let place = folder.path().display().to_string();
        let asked = ["verify", "--json", "--calibration", &file, "--board", "9x6", &place];
        let finished = plumb(asked);
        assert_eq!(finished.code, Some(0), "{}", finished.stderr);
        let answer: Value = serde_json::from_str(&finished.stdout).unwrap();
        (answer["depth"]["holds"].as_bool().unwrap(), answer)
    };
    let (holds, answer) = verify(&verified, Change::Nothing);
    assert!(holds && answer["depth"]["visible_m"].as_f64().unwrap() < 0.02, "{answer}");
    let wrong = [
        (Change::Depth(mirrored), "same device"),
        (Change::Depth(moved), "same device"),
        (Change::Depth(scaled), "% in all views"),
    ];
    for (change, word) in wrong {
        let (holds, answer) = verify(&verified, change);
        assert!(!holds && answer["holds"] == false, "{answer}");
        assert!(answer["reasons"].to_string().contains(word), "{answer}");
    }
    let (_, answer) = verify(&verified[..1], Change::Nothing);
    assert!(answer["depth"]["visible_m"].is_null(), "{answer}");
    assert!(answer["reasons"].to_string().contains("cannot show every motion"), "{answer}");
}

/// In three of its views the board moves in the 12 ms between color and depth.
#[test]
fn a_recording_in_which_the_board_moves_holds_against_its_own_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let calibration = folder.path().join("calibration.json").display().to_string();
    let recording = recording("rgbd.mcap").display().to_string();
    let calibrate = ["calibrate", "--board", "9x6", "--square", "40mm", "--lens", "brown"];
    let finished = plumb([&calibrate[..], &["--out", &calibration, &recording]].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    let verify = ["verify", "--calibration", &calibration, "--board", "9x6", "--json"];
    let finished = plumb([&verify[..], &[&recording]].concat());
    let answer: Value = serde_json::from_str(&finished.stdout).unwrap();
    assert_eq!((&answer["holds"], &answer["depth"]["holds"]), (&json!(true), &json!(true)));
    assert!(answer["depth"]["off_sigmas"].as_f64().unwrap() < 1.5, "{answer}");
    assert!(answer["reasons"].to_string().contains("in 3 of 14 views the board moved"), "{answer}");
}

#[test]
fn what_is_missing_beside_depth_is_said_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &taken()[..4], Change::ColorInHalf, false);
    let place = folder.path().display().to_string();
    let finished = plumb(["detect", "--board", "9x6", "--json", &place]);
    let lines: Vec<Value> =
        finished.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((finished.code, lines.len()), (Some(0), 4), "{finished:?}");
    assert!(finished.stderr.contains("2 frame sets have no color image"), "{finished:?}");
    for (index, line) in lines.iter().enumerate() {
        let missing = format!("put it at {place}/color/{index:02}");
        let reason = line["reason"].as_str().unwrap_or_default();
        let says = reason.contains(&missing) && reason.contains(&format!("depth/{index:02} out"));
        assert_eq!(says, index % 2 == 1, "{line}");
    }
}

#[test]
fn a_session_says_which_color_image_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("box");
    fs::create_dir(&place).unwrap();
    write(&place, &taken()[..4], Change::NoColor, false);
    let served = Served::start(folder.path(), &repeating("front", &place));
    let mut events = served.events("?camera=front", None);
    let target = json!({"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.04});
    let session = served.post("/v1/cameras/front/sessions", &json!({ "target": target })).json();
    let event = events.until(|event| event.name == "detection").data;
    assert_eq!(event["rejection"], "no_image", "{event}");
    assert!(event["reason"].as_str().unwrap().contains("put it at color/0"), "{event}");
    let advised = events.until(|event| {
        let said = event.data["guidance"]["message"].as_str().unwrap_or_default();
        event.name == "session" && said.contains("its color image is missing")
    });
    assert!(advised.data["rejected"]["no_image"].as_u64() > Some(0), "{}", advised.data);
    assert_eq!(advised.data["rejected"]["unreadable"], 0, "{}", advised.data);
    assert_eq!(advised.data["id"], session["id"]);
}
