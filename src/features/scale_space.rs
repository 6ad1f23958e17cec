//! The Gaussian scale space of an image, octave by octave (Lowe 2004, section 3).

use crate::features::plane::Plane;
use crate::imaging::gray::GrayView;

/// The number of scales per octave at which extrema are searched (Lowe 2004, figure 3: most
/// repeatable).
pub(super) const SCALES: usize = 3;

/// The blur of the first plane of an octave, in its own pixels (Lowe 2004, section 3.3).
pub(super) const BASE_SIGMA: f64 = 1.6;

/// The blur that a photograph is assumed to have, in its pixels (Lowe 2004, section 3.3).
const CAMERA_SIGMA: f64 = 0.5;

/// Images with at most this many pixels, whose doubled side is no longer than [`LONGEST_SIDE`], are
/// doubled first, for the finest details; larger ones have enough keypoints without.
const DOUBLED_PIXELS: usize = 700_000;

/// Images with a side longer than this are halved first: details smaller than two pixels in them
/// are noise and sharpening.
pub(super) const LONGEST_SIDE: usize = 2400;

/// The least length of the shorter side of an octave: below it there is no room for a descriptor.
const SHORTEST_SIDE: usize = 24;

/// One octave: SCALES + 3 planes, each blurred 2^(1/SCALES) times as much as the one before.
pub(super) struct Octave {
    /// Pixel (x, y) of a plane is pixel (x, y) · spacing + offset of the image.
    pub spacing_px: f64,
    /// See `spacing_px`.
    pub offset_px: f64,
    pub gaussians: Vec<Plane>,
}

/// The blur of plane `k` of an octave, in its own pixels.
pub(super) fn sigma(k: f64) -> f64 {
    BASE_SIGMA * (k / SCALES as f64).exp2()
}

/// The octaves of `image` one after the other, each computed when requested; luma from 0 to 1.
pub(super) struct Octaves {
    next: Option<(Plane, f64, f64)>,
}

impl Octaves {
    pub fn of(image: GrayView<'_>) -> Self {
        let mut plane = Plane::zeros(image.width(), image.height());
        for (y, row) in plane.values.chunks_exact_mut(image.width().max(1)).enumerate() {
            for (value, pixel) in row.iter_mut().zip(image.row(y)) {
                *value = f32::from(*pixel) / 255.0;
            }
        }
        let (mut spacing, mut offset, mut blur) = (1.0, 0.0, CAMERA_SIGMA);
        // An image that would be halved at once must not be doubled: that only adds blur and an
        // offset of a quarter of a pixel.
        let is_short = 2 * plane.width.max(plane.height) <= LONGEST_SIDE;
        if plane.values.len() <= DOUBLED_PIXELS && is_short {
            plane = plane.doubled();
            (spacing, blur) = (0.5, 2.0 * CAMERA_SIGMA);
        }
        while plane.width.max(plane.height) > LONGEST_SIDE {
            plane = mean_of_four(&plane);
            offset += 0.5 * spacing;
            spacing *= 2.0;
        }
        if plane.width.min(plane.height) < SHORTEST_SIDE {
            return Self { next: None };
        }
        let base = plane.blurred((BASE_SIGMA * BASE_SIGMA - blur * blur).sqrt());
        Self { next: Some((base, spacing, offset)) }
    }
}

impl Iterator for Octaves {
    type Item = Octave;

    fn next(&mut self) -> Option<Octave> {
        let (base, spacing_px, offset_px) = self.next.take()?;
        let mut gaussians = vec![base];
        for k in 1..SCALES + 3 {
            let (from, to) = (sigma(k as f64 - 1.0), sigma(k as f64));
            gaussians.push(gaussians[k - 1].blurred((to * to - from * from).sqrt()));
        }
        let half = gaussians[SCALES].halved();
        if half.width.min(half.height) >= SHORTEST_SIDE {
            self.next = Some((half, 2.0 * spacing_px, offset_px));
        }
        Some(Octave { spacing_px, offset_px, gaussians })
    }
}

fn mean_of_four(plane: &Plane) -> Plane {
    let (width, height) = (plane.width / 2, plane.height / 2);
    let mut half = Plane::zeros(width, height);
    for (y, row) in half.values.chunks_exact_mut(width.max(1)).enumerate() {
        let (above, below) = (plane.row(2 * y), plane.row(2 * y + 1));
        for (x, value) in row.iter_mut().enumerate() {
            *value = 0.25 * (above[2 * x] + above[2 * x + 1] + below[2 * x] + below[2 * x + 1]);
        }
    }
    half
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::gray::GrayImage;

    #[test]
    fn images_are_doubled_or_halved_and_never_both() {
        // Width and height; the first octave's width, spacing and offset.
        let table = [
            ((640, 480), (1280, 0.5, 0.0)),
            ((1200, 500), (2400, 0.5, 0.0)),
            ((1241, 376), (1241, 1.0, 0.0)),
            ((376, 1241), (376, 1.0, 0.0)),
            ((2600, 100), (1300, 2.0, 0.5)),
        ];
        for ((width, height), expected) in table {
            let image = GrayImage::filled(width, height, 90);
            let first = Octaves::of(image.view()).next().expect("an octave");
            let found = (first.gaussians[0].width, first.spacing_px, first.offset_px);
            assert_eq!(found, expected, "{width}x{height}");
        }
    }

    #[test]
    fn images_of_single_lines_have_no_octaves() {
        for (width, height) in [(1, 2500), (2500, 1), (1, 1), (0, 0)] {
            let image = GrayImage::filled(width, height, 90);
            assert!(Octaves::of(image.view()).next().is_none(), "{width}x{height}");
        }
    }
}
