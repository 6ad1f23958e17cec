//! What a camera sees, as JPEG: each frame is drawn and encoded once for each kind of drawing,
//! however many clients watch it, and only while there is one.

pub mod drawing;
pub mod error;
pub(super) mod maps;
mod newest;
mod registered;

use std::sync::{Arc, Mutex, Weak};

use tokio::sync::watch;

use crate::calibration::scene::correspondence::SceneImage;
use crate::geometry::pixel::Pixel;
use crate::imaging::frame::SensorKind;
use crate::locks::lock;
use crate::pipeline::frame_slot::FrameSlot;
use crate::pipeline::live_frame::LiveFrame;
use crate::pipeline::preview::drawing::{Drawing, DrawnScene, EncodedFrame, encoded};
use crate::pipeline::preview::error::PreviewError;
use crate::pipeline::preview::maps::CalibrationMaps;

/// The newest encoded frame, as it changes; `None` before the first.
pub type PreviewReceiver = watch::Receiver<Option<EncodedFrame>>;

/// How many drawings of the newest frame are kept for further requests of the same drawing.
const KEPT_DRAWINGS: usize = 8;

/// The previews of one camera.
#[derive(Debug)]
pub(super) struct Preview {
    maps: Arc<CalibrationMaps>,
    /// Frames on their way to the clients: a newer one replaces an older.
    pub(super) slot: FrameSlot<Arc<LiveFrame>>,
    watched: Mutex<Vec<WatchedDrawing>>,
    drawn: Mutex<Vec<DrawnFrame>>,
}

/// A drawing that a client watches.
#[derive(Debug)]
struct WatchedDrawing {
    drawing: Drawing,
    frames: watch::Sender<Option<EncodedFrame>>,
    /// The frame that was shown last.
    shown: Weak<LiveFrame>,
}

/// A drawing of the newest frame.
#[derive(Debug)]
struct DrawnFrame {
    of: Weak<LiveFrame>,
    drawing: Drawing,
    state: PreviewState,
    jpeg: EncodedFrame,
}

/// What the preview of a camera depends on besides its frames.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PreviewState {
    pub(super) camera: String,
    /// The sensors that have given an image since the camera came.
    pub(super) sensors: Vec<SensorKind>,
    /// The id of the current calibration.
    pub(super) calibration: Option<String>,
    /// The id of the current calibration of its rig.
    pub(super) rig_calibration: Option<String>,
    /// The outline of the board at its suggested pose.
    pub(super) outline_px: Vec<Pixel>,
    /// The last key frame of a session without a target.
    pub(super) key_frame: Option<SceneImage>,
}

impl Preview {
    pub(super) fn new(maps: Arc<CalibrationMaps>) -> Self {
        Self { maps, slot: FrameSlot::new(), watched: Mutex::default(), drawn: Mutex::default() }
    }

    /// Watches a drawing from now on, beginning with `newest`.
    pub(super) fn watch(
        &self,
        drawing: Drawing,
        newest: Option<Arc<LiveFrame>>,
    ) -> PreviewReceiver {
        let mut frames = {
            let mut watched = lock(&self.watched);
            watched.retain(WatchedDrawing::is_watched);
            if let Some(known) = watched.iter().find(|known| known.drawing == drawing) {
                known.frames.subscribe()
            } else {
                let (frames, receiver) = watch::channel(None);
                watched.push(WatchedDrawing { drawing, frames, shown: Weak::new() });
                receiver
            }
        };
        if frames.borrow().is_some() {
            frames.mark_changed();
        } else if let Some(newest) = newest {
            // A closed slot belongs to a camera that is being stopped.
            let _ = self.slot.put_newest(newest);
        }
        frames
    }

    /// Offers a frame to the clients. Returns whether it replaced one that was not drawn yet.
    pub(super) fn offer(&self, live: &Arc<LiveFrame>) -> bool {
        let mut watched = lock(&self.watched);
        watched.retain(WatchedDrawing::is_watched);
        let is_watched = !watched.is_empty();
        drop(watched);
        is_watched && matches!(self.slot.put_newest(Arc::clone(live)), Ok(Some(_)))
    }

    /// Shows `live` in every drawing that is watched. Returns how many drawings were made for it.
    pub(super) fn show(&self, live: &Arc<LiveFrame>, state: &PreviewState) -> u64 {
        let mut drawn = 0;
        let is_wanted = |known: &&WatchedDrawing| known.is_watched() && !is_of(&known.shown, live);
        let wanted: Vec<Drawing> =
            lock(&self.watched).iter().filter(is_wanted).map(|known| known.drawing).collect();
        for drawing in wanted {
            let encoded = match self.encoded(live, drawing, state) {
                Ok((encoded, was_drawn)) => {
                    drawn += u64::from(was_drawn);
                    encoded
                }
                Err(error) => {
                    tracing::debug!(camera = state.camera, "no preview: {error}");
                    continue;
                }
            };
            let mut watched = lock(&self.watched);
            if let Some(known) = watched.iter_mut().find(|known| known.drawing == drawing) {
                known.shown = Arc::downgrade(live);
                known.frames.send_replace(Some(encoded));
            }
        }
        drawn
    }

