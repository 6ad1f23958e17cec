//! Why no board was found, as `plumb detect` says it, and as a session counts, announces and
//! publishes it.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::{Served, repeating};

/// An image of a board of inner corners, seen straight on, before white.
struct Straight {
    corners: (i32, i32),
    square_px: f64,
    /// Where the board's upper left corner is.
    origin: (f64, f64),
    colors: [f64; 2],
    /// Each pixel is the mean of a square reaching this far.
    soft_px: i32,
}

const WIDTH: i32 = 320;
const HEIGHT: i32 = 240;

impl Straight {
    const WHOLE: Self = Self {
        corners: (9, 6),
        square_px: 24.0,
        origin: (40.3, 36.2),
        colors: [40.0, 210.0],
        soft_px: 0,
    };

    /// The image as a PGM.
    fn pgm(&self) -> Vec<u8> {
        let sharp: Vec<f64> =
            (0..WIDTH * HEIGHT).map(|at| self.light(at % WIDTH, at / WIDTH)).collect();
        let mean = |x: i32, y: i32, step: (i32, i32), of: &[f64]| {
            let reach = -self.soft_px..=self.soft_px;
            let count = f64::from(2 * self.soft_px + 1);
            let at = |k: i32| {
                (y + k * step.1).clamp(0, HEIGHT - 1) * WIDTH + (x + k * step.0).clamp(0, WIDTH - 1)
            };
            reach.map(|k| of[at(k) as usize]).sum::<f64>() / count
        };
        let all = || (0..WIDTH * HEIGHT).map(|at| (at % WIDTH, at / WIDTH));
        let across: Vec<f64> = all().map(|(x, y)| mean(x, y, (1, 0), &sharp)).collect();
        let mut pgm = format!("P5 {WIDTH} {HEIGHT} 255\n").into_bytes();
        pgm.extend(all().map(|(x, y)| mean(x, y, (0, 1), &across) as u8));
        pgm
    }

    fn light(&self, x: i32, y: i32) -> f64 {
        let square =
            |at: i32, origin: f64| ((f64::from(at) - origin) / self.square_px).floor() as i32;
        let (col, row) = (square(x, self.origin.0), square(y, self.origin.1));
        let on_board = (0..=self.corners.0).contains(&col) && (0..=self.corners.1).contains(&row);
        self.colors[usize::from(!on_board || (col + row) % 2 != 0)]
    }
}

#[test]
fn detect_says_why_there_is_no_board() {
    let images = [
        ("whole", Straight::WHOLE, None),
        ("flat", Straight { colors: [100.0, 104.0], ..Straight::WHOLE }, Some("contrast")),
        ("soft", Straight { soft_px: 30, ..Straight::WHOLE }, Some("blur")),
        (
            "other",
            Straight { corners: (7, 5), ..Straight::WHOLE },
            Some("a board of 7x5 is seen, not 9x6"),
        ),
        ("cut", Straight { origin: (-60.0, 36.2), ..Straight::WHOLE }, Some("cut off")),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(format!("{name}.pgm")).to_str().unwrap().to_owned();
    for (name, image, _) in &images {
        std::fs::write(path(name), image.pgm()).unwrap();
    }
    let tiny = path("tiny");
    std::fs::write(&tiny, [b"P5 30 20 255\n".as_slice(), &[90; 600]].concat()).unwrap();
    let asked = ["detect", "--board", "9x6", "--json"].map(str::to_owned);
    let paths = images.iter().map(|(name, ..)| path(name)).chain([tiny.clone()]);
    let finished = plumb(asked.into_iter().chain(paths));
    let lines: Vec<Value> =
        finished.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), images.len() + 1, "{finished:?}");
    let expected = images.iter().map(|(_, _, reason)| *reason).chain([Some("30x20")]);
    for (line, expected) in lines.iter().zip(expected) {
        match expected {
            None => assert!(line["found"] == true && line["reason"].is_null(), "{line}"),
            Some(words) => {
                assert_eq!(line["found"], false, "{line}");
                assert!(
                    line["reason"].as_str().is_some_and(|reason| reason.contains(words)),
                    "{words}: {line}"
                );
            }
        }
    }
}

