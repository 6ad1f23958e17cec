//! The maps that draw a camera's images through its current calibration.

use std::sync::Arc;

use crate::calibration::result::Calibration;
use crate::calibration::sensor::SensorId;
use crate::calibration::stereo_pair::{StereoPair, StereoPairError};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::SensorKind;
use crate::imaging::rectify::rectifying_maps;
use crate::imaging::registration::DepthRegistration;
use crate::imaging::remap::PixelMap;
use crate::imaging::undistort::{UndistortOptions, Undistortion};
use crate::pipeline::preview::error::PreviewError;
use crate::pipeline::preview::newest::NewestValues;
use crate::pipeline::preview::registered::Registration;
use crate::store::Store;

/// Whose images are shown undistorted, and alpha as in OpenCV: at 0, all pixels shown are valid, at
/// 1, the whole source image is visible.
pub(super) type FlatView = (SensorKind, f64);

/// The maps used last, of all cameras.
#[derive(Debug)]
pub(in crate::pipeline) struct CalibrationMaps {
    store: Arc<Store>,
    /// By calibration, camera and view; so are the rectifications.
    undistortions: NewestValues<(String, String, FlatView), PixelMap>,
    rectifications: NewestValues<(String, String, FlatView), PixelMap>,
    registrations: NewestValues<String, Registration>,
}

impl CalibrationMaps {
    pub(in crate::pipeline) fn new(store: Arc<Store>) -> Self {
        Self {
            store,
            undistortions: NewestValues::default(),
            rectifications: NewestValues::default(),
            registrations: NewestValues::default(),
        }
    }

    /// The map that undistorts a sensor's images with the current calibration of `camera` or of its
    /// rig: the first of `ids` that contains the sensor's lens.
    ///
    /// # Errors
    /// [`PreviewError::NotCalibrated`], [`PreviewError::Store`].
    pub(super) fn undistortion(
        &self,
        camera: &str,
        ids: [Option<&str>; 2],
        (sensor, alpha): FlatView,
    ) -> Result<Arc<PixelMap>, PreviewError> {
        let none = || PreviewError::NotCalibrated { camera: camera.to_owned(), sensor };
        for id in ids.into_iter().flatten() {
            let key = (id.to_owned(), camera.to_owned(), (sensor, alpha));
            let made = self.undistortions.get_or_make(&key, || {
                let calibration = self.store.calibration(id)?.ok_or_else(none)?;
                let (lens, size) = lens_of(&calibration, camera, sensor).ok_or_else(none)?;
                let options = UndistortOptions { balance: alpha, size: None };
                let undistortion = Undistortion::new(lens, size, &options);
                Ok((key.clone(), undistortion.map))
            });
            if !matches!(made, Err(PreviewError::NotCalibrated { .. })) {
                return made;
            }
        }
        Err(none())
    }

    /// The map that rectifies a sensor's images with the current calibration of the camera's rig or
    /// its own: the first of `ids` that is of a stereo pair which contains the sensor.
    ///
    /// # Errors
    /// [`PreviewError::NotStereo`], [`PreviewError::Store`].
    pub(super) fn rectification(
        &self,
        camera: &str,
        ids: [Option<&str>; 2],
        (sensor, alpha): FlatView,
    ) -> Result<Arc<PixelMap>, PreviewError> {
        let mut why = None;
        for id in ids.into_iter().flatten() {
            let key = (id.to_owned(), camera.to_owned(), (sensor, alpha));
            let refused = |reason: Option<String>| {
                let camera = camera.to_owned();
                PreviewError::NotStereo { camera, sensor, reason }
            };
            let made = self.rectifications.get_or_make(&key, || {
                let calibration = self.store.calibration(id)?.ok_or_else(|| refused(None))?;
                let stated = |error: &dyn std::fmt::Display| refused(Some(error.to_string()));
                let pair = StereoPair::of(&calibration, None).map_err(|error| match &error {
                    StereoPairError::NotTwo { known, several: true } => refused(Some(format!(
                        "it has {known}, and images are shown rectified where it has two cameras; export it as ros_stereo for two of them"
                    ))),
                    StereoPairError::NotTwo { several: false, .. } => refused(None),
                    _ => stated(&error),
                })?;
                let stereo = pair.rectify(alpha).map_err(|error| stated(&error))?;
                let is_own = |id: &SensorId| {
                    id.kind == sensor && id.camera.as_deref().is_none_or(|own| own == camera)
                };
                let at = pair.sensors.iter().position(is_own).ok_or_else(|| refused(None))?;
                let [first, second] = rectifying_maps(&pair.cameras, &stereo);
                Ok((key.clone(), if at == 0 { first } else { second }))
            });
            match made {
                Err(PreviewError::NotStereo { reason, .. }) => why = why.or(reason),
                made => return made,
            }
        }
        Err(PreviewError::NotStereo { camera: camera.to_owned(), sensor, reason: why })
    }

    /// How depth is mapped into the color image by the calibration `id`, the current one of
    /// `camera`.
    ///
    /// # Errors
    /// [`PreviewError::NotRegistered`], [`PreviewError::Store`].
    pub(super) fn registration(
        &self,
        camera: &str,
        id: Option<&str>,
    ) -> Result<Arc<Registration>, PreviewError> {
        let none = || PreviewError::NotRegistered { camera: camera.to_owned() };
        let id = id.ok_or_else(none)?.to_owned();
        self.registrations.get_or_make(&id, || {
            let calibration = self.store.calibration(&id)?.ok_or_else(none)?;
            let [color, depth] = [SensorKind::Color, SensorKind::Depth].map(SensorId::own);
            let color_from_depth =
                calibration.pose(&color, &depth).ok_or_else(none)?.target_from_source;
            let (color, depth) = calibration.color().zip(calibration.depth()).ok_or_else(none)?;
            let map = DepthRegistration::new(
                &depth.camera,
                &color.lens,
                color.image_size,
                &color_from_depth,
            );
            let registration = Registration {
                map,
                invalid: depth.invalid,
                depth_size: depth.camera.image_size,
                color_size: color.image_size,
            };
            Ok((id.clone(), registration))
        })
    }
}

/// The lens of a sensor of `camera`, by itself or in a rig, and the size of its images.
fn lens_of<'a>(
    calibration: &'a Calibration,
    camera: &str,
    sensor: SensorKind,
) -> Option<(&'a Lens, ImageSize)> {
    if sensor == SensorKind::Depth {
        let depth = &calibration.depth()?.camera;
        return Some((&depth.lens, depth.image_size));
    }
    let in_rig = || calibration.sensor(&SensorId::of(camera, sensor))?.as_image();
    let image = calibration.image(sensor).or_else(in_rig)?;
    Some((&image.lens, image.image_size))
}
