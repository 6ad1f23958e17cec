//! The uncertainty of where one camera sees what another one sees: pixels of a are taken to a
//! distance, and from there projected into the image of b. Both lenses and the relative pose
//! contribute, with their correlations.

use nalgebra::{DMatrix, Matrix2x3, Point3, SMatrix, Vector3};

use crate::calibration::information::pair_information::PairInformation;
use crate::calibration::information::projection_goal::GoalFigure;
use crate::calibration::information::view_information::by_motion;
use crate::estimation::uncertainty::{PixelGrid, greatest_variance};
use crate::geometry::lens::{Lens, MAX_PARAMETERS};
use crate::geometry::pixel::{ImageSize, Pixel};

/// The derivatives of transferred pixels by both lenses and by the relative pose.
#[derive(Debug, Clone)]
pub struct TransferGoal {
    /// Two columns per pixel, a row for each parameter of the pair.
    by_known: DMatrix<f64>,
    figure: GoalFigure,
}

/// Columns of the grid over the image of a.
const COLUMNS: u32 = 7;
/// If fewer of them than this project into the image of b, those outside it count too.
const LEAST_SEEN: usize = 4;

impl TransferGoal {
    /// The uncertainty of the first camera's pixels, taken to `distance_m`, in the second one,
    /// reduced to `figure`. `None` where no pixel is in the valid regions of both lenses.
    pub fn new(
        information: &PairInformation,
        cameras: [(&Lens, ImageSize); 2],
        distance_m: f64,
        figure: GoalFigure,
    ) -> Option<Self> {
        let grid = PixelGrid::over(cameras[0].1, COLUMNS);
        let lenses = cameras.map(|(lens, _)| lens);
        let transfer = |pixel| TransferredPixel::of(information, lenses, pixel, distance_m);
        let all: Vec<TransferredPixel> = grid.pixels().filter_map(transfer).collect();
        let seen: Vec<&TransferredPixel> =
            all.iter().filter(|transfer| cameras[1].1.contains(transfer.pixel)).collect();
        let taken = if seen.len() < LEAST_SEEN { all.iter().collect() } else { seen };
        let free = &information.free;
        let count = free[0].len() + free[1].len() + 6;
        let mut by_known = DMatrix::zeros(count, 2 * taken.len());
        for (at, transfer) in taken.iter().enumerate() {
            for axis in 0..2 {
                let by_lenses = [0, 1].map(|k| transfer.by_lenses[k].row(axis));
                let values = (free[0].iter().map(|index| by_lenses[0][*index]))
                    .chain(free[1].iter().map(|index| by_lenses[1][*index]))
                    .chain(transfer.by_place.row(axis).iter().copied().collect::<Vec<_>>());
                for (row, value) in values.enumerate() {
                    by_known[(row, 2 * at + axis)] = value;
                }
            }
        }
        (!taken.is_empty()).then_some(Self { by_known, figure })
    }

    /// The 1-σ uncertainty of each transferred pixel in its worst direction, in pixels of b. `None`
    /// where the information matrix leaves something undetermined.
    pub fn std_px(&self, information: &DMatrix<f64>) -> Option<Vec<f64>> {
        let mut rest = self.by_known.clone();
        let factor = information.clone().cholesky()?;
        factor.l_dirty().solve_lower_triangular_mut(&mut rest).then_some(())?;
        let std = |at: usize| {
            let (u, v) = (rest.column(2 * at), rest.column(2 * at + 1));
            greatest_variance([u.norm_squared(), v.norm_squared()], u.dot(&v)).sqrt()
        };
        let stds: Vec<f64> = (0..rest.ncols() / 2).map(std).collect();
        stds.iter().all(|std| std.is_finite()).then_some(stds)
    }

    /// The figure of uncertainties, in pixels of b.
    pub fn figure_px(&self, std_px: &[f64]) -> f64 {
        self.figure.of(std_px)
    }

    /// The number that views are compared by, in pixels of b.
    pub fn criterion_px(&self, std_px: &[f64]) -> f64 {
        self.figure.criterion(std_px)
    }
}

/// One pixel of a, transferred to b.
struct TransferredPixel {
    pixel: Pixel,
    by_lenses: [SMatrix<f64, 2, MAX_PARAMETERS>; 2],
    by_place: SMatrix<f64, 2, 6>,
}

impl TransferredPixel {
    /// At `distance_m` from a, along the pixel's ray.
    fn of(
        information: &PairInformation,
        lenses: [&Lens; 2],
        pixel: Pixel,
        distance_m: f64,
    ) -> Option<Self> {
        let bearing = lenses[0].bearing_from_pixel(pixel)?;
        let point_in_a = Point3::from(bearing.into_inner() * distance_m);
        let in_a = lenses[0].project(&point_in_a)?;
        let point_in_b = information.b_from_a * point_in_a;
        let in_b = lenses[1].project(&point_in_b)?;
        // The pixel is fixed: when the lens changes, the point moves across the ray so that it
        // still projects to the pixel, at its distance.
        let across = bearing.cross(&axis_across(&bearing.into_inner())).normalize();
        let tangents = nalgebra::Matrix3x2::from_columns(&[across, bearing.cross(&across)]);
        let point_by_lens =
            -tangents * (in_a.by_point * tangents).try_inverse()? * in_a.by_parameters;
        let rotation = information.b_from_a.rotation_matrix();
        let by_point: Matrix2x3<f64> = in_b.by_point;
        Some(Self {
            pixel: in_b.pixel,
            by_lenses: [by_point * rotation * point_by_lens, in_b.by_parameters],
            by_place: by_motion(
                &by_point,
                &(point_in_b.coords - information.b_from_a.translation()),
            ),
        })
    }
}

/// The coordinate axis that is most nearly perpendicular to a direction.
fn axis_across(direction: &Vector3<f64>) -> Vector3<f64> {
    let mut across = Vector3::zeros();
    across[direction.iamin()] = 1.0;
    across
}
