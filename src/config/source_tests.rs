//! Each kind of source as written, and what is refused at its key.

use std::collections::BTreeMap;
use std::path::Path;

use crate::capture::mode::ModeRequest;
use crate::capture::realsense::{Preset, Settings};
use crate::capture::uvc::Backend;
use crate::config::source::{SourceConfig, UvcSelector};
use crate::config::{Overrides, Written};
use crate::geometry::pixel::ImageSize;
use crate::simulation::OperatorKind;

fn source(text: &str) -> Result<SourceConfig, String> {
    let text = format!("[[camera]]\nname = \"front\"\nsource = {text}\n");
    let config = Written::parse(&text, Path::new("plumb.toml"))
        .and_then(|written| written.check(&Overrides::default()))
        .map_err(|error| error.to_string())?;
    Ok(config.cameras[0].source.clone())
}

#[test]
fn each_kind_with_its_defaults() {
    let simulator = SourceConfig::Simulator {
        seed: 1,
        size: ImageSize::new(640, 480),
        fps: 30.0,
        seat: None,
        operator: None,
        fastest: false,
    };
    let operated = SourceConfig::Simulator {
        seed: 1,
        size: ImageSize::new(640, 480),
        fps: 30.0,
        seat: None,
        operator: Some(OperatorKind::Follows),
        fastest: true,
    };
    let written = "{ kind = \"simulator\", operator = \"follows\", pace = \"fastest\" }";
    assert_eq!(source(written), Ok(operated));
    assert_eq!(source("{ kind = \"simulator\" }"), Ok(simulator));
    let recording = |topics: &[&str]| SourceConfig::Recording {
        path: "/".into(),
        topics: topics.iter().map(|topic| (*topic).to_owned()).collect(),
        fastest: false,
        repeat: false,
        fps: 10.0,
    };
    assert_eq!(source("{ kind = \"recording\", path = \"/\" }"), Ok(recording(&[])));
    let of_bag = "{ kind = \"recording\", path = \"/\", topic = \"/a\", depth = \"/b\" }";
    assert_eq!(source(of_bag), Ok(recording(&["/a", "/b"])));
    let ros2 = SourceConfig::Ros2 {
        topic: "/front/image_raw".to_owned(),
        depth: Some("/front/depth/image_rect_raw".to_owned()),
        domain_id: Some(7),
    };
    let of_driver = "{ kind = \"ros2\", topic = \"/front/image_raw\", depth = \"/front/depth/image_rect_raw\", domain_id = 7 }";
    assert_eq!(source(of_driver), Ok(ros2));
    let realsense = |mode, settings| Ok(SourceConfig::Realsense { serial: None, mode, settings });
    assert_eq!(
        source("{ kind = \"realsense\" }"),
        realsense(ModeRequest::default(), Settings::default())
    );
    let set = "{ kind = \"realsense\", width = 848, height = 480, fps = 30, preset = \"high_accuracy\", emitter = false }";
    let mode = ModeRequest { size: Some(ImageSize::new(848, 480)), format: None, fps: Some(30.0) };
    let settings = Settings { preset: Some(Preset::HighAccuracy), emitter: Some(false) };
    assert_eq!(source(set), realsense(mode, settings));
    let uvc = |backend| {
        let (camera, mode) = (UvcSelector::Index(0), ModeRequest::default());
        Ok(SourceConfig::Uvc { camera, mode, backend })
    };
    assert_eq!(source("{ kind = \"uvc\", index = 0 }"), uvc(Backend::DEFAULT));
    let backends = [Backend::Native, Backend::Nokhwa];
    let (built, absent): (Vec<Backend>, Vec<Backend>) =
        backends.into_iter().partition(|backend| backend.missing().is_none());
    let asked = |backend: Backend| {
        source(&format!("{{ kind = \"uvc\", index = 0, backend = \"{}\" }}", backend.name()))
    };
    for backend in built {
        assert_eq!(asked(backend), uvc(backend));
    }
    for backend in absent {
        let error = asked(backend).unwrap_err();
        assert!(error.contains(backend.missing().unwrap()), "{error}");
    }
}

#[test]
fn the_contracts_v4l2_camera_reads_as_written() {
    let text = "{ kind = \"v4l2\", device = \"/dev/v4l/by-id/x\", width = 1280, height = 720, format = \"MJPG\", \
                fps = 30, controls = { focus_auto = 0 } }";
    let mode = ModeRequest {
        size: Some(ImageSize::new(1280, 720)),
        format: Some("MJPG".to_owned()),
        fps: Some(30.0),
    };
    let controls = BTreeMap::from([("focus_auto".to_owned(), 0)]);
    assert_eq!(
        source(text),
        Ok(SourceConfig::V4l2 { device: "/dev/v4l/by-id/x".into(), mode, controls, lock: false })
    );
}

