//! The same calibration for other images than it was made with, a part of them or scaled, on
//! explicit request only.

use nalgebra::DMatrix;

use crate::calibration::result::{
    CalibratedView, Calibration, Checks, ComparedLens, ImageCalibration, ProjectionUncertainty,
    SensorResult,
};
use crate::calibration::solve::uncertainty_over;
use crate::geometry::image_region::{ImageRegion, RegionError, lens_in_region};
use crate::geometry::pixel::ImageSize;

/// How the images that a calibration is wanted for come from those that it was made with.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OtherImages {
    /// The part of them that is shown, in their pixels. Default: the whole.
    pub crop: Option<ImageRegion>,
    /// What that is scaled to. Default: not scaled.
    pub size: Option<ImageSize>,
    /// The sensor whose images they are. Default: all of a calibration's, where nothing is
    /// cropped; else its only one.
    pub sensor: Option<String>,
}

/// Images that a calibration cannot be taken to.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OtherImagesError {
    /// No crop or scale explains them.
    #[error("{sensor}: {error}")]
    Region {
        /// The sensor's name.
        sensor: String,
        /// Why not.
        error: RegionError,
    },
    /// A crop is of one sensor's images.
    #[error("the calibration has several sensors, and a crop applies to one: name one of {}", .known.join(", "))]
    SeveralSensors {
        /// The names of its image sensors.
        known: Vec<String>,
    },
    /// It has no such sensor.
    #[error("the calibration has no image sensor `{name}`: name one of {}", .known.join(", "))]
    UnknownSensor {
        /// The name that was asked for.
        name: String,
        /// The names of its image sensors.
        known: Vec<String>,
    },
}

/// `calibration` for other images: the lens, and every figure that counts pixels. Poses and depth
/// stay.
///
/// # Errors
/// [`OtherImagesError`] where a sensor's images would be stretched, a crop is not inside them, or
/// it is not said whose it is.
pub fn for_other_images(
    calibration: &Calibration,
    other: &OtherImages,
) -> Result<Calibration, OtherImagesError> {
    if other.crop.is_none() && other.size.is_none() {
        return Ok(calibration.clone());
    }
    let known: Vec<String> =
        calibration.image_sensors().map(|(id, _)| calibration.name_of(id)).collect();
    match &other.sensor {
        Some(name) if !known.contains(name) => {
            return Err(OtherImagesError::UnknownSensor { name: name.clone(), known });
        }
        None if other.crop.is_some() && known.len() > 1 => {
            return Err(OtherImagesError::SeveralSensors { known });
        }
        _ => {}
    }
    let mut changed = calibration.clone();
    for sensor in &mut changed.sensors {
        let name = calibration.name_of(&sensor.id);
        if let SensorResult::Image(image) = &mut sensor.result
            && other.sensor.as_ref().is_none_or(|asked| *asked == name)
        {
            *image = sensor_for(image, other)
                .map_err(|error| OtherImagesError::Region { sensor: name, error })?;
        }
    }
    // How many pixels of the new images lie across one of the old ones: the focal length says it
    // also where a crop is scaled back to the old size. The error is the worst sensor's, which may
    // be any, so that the largest scale bounds it.
    let scales = changed.image_sensors().zip(calibration.image_sensors());
    let scales = scales.map(|((_, new), (_, old))| new.lens.matrix.fx / old.lens.matrix.fx);
    let scale = scales.reduce(f64::max).unwrap_or(1.0);
    changed.checks = Checks {
        held_out_rms_px: calibration.checks.held_out_rms_px.map(|rms| rms * scale),
        ..calibration.checks
    };
    Ok(changed)
}

fn sensor_for(
    sensor: &ImageCalibration,
    other: &OtherImages,
) -> Result<ImageCalibration, RegionError> {
    let shown = other.crop.unwrap_or(ImageRegion { left: 0, top: 0, size: sensor.image_size });
    let size = other.size.unwrap_or(shown.size);
    let lens = lens_in_region(&sensor.lens, sensor.image_size, shown, size)?;
    let across = f64::from(size.width) / f64::from(shown.size.width);
    let down = f64::from(size.height) / f64::from(shown.size.height);
    // fx, fy, cx, cy, skew count pixels; distortion coefficients do not.
    let in_pixels = [across, down, across, down, across];
    let factor = |index: usize| in_pixels.get(index).copied().unwrap_or(1.0);
    let ProjectionUncertainty { center, median, worst } = sensor.uncertainty_px;
    let covariance = sensor.lens_covariance.iter().enumerate();
    let scaled_row = |(i, row): (usize, &Vec<f64>)| {
        row.iter().enumerate().map(|(j, value)| value * factor(i) * factor(j)).collect()
    };
    let lens_covariance: Vec<Vec<f64>> = covariance.map(scaled_row).collect();
    let scaled = ProjectionUncertainty {
        center: center * across,
        median: median * across,
        worst: worst * across,
    };
    // Another part of the image has another median and another worst place.
    let uncertainty_px = if other.crop.is_some() && !lens_covariance.is_empty() {
        let count = lens_covariance.len();
        uncertainty_over(&lens, &DMatrix::from_fn(count, count, |i, j| lens_covariance[i][j]), size)
    } else {
        scaled
    };
    Ok(ImageCalibration {
        image_size: size,
        lens_std: sensor.lens_std.iter().enumerate().map(|(i, std)| std * factor(i)).collect(),
        lens_covariance,
        rms_px: sensor.rms_px * across,
        uncertainty_px,
        views: sensor.views.iter().map(|view| scaled_view(view, across)).collect(),
        compared: sensor
            .compared
            .iter()
            .map(|compared| scaled_comparison(compared, across))
            .collect(),
        board_warp_m: sensor.board_warp_m,
        board_shape: sensor.board_shape.clone(),
        rolling_shutter: sensor.rolling_shutter,
        scene: sensor.scene.clone(),
        lens,
    })
}

