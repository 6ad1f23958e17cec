//! Detects views that show the board at the same place.

use crate::estimation::problem::{BoardView, Correspondence};

/// Two views are the same if all their corners are closer to each other than this, in standard
/// deviations of their difference: by chance, none of a few hundred differences is larger.
const SAME_VIEW_SIGMAS: f64 = 5.0;

/// Whether two images show the board at the same place: copies of an image, or a camera and a board
/// that stood still. Their model errors are the same, so they are not two independent views.
pub fn is_same(one: &BoardView, other: &BoardView) -> bool {
    let is_near = |(a, b): (&Correspondence, &Correspondence)| {
        let limit_px = SAME_VIEW_SIGMAS * a.std_px.hypot(b.std_px);
        a.point_in_board == b.point_in_board
            && (a.pixel.x - b.pixel.x).abs() <= limit_px
            && (a.pixel.y - b.pixel.y).abs() <= limit_px
    };
    one.correspondences.len() == other.correspondences.len()
        && one.correspondences.iter().zip(&other.correspondences).all(is_near)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::geometry::pixel::Pixel;

    fn view(offset_px: impl Fn(usize) -> f64) -> BoardView {
        let corner = |k: usize| Correspondence {
            point_in_board: Point3::new(0.03 * k as f64, 0.0, 0.0),
            pixel: Pixel::new(40.0 * k as f64 + offset_px(k), 100.0),
            std_px: 0.05,
        };
        BoardView { name: "a".to_owned(), correspondences: (0..8).map(corner).collect() }
    }

    #[test]
    fn copies_and_images_that_differ_by_noise_are_one_view() {
        let noise = view(|k| if k % 2 == 0 { 0.15 } else { -0.15 });
        assert!(is_same(&view(|_| 0.0), &view(|_| 0.0)) && is_same(&view(|_| 0.0), &noise));
        let moved = view(|k| if k == 7 { 1.0 } else { 0.0 });
        assert!(!is_same(&view(|_| 0.0), &moved));
        let mut fewer = view(|_| 0.0);
        fewer.correspondences.pop();
        assert!(!is_same(&view(|_| 0.0), &fewer));
    }
}
