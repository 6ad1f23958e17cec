//! A board that is not flat, before a camera with color and depth: rendered into a folder, and
//! reported in one line of the verdict.

use std::fs;
use std::path::Path;

use image::{GrayImage, Luma};
use nalgebra::{Point3, Vector3};
use plumb::geometry::camera_matrix::CameraMatrix;
use plumb::geometry::lens::Lens;
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;
use plumb::imaging::depth_image::DepthImage;
use serde_json::Value;

use crate::program::plumb;

const SQUARE_M: f64 = 0.03;
/// From the first inner corner to the last one.
const REACH_M: [f64; 2] = [8.0 * SQUARE_M, 5.0 * SQUARE_M];
const MARGIN_M: f64 = 2.0 * SQUARE_M;
const UNIT_M: f64 = 1e-4;

/// How far the board's surface is from its plane, where x runs along its rows: `bulge_m` in their
/// middle.
fn height_m(bulge_m: f64, x: f64) -> f64 {
    let part = x / REACH_M[0];
    bulge_m * 4.0 * part * (1.0 - part)
}

struct Camera {
    size: ImageSize,
    lens: Lens,
    from_color: Pose,
}

impl Camera {
    /// Where the ray through a pixel meets the board, in the board's frame, and how far ahead;
    /// `None` beside the board.
    fn sees(
        &self,
        color_from_board: &Pose,
        bulge_m: f64,
        pixel: Pixel,
    ) -> Option<(Point3<f64>, f64)> {
        let board_from_camera = (self.from_color * *color_from_board).inverse();
        let ray = self.lens.bearing_from_pixel(pixel)?.into_inner();
        let ray = ray / ray.z;
        let (eye, ahead) =
            (board_from_camera * Point3::origin(), board_from_camera.rotation() * ray);
        let mut z = -eye.z / ahead.z;
        for _ in 0..8 {
            z = (height_m(bulge_m, eye.x + z * ahead.x) - eye.z) / ahead.z;
        }
        let at = eye + ahead * z;
        let within = |k: usize| at[k] > -MARGIN_M && at[k] < REACH_M[k] + MARGIN_M;
        (within(0) && within(1)).then_some((at, z))
    }

    fn pixels(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let ImageSize { width, height } = self.size;
        (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)))
    }

    fn image(&self, color_from_board: &Pose, bulge_m: f64) -> GrayImage {
        let mut image = GrayImage::new(self.size.width, self.size.height);
        for (x, y) in self.pixels() {
            let seen = self.sees(color_from_board, bulge_m, Pixel::new(f64::from(x), f64::from(y)));
            let light =
                seen.map_or(90.0, |(at, z)| lightness(&at, self.lens.matrix.fx * SQUARE_M / z));
            image.put_pixel(x, y, Luma([light as u8 + noise(x, y)]));
        }
        image
    }

    fn depth(&self, color_from_board: &Pose, bulge_m: f64) -> DepthImage {
        let reading = |(x, y): (u32, u32)| {
            let seen = self.sees(color_from_board, bulge_m, Pixel::new(f64::from(x), f64::from(y)));
            (seen.map_or(2.0, |(_, z)| z) / UNIT_M).round() as u16 + u16::from(noise(y, x))
        };
        DepthImage::new(self.size, self.pixels().map(reading).collect()).unwrap()
    }
}

/// White around squares that are dark outside the first inner corner, and that are `square_px`
/// pixels wide: an edge is as wide as two pixels.
fn lightness(at: &Point3<f64>, square_px: f64) -> f64 {
    let side = |along: f64| {
        let (square, part) = (along.floor(), along - along.floor());
        let inside = (square_px * part.min(1.0 - part)).min(1.0);
        if square.rem_euclid(2.0) < 0.5 { inside } else { -inside }
    };
    let [across, down] = [0, 1].map(|k| at[k] / SQUARE_M);
    let on_squares = (-1.0..9.0).contains(&across) && (-1.0..6.0).contains(&down);
    if on_squares { 122.0 - 92.0 * side(across) * side(down) } else { 214.0 }
}

/// 0 to 3, and alike for every image.
fn noise(x: u32, y: u32) -> u8 {
    ((x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663)).wrapping_mul(2_654_435_761) >> 30)
        as u8
}

fn render(folder: &Path, bulge_m: f64) {
    let lens =
        |f: f64, cx: f64, cy: f64| Lens::pinhole(CameraMatrix { fx: f, fy: f, cx, cy, skew: 0.0 });
    let color = Camera {
        size: ImageSize::new(640, 480),
        lens: lens(560.0, 322.0, 236.0),
        from_color: Pose::identity(),
    };
    let from_color = Pose::from_axis_angle(
        Vector3::new(0.004, -0.01, 0.002),
        Vector3::new(-0.025, 0.001, 0.002),
    );
    let depth =
        Camera { size: ImageSize::new(320, 240), lens: lens(290.0, 158.0, 121.0), from_color };
    for sensor in ["color", "infrared", "depth"] {
        fs::create_dir(folder.join(sensor)).unwrap();
    }
    for view in 0..12_u32 {
        let (around, view_m) = (f64::from(view) * 2.4, 0.04 * f64::from(view % 3));
        let axis_angle = Vector3::new(0.45 * around.sin(), 0.45 * around.cos(), 0.05 * around);
        let rotation = Pose::from_axis_angle(axis_angle, Vector3::zeros());
        let middle = Vector3::new(0.5 * REACH_M[0], 0.5 * REACH_M[1], 0.0);
        let at =
            Vector3::new(0.05 * (1.7 * around).cos(), 0.04 * (1.3 * around).sin(), 0.4 + view_m);
        let color_from_board = Pose::new(rotation.rotation(), at - rotation.rotation() * middle);
        let place = |sensor: &str| folder.join(sensor).join(format!("{view:02}.png"));
        color.image(&color_from_board, bulge_m).save(place("color")).unwrap();
        depth.image(&color_from_board, bulge_m).save(place("infrared")).unwrap();
        fs::write(place("depth"), depth.depth(&color_from_board, bulge_m).to_png()).unwrap();
    }
    fs::write(
        folder.join("sensors.toml"),
        format!("[depth]\nkind = \"depth\"\nunit_m = {UNIT_M}\n"),
    )
    .unwrap();
}

#[test]
fn a_bent_board_is_reported_in_one_line_and_a_flat_one_is_not() {
    for (bulge_m, is_reported) in [(0.006, true), (0.0, false)] {
        let folder = tempfile::tempdir().unwrap();
        render(folder.path(), bulge_m);
        let place = folder.path().display().to_string();
        let finished = plumb([
            "calibrate",
            "--json",
            "--lens",
            "brown",
            "--board",
            "9x6",
            "--square",
            "30mm",
            &place,
        ]);
        assert_eq!(finished.code, Some(0), "{}", finished.stderr);
        let document: Value = serde_json::from_str(&finished.stdout).unwrap();
        let reasons = document["verdict"]["reasons"].as_array().unwrap();
        let lines: Vec<&str> =
            reasons.iter().filter_map(Value::as_str).filter(|line| line.contains("bent")).collect();
        assert_eq!(!lines.is_empty(), is_reported, "{reasons:?}");
        assert!(
            lines.iter().all(|line| line.contains("flat and stiff") && !line.contains('\n')),
            "{lines:?}"
        );
        assert!(!is_reported || document["verdict"]["grade"] != "good", "{reasons:?}");
    }
}
