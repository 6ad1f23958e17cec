//! How a computation is ended early whose result is no longer needed.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::estimation::error::EstimationError;

/// A request from outside to end a computation early, shared by all clones. A computation without a
/// request gives the same result with an interrupt as without. Default: cannot be requested.
///
/// Iterations test it before each pass over the corners. Their partial state is no result: the
/// caller returns [`EstimationError::Interrupted`] instead.
#[derive(Debug, Clone, Default)]
pub struct Interrupt(Option<Arc<AtomicBool>>);

impl Interrupt {
    /// One that can be requested.
    pub fn new() -> Self {
        Self(Some(Arc::default()))
    }

    /// Requests that the computations that hold a clone end.
    pub fn request(&self) {
        if let Some(requested) = &self.0 {
            requested.store(true, Ordering::Relaxed);
        }
    }

    /// Whether it was requested.
    pub fn is_requested(&self) -> bool {
        self.0.as_ref().is_some_and(|requested| requested.load(Ordering::Relaxed))
    }

    /// # Errors
    /// [`EstimationError::Interrupted`] once it was requested.
    pub fn check(&self) -> Result<(), EstimationError> {
        if self.is_requested() { Err(EstimationError::Interrupted) } else { Ok(()) }
    }
}

/// An interrupt is no part of a problem: options that differ in nothing else are equal.
impl PartialEq for Interrupt {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::camera::{CameraOptions, calibrate_camera};
    use crate::estimation::problem::CameraProblem;
    use crate::geometry::pixel::ImageSize;

    #[test]
    fn what_was_ended_early_says_so_and_nothing_else() {
        let problem = CameraProblem { image_size: ImageSize::new(640, 480), views: Vec::new() };
        let of = |interrupt: &Interrupt| {
            let options = CameraOptions { interrupt: interrupt.clone(), ..Default::default() };
            calibrate_camera(&problem, &options).unwrap_err()
        };
        let interrupt = Interrupt::new();
        let without = of(&Interrupt::default());
        assert_eq!(of(&interrupt), without);
        assert_ne!(without, EstimationError::Interrupted);
        interrupt.request();
        assert_eq!(of(&interrupt), EstimationError::Interrupted);
        Interrupt::default().request();
        assert!(!Interrupt::default().is_requested());
    }
}
