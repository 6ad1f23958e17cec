//! Examples that the store's tests use.

use crate::calibration::admission::Rejections;
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::Guidance;
use crate::calibration::result::{Calibration, ProjectionUncertainty};
use crate::calibration::sensor::SensorId;
use crate::calibration::session_record::{
    Finish, HeldLens, RunningEstimate, SessionRecord, SessionRequest, SessionState,
};
use crate::calibration::view::{FrameFacts, View};
use crate::document::lens_model::LensRequest;
use crate::document::reading::from_json;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::target::chessboard;
use crate::imaging::frame::SensorKind;
use crate::store::{Picture, SensorView, Store, StoreError};

/// A calibration with every field filled in.
pub(super) fn calibration(id: &str, created_at_ns: i64) -> Calibration {
    Calibration { id: id.into(), created_at_ns, ..crate::document::calibration::tests::example() }
}

/// A session in the middle of its work, with every field filled in.
pub(super) fn record(id: &str) -> SessionRecord {
    let third = 1.0 / 3.0;
    let lens = Lens::from_parameters(
        LensModel::Radial,
        &[500.0 + third, 501.0, 320.0, 240.0, 0.0, -0.1 * third],
    );
    SessionRecord {
        id: id.into(),
        camera: "front".into(),
        members: Vec::new(),
        sources: [("front".to_owned(), "v4l2 /dev/video0 1280x720".to_owned())].into(),
        devices: [("front".to_owned(), "C920, serial 1A2B".to_owned())].into(),
        request: SessionRequest {
            target: chessboard(9, 6, 0.1 * third).unwrap().into(),
            lens: from_json::<LensRequest>(b"\"brown\"").unwrap().into(),
            finish: Some(Finish {
                uncertainty_px: Some(third),
                min_views: Some(12),
                max_seconds: None,
            }),
            given: vec![HeldLens {
                sensor: SensorId::of("left", SensorKind::Color),
                lens: lens.unwrap(),
            }],
        },
        state: SessionState::Collecting,
        reason: None,
        started_at_ns: 1_770_000_000_123_456_789,
        finished_at_ns: None,
        frames_seen: 100,
        boards_seen: 50,
        views_kept: 1,
        rejected: Rejections::from_counts([("blurred", 3), ("too_similar", 46)]),
        collecting_s: 10.0 * third,
        coverage: Coverage::from_cells(vec![vec![0, 1], vec![2, 3]]).unwrap(),
        guidance: Guidance {
            message: "tilt it".into(),
            outline_px: vec![Pixel::new(third, 2.0 * third)],
            camera_from_board: None,
            expected_uncertainty_px: Some(third),
            views_to_go: Some([2, 5]),
        },
        estimate: Some(RunningEstimate {
            lens: lens.unwrap(),
            rms_px: third,
            uncertainty_px: ProjectionUncertainty { center: 0.1, median: third, worst: 1.0 },
            uncertainty_map: None,
            views: 1,
        }),
        calibration: None,
    }
}

/// A view of the sensor that boards are searched for in.
pub(super) fn numbered(view: &View, frame_set: u32, sensor: SensorId) -> SensorView {
    let detection = Some(view.detection.clone());
    let (number, frame) = (Some(view.number), view.frame.clone());
    SensorView { frame_set, sensor, number, frame, depth_encoding: None, detection }
}

/// Keeps `view` of an instrument that is one camera.
pub(super) fn keep(
    store: &Store,
    session_id: &str,
    view: &View,
    media_type: &str,
    bytes: &[u8],
) -> Result<(), StoreError> {
    let sensor_view = numbered(view, view.number, SensorId::own(SensorKind::Color));
    let picture = Picture { media_type: media_type.to_owned(), bytes: bytes.to_vec() };
    store.keep_views(&record(session_id), &[(sensor_view, picture)])
}

/// The numbered views of a session, in the order they were kept.
pub(super) fn views(store: &Store, session_id: &str) -> Vec<View> {
    let all = store.sensor_views(session_id).unwrap();
    let mut views: Vec<View> = all.iter().filter_map(|view| Some(view.to_kept(0)?.1)).collect();
    views.sort_by_key(|view| view.number);
    views
}

/// A view whose numbers have no short decimals.
pub(super) fn view(number: u32) -> View {
    let frame = FrameFacts {
        sequence: u64::MAX - u64::from(number),
        name: (number == 0).then(|| "left01.jpg".to_owned()),
        host_time_ns: 1_770_000_000_123_456_789,
        device_time_ns: Some(i64::MIN),
        image_size: ImageSize::new(640, 480),
    };
    View { number, frame, detection: crate::document::detection::tests::example() }
}
