//! A live device of the library's, without a camera: its streams and options, several by serial
//! number, one that stops.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use plumb::calibration::result::Calibration;
use plumb::calibration::sensor::SensorId;
use plumb::calibration::session_record::{SessionRequest, SessionState};
use plumb::capture::realsense::{Origin, Preset, RealsenseCamera, RealsenseOptions, Settings};
use plumb::capture::{CaptureError, FrameSource, SourceOpener};
use plumb::estimation::problem::LensChoice;
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::LensModel;
use plumb::imaging::frame::SensorKind;
use plumb::pipeline::camera_status::CameraState;
use plumb::pipeline::event::{EventKind, EventStream};
use plumb::pipeline::fleet::Fleet;
use plumb::pipeline::preview::drawing::Drawing;
use plumb::pipeline::{CameraPlan, FleetOptions, Supervision};
use plumb::store::Store;
use realsense_rust::context::Context;
use realsense_rust::kind::Rs2Option;
use serde_json::Value;

use crate::served::recording;
use crate::software_device::{Device, LiveDevice, SensorImages};
use crate::{POLL, described, images, walk_images};

/// Longer than anything asked for here takes, on a busy machine too.
const PATIENCE: Duration = Duration::from_secs(120);
/// Color as it comes.
const PLAIN: Drawing = Drawing {
    sensor: SensorKind::Color,
    overlay: false,
    guidance: false,
    undistorted: false,
    rectified: false,
    alpha: 0.0,
    registered: false,
};
const SETTABLE: [(Rs2Option, f32); 3] = [
    (Rs2Option::VisualPreset, 0.0),
    (Rs2Option::EmitterEnabled, 1.0),
    (Rs2Option::EmitterOnOff, 0.0),
];

fn truth() -> Value {
    serde_json::from_slice(&std::fs::read(recording("rgbd.truth.json")).unwrap()).unwrap()
}

fn context() -> Arc<Mutex<Context>> {
    Arc::new(Mutex::new(Context::new().unwrap()))
}

fn device(serial: &'static str, options: &[(Rs2Option, f32)]) -> Device {
    Device { fps: 30, options: options.to_vec(), ..described(serial, &truth()) }
}

/// A device that shows images over and over while it is switched on.
struct Showing {
    device: Arc<Mutex<LiveDevice>>,
    is_on: Arc<AtomicBool>,
    ends: Arc<AtomicBool>,
    shown: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

impl Showing {
    fn start(device: LiveDevice, sets: Vec<SensorImages>, pace: Duration) -> Self {
        let (device, is_on) = (Arc::new(Mutex::new(device)), Arc::new(AtomicBool::new(true)));
        let (ends, shown) = (Arc::default(), Arc::default());
        let work = {
            let (device, is_on) = (Arc::clone(&device), Arc::clone(&is_on));
            let (ends, shown): (Arc<AtomicBool>, Arc<AtomicUsize>) =
                (Arc::clone(&ends), Arc::clone(&shown));
            move || {
                while !ends.load(Ordering::Relaxed) {
                    let at = shown.load(Ordering::Relaxed);
                    // Switched off and on under the same lock: off means that nothing comes any
                    // more.
                    let mut device = device.lock().unwrap();
                    if is_on.load(Ordering::Relaxed) {
                        device.show(&sets[at % sets.len()]);
                        shown.store(at + 1, Ordering::Relaxed);
                    }
                    drop(device);
                    sleep(pace);
                }
            }
        };
        Self { device, is_on, ends, shown, thread: Some(std::thread::spawn(work)) }
    }

    fn switch(&self, on: bool) {
        let _nothing_is_shown_now = self.device.lock().unwrap();
        self.is_on.store(on, Ordering::Relaxed);
    }

