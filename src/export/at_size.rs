//! The same calibration for pictures of another size, on explicit request only.

use crate::calibration::calibration::{
    CalibratedView, Calibration, Checks, ComparedLens, ProjectionUncertainty, RigCamera, SensorCalibration,
};
use crate::geometry::image_region::{RegionError, lens_at_size};
use crate::geometry::pixel::ImageSize;

/// `calibration` for pictures that are scaled to `size`: the lens, and every figure that counts pixels. Poses stay.
///
/// # Errors
/// [`RegionError`] when a sensor's pictures would be stretched.
pub fn at_size(calibration: &Calibration, size: ImageSize) -> Result<Calibration, RegionError> {
    let resized = |sensor: &Option<SensorCalibration>| sensor.as_ref().map(|s| sensor_at_size(s, size)).transpose();
    let picture = calibration.picture_sensors().next().map(|(_, sensor)| sensor);
    let camera =
        |camera: &RigCamera| Ok(RigCamera { name: camera.name.clone(), sensor: sensor_at_size(&camera.sensor, size)? });
    let scale = picture.map_or(1.0, |sensor| f64::from(size.width) / f64::from(sensor.image_size.width));
    let held_out_rms_px = calibration.checks.held_out_rms_px.map(|rms| rms * scale);
    Ok(Calibration {
        color: resized(&calibration.color)?,
        infrared: resized(&calibration.infrared)?,
        infrared2: resized(&calibration.infrared2)?,
        cameras: calibration.cameras.iter().map(camera).collect::<Result<_, RegionError>>()?,
        checks: Checks { held_out_rms_px, ..calibration.checks },
        ..calibration.clone()
    })
}

fn sensor_at_size(sensor: &SensorCalibration, size: ImageSize) -> Result<SensorCalibration, RegionError> {
    let lens = lens_at_size(&sensor.lens, sensor.image_size, size)?;
    let across = f64::from(size.width) / f64::from(sensor.image_size.width);
    let down = f64::from(size.height) / f64::from(sensor.image_size.height);
    // fx, fy, cx, cy, skew count pixels; distortion coefficients do not.
    let in_pixels = [across, down, across, down, across];
    let factor = |index: usize| in_pixels.get(index).copied().unwrap_or(1.0);
    let ProjectionUncertainty { center, median, worst } = sensor.uncertainty_px;
    let covariance = sensor.lens_covariance.iter().enumerate();
    let scaled_row =
        |(i, row): (usize, &Vec<f64>)| row.iter().enumerate().map(|(j, value)| value * factor(i) * factor(j)).collect();
    Ok(SensorCalibration {
        image_size: size,
        lens_std: sensor.lens_std.iter().enumerate().map(|(i, std)| std * factor(i)).collect(),
        lens_covariance: covariance.map(scaled_row).collect(),
        rms_px: sensor.rms_px * across,
        uncertainty_px: ProjectionUncertainty {
            center: center * across,
            median: median * across,
            worst: worst * across,
        },
        views: sensor.views.iter().map(|view| scaled_view(view, across)).collect(),
        compared: sensor.compared.iter().map(|compared| scaled_comparison(compared, across)).collect(),
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
    use crate::document::calibration::tests::example;

    #[test]
    fn half_the_pixels_and_half_of_all_that_counts_them() {
        let whole = example();
        let sensor = whole.color.as_ref().unwrap();
        let size = ImageSize::new(sensor.image_size.width / 2, sensor.image_size.height / 2);
        let half = at_size(&whole, size).unwrap();
        let halved = half.color.as_ref().unwrap();
        assert_eq!(halved.image_size, size);
        assert!((halved.lens.matrix.fx - sensor.lens.matrix.fx / 2.0).abs() < 1e-12);
        assert!((halved.rms_px - sensor.rms_px / 2.0).abs() < 1e-12);
        assert!((halved.lens_std[0] - sensor.lens_std[0] / 2.0).abs() < 1e-12);
        assert_eq!(halved.lens_std[5..], sensor.lens_std[5..]);
        assert_eq!(at_size(&half, sensor.image_size).unwrap().color.unwrap().image_size, sensor.image_size);
    }

    #[test]
    fn another_shape_is_refused() {
        assert!(at_size(&example(), ImageSize::new(640, 360)).is_err());
    }
}
