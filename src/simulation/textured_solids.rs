//! Textured boxes, and their intersections with rays.

use nalgebra::{Point3, Vector3};

/// An axis-aligned box; each of its faces has its own texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TexturedBox {
    pub center: Point3<f64>,
    /// Half of its edge lengths.
    pub half: Vector3<f64>,
    /// The seed of its textures.
    pub salt: u64,
    /// Whether it is seen from inside, as a room is.
    pub is_room: bool,
}

/// The intersection of a ray with a face.
#[derive(Debug, Clone, Copy)]
pub(super) struct FaceHit {
    /// The factor of the ray's direction at the intersection.
    pub along: f64,
    /// Coordinates on the face.
    at: [f64; 2],
    salt: u64,
    /// The length of a pixel's footprint on the face, relative to that across the ray.
    slant: f64,
}

impl TexturedBox {
    /// The first intersection with the ray from `origin`, as a factor of the ray's direction, and
    /// the axis normal to the face. `inverse` has the inverses of the direction's coordinates.
    fn met(&self, origin: &Point3<f64>, inverse: &Vector3<f64>) -> Option<(f64, usize)> {
        let (mut enter, mut leave) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
        for k in 0..3 {
            let middle = (self.center[k] - origin[k]) * inverse[k];
            let reach = (self.half[k] * inverse[k]).abs();
            if middle - reach > enter.0 {
                enter = (middle - reach, k);
            }
            if middle + reach < leave.0 {
                leave = (middle + reach, k);
            }
        }
        let met = if self.is_room { leave } else { enter };
        (enter.0 <= leave.0 && met.0 > 0.0).then_some(met)
    }
}

/// The face that the ray from `origin` along `direction` meets first.
pub(super) fn nearest_face(
    solids: &[TexturedBox],
    origin: &Point3<f64>,
    direction: &Vector3<f64>,
) -> Option<FaceHit> {
    let inverse = direction.map(|coordinate| 1.0 / coordinate);
    let mut nearest: Option<(f64, usize, u64)> = None;
    for solid in solids {
        let Some((along, axis)) = solid.met(origin, &inverse) else { continue };
        if nearest.is_none_or(|(nearest, ..)| along < nearest) {
            nearest = Some((along, axis, solid.salt));
        }
    }
    let (along, axis, salt) = nearest?;
    let point = origin + direction * along;
    let [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
    let side = u64::from(direction[axis] > 0.0) + 2 * axis as u64;
    let slant = direction.norm() * inverse[axis].abs();
    Some(FaceHit { along, at: [point[u], point[v]], salt: salt * 8 + side, slant })
}

impl FaceHit {
    /// The number of the box, derived from the seed of its textures, which is different for each.
    pub fn solid(&self) -> u64 {
        self.salt / 8
    }

    /// The light from there, 0 to 1, for a pixel with this `footprint`: without details finer than
    /// the pixel, which would alias.
    pub fn light(&self, footprint: f64) -> f64 {
        texture(self.at, self.salt, footprint * self.slant)
    }
}

/// The frequency of the coarsest noise of a texture, in waves per length, and the factor from each
/// frequency to the next.
const COARSEST_WAVES: f64 = 1.3;
const OCTAVE_FACTOR: f64 = 2.1;
const OCTAVES: u64 = 8;

/// Noise of several frequencies. Details finer than a pixel are left out, because a pixel averages
/// over its area.
fn texture([u, v]: [f64; 2], salt: u64, footprint: f64) -> f64 {
    let (mut light, mut frequency) = (0.5, COARSEST_WAVES);
    for octave in 0..OCTAVES {
        let seen = (1.0 - 2.0 * frequency * footprint).clamp(0.0, 1.0);
        if seen <= 0.0 {
            break;
        }
        light +=
            0.42 * seen * (smooth_noise(u * frequency, v * frequency, salt * 16 + octave) - 0.5);
        frequency *= OCTAVE_FACTOR;
    }
    light.clamp(0.02, 0.98)
}

/// Values from 0 to 1 at the corners of a grid, smooth between them: the same for the same place
/// and `salt`.
///
/// ```
/// use plumb::simulation::smooth_noise;
///
/// assert_eq!(smooth_noise(2.0, -3.0, 7), smooth_noise(2.0, -3.0, 7));
/// assert!((smooth_noise(2.0, -3.0, 7) - smooth_noise(2.0 + 1e-6, -3.0, 7)).abs() < 1e-9);
/// ```
pub fn smooth_noise(x: f64, y: f64, salt: u64) -> f64 {
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (column, row) = (x.floor(), y.floor());
    let (fx, fy) = (smooth(x - column), smooth(y - row));
    let at = |dx: i64, dy: i64| corner(column as i64 + dx, row as i64 + dy, salt);
    let upper = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
    let lower = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
    upper * (1.0 - fy) + lower * fy
}

/// A value from 0 to 1, always the same for the same place.
fn corner(x: i64, y: i64, salt: u64) -> f64 {
    let mut bits = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ salt.wrapping_mul(0x1656_67b1_9e37_79f9);
    for _ in 0..2 {
        bits = (bits ^ (bits >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    (bits >> 40) as f64 / f64::from(1 << 24)
}