    /// One drawing of a frame, and whether it was made for this call.
    ///
    /// # Errors
    /// [`PreviewError`].
    pub(super) fn encoded(
        &self,
        live: &Arc<LiveFrame>,
        drawing: Drawing,
        state: &PreviewState,
    ) -> Result<(EncodedFrame, bool), PreviewError> {
        // Locked while drawing: a request for the same drawing meanwhile gets this one.
        let mut drawn = lock(&self.drawn);
        let is_same = |known: &&DrawnFrame| {
            is_of(&known.of, live) && known.drawing == drawing && known.state == *state
        };
        if let Some(known) = drawn.iter().find(is_same) {
            return Ok((Arc::clone(&known.jpeg), false));
        }
        let scene = DrawnScene {
            camera: &state.camera,
            sensors: &state.sensors,
            calibration: state.calibration.as_deref(),
            rig_calibration: state.rig_calibration.as_deref(),
            outline_px: &state.outline_px,
            key_frame: state.key_frame.as_ref(),
        };
        let jpeg = encoded(live, drawing, &scene, &self.maps)?;
        drawn.retain(|known| is_of(&known.of, live));
        if drawn.len() == KEPT_DRAWINGS {
            drawn.remove(0);
        }
        drawn.push(DrawnFrame {
            of: Arc::downgrade(live),
            drawing,
            state: state.clone(),
            jpeg: Arc::clone(&jpeg),
        });
        Ok((jpeg, true))
    }
}

impl WatchedDrawing {
    fn is_watched(&self) -> bool {
        self.frames.receiver_count() > 0
    }
}

