//! From the board's poses during an exposure to the light on a sensor's pixels.

use nalgebra::{Matrix3, Vector3};

use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;
use crate::simulation::background::Background;
use crate::simulation::board_pattern::BoardPattern;
use crate::simulation::image_sensor::ImageSensor;
use crate::simulation::light_filter::LightFilter;
use crate::simulation::rays::{RayTable, SUBPIXELS};

/// Renders one sensor's view of the board in front of a static background.
#[derive(Debug, Clone)]
pub struct Renderer {
    sensor: ImageSensor,
    pattern: BoardPattern,
    filter: LightFilter,
    rays: RayTable,
    /// Light of the background on each sub-pixel, and on each pixel.
    background: Vec<f32>,
    background_on_pixels: Vec<f32>,
    /// Light of the scene on each sub-pixel; that of the background wherever no board was drawn.
    scene: Vec<f32>,
}

/// A half-open rectangle of padded pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Area {
    x: [usize; 2],
    y: [usize; 2],
}

impl Renderer {
    /// A renderer for `sensor`, which sees `pattern` in front of `background`.
    pub fn new(sensor: ImageSensor, pattern: BoardPattern, background: &Background) -> Self {
        let filter = LightFilter::new(sensor.blur_px);
        let rays = RayTable::new(&sensor.lens, sensor.size, filter.reach);
        let inside = |sub: usize| ((sub % SUBPIXELS) as f64 + 0.5) / SUBPIXELS as f64;
        let ray = |i: usize, j: usize| {
            rays.ray_inside([i / SUBPIXELS, j / SUBPIXELS], [inside(i), inside(j)])
        };
        let background: Vec<f32> = (0..rays.rows * SUBPIXELS)
            .flat_map(|j| (0..rays.columns * SUBPIXELS).map(move |i| (i, j)))
            .map(|(i, j)| background.light(&ray(i, j)) as f32)
            .collect();
        let scene = background.clone();
        let mut renderer = Self {
            background_on_pixels: Vec::new(),
            background,
            sensor,
            pattern,
            filter,
            rays,
            scene,
        };
        let mut light =
            vec![0.0; renderer.sensor.size.width as usize * renderer.sensor.size.height as usize];
        renderer.filter_area(renderer.whole(), &mut light);
        renderer.background_on_pixels = light;
        renderer
    }

    /// The sensor that is rendered.
    pub fn sensor(&self) -> &ImageSensor {
        &self.sensor
    }

    /// The board.
    pub fn pattern(&self) -> &BoardPattern {
        &self.pattern
    }

    /// Light on each pixel, row by row, for a board that was at each of the poses
    /// `camera_from_board` for an equal part of the exposure.
    pub fn light(&mut self, camera_from_board: &[Pose]) -> Vec<f32> {
        let mut light = self.background_on_pixels.clone();
        let areas: Vec<_> = camera_from_board
            .iter()
            .map(|camera_from_board| self.board_area(camera_from_board))
            .collect();
        let Some(union) = areas.iter().copied().reduce(Area::union) else { return light };
        let share = 1.0 / camera_from_board.len() as f32;
        for (camera_from_board, area) in camera_from_board.iter().zip(areas) {
            self.add_board(camera_from_board, area, share);
        }
        self.filter_area(union, &mut light);
        for row in union.y[0] * SUBPIXELS..union.y[1] * SUBPIXELS {
            let start = row * self.rays.columns * SUBPIXELS;
            let range = start + union.x[0] * SUBPIXELS..start + union.x[1] * SUBPIXELS;
            self.scene[range.clone()].copy_from_slice(&self.background[range]);
        }
        light
    }

    /// The largest motion of the board's image between two poses, in pixels; infinite if it leaves
    /// the lens's view.
    pub fn motion_px(&self, camera_from_board: [&Pose; 2]) -> f64 {
        let [left, right, top, bottom] = self.pattern.edges_in_squares();
        let seen =
            |camera_from_board: &Pose, x: f64, y: f64| self.pixel_of(camera_from_board, x, y);
        [(left, top), (right, top), (right, bottom), (left, bottom)]
            .into_iter()
            .map(|(x, y)| {
                match camera_from_board.map(|camera_from_board| seen(camera_from_board, x, y)) {
                    [Some(before), Some(after)] => before.distance_px(after),
                    _ => f64::INFINITY,
                }
            })
            .fold(0.0, f64::max)
    }

