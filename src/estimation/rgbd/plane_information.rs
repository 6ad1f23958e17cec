//! What the board's surface in one depth image says of the depth camera that measured it: the very
//! equations that the solve by planes sums up, view by view, for whoever weighs views before there
//! is a solve.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Matrix6, Point3, Vector3, Vector6};

use crate::estimation::depth_error::Prior;
use crate::estimation::joint::depth_terms::{
    CorrectionColumns, PlaneObservation, add_planes, correction_columns, ray,
};
use crate::estimation::joint::linearize::LinearizationPoint;
use crate::estimation::joint::normal::{LocalBlock, NormalEquations};
use crate::estimation::joint::{FreeLens, Layout, SensorLayout, State, moved};
use crate::estimation::rgbd::BASE_SMOOTHNESS;
use crate::estimation::rgbd::device_prior::LENS_PARAMETERS;
use crate::estimation::rgbd::planes::tile_inverse_std;
use crate::estimation::rgbd::problem::free;
use crate::geometry::depth_camera::{DepthReading, DepthTile, PosedDepthLens};
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::{Pose, pose_step};

/// Beyond a scale and an offset a correction's form follows from all views together.
const TERMS: usize = 2;

/// A depth camera beside a color camera, as far as it is known. Its parameters are the open ones of
/// its lens, then a step of `depth_from_color` (a rotation about depth's axes and a translation),
/// and the coefficients of the correction.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedDepth {
    /// Its lens.
    pub lens: Lens,
    /// The open parameters of that, by their index in [`Lens::parameters`]: the focal lengths and
    /// the principal point, which planes determine; all of them where infrared sees boards.
    pub open: Vec<usize>,
    /// Where color is, seen from depth.
    pub depth_from_color: Pose,
    /// What its numbers mean.
    pub reading: DepthReading,
    /// Its systematic error.
    pub correction: DepthCorrection,
}

/// Some tiles of a board's surface that stand for all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct TileSample {
    /// The tiles.
    pub tiles: Vec<DepthTile>,
    /// For how many tiles each of them stands.
    pub each: f64,
}

/// The normal equations of one view over the depth camera's parameters and the board's pose. The
/// pose is a step of where the board is before color, about the board's origin.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneNormal {
    /// Over the depth camera's parameters.
    pub by_depth: DMatrix<f64>,
    /// Depth camera by pose.
    pub coupling: DMatrix<f64>,
    /// Over the pose.
    pub by_pose: Matrix6<f64>,
    /// The sum of squared residuals, in variances.
    pub squares: f64,
    /// Of half the sum of squares, by the depth camera's parameters …
    pub gradient: DVector<f64>,
    /// … and by the pose.
    pub pose_gradient: Vector6<f64>,
}

impl PlacedDepth {
    /// A camera whose depth is wrong by a scale and an offset in 1/z that nothing is known of,
    /// about the depths `seen_m`.
    pub fn new(
        lens: Lens,
        size: ImageSize,
        depth_from_color: Pose,
        reading: DepthReading,
        seen_m: [f64; 2],
    ) -> Self {
        let quantity = CorrectedQuantity::InverseDepth;
        let correction = DepthCorrection::none(quantity, TERMS, SplineGrid::constant(size), seen_m);
        let open = free(&lens, LENS_PARAMETERS).free;
        Self { lens, open, depth_from_color, reading, correction }
    }

    /// Its lens and pose alone.
    pub fn posed_lens(&self) -> PosedDepthLens {
        PosedDepthLens { lens: self.lens, depth_from_color: self.depth_from_color }
    }

    /// The same with all of its lens open.
    #[must_use]
    pub fn with_open_lens(self) -> Self {
        let open = free(&self.lens, self.lens.parameters().len()).free;
        Self { open, ..self }
    }

    /// Where the step of the pose begins among its parameters.
    pub fn pose_at(&self) -> usize {
        self.open.len()
    }

    /// Where the coefficients of the correction do.
    pub fn correction_at(&self) -> usize {
        self.pose_at() + 6
    }