fn is_of(frame: &Weak<LiveFrame>, live: &Arc<LiveFrame>) -> bool {
    std::ptr::eq(frame.as_ptr(), Arc::as_ptr(live))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::depth_calibration::{DepthCalibration, DepthNoise};
    use crate::calibration::result::CalibratedSensor;
    use crate::geometry::depth_camera::{DepthCamera, DepthReading};
    use crate::geometry::lens::{Lens, LensModel};
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::frame::{Frame, FrameSet, PixelFormat};
    use crate::imaging::timestamp::HostTime;
    use crate::store::Store;

    const DRAWING: Drawing = Drawing {
        sensor: SensorKind::Color,
        overlay: true,
        guidance: true,
        undistorted: false,
        rectified: false,
        alpha: 0.0,
        registered: false,
    };

    fn preview(folder: &tempfile::TempDir) -> Preview {
        let store = Arc::new(Store::open(folder.path()).unwrap());
        Preview::new(Arc::new(CalibrationMaps::new(store)))
    }

    fn live(sequence: u64) -> Arc<LiveFrame> {
        let frame = Frame {
            sensor: SensorKind::Color,
            size: ImageSize::new(64, 48),
            format: PixelFormat::Mono8,
            stride: 64,
            bytes: vec![sequence as u8; 64 * 48].into(),
        };
        let host_time = HostTime { utc_ns: 0 };
        let frame_set =
            FrameSet { sequence, host_time, device_time: None, name: None, frames: vec![frame] };
        Arc::new(LiveFrame { frame_set: Arc::new(frame_set), detection: None })
    }

    fn state() -> PreviewState {
        PreviewState {
            camera: "front".into(),
            sensors: vec![SensorKind::Color],
            calibration: None,
            rig_calibration: None,
            outline_px: Vec::new(),
            key_frame: None,
        }
    }

    #[test]
    fn ten_who_watch_cost_what_one_costs() {
        let folder = tempfile::tempdir().unwrap();
        let preview = preview(&folder);
        let mut receivers: Vec<PreviewReceiver> =
            (0..10).map(|_| preview.watch(DRAWING, None)).collect();
        let mut drawn = 0;
        for sequence in 0..5 {
            let live = live(sequence);
            drawn += preview.show(&live, &state());
            let shown: Vec<EncodedFrame> =
                receivers.iter_mut().map(|r| r.borrow_and_update().clone().unwrap()).collect();
            assert!(shown.iter().all(|jpeg| Arc::ptr_eq(jpeg, &shown[0])));
            // An image of the same frame is the same, and another drawing of it another.
            let (again, was_drawn) = preview.encoded(&live, DRAWING, &state()).unwrap();
            assert!(Arc::ptr_eq(&again, &shown[0]) && !was_drawn);
            let outline_px = vec![Pixel::new(5.0, 5.0), Pixel::new(40.0, 30.0)];
            let guided = PreviewState { outline_px, ..state() };
            assert!(preview.encoded(&live, DRAWING, &guided).unwrap().1);
        }
        assert_eq!(drawn, 5);
    }

    #[test]
    fn nothing_is_drawn_while_nobody_watches_and_the_newest_is_shown_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let preview = preview(&folder);
        let (first, second) = (live(1), live(2));
        assert!(!preview.offer(&first));
        assert_eq!(preview.show(&first, &state()), 0);

        let mut early = preview.watch(DRAWING, Some(Arc::clone(&first)));
        let offered = preview.slot.take().unwrap();
        assert!(Arc::ptr_eq(&offered, &first));
        assert_eq!(preview.show(&offered, &state()), 1);
        assert!(early.has_changed().unwrap() && early.borrow_and_update().is_some());
        let late = preview.watch(DRAWING, Some(first));
        assert!(late.has_changed().unwrap(), "what the others see is shown at once");

        assert!(!preview.offer(&second));
        assert!(preview.offer(&second), "the one before was not drawn yet");
        drop((early, late));
        assert_eq!(preview.show(&second, &state()), 0);
    }

    #[test]
    fn depth_is_undistorted_through_its_own_lens() {
        let folder = tempfile::tempdir().unwrap();
        let store = Arc::new(Store::open(folder.path()).unwrap());
        let preview = Preview::new(Arc::new(CalibrationMaps::new(Arc::clone(&store))));
        let size = ImageSize::new(64, 48);
        let lens = [40.0, 40.0, 31.5, 23.5, 0.0, -0.2];
        let depth = DepthCalibration {
            camera: DepthCamera {
                image_size: size,
                lens: Lens::from_parameters(LensModel::Radial, &lens).unwrap(),
                reading: DepthReading::Metric { unit_m: 1e-3 },
                correction: None,
            },
            invalid: None,
            lens_std: vec![0.0; lens.len()],
            bias: Vec::new(),
            noise: DepthNoise { constant_m: 0.0, quadratic_per_m: 0.0 },
            time_offset: None,
        };
        let mut calibration = crate::document::calibration::tests::example();
        calibration.add_sensor(CalibratedSensor::depth(None, depth));
        store.append_calibration(&calibration).unwrap();

        let readings = (0..64 * 48).flat_map(|k| (500 + 80 * (k % 64) as u16).to_le_bytes());
        let frame = Frame {
            sensor: SensorKind::Depth,
            size,
            format: PixelFormat::Depth16,
            stride: 128,
            bytes: readings.collect::<Vec<u8>>().into(),
        };
        let host_time = HostTime { utc_ns: 0 };
        let frame_set =
            FrameSet { sequence: 0, host_time, device_time: None, name: None, frames: vec![frame] };
        let live = Arc::new(LiveFrame { frame_set: Arc::new(frame_set), detection: None });
        let state = PreviewState { calibration: Some(calibration.id), ..state() };
        let plain = Drawing { sensor: SensorKind::Depth, ..DRAWING };
        let drawn = |drawing: Drawing| {
            let (jpeg, _) = preview.encoded(&live, drawing, &state).unwrap();
            let image = image::load_from_memory(&jpeg).unwrap().into_rgb8();
            assert_eq!(image.dimensions(), (64, 48));
            image
        };
        assert_ne!(drawn(plain), drawn(Drawing { undistorted: true, alpha: 1.0, ..plain }));
    }

    #[test]
    fn an_image_that_only_the_newest_frames_lack_is_asked_for_again() {
        let folder = tempfile::tempdir().unwrap();
        let preview = preview(&folder);
        let sensors = vec![SensorKind::Color, SensorKind::Depth];
        let state = PreviewState { sensors, ..state() };
        let drawing = Drawing { sensor: SensorKind::Depth, ..DRAWING };
        let error = preview.encoded(&live(0), drawing, &state).unwrap_err();
        assert!(error.is_of_one_frame(), "the preview goes on");
        assert_eq!(
            error.to_string(),
            "the newest frames have no depth image; ask again in a moment"
        );
    }

    #[test]
    fn what_cannot_be_shown_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let preview = preview(&folder);
        let refusal = |drawing: Drawing| {
            preview.encoded(&live(0), drawing, &state()).unwrap_err().to_string()
        };
        let depth = refusal(Drawing { sensor: SensorKind::Depth, ..DRAWING });
        assert_eq!(
            depth,
            "camera `front` has given no depth image so far; see its sensors at GET /v1/cameras/front"
        );
        let undistorted = refusal(Drawing { undistorted: true, ..DRAWING });
        assert!(undistorted.contains("no approved calibration of color"), "{undistorted}");
        let rectified = refusal(Drawing { rectified: true, ..DRAWING });
        assert!(
            rectified.contains("no calibration of two cameras with it is approved"),
            "{rectified}"
        );
        let registered = refusal(Drawing { registered: true, ..DRAWING });
        assert!(registered.contains("color and depth to register"), "{registered}");
    }
}