    fn pixel_of(&self, camera_from_board: &Pose, x_squares: f64, y_squares: f64) -> Option<Pixel> {
        let side = self.pattern.board.square_m;
        let point_in_camera =
            *camera_from_board * nalgebra::Point3::new(x_squares * side, y_squares * side, 0.0);
        self.sensor.lens.pixel_from_point(&point_in_camera)
    }

    /// The padded pixels that the board may cover: all of them if part of its edge is outside the
    /// lens's view.
    fn board_area(&self, camera_from_board: &Pose) -> Area {
        // Samples of each of the board's edges.
        const STEPS: usize = 24;
        let [left, right, top, bottom] = self.pattern.edges_in_squares();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for step in 0..=STEPS {
            let part = step as f64 / STEPS as f64;
            let [x, y] = [left + part * (right - left), top + part * (bottom - top)];
            for [x, y] in [[x, top], [x, bottom], [left, y], [right, y]] {
                let Some(pixel) = self.pixel_of(camera_from_board, x, y) else {
                    return self.whole();
                };
                let at =
                    [pixel.x + 0.5 + self.rays.pad as f64, pixel.y + 0.5 + self.rays.pad as f64];
                low = [low[0].min(at[0]), low[1].min(at[1])];
                high = [high[0].max(at[0]), high[1].max(at[1])];
            }
        }
        // The image of an edge may be curved between the samples; the error is far less than this.
        let margin = 1.0 + 0.02 * (high[0] - low[0]).max(high[1] - low[1]);
        let range = |low: f64, high: f64, end: usize| {
            let clamped = |value: f64| value.clamp(0.0, end as f64) as usize;
            [clamped(low - margin), clamped((high + margin).ceil())]
        };
        Area {
            x: range(low[0], high[0], self.rays.columns),
            y: range(low[1], high[1], self.rays.rows),
        }
    }

