//! A fit with the board's shape and motion whose lens has no pole.

use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::effects::apply::with_effects;
use crate::estimation::lens_pole::{has_pole, with_smaller_denominators};
use crate::estimation::problem::CameraOptions;
use crate::estimation::start::Prepared;

/// A fit of one lens model, without and with effects.
pub(crate) struct FitWithEffects {
    /// With lens and poses alone.
    pub(crate) plain: CameraFit,
    /// With the board's shape and motion, where the views show them.
    pub(crate) full: CameraFit,
}

impl FitWithEffects {
    /// Continues `plain` with effects. Coefficients of a rational lens that do not cancel under the
    /// board as stated may do so once its shape is estimated; then the fit is made again with
    /// smaller denominators, as in [`fit_camera`].
    pub(crate) fn of(plain: CameraFit, prepared: &mut Prepared, options: &CameraOptions) -> Self {
        let size = prepared.image_size;
        let continued = |plain: CameraFit| {
            let full = with_effects(plain.clone(), size, options);
            Self { plain, full }
        };
        let model = plain.lens().model();
        let fit = continued(plain);
        if !has_pole(fit.full.lens(), size) {
            return fit;
        }
        let smaller = with_smaller_denominators(model, options);
        let again = smaller.iter().filter_map(|smaller| {
            let plain = fit_camera(prepared, model, smaller).ok()?;
            Some(continued(plain))
        });
        let mut sound = again.filter(|fit| !has_pole(fit.full.lens(), size));
        sound.next().unwrap_or(fit)
    }
}
