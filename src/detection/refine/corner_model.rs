//! A parametric model of a blurred chessboard corner: two crossing edges, each with a Gaussian's
//! integral as profile.
//!
//! With u₁ and u₂ the distances to the two edges in units of the blur, ρ the correlation of the
//! blur across them (the cosine between their normals, for isotropic blur), and Φ₂ the bivariate
//! normal distribution, the pattern is t = 4Φ₂(u₁, u₂; ρ) − 2Φ(u₁) − 2Φ(u₂) + 1, in −1 … 1, here to
//! third order in ρ (the tetrachoric series: K. Pearson, 1900). The gray value is (level +
//! amplitude·t + gamma_term·(1 − t²))·(1 + gradient·x): `gamma_term` models a camera's gamma to
//! second order.

/// How many unknowns [`CornerModel`] has, in the order of [`CornerModel::moved_by`].
pub(super) const UNKNOWNS: usize = 9;
/// The first of the two unknowns that move the corner. They are the last ones, so that the block
/// that remains after eliminating all others is the corner's own.
pub(super) const OFFSETS: usize = UNKNOWNS - 2;

/// 1/σ of an edge that is blurred only by the pixels' own width, with a margin for sharpening
/// cameras. An edge midway between two rows of pixels does not show its width: without a limit its
/// sharpness would grow without bound, and its position would be undetermined.
const SHARPEST: f64 = 3.6;

/// One corner, in the pixels of its window and relative to the window's origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CornerModel {
    /// Where the edges cross.
    pub center: [f64; 2],
    /// Unit vectors along the two edges at the corner.
    pub along: [[f64; 2]; 2],
    /// 1/σ of the blur across each edge.
    pub sharpness: [f64; 2],
    /// Curvature of each edge, towards its normal, in 1/pixel.
    pub curvature: [f64; 2],
    /// Mean of black and white.
    pub level: f64,
    /// Half the difference of white and black; its sign says which diagonal is white.
    pub amplitude: f64,
    /// How far the gray value at an edge lies above the mean of black and white: a second-order
    /// gamma term.
    pub gamma_term: f64,
    /// Relative change of light per pixel.
    pub gradient: [f64; 2],
}

impl CornerModel {
    /// The normals of the edges: `along` rotated by +90° (x towards y).
    pub fn normals(&self) -> [[f64; 2]; 2] {
        self.along.map(|[x, y]| [-y, x])
    }

    /// Correlation of a round blur across the two edges.
    pub fn correlation(&self) -> f64 {
        self.along[0][0] * self.along[1][0] + self.along[0][1] * self.along[1][1]
    }

    /// How far blur displaces each curved edge along its normal: towards the center of curvature,
    /// by half the curvature times the variance of the blur along the edge, taken as that across
    /// the other edge.
    pub fn pull_of_blur(&self) -> [f64; 2] {
        [0, 1].map(|edge| {
            self.curvature[edge] / 2.0 / (self.sharpness[1 - edge] * self.sharpness[1 - edge])
        })
    }

    /// The displacement of `center` that moves the two edges by `offsets` along their normals.
    pub fn center_move(&self, offsets: [f64; 2]) -> [f64; 2] {
        let [a, b] = self.normals();
        let det = a[0] * b[1] - a[1] * b[0];
        [
            (offsets[0] * b[1] - offsets[1] * a[1]) / det,
            (a[0] * offsets[1] - b[0] * offsets[0]) / det,
        ]
    }

    /// The model after a step in the unknowns: rotation of each edge (radians), sharpness of each
    /// edge, level, amplitude, gamma term, offset of each edge along its normal. Steps beyond the
    /// linearization's range are cut short.
    pub fn moved_by(&self, step: &[f64; UNKNOWNS]) -> Self {
        let mut moved = *self;
        for edge in 0..2 {
            let angle = step[edge].clamp(-0.25, 0.25);
            let [x, y] = self.along[edge];
            let rotated = [x - angle * y, y + angle * x];
            let unit = 1.0 / length(rotated);
            moved.along[edge] = rotated.map(|v| v * unit);
            let sharpness = self.sharpness[edge];
            let kept = (sharpness + step[2 + edge]).clamp(0.6 * sharpness, 1.7 * sharpness);
            moved.sharpness[edge] = kept.min(SHARPEST);
        }
        moved.level += step[4];
        moved.amplitude += step[5];
        moved.gamma_term += step[6];
        let reach = 0.5 + 1.0 / self.sharpness[0].min(self.sharpness[1]);
        let [dx, dy] = self.center_move([step[OFFSETS], step[OFFSETS + 1]]);
        let short = (reach / length([dx, dy]).max(1e-12)).min(1.0);
        moved.center = [self.center[0] + short * dx, self.center[1] + short * dy];
        moved
    }

    /// Whether directions, blur, black and white are those of `other`, up to a share of `most`
    /// (radians for directions).
    pub fn is_like(&self, other: &Self, most: f64) -> bool {
        let alike = |edge: usize| {
            let ([ax, ay], [bx, by]) = (self.along[edge], other.along[edge]);
            (ax * by - ay * bx).abs() < most
                && (self.sharpness[edge] - other.sharpness[edge]).abs()
                    < most * other.sharpness[edge]
        };
        let near = |a: f64, b: f64| (a - b).abs() < most * other.amplitude.abs();
        alike(0)
            && alike(1)
            && near(self.level, other.level)
            && near(self.amplitude, other.amplitude)
    }

    /// The same model in samples of another size: from bins of `from` pixels to bins of `to`.
    pub fn rescaled(&self, from: f64, to: f64) -> Self {
        let scale = to / from;
        let sharpness = self.sharpness.map(|k| {
            let variance = from * from * (1.0 / (k * k) - 1.0 / 12.0) + to * to / 12.0;
            to / variance.max(0.08 * to * to).sqrt()
        });
        Self {
            center: self.center.map(|c| c / scale),
            sharpness,
            curvature: self.curvature.map(|c| c * scale),
            gradient: self.gradient.map(|g| g * scale),
            ..*self
        }
    }
}

/// A vector's length; `hypot` without its care for the largest and smallest numbers.
pub(super) fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}