    /// How many parameters it has.
    pub fn parameters(&self) -> usize {
        self.correction_at() + self.correction.coefficients.len()
    }

    /// What the solve takes for known of the correction beforehand: the inverse of its covariance,
    /// over all parameters.
    pub fn correction_prior(&self) -> DMatrix<f64> {
        let prior = Prior::of(&self.correction, BASE_SMOOTHNESS).hessian;
        let count = self.parameters();
        let mut all = DMatrix::zeros(count, count);
        let at = self.correction_at();
        all.view_mut((at, at), prior.shape()).copy_from(&prior);
        all
    }

    /// The same after a step of its parameters; `None` where a lens parameter leaves the possible.
    pub fn stepped(&self, step: &DVector<f64>) -> Option<Self> {
        let mut parameters = self.lens.parameters();
        self.open.iter().enumerate().for_each(|(k, index)| parameters[*index] += step[k]);
        let possible = parameters[0] > 0.0 && parameters[1] > 0.0;
        let lens = Lens::from_parameters(self.lens.model(), &parameters).filter(|_| possible)?;
        let depth_from_color =
            moved(&self.depth_from_color, &step.as_slice()[self.pose_at()..self.correction_at()]);
        let mut correction = self.correction.clone();
        for (k, coefficient) in correction.coefficients.iter_mut().enumerate() {
            *coefficient += step[self.correction_at() + k];
        }
        Some(Self { lens, depth_from_color, correction, ..self.clone() })
    }

    /// The uncorrected 1/z where `corrected` is the right one, in 1/m.
    pub fn uncorrected(&self, pixel: Pixel, corrected: f64) -> f64 {
        let at = self.correction.at(pixel);
        (0..3).fold(corrected, |inverse, _| inverse + corrected - at.correct(inverse))
    }

    /// The true 1/z of a board's plane along a pixel's ray, in 1/m; `None` behind the camera.
    pub fn plane_inverse_depth(&self, depth_from_board: &Pose, pixel: Pixel) -> Option<f64> {
        let bearing = self.lens.bearing_from_pixel(pixel).filter(|bearing| bearing.z > 1e-3)?;
        let normal = *depth_from_board * Vector3::z();
        let along = normal.dot(&(bearing.into_inner() / bearing.z));
        let inverse = along / normal.dot(&depth_from_board.translation());
        (inverse.is_finite() && inverse > 0.0).then_some(inverse)
    }

    /// A tile against the board's plane, in standard deviations; `None` where the lens sees
    /// nothing.
    pub fn residual(&self, depth_from_board: &Pose, tile: &DepthTile) -> Option<f64> {
        let plane = self.plane_inverse_depth(depth_from_board, tile.pixel)?;
        let at = self.correction.at(tile.pixel);
        let std = at.gain(tile.inverse_depth) / tile_inverse_std(self.reading, tile);
        let residual = (at.correct(tile.inverse_depth) - plane) / std;
        residual.is_finite().then_some(residual)
    }

    /// The point at depth `z_m` behind a pixel, seen from color, and its derivative by the depth
    /// camera's parameters where the reading stays as it is. `None` where the lens sees nothing.
    pub fn point_in_color(&self, pixel: Pixel, z_m: f64) -> Option<(Point3<f64>, DMatrix<f64>)> {
        let inverse_depth = self.uncorrected(pixel, 1.0 / z_m);
        let tile = DepthTile { pixel, inverse_depth, reading_std: 0.0, count: 1 };
        let ray = ray(&self.lens, &tile)?;
        let projection = self.lens.project(&Point3::from(ray))?;
        let by_xy: Matrix2<f64> = projection.by_point.fixed_view::<2, 2>(0, 0).into_owned();
        let inverse = by_xy.try_inverse()?;
        let in_depth = ray * z_m;
        let mut by_depth = DMatrix::zeros(3, self.parameters());
        for (k, index) in self.open.iter().enumerate() {
            let moved = inverse * projection.by_parameters.column(*index) * -z_m;
            by_depth.fixed_view_mut::<2, 1>(0, k).copy_from(&moved);
        }
        // The pose moves color's points, and depth's point moves the other way in color.
        let (pose_at, correction_at) = (self.pose_at(), self.correction_at());
        let lever = in_depth - self.depth_from_color.translation();
        by_depth.fixed_view_mut::<3, 3>(0, pose_at).copy_from(&lever.cross_matrix());
        by_depth.fixed_view_mut::<3, 3>(0, pose_at + 3).copy_from(&-Matrix3::identity());
        correction_columns(&self.correction, &tile, |k, by_coefficient| {
            let moved = ray * (-z_m * z_m * by_coefficient);
            by_depth.fixed_view_mut::<3, 1>(0, correction_at + k).copy_from(&moved);
        });
        let color_from_depth = self.depth_from_color.inverse();
        let rotation = color_from_depth.rotation_matrix();
        let by_depth = DMatrix::from_fn(3, by_depth.ncols(), |row, column| {
            (0..3).map(|k| rotation[(row, k)] * by_depth[(k, column)]).sum()
        });
        Some((color_from_depth * Point3::from(in_depth), by_depth))
    }
}

