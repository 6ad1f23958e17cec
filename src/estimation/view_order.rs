//! The order in which views are solved: that of their places in the image, whatever the order in
//! which they are given. Halves of the views, folds of held-out views and the views that a
//! jackknife leaves out are drawn by order. In the order of files, the same thirteen photographs
//! gave a standard deviation of fx of 0.33 or of 0.56 px, depending on how they were listed.

use crate::estimation::camera_estimate::{CameraEstimate, ViewEstimate};
use crate::estimation::problem::{BoardView, CameraOptions, CameraProblem, CameraStart};
use crate::estimation::view_fault::ViewFault;

/// The views of one camera, ordered by the mean of their pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ViewOrder {
    /// The index of each view as given.
    given: Vec<usize>,
}

impl ViewOrder {
    /// Views with the same mean remain in the order given, so that the first of several copies is
    /// the original.
    pub(crate) fn of(problem: &CameraProblem) -> Self {
        Self::by(problem.views.len(), |view| mean_pixel(&problem.views[view]))
    }

    /// By a pixel of each view.
    pub(crate) fn by(views: usize, pixel: impl Fn(usize) -> [f64; 2]) -> Self {
        let pixels: Vec<[f64; 2]> = (0..views).map(pixel).collect();
        let by_x_then_y = |a: &usize, b: &usize| {
            let ([a_x, a_y], [b_x, b_y]) = (pixels[*a], pixels[*b]);
            a_x.total_cmp(&b_x).then(a_y.total_cmp(&b_y))
        };
        let mut given: Vec<usize> = (0..views).collect();
        given.sort_by(by_x_then_y);
        Self { given }
    }

    /// By the `position` of each view, which no two share.
    pub(crate) fn by_position(views: usize, position: impl Fn(usize) -> usize) -> Self {
        let mut given: Vec<usize> = (0..views).collect();
        given.sort_by_key(|view| position(*view));
        Self { given }
    }

    /// The position in this order of each view as given.
    pub(crate) fn positions(&self) -> Vec<usize> {
        let mut positions = vec![0; self.given.len()];
        for (position, view) in self.given.iter().enumerate() {
            positions[*view] = position;
        }
        positions
    }

    /// Anything by view, in this order.
    pub(crate) fn ordered<T: Clone>(&self, by_view: &[T]) -> Vec<T> {
        self.given.iter().map(|view| by_view[*view].clone()).collect()
    }

    /// The problem with its views in this order.
    pub(crate) fn problem(&self, problem: &CameraProblem) -> CameraProblem {
        CameraProblem { image_size: problem.image_size, views: self.ordered(&problem.views) }
    }

    /// The options, with the poses of the start in this order.
    pub(crate) fn options(&self, options: &CameraOptions) -> CameraOptions {
        let start = options.start.as_ref().map(|start| {
            let pose = |view: &usize| start.camera_from_board.get(*view).copied().flatten();
            CameraStart {
                camera_from_board: self.given.iter().map(pose).collect(),
                ..start.clone()
            }
        });
        CameraOptions { start, ..options.clone() }
    }

    /// An estimate of the problem in this order, with its views in the order given.
    pub(crate) fn as_given(&self, estimate: CameraEstimate) -> CameraEstimate {
        let mut views: Vec<(usize, ViewEstimate)> =
            self.given.iter().copied().zip(estimate.views).collect();
        for (_, view) in &mut views {
            if let Some(ViewFault::Copied { number }) = &mut view.fault {
                *number = self.given[*number - 1] + 1;
            }
        }
        views.sort_by_key(|(given, _)| *given);
        let views = views.into_iter().map(|(_, view)| view).collect();
        CameraEstimate { views, ..estimate }
    }
}

/// The mean of the view's pixels; infinite for one without corners.
pub(crate) fn mean_pixel(view: &BoardView) -> [f64; 2] {
    if view.correspondences.is_empty() {
        return [f64::INFINITY; 2];
    }
    let count = view.correspondences.len() as f64;
    let pixels = view.correspondences.iter().map(|corner| corner.pixel);
    let [x, y] = pixels.fold([0.0, 0.0], |[x, y], pixel| [x + pixel.x, y + pixel.y]);
    [x / count, y / count]
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::estimation::problem::Correspondence;
    use crate::geometry::pixel::{ImageSize, Pixel};

    fn problem() -> CameraProblem {
        let corner = |x: f64, y: f64| Correspondence {
            point_in_board: Point3::origin(),
            pixel: Pixel::new(x, y),
            std_px: 1.0,
        };
        let view = |name: &str, corners: &[[f64; 2]]| BoardView {
            name: name.to_owned(),
            correspondences: corners.iter().map(|[x, y]| corner(*x, *y)).collect(),
        };
        let views = vec![
            view("right", &[[80.0, 10.0], [100.0, 30.0]]),
            view("no corner", &[]),
            view("left, below", &[[10.0, 40.0]]),
            view("left, above", &[[0.0, 10.0], [20.0, 10.0]]),
            view("copy of the first", &[[80.0, 10.0], [100.0, 30.0]]),
        ];
        CameraProblem { image_size: ImageSize { width: 100, height: 50 }, views }
    }

    #[test]
    fn views_are_ordered_by_their_mean_pixels_and_copies_as_given() {
        let (problem, names) = (problem(), |problem: &CameraProblem| {
            problem.views.iter().map(|view| view.name.clone()).collect::<Vec<_>>()
        });
        let order = ViewOrder::of(&problem);
        let expected = ["left, above", "left, below", "right", "copy of the first", "no corner"];
        assert_eq!(names(&order.problem(&problem)), expected);
        assert_eq!(order.positions(), [2, 4, 1, 0, 3]);
        // A problem in this order keeps it.
        let again = ViewOrder::of(&order.problem(&problem));
        assert_eq!(again.positions(), [0, 1, 2, 3, 4]);
    }
}
