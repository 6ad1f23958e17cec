//! The drift of a board that is held by hand.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};

/// The translation in meters and the rotation at `time_s` of a drift whose amplitudes on each axis
/// are `most_m` and `most_rad`, each a sine wave of its own frequency.
pub(super) fn tremor(
    time_s: f64,
    [most_m, most_rad]: [f64; 2],
) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let wave = |frequency_hz: f64, phase: f64| (TAU * frequency_hz * time_s + phase).sin();
    let shake = Vector3::new(wave(1.7, 0.0), wave(2.3, 1.0), wave(1.1, 2.0)) * most_m;
    let wobble = Vector3::new(wave(1.3, 3.0), wave(1.9, 4.0), wave(2.9, 5.0)) * most_rad;
    (shake, UnitQuaternion::from_scaled_axis(wobble))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_stays_within_its_limits_and_nears_them() {
        let [most_m, most_rad] = [2e-4, 5e-4];
        let at = |k: i32| tremor(f64::from(k) * 0.01, [most_m, most_rad]);
        let (mut farthest_m, mut farthest_rad) = (0.0_f64, 0.0_f64);
        for (shake, wobble) in (0..3000).map(at) {
            farthest_m = farthest_m.max(shake.amax());
            farthest_rad = farthest_rad.max(wobble.scaled_axis().amax());
        }
        assert!((0.99 * most_m..=most_m).contains(&farthest_m), "{farthest_m}");
        let within = (1.0 + 1e-9) * most_rad;
        assert!((0.99 * most_rad..=within).contains(&farthest_rad), "{farthest_rad}");
    }
}
