//! The information of one depth image of the board on the depth camera: the same equations that the
//! solve by planes sums up. They allow views to be weighed before there is a solve.

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

/// A scale and an offset. Any further form of a correction follows from all views together.
const TERMS: usize = 2;

/// An approximately known depth camera beside a color camera. Its parameters are the open ones of
/// its lens, then a step of `depth_from_color` (a rotation about depth's axes and a translation),
/// then the coefficients of the correction.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedDepth {
    /// Its lens.
    pub lens: Lens,
    /// Indices into [`Lens::parameters`] of the open parameters: the focal lengths and the
    /// principal point, which planes determine; all of them where infrared sees boards.
    pub open: Vec<usize>,
    /// Color's pose in depth's frame.
    pub depth_from_color: Pose,
    /// The meaning of its readings.
    pub reading: DepthReading,
    /// Its systematic error.
    pub correction: DepthCorrection,
}

/// A sample of the tiles on a board's surface that represents all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct TileSample {
    /// The tiles.
    pub tiles: Vec<DepthTile>,
    /// The number of tiles that each of them represents.
    pub each: f64,
}

/// The normal equations of one view over the depth camera's parameters and the board's pose. The
/// latter is a step of the board's pose in color's frame, about the board's origin.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneNormal {
    /// Over the depth camera's parameters.
    pub by_depth: DMatrix<f64>,
    /// Depth camera by pose.
    pub coupling: DMatrix<f64>,
    /// Over the pose.
    pub by_pose: Matrix6<f64>,
    /// The sum of squared residuals, each in standard deviations.
    pub squares: f64,
    /// The gradient of half the sum of squares by the depth camera's parameters …
    pub gradient: DVector<f64>,
    /// … and by the pose.
    pub pose_gradient: Vector6<f64>,
}

impl PlacedDepth {
    /// A camera whose depth has an unknown scale and offset in 1/z, for depths in the range
    /// `seen_m`.
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

    /// Its lens and pose, without the correction.
    pub fn posed_lens(&self) -> PosedDepthLens {
        PosedDepthLens { lens: self.lens, depth_from_color: self.depth_from_color }
    }

    /// The same with all parameters of its lens open.
    #[must_use]
    pub fn with_open_lens(self) -> Self {
        let open = free(&self.lens, self.lens.parameters().len()).free;
        Self { open, ..self }
    }

    /// The index of the pose's step among its parameters.
    pub fn pose_at(&self) -> usize {
        self.open.len()
    }

    /// The index of the correction's first coefficient.
    pub fn correction_at(&self) -> usize {
        self.pose_at() + 6
    }

    /// The number of its parameters.
    pub fn parameters(&self) -> usize {
        self.correction_at() + self.correction.coefficients.len()
    }

    /// The solve's prior of the correction, as an information matrix over all parameters.
    pub fn correction_prior(&self) -> DMatrix<f64> {
        let prior = Prior::of(&self.correction, BASE_SMOOTHNESS).hessian;
        let count = self.parameters();
        let mut all = DMatrix::zeros(count, count);
        let at = self.correction_at();
        all.view_mut((at, at), prior.shape()).copy_from(&prior);
        all
    }

    /// The same after a step of its parameters; `None` where the lens is no longer valid.
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

    /// The uncorrected 1/z that the correction maps to `corrected`, in 1/m.
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

    /// The residual of a tile against the board's plane, in standard deviations; `None` where the
    /// lens has no ray for the tile's pixel, or the plane is behind the camera.
    pub fn residual(&self, depth_from_board: &Pose, tile: &DepthTile) -> Option<f64> {
        let plane = self.plane_inverse_depth(depth_from_board, tile.pixel)?;
        let at = self.correction.at(tile.pixel);
        let std = at.gain(tile.inverse_depth) / tile_inverse_std(self.reading, tile);
        let residual = (at.correct(tile.inverse_depth) - plane) / std;
        residual.is_finite().then_some(residual)
    }

    /// The point at depth `z_m` behind a pixel, in color's frame, and its derivative by the depth
    /// camera's parameters for a fixed reading. `None` where the lens has no ray for the pixel.
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
        // The pose moves color's points in depth's frame, so depth's point moves the other way in
        // color's.
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
    /// From a board at `color_from_board`, whose surface was measured in `sample`. The variance of
    /// tiles is `variance` times that of their readings. `None` where the lens cannot see one of
    /// them, or the board is edge-on.
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

/// A board's pose after a step as in [`PlaneNormal`].
pub fn moved_board(color_from_board: &Pose, step: &Vector6<f64>) -> Pose {
    moved(color_from_board, step.as_slice())
}

/// The step of `depth_from_color` from one pose to another close to it.
pub fn depth_pose_step(depth_from_color: &Pose, moved_depth_from_color: &Pose) -> Vector6<f64> {
    let (now, then) = (depth_from_color, moved_depth_from_color);
    let rotation = (then.rotation() * now.rotation().inverse()).scaled_axis();
    pose_step(&rotation, &(then.translation() - now.translation()))
}
