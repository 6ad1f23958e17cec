//! Sessions with boards that have markers, of which a part is enough: which corners were seen is
//! said as `plumb detect` says it.

use image::GrayImage;
use image::imageops::{FilterType, blur, resize};
use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::Served;

const TARGETS: [&str; 2] = [
    r#"{"kind":"charuco","cols":7,"rows":5,"square_m":0.03,"marker_m":0.022,"dictionary":"DICT_4X4_50"}"#,
    r#"{"kind":"aprilgrid","cols":4,"rows":3,"tag_m":0.04,"spacing":0.3,"family":"tag36h11"}"#,
];

/// The print of the target in `file`, as it fills an image, with the left part covered.
fn covered(file: &str, folder: &std::path::Path) -> GrayImage {
    let sheet = folder.join("board.png");
    let sheet = sheet.to_str().unwrap();
    let printed =
        plumb(["target", "--target", file, "--paper", "a3", "--dpi", "100", "--out", sheet]);
    assert_eq!(printed.code, Some(0), "{}", printed.stderr);
    let sheet = image::open(sheet).unwrap().to_luma8();
    let scale = 900.0 / f64::from(sheet.width().max(sheet.height()));
    let [width, height] =
        [sheet.width(), sheet.height()].map(|side| (f64::from(side) * scale) as u32);
    let mut seen = blur(&resize(&sheet, width, height, FilterType::Triangle), 0.7);
    for (x, _, pixel) in seen.enumerate_pixels_mut() {
        if x < width * 2 / 5 {
            pixel.0 = [200];
        }
    }
    seen
}

#[test]
fn which_corners_of_a_covered_board_were_seen_is_said() {
    for target in TARGETS {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("target.json");
        std::fs::write(&file, target).unwrap();
        let file = file.to_str().unwrap();
        let images = folder.path().join("images");
        std::fs::create_dir(&images).unwrap();
        let image = images.join("0.png");
        covered(file, folder.path()).save(&image).unwrap();
        let detected = plumb([
            "detect",
            "--target",
            file,
            "--json",
            "--allow-partial",
            image.to_str().unwrap(),
        ]);
        let detected: Value = serde_json::from_str(&detected.stdout).unwrap();
        assert_eq!((&detected["found"], &detected["partial"]), (&json!(true), &json!(true)));

        let source = format!("{{ kind = \"recording\", path = {images:?}, pace = \"fastest\" }}");
        let config = format!("[[camera]]\nname = \"front\"\nsource = {source}\n");
        let served = Served::start(folder.path(), &config);
        let target: Value = serde_json::from_str(target).unwrap();
        let started = served.post("/v1/cameras/front/sessions", &json!({"target": target}));
        assert_eq!(started.status, 201, "{}", started.text());
        let mut events = served.events("", Some("0"));
        let detection = events.until(|event| event.name == "detection").data;
        let path = format!("/v1/sessions/{}/views", started.json()["id"].as_str().unwrap());
        let view = served.get(&path).json()["views"][0].clone();
        for (said, corners) in [(&detection, "corners"), (&view, "corners_px")] {
            assert_eq!(said[corners], detected["corners"], "{said}");
            assert_eq!(said["indices"], detected["indices"], "{said}");
            assert_eq!(said["ids"], detected["ids"], "{said}");
        }
    }
}