    /// Adds the board to the scene for `share` of the exposure.
    fn add_board(&mut self, camera_from_board: &Pose, area: Area, share: f32) {
        let squares_from_ray = self.squares_from_ray(camera_from_board);
        let lit = self.illumination(camera_from_board) as f32 * share;
        let row_of = |rays: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            rays[area.x[0]..=area.x[1]].iter().map(|ray| squares_from_ray * ray).collect()
        };
        let mut upper = row_of(self.rays.node_row(area.y[0]));
        for y in area.y[0]..area.y[1] {
            let lower = row_of(self.rays.node_row(y + 1));
            for (i, x) in (area.x[0]..area.x[1]).enumerate() {
                let corners = [upper[i], upper[i + 1], lower[i + 1], lower[i]];
                match self.pattern.even_shade(&corners.map(on_board)) {
                    Some(shade) if shade.coverage == 0.0 => {}
                    Some(shade) => self.add_even_pixel([x, y], shade.light as f32 * lit, share),
                    None => self.add_uneven_pixel([x, y], &corners, lit, share),
                }
            }
            upper = lower;
        }
    }

    /// Adds the same light to all of a pixel, for `share` of the exposure.
    fn add_even_pixel(&mut self, [x, y]: [usize; 2], light: f32, share: f32) {
        for row in y * SUBPIXELS..(y + 1) * SUBPIXELS {
            let start = (row * self.rays.columns + x) * SUBPIXELS;
            let behind = &self.background[start..start + SUBPIXELS];
            for (value, behind) in self.scene[start..start + SUBPIXELS].iter_mut().zip(behind) {
                *value += light - share * behind;
            }
        }
    }

    /// Adds the pattern to a pixel with these `corners`, in homogeneous board coordinates.
    fn add_uneven_pixel(
        &mut self,
        [x, y]: [usize; 2],
        corners: &[Vector3<f64>; 4],
        lit: f32,
        share: f32,
    ) {
        let part = |sub: usize| sub as f64 / SUBPIXELS as f64;
        let nodes: [[[f64; 2]; SUBPIXELS + 1]; SUBPIXELS + 1] = std::array::from_fn(|j| {
            let (left, right) =
                (corners[0].lerp(&corners[3], part(j)), corners[1].lerp(&corners[2], part(j)));
            std::array::from_fn(|i| on_board(left.lerp(&right, part(i))))
        });
        for j in 0..SUBPIXELS {
            let start = ((y * SUBPIXELS + j) * self.rays.columns + x) * SUBPIXELS;
            for i in 0..SUBPIXELS {
                let patch = [nodes[j][i], nodes[j][i + 1], nodes[j + 1][i + 1], nodes[j + 1][i]];
                let shade = self.pattern.shade(&patch);
                let behind = share * shade.coverage as f32 * self.background[start + i];
                self.scene[start + i] += shade.light as f32 * lit - behind;
            }
        }
    }

    /// Maps a ray to homogeneous board coordinates in squares; the third is positive in front of
    /// the camera.
    fn squares_from_ray(&self, camera_from_board: &Pose) -> Matrix3<f64> {
        let rotation = camera_from_board.rotation_matrix();
        let side = self.pattern.board.square_m;
        let plane = Matrix3::from_columns(&[
            rotation.column(0) * side,
            rotation.column(1) * side,
            camera_from_board.translation(),
        ]);
        plane.try_inverse().unwrap_or_else(|| Matrix3::repeat(f64::NAN))
    }

    /// Light on the board: part of it ambient, part from a lamp above and to the left of the
    /// camera.
    fn illumination(&self, camera_from_board: &Pose) -> f64 {
        let toward_lamp = Vector3::new(-0.35, -0.5, -1.0).normalize();
        let toward_viewer = -(*camera_from_board * Vector3::z());
        0.5 + 0.5 * toward_viewer.dot(&toward_lamp).max(0.0)
    }

    fn whole(&self) -> Area {
        Area { x: [0, self.rays.columns], y: [0, self.rays.rows] }
    }

    /// Filters the scene onto all pixels that receive light from the padded pixels of `from`.
    fn filter_area(&self, from: Area, light: &mut [f32]) {
        let reached = |[low, high]: [usize; 2], end: u32| {
            low.saturating_sub(2 * self.rays.pad).min(end as usize)..high.min(end as usize)
        };
        let (x, y) =
            (reached(from.x, self.sensor.size.width), reached(from.y, self.sensor.size.height));
        if x.is_empty() || y.is_empty() {
            return;
        }
        let taps = self.filter.taps();
        let rows = y.start * SUBPIXELS..(y.end - 1) * SUBPIXELS + taps;
        let mut reduced = vec![0.0; rows.len() * x.len()];
        for (row, out) in rows.zip(reduced.chunks_exact_mut(x.len())) {
            let start = row * self.rays.columns * SUBPIXELS;
            let columns = start + x.start * SUBPIXELS..start + (x.end - 1) * SUBPIXELS + taps;
            self.filter.reduce_row(&self.scene[columns], out);
        }
        for (i, y) in y.enumerate() {
            let rows = reduced.chunks_exact(x.len()).skip(i * SUBPIXELS);
            let start = y * self.sensor.size.width as usize;
            self.filter.reduce_columns(rows, &mut light[start + x.start..start + x.end]);
        }
    }
}

