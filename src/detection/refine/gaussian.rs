//! The profile of a blurred edge, in vector lanes: the Gaussian bell and its integral.

use pulp::Simd;

/// Beyond this many standard deviations (squared) the profile is flat in single precision.
const U_MAX_SQUARED: f32 = 25.6;
/// (2/π)^(1/16)·exp(−x/32) on 0 … 25.6, least relative error (1.8e-7).
const BELL: [f32; 6] =
    [0.985_986_97, -0.030_811_657, 4.812_505e-4, -4.984_702_7e-6, 3.691_658_5e-8, -1.632_075_6e-10];
/// 1 − erf(u/√2) as the bell times a polynomial of 1/(1 + p·u), the form of Abramowitz & Stegun,
/// 7.1.25, by least error (1.7e-6).
const TAIL_P: f32 = 0.271;
const TAIL: [f32; 4] = [0.188_474_54, 0.735_056_9, -0.712_649_05, 1.042_437_4];

/// For `u` in standard deviations across an edge: erf(u/√2), that is twice the normal distribution
/// less one, and its derivative, twice the normal density. Absolute error below 5e-6.
#[inline(always)]
pub(super) fn edge_profile<S: Simd>(simd: S, u: S::f32s) -> (S::f32s, S::f32s) {
    let of = |value: f32| simd.splat_f32s(value);
    let squared = simd.min_f32s(simd.mul_f32s(u, u), of(U_MAX_SQUARED));
    let mut bell = of(BELL[5]);
    for coefficient in BELL[..5].iter().rev() {
        bell = simd.mul_add_f32s(bell, squared, of(*coefficient));
    }
    for _ in 0..4 {
        bell = simd.mul_f32s(bell, bell);
    }
    let size = simd.abs_f32s(u);
    let t = simd.div_f32s(of(1.0), simd.mul_add_f32s(size, of(TAIL_P), of(1.0)));
    let mut tail = of(TAIL[3]);
    for coefficient in TAIL[..3].iter().rev() {
        tail = simd.mul_add_f32s(tail, t, of(*coefficient));
    }
    let step = simd.negate_mul_add_f32s(simd.mul_f32s(tail, t), bell, of(1.0));
    // The sign of u.
    let step = simd.xor_f32s(step, simd.xor_f32s(u, size));
    (step, bell)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Profiles<'a>(&'a [f32], &'a mut Vec<(f32, f32)>);

    impl pulp::WithSimd for Profiles<'_> {
        type Output = ();
        fn with_simd<S: Simd>(self, simd: S) {
            for &u in self.0 {
                let (step, slope) = edge_profile(simd, simd.splat_f32s(u));
                let lanes = S::F32_LANES as f32;
                self.1.push((
                    simd.reduce_sum_f32s(step) / lanes,
                    simd.reduce_sum_f32s(slope) / lanes,
                ));
            }
        }
    }

    #[test]
    fn profile_agrees_with_the_integral_of_the_bell() {
        let us: Vec<f32> = (-600..=600).map(|i| i as f32 / 100.0).collect();
        let mut profiles = Vec::new();
        pulp::Arch::new().dispatch(Profiles(&us, &mut profiles));
        let density = |u: f64| (-u * u / 2.0).exp() / std::f64::consts::TAU.sqrt();
        for (&u, &(step, slope)) in us.iter().zip(&profiles) {
            // Simpson's rule from 0 to u with steps fine enough for 1e-9.
            let n = 400;
            let h = f64::from(u) / f64::from(n);
            let at = |i: i32| {
                density(h * f64::from(i))
                    * if i == 0 || i == n { 1.0 } else { f64::from(2 + 2 * (i % 2)) }
            };
            let integral = 2.0 * h / 3.0 * (0..=n).map(at).sum::<f64>();
            assert!(
                (f64::from(step) - integral).abs() < 5e-6,
                "step at {u}: {step} for {integral}"
            );
            assert!((f64::from(slope) - 2.0 * density(f64::from(u))).abs() < 5e-6, "slope at {u}");
        }
    }
}