/// Sensors of one camera do not start with the same frame.
#[test]
fn frames_of_depth_without_color_are_named_and_the_others_searched() {
    let folder = tempfile::tempdir().unwrap();
    let depth = [b"P5 2 2 65535\n".as_slice(), &[4; 8]].concat();
    for sensor in ["color", "depth"] {
        std::fs::create_dir(folder.path().join(sensor)).unwrap();
    }
    for name in ["1", "2", "3"] {
        std::fs::write(folder.path().join(format!("depth/{name}.pgm")), &depth).unwrap();
    }
    let source = folder.path().to_str().unwrap();
    let asked = ["detect", "--board", "9x6", "--json", source];
    assert_eq!(plumb(asked.map(str::to_owned)).code, Some(1), "there is no image at all");
    std::fs::write(folder.path().join("color/2.pgm"), Straight::WHOLE.pgm()).unwrap();
    let finished = plumb(asked.map(str::to_owned));
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    let lines: Vec<Value> =
        finished.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let found: Vec<&Value> = lines.iter().map(|line| &line["found"]).collect();
    assert_eq!(found, [false, true, false], "{lines:?}");
    assert!(lines[0]["reason"].as_str().unwrap().contains("color image is missing"), "{lines:?}");
    assert!(finished.stderr.contains("2 frame sets have no color image"), "{}", finished.stderr);
}

/// What rejected a frame reaches all remote clients: the events, the session's document and
/// the metrics.
#[test]
fn a_session_counts_and_reports_each_reason_by_its_own_name() {
    let images = [
        (
            "low_contrast",
            Straight { colors: [100.0, 104.0], ..Straight::WHOLE },
            "not enough contrast",
        ),
        ("blurred", Straight { soft_px: 30, ..Straight::WHOLE }, "too blurred"),
        (
            "other_size",
            Straight { corners: (7, 5), ..Straight::WHOLE },
            "a board of 7x5 is seen, not 9x6",
        ),
        (
            "no_corners",
            Straight { corners: (0, 0), square_px: 90.0, ..Straight::WHOLE },
            "no chessboard corners",
        ),
    ];
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("images");
    std::fs::create_dir(&recording).unwrap();
    for (name, image, _) in &images {
        std::fs::write(recording.join(format!("{name}.pgm")), image.pgm()).unwrap();
    }
    let served = Served::start(folder.path(), &repeating("front", &recording));
    let mut events = served.events("?camera=front", None);
    let target = json!({"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025});
    let session = served.post("/v1/cameras/front/sessions", &json!({ "target": target })).json();
    let mut awaited: BTreeSet<&str> = images.iter().map(|(kind, ..)| *kind).collect();
    while !awaited.is_empty() {
        let event = events.until(|event| event.name == "detection").data;
        assert!(event["found"] == false && event["session"] == session["id"], "{event}");
        let (kind, reason) =
            (event["rejection"].as_str().unwrap(), event["reason"].as_str().unwrap());
        let (.., words) =
            images.iter().find(|(name, ..)| *name == kind).unwrap_or_else(|| panic!("{event}"));
        assert!(reason.contains(words), "{event}");
        awaited.remove(kind);
    }
    let counted = served.get(&format!("/v1/sessions/{}", session["id"].as_str().unwrap())).json();
    let metrics = served.get("/metrics").text();
    for (kind, ..) in &images {
        assert!(counted["rejected"][kind].as_u64().unwrap() > 0, "{kind}: {counted}");
        let label = format!("plumb_frames_rejected_total{{camera=\"front\",reason=\"{kind}\"}} ");
        let count = metrics
            .lines()
            .find_map(|line| line.strip_prefix(&label))
            .unwrap_or_else(|| panic!("{metrics}"));
        assert!(count.parse::<u64>().unwrap() > 0, "{kind}: {count}");
    }
}

/// A whole chessboard of whatever size is named; part of one, or none, never is.
#[test]
fn a_chessboard_that_nobody_described_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let straight = |corners, square_px| Straight { corners, square_px, ..Straight::WHOLE };
    let whole = [((4, 3), 30.0), ((7, 5), 24.0), ((9, 6), 22.0), ((12, 8), 18.0), ((17, 12), 12.0)];
    let mut images: Vec<_> = whole
        .map(|(size, px)| (straight(size, px), Some(json!([size.0, size.1]))))
        .into_iter()
        .collect();
    // Beyond the image's right border.
    images.push((straight((12, 6), 24.0), None));
    images.push((straight((0, 0), 90.0), None));
    let write = |(k, (image, _)): (usize, &(Straight, _))| {
        let path = folder.path().join(format!("{k}.pgm"));
        std::fs::write(&path, image.pgm()).unwrap();
        path.display().to_string()
    };
    let paths: Vec<String> = images.iter().enumerate().map(write).collect();
    let options = ["detect", "--target", "auto", "--json"].map(str::to_owned);
    let finished = plumb(options.into_iter().chain(paths));
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    let lines: Vec<Value> =
        finished.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), images.len());
    for (line, (_, size)) in lines.iter().zip(&images) {
        match size {
            Some(size) => {
                assert_eq!(
                    json!([line["target"]["cols"], line["target"]["rows"]]),
                    *size,
                    "{line}"
                );
                assert_eq!(line["target"]["kind"], "chessboard", "{line}");
            }
            None => assert_eq!((&line["found"], &line["target"]), (&json!(false), &json!(null))),
        }
    }
}