impl PlaneNormal {
    /// That of a board at `color_from_board`, whose surface was measured in `sample`. Tiles scatter
    /// with `variance` times that of their readings. `None` where one of them is not seen by the
    /// lens, or the board is edge-on.
    pub fn of(
        depth: &PlacedDepth,
        color_from_board: &Pose,
        sample: &TileSample,
        variance: f64,
    ) -> Option<Self> {
        let TileSample { tiles, each } = sample;
        let weight = each / variance;
        let known = SensorLayout { lens: free(&depth.lens, 0), lens_at: 0, pose_at: None };
        let own = SensorLayout {
            lens: FreeLens { free: depth.open.clone(), ..known.lens.clone() },
            lens_at: 0,
            pose_at: Some(depth.pose_at()),
        };
        let layout = Layout {
            sensors: vec![known, own],
            warp: None,
            len: depth.parameters(),
            interrupt: Default::default(),
        };
        let state = State {
            lenses: vec![depth.lens; 2],
            sensor_from_rig: vec![Pose::identity(), depth.depth_from_color],
            rig_from_board: vec![*color_from_board],
            warp: [0.0; 2],
        };
        let plane = PlaneObservation {
            sensor: 1,
            frame_set: 0,
            inverse_std: (tiles.iter())
                .map(|tile| tile_inverse_std(depth.reading, tile) * weight.sqrt())
                .collect(),
            used: vec![true; tiles.len()],
            tiles: tiles.clone(),
        };
        let mut equations = NormalEquations::empty(layout.len, 1);
        let residuals = add_planes(
            &mut equations,
            LinearizationPoint { layout: &layout, state: &state },
            CorrectionColumns { correction: &depth.correction, first: depth.correction_at() },
            &[plane],
            true,
        );
        equations.mirror();
        let of = equations.coupling_of(0);
        let coupling = DMatrix::from_fn(layout.len, 6, |k, a| of[k][a]);
        let LocalBlock { hessian, gradient } = equations.frame_sets[0];
        let is_seen = residuals.iter().flatten().all(|residual| residual.is_finite());
        is_seen.then(|| Self {
            coupling,
            by_pose: Matrix6::from_fn(|a, b| hessian[a][b]),
            squares: equations.cost,
            gradient: equations.global_gradient.clone(),
            pose_gradient: Vector6::from(gradient),
            by_depth: equations.global,
        })
    }
}

/// A board's pose after a step as [`PlaneNormal`] has it.
pub fn moved_board(color_from_board: &Pose, step: &Vector6<f64>) -> Pose {
    moved(color_from_board, step.as_slice())
}

/// The step of `depth_from_color` from one pose to another one near it.
pub fn depth_pose_step(depth_from_color: &Pose, moved_depth_from_color: &Pose) -> Vector6<f64> {
    let (now, then) = (depth_from_color, moved_depth_from_color);
    let rotation = (then.rotation() * now.rotation().inverse()).scaled_axis();
    pose_step(&rotation, &(then.translation() - now.translation()))
}