    fn option(&self, option: Rs2Option) -> f32 {
        self.device.lock().unwrap().option(option)
    }
}

impl Drop for Showing {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

fn next(source: &mut dyn FrameSource) -> plumb::imaging::frame::FrameSet {
    let began = Instant::now();
    loop {
        match source.next_frame(POLL) {
            Ok(set) => return set,
            Err(CaptureError::TimedOut { .. }) => assert!(began.elapsed() < PATIENCE, "no frame"),
            Err(error) => panic!("{error}"),
        }
    }
}

#[test]
fn every_sensor_of_a_live_device_comes_in_one_frame_set() {
    let context = context();
    let fed = walk_images(4);
    let live = LiveDevice::plug_in(&context, &device("000000054321", &[]));
    let mut source = RealsenseCamera::in_context(RealsenseOptions::default(), Arc::clone(&context))
        .open()
        .unwrap();
    let description = source.description();
    assert_eq!(description.serial.as_deref(), Some("000000054321"));
    let right =
        description.factory.sensor(SensorKind::Infrared2).unwrap().color_from_sensor.unwrap();
    assert!(
        (right.translation().x - 0.075).abs() < 1e-6,
        "{right:?}: 50 mm right of the depth sensor"
    );
    let showing = Showing::start(live, fed.clone(), Duration::from_millis(40));
    let mut whole = 0;
    let mut last = None;
    while whole < 10 {
        let set = next(source.as_mut());
        let time = set.device_time.unwrap().monotonic_ns;
        assert!(
            last.is_none_or(|(sequence, before)| set.sequence > sequence && time > before),
            "{last:?}"
        );
        last = Some((set.sequence, time));
        if set.frames.len() == 4 {
            assert!(
                fed.contains(&images(&set)),
                "frame set {} is none of those shown",
                set.sequence
            );
            whole += 1;
        }
    }
    let missed = source.losses().missed;
    (0..5).for_each(|_| showing.device.lock().unwrap().skip());
    while source.losses().missed < missed + 5 {
        next(source.as_mut());
    }
}

#[test]
fn the_emitter_and_the_preset_are_set_and_given_back() {
    let emitter = |showing: &LiveDevice| {
        [Rs2Option::EmitterEnabled, Rs2Option::EmitterOnOff].map(|o| showing.option(o))
    };
    let settings = Settings { preset: Some(Preset::HighAccuracy), emitter: Some(true) };
    let options = RealsenseOptions { settings, ..RealsenseOptions::default() };

    let alternates = context();
    let live = LiveDevice::plug_in(&alternates, &device("000000000001", &SETTABLE));
    let mut source = RealsenseCamera::in_context(options.clone(), alternates).open().unwrap();
    assert_eq!((live.option(Rs2Option::VisualPreset), emitter(&live)), (3.0, [1.0, 0.0]));
    source.calibrating(true).unwrap();
    assert_eq!(
        emitter(&live),
        [1.0, 1.0],
        "on in every other frame: the board is seen, and depth goes on"
    );
    source.calibrating(false).unwrap();
    assert_eq!(emitter(&live), [1.0, 0.0]);
    source.calibrating(true).unwrap();
    drop(source);
    assert_eq!(emitter(&live), [1.0, 0.0], "given back when it is closed in a session too");

    let only_off = context();
    let live = LiveDevice::plug_in(&only_off, &device("000000000002", &SETTABLE[..2]));
    let mut source = RealsenseCamera::in_context(options.clone(), only_off).open().unwrap();
    source.calibrating(true).unwrap();
    assert_eq!(live.option(Rs2Option::EmitterEnabled), 0.0, "off where it cannot alternate");
    source.calibrating(false).unwrap();
    assert_eq!(live.option(Rs2Option::EmitterEnabled), 1.0);

    let without = context();
    let _live = LiveDevice::plug_in(&without, &device("000000000003", &[]));
    let error = RealsenseCamera::in_context(options, without).open().map(|_| ()).unwrap_err();
    assert_eq!(error.to_string(), "000000000003: this device has no preset: remove `preset`");
}

#[test]
fn several_devices_are_distinguished_by_their_serial_numbers() {
    let context = context();
    let sets = walk_images(2);
    let serials = ["000000000011", "000000000022"];
    let _showing: Vec<Showing> = serials
        .iter()
        .zip(&sets)
        .map(|(serial, images)| {
            let live = LiveDevice::plug_in(&context, &device(serial, &[]));
            Showing::start(live, vec![images.clone()], Duration::from_millis(40))
        })
        .collect();
    let open = |origin: Origin| {
        RealsenseCamera::in_context(
            RealsenseOptions { origin, ..RealsenseOptions::default() },
            Arc::clone(&context),
        )
        .open()
    };
    let error = open(Origin::OnlyDevice).map(|_| ()).unwrap_err().to_string();
    assert!(
        error.starts_with(
            "several RealSense cameras are plugged in: write serial = one of 0000000000"
        ),
        "{error}"
    );
    let mut sources = serials.map(|serial| open(Origin::Serial(serial.to_owned())).unwrap());
    for (source, shown) in sources.iter_mut().zip(&sets) {
        let whole = std::iter::repeat_with(|| next(source.as_mut()))
            .find(|set| set.frames.len() == 4)
            .unwrap();
        assert!(images(&whole) == *shown);
    }
    let error =
        open(Origin::Serial("000000000033".to_owned())).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("it is not plugged in; connected: 0000000000"), "{error}");
}

fn fleet(
    context: &Arc<Mutex<Context>>,
    folder: &tempfile::TempDir,
    supervision: Supervision,
) -> (Fleet, Arc<Store>) {
    let store = Arc::new(Store::open(folder.path()).unwrap());
    let camera = RealsenseCamera::in_context(RealsenseOptions::default(), Arc::clone(context));
    let (name, kind, image_source) =
        ("front".to_owned(), "realsense".to_owned(), "realsense".to_owned());
    let plan = CameraPlan { name, kind, image_source, open: Box::new(camera), may_stall: true };
    let options = FleetOptions { supervision, ..FleetOptions::default() };
    (Fleet::start(vec![plan], Arc::clone(&store), &options).unwrap(), store)
}

async fn until<T>(events: &mut EventStream, mut wanted: impl FnMut(&EventKind) -> Option<T>) -> T {
    let found = async {
        loop {
            if let Some(found) = wanted(&events.next().await.kind) {
                return found;
            }
        }
    };
    tokio::time::timeout(PATIENCE, found).await.unwrap()
}

async fn until_state(events: &mut EventStream, state: CameraState) -> String {
    until(events, |event| match event {
        EventKind::Camera(status) if status.state == state => {
            Some(status.reason.clone().unwrap_or_default())
        }
        _ => None,
    })
    .await
}

async fn until_views(events: &mut EventStream, count: u64) {
    until(events, |event| match event {
        EventKind::Session(record) => (u64::from(record.views_kept) >= count).then_some(()),
        _ => None,
    })
    .await;
}

/// As the daemon has it by default: reported within 2 s, taken up again by its serial number, and
/// the session goes on.
#[tokio::test(flavor = "multi_thread")]
async fn a_live_walk_with_a_stop_in_it_is_calibrated() {
    let (context, folder) = (context(), tempfile::tempdir().unwrap());
    let live = LiveDevice::plug_in(&context, &device("000000012345", &SETTABLE));
    let sets = walk_images(usize::MAX);
    let count = sets.len();
    // Slower than the daemon searches, on a busy machine too.
    let showing = Showing::start(live, sets, Duration::from_millis(200));
    let (fleet, store) = fleet(&context, &folder, Supervision::default());
    let mut events = fleet.events(Some(0));
    until_state(&mut events, CameraState::Streaming).await;
    let target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.04).unwrap();
    let request = SessionRequest {
        target: target.into(),
        lens: LensChoice::Model(LensModel::Brown),
        finish: None,
        given: Vec::new(),
    };
    let id = fleet.start_session("front", request).await.unwrap().id;
    until_views(&mut events, 4).await;
    assert_eq!(showing.option(Rs2Option::EmitterOnOff), 1.0, "while the board is searched for");

