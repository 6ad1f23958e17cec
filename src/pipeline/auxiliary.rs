//! What the other sensors of a camera delivered with its kept views: their boards, and depth as it
//! was decoded when the view was kept. Depth is read from the store only after a restart, or where
//! there is more of it than may stay in memory.

use std::sync::Arc;

use crate::calibration::sensor::SensorId;
use crate::detection::board_detection::Detection;
use crate::geometry::pixel::ImageSize;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::SensorKind;
use crate::imaging::image_file::frame_from_file;
use crate::pipeline::seen::SensorObservation;
use crate::store::{SensorView, Store, StoreError};

/// The most depth of one session that stays in memory, in bytes: 150 views, the most that a session
/// keeps of a camera, of 848 × 480 readings.
const MOST_DEPTH_BYTES: usize = 128 << 20;

/// What another sensor delivered with a kept view.
#[derive(Debug, Clone)]
pub(super) struct AuxiliaryView {
    /// The kept view's number in its session.
    pub(super) number: u32,
    pub(super) sensor: SensorKind,
    pub(super) image_size: ImageSize,
    /// The encoding of the depth readings, where the device states it.
    pub(super) depth_encoding: Option<DepthEncoding>,
    /// The board in it, where it was found.
    pub(super) detection: Option<Detection>,
    /// The depth image, unless it has to be read from the store.
    pub(super) depth: Option<Arc<DepthImage>>,
    /// Where it is stored.
    frame_set: u32,
    camera: Option<String>,
}

/// All auxiliary views of a session.
#[derive(Debug, Default)]
pub(super) struct AuxiliaryViews {
    views: Vec<AuxiliaryView>,
    depth_bytes: usize,
}

impl AuxiliaryViews {
    /// The stored auxiliary views of a session, without depth.
    pub(super) fn of_stored(stored: &[SensorView]) -> Self {
        let view = |view: &SensorView| {
            let is_numbered = |other: &&SensorView| {
                other.number.is_some()
                    && other.frame_set == view.frame_set
                    && other.sensor.camera == view.sensor.camera
            };
            Some(AuxiliaryView {
                number: stored.iter().find(is_numbered)?.number?,
                sensor: view.sensor.kind,
                image_size: view.frame.image_size,
                depth_encoding: view.depth_encoding,
                detection: view.detection.clone(),
                depth: None,
                frame_set: view.frame_set,
                camera: view.sensor.camera.clone(),
            })
        };
        let others = stored.iter().filter(|view| view.number.is_none());
        Self { views: others.filter_map(view).collect(), depth_bytes: 0 }
    }

    /// Adds what a sensor delivered with the view `number`, which is stored as `frame_set` of
    /// `camera`.
    pub(super) fn add(
        &mut self,
        number: u32,
        frame_set: u32,
        camera: Option<&str>,
        observation: &SensorObservation,
    ) {
        let bytes = observation.depth.as_ref().map_or(0, |depth| 2 * depth.readings().len());
        let fits = self.depth_bytes + bytes <= MOST_DEPTH_BYTES;
        self.depth_bytes += if fits { bytes } else { 0 };
        self.views.push(AuxiliaryView {
            number,
            sensor: observation.sensor,
            image_size: observation.image_size,
            depth_encoding: observation.depth_encoding,
            detection: observation.detection.clone(),
            depth: observation.depth.clone().filter(|_| fits),
            frame_set,
            camera: camera.map(str::to_owned),
        });
    }

    pub(super) fn views(&self) -> &[AuxiliaryView] {
        &self.views
    }

    /// The size of the depth in memory, in bytes.
    pub(super) fn depth_bytes(&self) -> usize {
        self.depth_bytes
    }

    /// Reads the depth that is not in memory from the store. A view whose depth cannot be decoded
    /// has none.
    ///
    /// # Errors
    /// [`StoreError`].
    pub(super) fn complete(&mut self, store: &Store, session: &str) -> Result<(), StoreError> {
        let is_open =
            |view: &&mut AuxiliaryView| view.sensor == SensorKind::Depth && view.depth.is_none();
        for view in self.views.iter_mut().filter(is_open) {
            let sensor = SensorId { camera: view.camera.clone(), kind: view.sensor };
            let image = store.sensor_picture(session, view.frame_set, &sensor)?;
            let frame = image.map(|image| frame_from_file(view.sensor, image.bytes));
            view.depth = frame.and_then(|f| DepthImage::from_frame(&f).ok()).map(Arc::new);
        }
        Ok(())
    }
}