#[test]
fn what_cannot_be_is_refused_at_its_key() {
    let cases = [
        ("{ kind = \"webcam\" }", "camera.source.kind: `webcam` is not a valid kind"),
        ("{ kind = \"recording\" }", "camera.source.path: missing"),
        (
            "{ kind = \"recording\", path = \"/not/there.mcap\" }",
            "camera.source.path: `/not/there.mcap` cannot be",
        ),
        (
            "{ kind = \"recording\", path = \"/\", pace = \"slow\" }",
            "camera.source.pace: `slow` is not a valid pace",
        ),
        (
            "{ kind = \"recording\", path = \"/\", fps = 0 }",
            "camera.source.fps: impossible; write 0.001 to 1000",
        ),
        (
            "{ kind = \"recording\", path = \"/\", fps = nan }",
            "camera.source.fps: impossible; write 0.001 to 1000",
        ),
        (
            "{ kind = \"simulator\", fps = 1e-300 }",
            "camera.source.fps: impossible; write 0.001 to 1000",
        ),
        (
            "{ kind = \"recording\", path = \"/\", device = \"x\" }",
            "camera.source.device: unknown for kind",
        ),
        (
            "{ kind = \"simulator\", width = 0, height = 480 }",
            "camera.source.width: 0 px is impossible",
        ),
        ("{ kind = \"simulator\", width = 640 }", "camera.source.height: missing"),
        ("{ kind = \"simulator\", tint = 1 }", "tint: unknown field `tint`"),
        (
            "{ kind = \"simulator\", operator = \"sleeps\" }",
            "camera.source.operator: `sleeps` is not a valid operator; write follows",
        ),
        ("{ kind = \"ros2\" }", "camera.source.topic: missing"),
        (
            "{ kind = \"ros2\", topic = \"front\" }",
            "camera.source.topic: `front` is not a topic name; write it as",
        ),
        (
            "{ kind = \"ros2\", topic = \"/a\", domain_id = 233 }",
            "camera.source.domain_id: 233 is not a valid domain; write 0 to 232",
        ),
        ("{ kind = \"v4l2\" }", "camera.source.device: missing"),
        (
            "{ kind = \"uvc\", index = 0, backend = \"v4l\" }",
            "camera.source.backend: `v4l` is not a valid backend; write \"native\" or \"nokhwa\"",
        ),
        (
            "{ kind = \"uvc\", index = 0, name = \"x\" }",
            "camera.source.index: give the camera's index or its name",
        ),
        (
            "{ kind = \"realsense\", serial = \"1\", path = \"/\" }",
            "camera.source.serial: a serial number and a",
        ),
        (
            "{ kind = \"realsense\", preset = \"best\" }",
            "camera.source.preset: `best` is not a valid preset; write one of",
        ),
        (
            "{ kind = \"realsense\", path = \"/\", emitter = true }",
            "camera.source.emitter: unknown for kind",
        ),
        ("\"simulator\"", "source: invalid type: string"),
    ];
    for (text, expected) in cases {
        let message = source(text).unwrap_err();
        assert!(
            message.starts_with(&format!("plumb.toml:3: {expected}")),
            "{message}\nis not\n{expected}"
        );
    }
}

/// A session goes on with views of one lens only: what may change its images' geometry is in the
/// words, what may not is not.
#[test]
fn the_image_source_is_what_decides_the_geometry() {
    let words = |text: &str| source(text).unwrap().image_source();
    let v4l2 =
        |keys: &str| words(&format!("{{ kind = \"v4l2\", device = \"/dev/video0\"{keys} }}"));
    let plain = v4l2("");
    assert_eq!(plain, "v4l2 /dev/video0");
    for same in [", lock = true", ", controls = { exposure_absolute = 9, gain = 3 }"] {
        assert_eq!(v4l2(same), plain);
    }
    let full = ", width = 640, height = 480, format = \"MJPG\", fps = 30, controls = { focus_absolute = 9, gain = 3 }";
    assert_eq!(v4l2(full), "v4l2 /dev/video0 640x480 MJPG 30 fps focus_absolute=9");
    let recording = |keys: &str| words(&format!("{{ kind = \"recording\", path = \"/\"{keys} }}"));
    assert_eq!(recording(""), "recording /");
    for same in [", pace = \"fastest\"", ", repeat = true", ", fps = 3"] {
        assert_eq!(recording(same), recording(""));
    }
    let rgbd = recording(", topic = \"/a/color\", depth = \"/a/depth\"");
    assert_eq!(rgbd, "recording / /a/color /a/depth");
    let simulator = |keys: &str| words(&format!("{{ kind = \"simulator\"{keys} }}"));
    assert_eq!(simulator(", seat = 1"), "simulator seed 1 640x480 seat 1");
    let carried = simulator(", operator = \"follows\", pace = \"fastest\", fps = 5");
    assert_eq!(carried, simulator(""));
    assert_eq!(words("{ kind = \"realsense\", serial = \"7\", emitter = true }"), "realsense 7");
    assert_eq!(words("{ kind = \"ros2\", topic = \"/a\", domain_id = 7 }"), "ros2 /a domain 7");
}