    showing.switch(false);
    let stopped = Instant::now();
    let reason = until_state(&mut events, CameraState::Lost).await;
    let reported = stopped.elapsed();
    assert!(
        reported < Duration::from_secs(2) && reason.starts_with("no frame for 1."),
        "{reason}, reported after {reported:?}"
    );
    assert_eq!(fleet.live_session(&id).unwrap().state, SessionState::Collecting);

    showing.switch(true);
    let before = showing.shown.load(Ordering::Relaxed);
    until_state(&mut events, CameraState::Streaming).await;
    until(&mut events, |_| {
        (showing.shown.load(Ordering::Relaxed) >= before + count + 3).then_some(())
    })
    .await;
    fleet.stop_session(&id).await.unwrap();
    let session = fleet.session_over(&id).await.unwrap();
    assert_eq!(session.state, SessionState::Finished, "{:?}", session.reason);
    // The capture thread gives it back before it takes the next frame.
    let mut preview = fleet.preview("front", PLAIN).unwrap();
    let given_back = async {
        while showing.option(Rs2Option::EmitterOnOff) != 0.0 {
            preview.changed().await.unwrap();
        }
    };
    tokio::time::timeout(PATIENCE, given_back).await.expect("given back after the session");
    let calibration = store.calibration(session.calibration.as_ref().unwrap()).unwrap().unwrap();
    is_true(&calibration);
    let views = session.views_kept;
    eprintln!(
        "live: reported {reported:?} after the last frame: {reason}; {views} views, {:?}",
        calibration.verdict
    );
}