fn scaled_view(view: &CalibratedView, scale: f64) -> CalibratedView {
    CalibratedView { rms_px: view.rms_px.map(|rms| rms * scale), ..view.clone() }
}

fn scaled_comparison(compared: &ComparedLens, scale: f64) -> ComparedLens {
    ComparedLens { held_out_rms_px: compared.held_out_rms_px * scale, ..compared.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::calibration::tests::{example, with_infrared};

    fn scaled_to(size: ImageSize) -> OtherImages {
        OtherImages { size: Some(size), ..OtherImages::default() }
    }

    #[test]
    fn half_the_pixels_and_half_of_all_that_counts_them() {
        let whole = example();
        let sensor = whole.color().unwrap();
        let size = ImageSize::new(sensor.image_size.width / 2, sensor.image_size.height / 2);
        let half = for_other_images(&whole, &scaled_to(size)).unwrap();
        let halved = half.color().unwrap();
        assert_eq!(halved.image_size, size);
        assert!((halved.lens.matrix.fx - sensor.lens.matrix.fx / 2.0).abs() < 1e-12);
        assert!((halved.rms_px - sensor.rms_px / 2.0).abs() < 1e-12);
        assert!((halved.lens_std[0] - sensor.lens_std[0] / 2.0).abs() < 1e-12);
        assert_eq!(halved.lens_std[5..], sensor.lens_std[5..]);
        let held_out = |calibration: &Calibration| calibration.checks.held_out_rms_px.unwrap();
        assert!((held_out(&half) - held_out(&whole) / 2.0).abs() < 1e-12);
        let back = for_other_images(&half, &scaled_to(sensor.image_size)).unwrap();
        assert_eq!(back.color().unwrap().image_size, sensor.image_size);
    }

    #[test]
    fn a_part_of_the_images_sees_what_it_saw() {
        let whole = example();
        let sensor = whole.color().unwrap();
        let crop = ImageRegion { left: 40, top: 20, size: ImageSize::new(320, 240) };
        let part =
            for_other_images(&whole, &OtherImages { crop: Some(crop), ..OtherImages::default() })
                .unwrap();
        let part = part.color().unwrap();
        assert_eq!((part.image_size, part.rms_px), (crop.size, sensor.rms_px));
        assert_eq!(
            (part.lens.matrix.fx, part.lens.matrix.cx),
            (sensor.lens.matrix.fx, sensor.lens.matrix.cx - 40.0)
        );
        assert_eq!(part.lens.matrix.cy, sensor.lens.matrix.cy - 20.0);
    }

    #[test]
    fn a_crop_scaled_to_the_old_size_has_larger_errors() {
        let whole = example();
        let sensor = whole.color().unwrap();
        let crop = ImageRegion { left: 160, top: 120, size: ImageSize::new(320, 240) };
        let other = OtherImages { crop: Some(crop), size: Some(sensor.image_size), sensor: None };
        let enlarged = for_other_images(&whole, &other).unwrap();
        let larger = enlarged.color().unwrap();
        assert_eq!(larger.image_size, sensor.image_size);
        assert!((larger.rms_px - 2.0 * sensor.rms_px).abs() < 1e-12);
        let held_out = |calibration: &Calibration| calibration.checks.held_out_rms_px.unwrap();
        assert!((held_out(&enlarged) - 2.0 * held_out(&whole)).abs() < 1e-12);

        // Of one of two sensors: the error may be the one's or the other's.
        let two = with_infrared(example(), sensor);
        let of_infrared = |width: u32, height: u32| OtherImages {
            sensor: Some("infrared".to_owned()),
            ..scaled_to(ImageSize::new(width, height))
        };
        for (other, scale) in [(of_infrared(1280, 960), 2.0), (of_infrared(320, 240), 1.0)] {
            let scaled = for_other_images(&two, &other).unwrap();
            assert!((held_out(&scaled) - scale * held_out(&two)).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_not_sure_is_refused_by_name() {
        let several = with_infrared(example(), example().color().unwrap());
        let crop = ImageRegion { left: 600, top: 0, size: ImageSize::new(320, 240) };
        let table = [
            (
                several.clone(),
                OtherImages { crop: Some(crop), ..OtherImages::default() },
                "name one of color, infrared",
            ),
            (
                several.clone(),
                OtherImages {
                    sensor: Some("left".to_owned()),
                    ..scaled_to(ImageSize::new(320, 240))
                },
                "no image sensor `left`",
            ),
            (
                several,
                OtherImages { crop: Some(crop), sensor: Some("infrared".to_owned()), size: None },
                "infrared: the region 320x240 at (600, 0) is not inside",
            ),
            (
                example(),
                scaled_to(ImageSize::new(640, 360)),
                "color: 640x480 scaled to 640x360 would stretch",
            ),
        ];
        for (calibration, other, words) in table {
            let error = for_other_images(&calibration, &other).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