impl Area {
    fn union(self, other: Self) -> Self {
        let joined = |a: [usize; 2], b: [usize; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Self { x: joined(self.x, other.x), y: joined(self.y, other.y) }
    }
}

fn on_board(at: Vector3<f64>) -> [f64; 2] {
    if at.z > 0.0 { [at.x / at.z, at.y / at.z] } else { [f64::NAN; 2] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::lens::{Distortion, DistortionModel, KannalaBrandt, Lens};
    use crate::geometry::pixel::ImageSize;

    fn renderer(lens: Lens, blur_px: f64) -> Renderer {
        let size = ImageSize::new(96, 72);
        let board = Chessboard::new(BoardSize::new(5, 4).unwrap(), 0.1).unwrap();
        let pattern = BoardPattern { white: 1.0, black: 0.0, ..BoardPattern::new(board) };
        let sensor = ImageSensor { blur_px, ..ImageSensor::new(size, lens) };
        Renderer::new(sensor, pattern, &Background::new(1, 0))
    }

    fn matrix() -> CameraMatrix {
        CameraMatrix { fx: 80.0, fy: 80.0, cx: 47.5, cy: 35.5, skew: 0.0 }
    }

    /// Gauss's error function by its series, which converges for every argument used here.
    fn erf(x: f64) -> f64 {
        let mut term = x;
        let mut sum = x;
        for n in 1..200 {
            term *= -x * x / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        sum * 2.0 / std::f64::consts::PI.sqrt()
    }

    /// The mean over [x − 1/2, x + 1/2] of an edge at `edge` blurred by `sigma`: the part of light
    /// right of the edge.
    fn blurred_edge(x: f64, edge: f64, sigma: f64) -> f64 {
        let integral = |t: f64| {
            let z = t / (sigma * std::f64::consts::SQRT_2);
            0.5 * (t * (1.0 + erf(z))
                + sigma * (2.0 / std::f64::consts::PI).sqrt() * (-z * z).exp())
        };
        integral(x + 0.5 - edge) - integral(x - 0.5 - edge)
    }

    #[test]
    fn an_edge_has_the_light_of_its_exact_integral() {
        let mut renderer = renderer(Lens::pinhole(matrix()), 0.8);
        for translation in [0.0, 0.003, 0.017] {
            // Upright at 0.4 m: squares of 20 px. Along the middle of the first row of squares
            // below the first corner: an edge at board x = 0.
            let camera_from_board =
                Pose::from_axis_angle(Vector3::zeros(), Vector3::new(translation, 0.0, 0.4));
            let lit = renderer.illumination(&camera_from_board);
            let light = renderer.light(&[camera_from_board]);
            let edge = 47.5 + 80.0 * translation / 0.4;
            let row = (35.5 + 80.0 * 0.05 / 0.4_f64).round() as usize;
            for x in (edge - 4.0) as usize..(edge + 4.0) as usize {
                // Right of the first corner, below it: dark.
                let expected = lit * (1.0 - blurred_edge(x as f64, edge, 0.8));
                let found = f64::from(light[row * 96 + x]);
                assert!(
                    (found - expected).abs() < 1.5e-3,
                    "at {x}: {found} not {expected}, edge {edge}"
                );
            }
        }
    }

    #[test]
    fn a_blurred_corner_stays_where_it_is_under_every_lens() {
        let fisheye =
            Distortion::KannalaBrandt(KannalaBrandt::from_coefficients([0.05, -0.01, 0.0, 0.0]));
        for lens in [Lens::pinhole(matrix()), Lens { matrix: matrix(), distortion: fisheye }] {
            let mut renderer = renderer(lens, 0.7);
            let camera_from_board = Pose::from_axis_angle(
                Vector3::new(0.4, -0.3, 0.2),
                Vector3::new(-0.17, -0.13, 0.5),
            );
            let light = renderer.light(&[camera_from_board]);
            let corner = renderer.pixel_of(&camera_from_board, 2.0, 1.0).unwrap();
            // A half turn about the corner leaves a chessboard corner as it is: so does the
            // image, to second order.
            let value = |x: f64, y: f64| {
                let (i, j) = (x.floor(), y.floor());
                let (s, t) = (x - i, y - j);
                let at = |dx: usize, dy: usize| {
                    f64::from(light[(j as usize + dy) * 96 + i as usize + dx])
                };
                let upper = at(0, 0) * (1.0 - s) + at(1, 0) * s;
                upper * (1.0 - t) + (at(0, 1) * (1.0 - s) + at(1, 1) * s) * t
            };
            for (dx, dy) in [(1.0, 0.3), (0.2, 1.4), (-1.1, 0.8)] {
                let [there, opposite] =
                    [value(corner.x + dx, corner.y + dy), value(corner.x - dx, corner.y - dy)];
                assert!((there - opposite).abs() < 0.03, "{there} {opposite} at {dx} {dy}");
            }
        }
    }

    #[test]
    fn a_board_out_of_view_leaves_the_background() {
        let mut renderer = renderer(Lens::pinhole(matrix()), 0.7);
        let behind = Pose::from_axis_angle(Vector3::zeros(), Vector3::new(0.0, 0.0, -2.0));
        let beside = Pose::from_axis_angle(Vector3::zeros(), Vector3::new(9.0, 0.0, 1.0));
        let empty = renderer.background_on_pixels.clone();
        assert_eq!(renderer.light(&[behind]), empty);
        assert_eq!(renderer.light(&[beside]), empty);
        assert_eq!(renderer.light(&[]), empty);
        let near = Pose::from_axis_angle(Vector3::zeros(), Vector3::new(0.0, 0.0, 1.0));
        assert_ne!(renderer.light(&[near]), empty);
        assert_eq!(renderer.light(&[beside]), empty, "nothing is left of an earlier frame");
    }
}