/// Holds a calibration against what the images were made of; the right infrared ones are the left
/// ones rotated by half a turn, so that their camera is the left one, rotated.
fn is_true(calibration: &Calibration) {
    let truth = truth();
    let number =
        |sensor: &str, name: &str| truth["sensors"][sensor]["lens"][name].as_f64().unwrap();
    let sensors: Vec<&str> = calibration.image_sensors().map(|(id, _)| id.kind.name()).collect();
    assert_eq!(sensors, ["color", "infrared", "infrared2"], "{:?}", calibration.verdict);
    for (name, sensor) in calibration.image_sensors().map(|(id, sensor)| (id.kind.name(), sensor)) {
        let of = |parameter: &str| match (name, parameter) {
            ("infrared2", "cx") => 639.0 - number("infrared", "cx"),
            ("infrared2", "cy") => 479.0 - number("infrared", "cy"),
            ("infrared2", _) => number("infrared", parameter),
            _ => number(name, parameter),
        };
        let matrix = sensor.lens.matrix;
        for ((parameter, found), std) in ["fx", "fy", "cx", "cy"]
            .into_iter()
            .zip([matrix.fx, matrix.fy, matrix.cx, matrix.cy])
            .zip(&sensor.lens_std)
        {
            let off = found - of(parameter);
            assert!(off.abs() < 4.5 * std, "{name} {parameter}: off by {off:.3} ± {std:.3}");
        }
    }
    let color = SensorId::own(SensorKind::Color);
    let pose = |kind: SensorKind| {
        calibration.pose(&color, &SensorId::own(kind)).unwrap().target_from_source
    };
    let (left, right) = (pose(SensorKind::Infrared), pose(SensorKind::Infrared2));
    let distance_m = (left.translation() - right.translation()).norm();
    let rotation = left.angle_to(&right).to_degrees();
    assert!(
        distance_m < 2e-3 && (rotation - 180.0).abs() < 0.1,
        "{distance_m} m and {rotation}° between both infrared sensors"
    );
    assert!(calibration.depth().is_some());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_never_gives_anything_is_reset_in_the_end() {
    let (context, folder) = (context(), tempfile::tempdir().unwrap());
    let live = LiveDevice::plug_in(&context, &device("000000000007", &[]));
    let showing = Showing::start(live, walk_images(1), Duration::from_millis(40));
    showing.switch(false);
    let soon = Duration::from_millis(10);
    let supervision = Supervision {
        first_retry: soon,
        longest_retry: soon,
        first_frame: POLL,
        ..Supervision::default()
    };
    let (fleet, _) = fleet(&context, &folder, supervision);
    let mut events = fleet.events(Some(0));
    let reset = until(&mut events, |event| match event {
        EventKind::Camera(status) => {
            status.reason.clone().filter(|reason| reason.contains("reset"))
        }
        _ => None,
    })
    .await;
    assert_eq!(
        reset,
        "000000000007 was lost: it was opened 3 times without delivering a frame, and was reset"
    );
    showing.switch(true);
    until_state(&mut events, CameraState::Streaming).await;
}
