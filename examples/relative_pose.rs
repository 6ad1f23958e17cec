//! From matches between two images to the fundamental matrix, the relative pose and the points,
//! some of the matches wrong.
//!
//! ```text
//! cargo run --example relative_pose -- matches.jsonl
//! ```
//!
//! Each line of the file is one pair of images and gives one line of answer; lengths are in units
//! of the distance between the cameras. Without a file a pair is simulated.
//!
//! ```text
//! {"image_size": [1280, 960], "camera": [fx, fy, cx, cy], "matches": [[x1, y1, x2, y2], …]}
//! ```

#![allow(clippy::print_stdout, reason = "it is what the program is for")]

use std::error::Error;

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use plumb::estimation::two_view::PointPair;
use plumb::estimation::two_view::calibrated::{CalibratedPair, relative_pose};
use plumb::estimation::two_view::degeneracy::two_view_geometry;
use plumb::estimation::two_view::triangulation::triangulate_pair;
use plumb::geometry::camera_matrix::CameraMatrix;
use plumb::geometry::pixel::ImageSize;
use plumb::geometry::pose::Pose;
use serde::{Deserialize, Serialize};

#[derive(Deserialize, Serialize)]
struct Given {
    image_size: [u32; 2],
    /// fx, fy, cx, cy of both cameras.
    camera: [f64; 4],
    matches: Vec<[f64; 4]>,
}

#[derive(Serialize)]
struct Answer {
    fundamental: Fundamental,
    rotation: [[f64; 3]; 3],
    /// A unit vector.
    translation: [f64; 3],
    inliers: Vec<usize>,
    /// Where each inlier is in the first camera's frame; none for a point too far away.
    points: Vec<Option<[f64; 3]>>,
}

#[derive(Serialize)]
struct Fundamental {
    matrix: [[f64; 3]; 3],
    inliers: Vec<usize>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let text = match std::env::args().nth(1) {
        Some(path) => std::fs::read_to_string(path)?,
        None => serde_json::to_string(&simulated())?,
    };
    for line in text.lines() {
        println!("{}", serde_json::to_string(&answer(&serde_json::from_str(line)?)?)?);
    }
    Ok(())
}

fn answer(given: &Given) -> Result<Answer, Box<dyn Error>> {
    let pairs: Vec<PointPair> = given
        .matches
        .iter()
        .map(|[x1, y1, x2, y2]| PointPair {
            first: Point2::new(*x1, *y1),
            second: Point2::new(*x2, *y2),
        })
        .collect();
    let [fx, fy, cx, cy] = given.camera;
    let camera = CameraMatrix { fx, fy, cx, cy, skew: 0.0 };
    let size = ImageSize::new(given.image_size[0], given.image_size[1]);
    let geometry = two_view_geometry(&pairs, size).ok_or("the matches do not agree on an F")?;
    let cameras = [camera; 2];
    let found = relative_pose(CalibratedPair { pairs: &pairs, cameras, size })
        .ok_or("the matches do not agree on a pose")?;
    let pose = found.model.second_from_first;
    let point = |k: &usize| {
        let point: Option<Point3<f64>> = triangulate_pair(&pose, cameras, &pairs[*k]);
        point.map(|point| point.coords.into())
    };
    Ok(Answer {
        fundamental: Fundamental { matrix: rows(&geometry.fundamental), inliers: geometry.inliers },
        rotation: rows(&pose.rotation_matrix()),
        translation: pose.translation().into(),
        points: found.inliers.iter().map(point).collect(),
        inliers: found.inliers,
    })
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    matrix.transpose().into()
}

/// Sixty points before two cameras; every fifth match is wrong.
fn simulated() -> Given {
    let camera = CameraMatrix { fx: 1100.0, fy: 1100.0, cx: 639.5, cy: 479.5, skew: 0.0 };
    let second_from_first =
        Pose::from_axis_angle(Vector3::new(0.02, 0.15, 0.0), Vector3::new(-1.0, 0.1, 0.2));
    let pixel = |at: Point3<f64>| camera.pixel_from_normalized(at.coords.xy() / at.z);
    let matches = (0..60).map(|number| {
        let k = f64::from(number);
        let point =
            Point3::new(2.0 * (1.7 * k).sin(), 1.5 * (2.9 * k).cos(), 7.0 + (0.7 * k).sin());
        let (first, second) = (pixel(point), pixel(second_from_first * point));
        let wrong = if number % 5 == 0 { 60.0 + 5.0 * k } else { 0.0 };
        [first.x, first.y, second.x, second.y + wrong]
    });
    Given {
        image_size: [1280, 960],
        camera: [camera.fx, camera.fy, camera.cx, camera.cy],
        matches: matches.collect(),
    }
}
