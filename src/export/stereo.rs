//! Two cameras rectified together: their `camera_info` for ROS, and the matrices of OpenCV's stereo
//! calibration sample.

use nalgebra::{Matrix3, Matrix3x4, Matrix4};

use crate::calibration::result::Calibration;
use crate::calibration::stereo_pair::StereoPair;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::opencv::{coefficients, matrix};
use crate::export::sensors::{self, Sensor, without_skew};
use crate::export::{ExportError, ExportOptions, ExportedFile, Format, ros};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::rectification::StereoRectification;

pub(super) const ROS: FormatFacts = FormatFacts {
    name: "ros_stereo",
    description: "ROS camera_info YAML of two cameras, rectified",
    media_type: "application/yaml",
    file_name: FileName::WithSuffix("-stereo.yaml"),
    holds_all: false,
    write: write_ros,
};

pub(super) const OPENCV: FormatFacts = FormatFacts {
    name: "opencv_stereo",
    description: "OpenCV FileStorage YAML of two cameras, rectified",
    media_type: "application/yaml",
    file_name: FileName::WithSuffix("-opencv-stereo.yaml"),
    holds_all: false,
    write: write_opencv,
};

/// A pair with its rectification, the left camera first.
struct RectifiedPair<'a> {
    pair: StereoPair,
    stereo: StereoRectification,
    sensors: [Sensor<'a>; 2],
}

/// A `camera_info` YAML file for each camera, the left one's first, and both as one text of two
/// YAML documents.
fn write_ros(calibration: &Calibration, options: &ExportOptions) -> Result<Formatted, ExportError> {
    let camera = camera_name(calibration);
    let of = rectified_pair(calibration, Format::RosStereo, options)?;
    let mut files = Vec::new();
    for (sensor, rectified) in of.sensors.iter().zip(&of.stereo.cameras) {
        let name = sensor.frame_name(camera);
        let text = ros::camera_info(&name, sensor, rectified)?;
        let file_name = ros::FACTS.file_name.of(&name);
        files.push(ExportedFile { file_name, bytes: text.into_bytes() });
    }
    let documents: Vec<_> = files.iter().map(|file| String::from_utf8_lossy(&file.bytes)).collect();
    let text = documents.join("---\n");
    Ok(Formatted { text, files, of: camera.to_owned(), note: None })
}

fn write_opencv(
    calibration: &Calibration,
    options: &ExportOptions,
) -> Result<Formatted, ExportError> {
    let text = opencv_matrices(calibration, options)?;
    Ok(Formatted::one_file(camera_name(calibration), text, None))
}

/// `cv::FileStorage` with the names of OpenCV's sample `stereo_calib`: M1, D1, M2, D2, R, T, R1,
/// R2, P1, P2, Q; 1 is the left camera.
fn opencv_matrices(
    calibration: &Calibration,
    options: &ExportOptions,
) -> Result<String, ExportError> {
    let format = Format::OpencvStereo;
    let of = rectified_pair(calibration, format, options)?;
    let size = of.stereo.image_size;
    let [first, second] = &of.sensors;
    let (first_fisheye, first_coefficients) = coefficients(first.lens, format)?;
    let (second_fisheye, second_coefficients) = coefficients(second.lens, format)?;
    if first_fisheye != second_fisheye {
        return Err(ExportError::StereoModels {
            format,
            models: [first, second].map(|s| s.lens.model()),
        });
    }
    let k = |sensor: &Sensor<'_>| {
        let CameraMatrix { fx, fy, cx, cy, .. } = sensor.lens.matrix;
        [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    };
    let pose = &of.pair.second_from_first;
    let [left, right] = &of.stereo.cameras;
    let mut text = format!(
        "%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\nfisheye_model: {}\n",
        size.width,
        size.height,
        i32::from(first_fisheye)
    );
    let each: [(&str, usize, Vec<f64>); 11] = [
        ("M1", 3, k(first).to_vec()),
        ("D1", first_coefficients.len(), first_coefficients),
        ("M2", 3, k(second).to_vec()),
        ("D2", second_coefficients.len(), second_coefficients),
        ("R", 3, square(&pose.rotation_matrix())),
        ("T", 3, pose.translation().as_slice().to_vec()),
        ("R1", 3, square(&left.rectified_from_camera)),
        ("R2", 3, square(&right.rectified_from_camera)),
        ("P1", 3, wide(&left.projection)),
        ("P2", 3, wide(&right.projection)),
        ("Q", 4, whole(&of.stereo.point_from_disparity())),
    ];
    for (name, rows, values) in &each {
        text += &matrix(name, *rows, values);
    }
    Ok(text)
}

fn rectified_pair<'a>(
    calibration: &'a Calibration,
    format: Format,
    options: &ExportOptions,
) -> Result<RectifiedPair<'a>, ExportError> {
    let names = |asked: &str| {
        let two = asked.split_once(',').map(|(a, b)| [a.trim().to_owned(), b.trim().to_owned()]);
        two.ok_or_else(|| ExportError::StereoNames { format, asked: asked.to_owned() })
    };
    let asked = options.sensor.as_deref().map(names).transpose()?;
    let asked = asked.as_ref().map(|names| names.each_ref().map(String::as_str));
    let in_asked_order = StereoPair::of(calibration, asked)?;
    let first_asked = in_asked_order.sensors[0].clone();
    let (pair, stereo) = in_asked_order.left_first(options.alpha)?;
    if asked.is_some() && pair.sensors[0] != first_asked {
        let [first, second] = pair.names;
        let is_vertical = stereo.axis.coordinate() != 0;
        return Err(ExportError::StereoOrder { format, first, second, is_vertical });
    }
    let [first, second] = pair.cameras.map(|camera| camera.image_size);
    if first != second {
        return Err(ExportError::StereoSizes { format, sizes: [first, second] });
    }
    let all = sensors::all(calibration);
    let sensor = |k: usize| {
        let found = all.iter().find(|sensor| *sensor.id == pair.sensors[k]).cloned();
        found.ok_or(ExportError::NoSensor { format })
    };
    let sensors = [sensor(0)?, sensor(1)?];
    for sensor in &sensors {
        without_skew(sensor, format)?;
    }
    Ok(RectifiedPair { pair, stereo, sensors })
}

/// Row by row.
fn square(m: &Matrix3<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

fn wide(m: &Matrix3x4<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

fn whole(m: &Matrix4<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}
