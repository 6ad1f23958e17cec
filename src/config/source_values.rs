//! The values that sources of several kinds take: paths, sizes, rates, and which keys there may be.

use std::ops::Range;
use std::path::PathBuf;

use toml::Spanned;

use crate::capture::mode::ModeRequest;
use crate::config::error::ConfigError;
use crate::config::place::Place;
use crate::config::written_source::WrittenSource;
use crate::geometry::pixel::ImageSize;

/// No camera sees more; a larger size is a slip of the keyboard.
const LARGEST_SIDE: u32 = 16_384;
/// An image every 17 minutes: seldomer ones make a session hopeless, and times between them
/// impossible to count.
const LOWEST_FPS: f64 = 0.001;
const HIGHEST_FPS: f64 = 1000.0;

impl WrittenSource {
    pub(super) fn existing_path(
        &self,
        span: &Range<usize>,
        place: &Place,
    ) -> Result<PathBuf, ConfigError> {
        let path = self.needed("path", self.path.as_ref(), span, place)?;
        let span = self.path.as_ref().map_or_else(|| span.clone(), Spanned::span);
        match std::fs::metadata(&path) {
            Ok(_) => Ok(path),
            Err(error) => {
                let problem = format!(
                    "`{}` cannot be opened: {error}; give an existing file or folder",
                    path.display()
                );
                Err(place.refuse(&span, "camera.source.path", problem))
            }
        }
    }

    pub(super) fn needed<T: Clone>(
        &self,
        key: &str,
        value: Option<&Spanned<T>>,
        span: &Range<usize>,
        place: &Place,
    ) -> Result<T, ConfigError> {
        value.map(|value| value.get_ref().clone()).ok_or_else(|| {
            let problem = format!("missing: a source of kind \"{}\" needs it", self.kind.get_ref());
            place.refuse(span, &format!("camera.source.{key}"), problem)
        })
    }

    pub(super) fn mode(&self, place: &Place) -> Result<ModeRequest, ConfigError> {
        let size = match (&self.width, &self.height) {
            (None, None) => None,
            (Some(width), Some(height)) => {
                for (key, side) in [("width", width), ("height", height)] {
                    if !(1..=LARGEST_SIDE).contains(side.get_ref()) {
                        let problem = format!(
                            "{} px is impossible; write 1 to {LARGEST_SIDE}",
                            side.get_ref()
                        );
                        return Err(place.refuse(
                            &side.span(),
                            &format!("camera.source.{key}"),
                            problem,
                        ));
                    }
                }
                Some(ImageSize::new(*width.get_ref(), *height.get_ref()))
            }
            (Some(side), None) => {
                return Err(place.refuse(
                    &side.span(),
                    "camera.source.height",
                    "missing: width is given",
                ));
            }
            (None, Some(side)) => {
                return Err(place.refuse(
                    &side.span(),
                    "camera.source.width",
                    "missing: height is given",
                ));
            }
        };
        Ok(ModeRequest {
            size,
            format: self.format.as_ref().map(|f| f.get_ref().clone()),
            fps: self.fps(place)?,
        })
    }

    pub(super) fn fps(&self, place: &Place) -> Result<Option<f64>, ConfigError> {
        let Some(fps) = &self.fps else { return Ok(None) };
        let value = *fps.get_ref();
        if (LOWEST_FPS..=HIGHEST_FPS).contains(&value) {
            return Ok(Some(value));
        }
        let problem = format!("impossible; write {LOWEST_FPS} to {HIGHEST_FPS} frames a second");
        Err(place.refuse(&fps.span(), "camera.source.fps", problem))
    }

    /// Refuses a key that another kind takes.
    pub(super) fn takes_only(&self, allowed: &[&str], place: &Place) -> Result<(), ConfigError> {
        let given = [
            ("device", self.device.as_ref().map(Spanned::span)),
            ("index", self.index.as_ref().map(Spanned::span)),
            ("name", self.name.as_ref().map(Spanned::span)),
            ("serial", self.serial.as_ref().map(Spanned::span)),
            ("path", self.path.as_ref().map(Spanned::span)),
            ("topic", self.topic.as_ref().map(Spanned::span)),
            ("depth", self.depth.as_ref().map(Spanned::span)),
            ("domain_id", self.domain_id.as_ref().map(Spanned::span)),
            ("pace", self.pace.as_ref().map(Spanned::span)),
            ("repeat", self.repeat.as_ref().map(Spanned::span)),
            ("seed", self.seed.as_ref().map(Spanned::span)),
            ("seat", self.seat.as_ref().map(Spanned::span)),
            ("width", self.width.as_ref().map(Spanned::span)),
            ("height", self.height.as_ref().map(Spanned::span)),
            ("format", self.format.as_ref().map(Spanned::span)),
            ("fps", self.fps.as_ref().map(Spanned::span)),
            ("controls", self.controls.as_ref().map(Spanned::span)),
            ("lock", self.lock.as_ref().map(Spanned::span)),
            ("operator", self.operator.as_ref().map(Spanned::span)),
            ("preset", self.preset.as_ref().map(Spanned::span)),
            ("emitter", self.emitter.as_ref().map(Spanned::span)),
        ];
        for (key, span) in given {
            if let (Some(span), false) = (span, allowed.contains(&key)) {
                let kind = self.kind.get_ref();
                let problem =
                    format!("unknown for kind \"{kind}\", which takes {}", allowed.join(", "));
                return Err(place.refuse(&span, &format!("camera.source.{key}"), problem));
            }
        }
        Ok(())
    }
}
