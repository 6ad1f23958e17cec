//! What a device states of its own sensors, as a calibration, so that it can be exported in every
//! format.

use crate::calibration::depth_calibration::{DepthCalibration, DepthNoise};
use crate::calibration::result::{
    CalibratedSensor, Calibration, Checks, Extrinsics, Grade, ImageCalibration,
    ProjectionUncertainty, Verdict,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::target::CalibrationTarget;
use crate::geometry::depth_camera::DepthCamera;
use crate::geometry::lens::Lens;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::{FactoryCalibration, FactorySensor};
use crate::imaging::frame::SensorKind;

/// Every number as stated in `factory`; `None` if it states no lens. Standard deviations are 0 and
/// uncertainties infinite, since nothing was measured. `created_at_ns` is the time of the request.
pub fn stated_calibration(
    factory: &FactoryCalibration,
    camera: &str,
    created_at_ns: i64,
) -> Option<Calibration> {
    let sensors: Vec<CalibratedSensor> =
        SensorKind::ALL.into_iter().filter_map(|kind| sensor(factory, kind)).collect();
    if sensors.is_empty() {
        return None;
    }
    let extrinsics = |stated: &FactorySensor| {
        (stated.sensor != SensorKind::Color).then_some(Extrinsics {
            target: SensorId::own(SensorKind::Color),
            source: SensorId::own(stated.sensor),
            target_from_source: stated.color_from_sensor?,
            rotation_std: [0.0; 3],
            translation_std_m: [0.0; 3],
        })
    };
    let mut reasons = vec![
        "factory calibration as stated by the device, not measured: run a session with a board to check it"
            .to_owned(),
    ];
    reasons.extend(factory.sensors.iter().filter(|stated| stated.lens.is_none()).map(left_out));
    if factory.sensor(SensorKind::Depth).is_some_and(|depth| depth.lens.is_some()) {
        reasons.extend(assumed_reading(factory.depth_encoding));
    }
    let verdict = Verdict { grade: Grade::Usable, reasons };
    Some(Calibration {
        id: "factory".to_owned(),
        camera: Some(camera.to_owned()),
        created_at_ns,
        extrinsics: factory.sensors.iter().filter_map(extrinsics).collect(),
        ..Calibration::unnamed(None::<CalibrationTarget>, sensors, Checks::default(), verdict)
    })
}

/// What the device does not state about depth readings, in words.
fn assumed_reading(stated: Option<DepthEncoding>) -> Option<String> {
    match stated {
        None => {
            Some("the device does not state its depth unit: millimeters are assumed".to_owned())
        }
        Some(DepthEncoding { reading: None, .. }) => Some(
            "depth is left out: the device does not state what its disparities mean".to_owned(),
        ),
        Some(_) => None,
    }
}

/// The sensor as stated; `None` without a lens, or for disparity of unknown meaning. If the meaning
/// of depth readings is not stated, millimeters are assumed, as in sessions.
fn sensor(factory: &FactoryCalibration, kind: SensorKind) -> Option<CalibratedSensor> {
    let stated = factory.sensor(kind)?;
    let lens = stated.lens?;
    match kind {
        SensorKind::Depth => {
            let encoding = factory.depth_encoding.unwrap_or(DepthEncoding::ORDINARY);
            Some(CalibratedSensor::depth(None, depth_sensor(stated, lens, encoding)?))
        }
        kind => Some(CalibratedSensor::image(SensorId::own(kind), image_sensor(stated, lens))),
    }
}

fn left_out(stated: &FactorySensor) -> String {
    format!(
        "{} is left out: none of Plumb's lens models is equivalent to the device's {} with coefficients {:?}",
        stated.sensor.name(),
        stated.stated.model,
        stated.stated.coefficients
    )
}

fn image_sensor(stated: &FactorySensor, lens: Lens) -> ImageCalibration {
    let unknown = f64::INFINITY;
    ImageCalibration {
        image_size: stated.image_size,
        lens,
        lens_std: vec![0.0; lens.parameters().len()],
        lens_covariance: Vec::new(),
        rms_px: 0.0,
        uncertainty_px: ProjectionUncertainty { center: unknown, median: unknown, worst: unknown },
        views: Vec::new(),
        compared: Vec::new(),
        board_warp_m: None,
        board_shape: None,
        rolling_shutter: None,
        scene: None,
    }
}

fn depth_sensor(
    stated: &FactorySensor,
    lens: Lens,
    encoding: DepthEncoding,
) -> Option<DepthCalibration> {
    let reading = encoding.reading?;
    Some(DepthCalibration {
        camera: DepthCamera { image_size: stated.image_size, lens, reading, correction: None },
        invalid: encoding.invalid,
        lens_std: vec![0.0; lens.parameters().len()],
        bias: Vec::new(),
        noise: DepthNoise::default(),
        time_offset: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::depth_camera::DepthReading;
    use crate::geometry::pixel::ImageSize;
    use crate::geometry::pose::Pose;
    use crate::imaging::factory::StatedLens;

    fn stated(sensor: SensorKind, fx: f64, lens: bool) -> FactorySensor {
        let matrix = CameraMatrix { fx, fy: fx, cx: 320.5, cy: 240.25, skew: 0.0 };
        FactorySensor {
            sensor,
            image_size: ImageSize::new(640, 480),
            stated: StatedLens {
                model: "BrownConradyInverse".to_owned(),
                focal_px: [fx; 2],
                principal_px: [320.5, 240.25],
                coefficients: vec![0.1; 5],
            },
            lens: lens.then(|| Lens::pinhole(matrix)),
            color_from_sensor: Some(Pose::from_axis_angle(
                [0.0, 0.01, 0.0].into(),
                [0.015, 0.0, 0.001].into(),
            )),
        }
    }

    #[test]
    fn every_number_is_as_stated() {
        let [color, depth] =
            [stated(SensorKind::Color, 612.5, true), stated(SensorKind::Depth, 385.25, true)];
        let infrared = stated(SensorKind::Infrared, 385.25, false);
        let sensors = vec![color.clone(), infrared, depth.clone()];
        let depth_encoding = Some(DepthEncoding::ORDINARY);
        let factory = FactoryCalibration { sensors, depth_encoding };
        let calibration = stated_calibration(&factory, "front", 7).unwrap();
        assert_eq!(calibration.color().map(|sensor| sensor.lens), color.lens);
        let camera = calibration.depth().unwrap().camera.clone();
        assert_eq!(
            (Some(camera.lens), camera.reading),
            (depth.lens, DepthReading::Metric { unit_m: 0.001 })
        );
        assert_eq!(calibration.image(SensorKind::Infrared), None);
        let sources: Vec<SensorKind> =
            calibration.extrinsics.iter().map(|one| one.source.kind).collect();
        assert_eq!(sources, [SensorKind::Infrared, SensorKind::Depth]);
        assert_eq!(Some(calibration.extrinsics[1].target_from_source), depth.color_from_sensor);
        let reasons = calibration.verdict.reasons.join("\n");
        assert!(
            reasons.contains("not measured") && reasons.contains("infrared is left out"),
            "{reasons}"
        );
    }

    #[test]
    fn depth_whose_readings_are_not_stated_is_in_millimeters() {
        let of = |depth_encoding| {
            let sensors = vec![stated(SensorKind::Depth, 385.25, true)];
            stated_calibration(&FactoryCalibration { sensors, depth_encoding }, "front", 7)
        };
        let assumed = of(None).unwrap();
        let reading = assumed.depth().unwrap().camera.reading;
        assert_eq!(reading, DepthReading::Metric { unit_m: 0.001 });
        assert!(assumed.verdict.reasons[1].contains("millimeters are assumed"));
        let known = of(Some(DepthEncoding::ORDINARY)).unwrap();
        assert_eq!(known.verdict.reasons.len(), 1);
        assert_eq!(of(Some(DepthEncoding { reading: None, invalid: None })), None);
    }

    #[test]
    fn nothing_is_made_of_nothing() {
        let only = |one| FactoryCalibration { sensors: vec![one], depth_encoding: None };
        assert_eq!(stated_calibration(&FactoryCalibration::default(), "front", 7), None);
        assert_eq!(
            stated_calibration(&only(stated(SensorKind::Color, 600.0, false)), "front", 7),
            None
        );
    }
}
