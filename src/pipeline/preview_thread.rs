//! Thread `preview-<camera>`: draws and encodes frames for the clients that watch, so that no other
//! thread waits for it.

use std::sync::Arc;

use crate::pipeline::guarded::guarded;
use crate::pipeline::live_camera::LiveCamera;

/// Draws frames until the camera ends.
pub(super) fn run(camera: &Arc<LiveCamera>) {
    while let Some(live) = camera.preview.slot.take() {
        let drawn = guarded(|| camera.preview.show(&live, &camera.preview_state()));
        match drawn {
            Ok(drawn) => camera.metrics.previews.with_label_values(&[&camera.name]).inc_by(drawn),
            Err(fault) => tracing::error!(camera = camera.name, "{fault}"),
        }
    }
}
