//! The interface of every source of frames.

use std::time::Duration;

use crate::capture::error::CaptureError;
use crate::geometry::pose::Pose;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::FrameSet;

/// What yields frames.
pub trait FrameSource: Send {
    /// The next frames taken together, waiting at most `timeout` for them.
    ///
    /// # Errors
    /// [`CaptureError::TimedOut`] when none came in time (asking again is right),
    /// [`CaptureError::Ended`] after the last frame of a recording, [`CaptureError::Lost`] when the
    /// device went away (opening it again may help), and [`CaptureError::Failed`] when a person has
    /// to act.
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError>;

    /// The source's kind, name and properties.
    fn description(&self) -> SourceDescription;

    /// Frames lost before [`Self::next_frame`] since it was opened.
    fn losses(&self) -> Losses {
        Losses::default()
    }

    /// A session begins or ends: a device fixes what would invalidate a calibration (focus,
    /// exposure) and adapts its infrared emitter for the board; at the end it restores both.
    ///
    /// # Errors
    /// [`CaptureError`] when the device refuses; it goes on as before.
    fn calibrating(&mut self, _on: bool) -> Result<(), CaptureError> {
        Ok(())
    }

    /// Where a session asks for the board now, as camera_from_board: a simulated operator follows
    /// it.
    fn suggested(&mut self, _camera_from_board: Option<&Pose>) {}

    /// Which of focus, zoom or exposure differs from the session's setting, in words: the
    /// calibration may no longer hold.
    fn moved_since_calibrating(&self) -> Option<String> {
        None
    }
}

/// Opens a source, and opens it again after it was lost.
pub trait SourceOpener: Send {
    /// Opens it; the same device every time, wherever it is plugged in by then.
    ///
    /// # Errors
    /// [`CaptureError::Lost`] when it is not there now and may come by itself,
    /// [`CaptureError::Failed`] when a person has to act.
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError>;
}

impl<F: FnMut() -> Result<Box<dyn FrameSource>, CaptureError> + Send> SourceOpener for F {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        self()
    }
}

/// Frames that never came out of [`FrameSource::next_frame`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Losses {
    /// Gaps in the device's own count.
    pub missed: u64,
    /// Frames that the driver flagged as damaged, or gave without content.
    pub damaged: u64,
}

/// What a source says about itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SourceDescription {
    /// The kind of source, as in the configuration: `recording`, `simulator`, …
    pub kind: &'static str,
    /// What stays the same when it is opened again: a path, a serial number.
    pub identity: String,
    /// Frame sets a second, where that is known beforehand.
    pub fps: Option<f64>,
    /// How many frame sets there will be, where that is known beforehand.
    pub frame_set_count: Option<usize>,
    /// Whether every frame waits to be taken: then none may be skipped, and none is ever late.
    pub waits: bool,
    /// The device's own name.
    pub model: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// Where it is plugged in.
    pub bus: Option<String>,
    /// The calibration that it states itself.
    pub factory: FactoryCalibration,
    /// What it was set to, and how that differs from what was asked for, in words.
    pub mode: Option<String>,
}
