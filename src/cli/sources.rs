//! A command's sources as frame sets, in the given order: images, folders, quoted globs and
//! recordings.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};

use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::imaging::image_file::frame_from_file;
use crate::imaging::no_image::NoImage;
use crate::imaging::timestamp::HostTime;
use crate::recording::{ReadOptions, Recording, is_bag_folder, is_recording_file, natural_order};

/// What of a recording is read.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct TopicArgs {
    /// The camera's topic, or a prefix of it that ends at a slash, if the bag or MCAP file has
    /// several cameras; repeat for a depth topic whose name does not show which camera it belongs
    /// to
    #[arg(long = "topic", value_name = "TOPIC")]
    topics: Vec<String>,
    /// Use every frame of a recording, not only those that a live session would keep
    #[arg(long)]
    every_frame: bool,
}

impl TopicArgs {
    /// How a recording is opened.
    pub fn read_options(&self) -> ReadOptions {
        ReadOptions { topics: self.topics.clone(), ..ReadOptions::default() }
    }
}

/// A source, or one of its frame sets, that could not be read.
#[derive(Debug)]
pub struct Unreadable {
    /// The path, as it was given.
    pub path: String,
    /// One line with its name, what was wrong, and what to do.
    pub reason: String,
    /// Whether this is a frame set of which nothing is damaged, but its color image is missing.
    pub lacks_color: bool,
}

impl Unreadable {
    /// The source at `path`, or a part of it, with the `reason`.
    pub fn new(path: String, reason: String) -> Self {
        Self { path, reason, lacks_color: false }
    }
}

/// A frame set and its source.
#[derive(Debug)]
pub struct SourcedFrames {
    /// The frames.
    pub set: FrameSet,
    /// The recording that they are part of; `None` for an image that was given by itself or in a
    /// folder.
    pub recording: Option<String>,
    /// The folder whose subfolders contain its images.
    pub folder: Option<String>,
}

impl SourcedFrames {
    /// The error that they contain no image, with what is missing where.
    pub fn no_image(&self) -> NoImage {
        NoImage::of(&self.set).in_folder(self.folder.as_deref())
    }

    /// The image of `sensor`; for a camera without color, this is the infrared image. An image by
    /// itself may be of any sensor.
    ///
    /// # Errors
    /// If there is none, in one line.
    pub fn image_of(&self, sensor: SensorKind) -> Result<&Frame, String> {
        let other = match (sensor, self.set.frames.as_slice()) {
            (SensorKind::Color, _) => self.set.frame(SensorKind::Infrared),
            (_, [only]) if only.sensor.is_image() => Some(only),
            _ => None,
        };
        self.set.frame(sensor).or(other).ok_or_else(|| match sensor {
            SensorKind::Color => self.no_image().to_string(),
            sensor => format!("it holds no {} image beside the others", sensor.name()),
        })
    }

    /// The image's path; for a frame of a recording, the recording's path and the sequence number.
    pub fn path(&self) -> String {
        let numbered =
            || format!("{}#{}", self.recording.as_deref().unwrap_or_default(), self.set.sequence);
        self.set.name.clone().unwrap_or_else(numbered)
    }
}

/// The frame sets of all requested sources, one after the other. A source is opened only when it is
/// reached, so that paths may arrive one at a time. A source that cannot be read gives one error,
/// and then the next source follows.
pub struct FrameSets<'a> {
    paths: Box<dyn Iterator<Item = String> + Send + 'a>,
    open: Option<Opened>,
    images: VecDeque<PathBuf>,
    reading: ReadOptions,
    every_frame: bool,
}

struct Opened {
    path: String,
    recording: Recording,
    is_folder: bool,
}

impl<'a> FrameSets<'a> {
    /// The frame sets of the files, folders, globs and recordings in `paths`.
    pub fn new(paths: impl Iterator<Item = String> + Send + 'a) -> Self {
        Self {
            paths: Box::new(paths),
            open: None,
            images: VecDeque::new(),
            reading: ReadOptions::default(),
            every_frame: false,
        }
    }

    /// Selects what is read of recordings, according to `args`.
    #[must_use]
    pub fn reading(mut self, args: &TopicArgs) -> Self {
        self.reading = args.read_options();
        self.every_frame = args.every_frame;
        self
    }

    fn open_next(&mut self, path: String) -> Result<(), Unreadable> {
        let place = Path::new(&path);
        if place.is_dir() || is_recording(place) {
            let is_folder = place.is_dir() && !is_bag_folder(place);
            let recording = Recording::open(place, &self.reading)
                .map_err(|error| Unreadable::new(path.clone(), error.to_string()))?;
            self.open = Some(Opened { path, recording, is_folder });
        } else if !place.exists() && path.contains(['*', '?', '[']) {
            self.images.extend(files_of_glob(&path)?);
        } else {
            self.images.push_back(place.to_owned());
        }
        Ok(())
    }
}

impl Iterator for FrameSets<'_> {
    type Item = Result<SourcedFrames, Unreadable>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(path) = self.images.pop_front() {
                return Some(image(&path).map(|set| SourcedFrames {
                    set,
                    recording: None,
                    folder: None,
                }));
            }
            if let Some(opened) = &mut self.open {
                match opened.recording.next_frame_set() {
                    Ok(Some(mut set)) => {
                        let chosen = opened.is_folder || self.every_frame;
                        if set.name.is_none() && chosen {
                            set.name = Some(format!("{}#{}", opened.path, set.sequence));
                        }
                        let recording = (!chosen).then(|| opened.path.clone());
                        let folder = opened.is_folder.then(|| opened.path.clone());
                        return Some(Ok(SourcedFrames { set, recording, folder }));
                    }
                    Ok(None) => self.open = None,
                    // A recording that was cut off ends here; everything before has been returned.
                    Err(error) => {
                        let unreadable = Unreadable::new(opened.path.clone(), error.to_string());
                        self.open = self.open.take().filter(|opened| opened.is_folder);
                        return Some(Err(unreadable));
                    }
                }
                continue;
            }
            let path = self.paths.next()?;
            if let Err(unreadable) = self.open_next(path) {
                return Some(Err(unreadable));
            }
        }
    }
}

/// Whether `path` is a recording, judged by its name, or a folder that contains a bag.
pub fn is_recording(path: &Path) -> bool {
    is_recording_file(path) || is_bag_folder(path)
}

/// The files of a source that is a file, a glob or a folder of images, including those of sensors
/// in subfolders, in natural order.
pub(super) fn files_of(source: &str) -> Vec<PathBuf> {
    let place = Path::new(source);
    if !place.is_dir() {
        return match place.exists() {
            true => vec![place.to_owned()],
            false => files_of_glob(source).unwrap_or_default(),
        };
    }
    let within = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten();
        entries.filter_map(|entry| Some(entry.ok()?.path())).collect()
    };
    let sensors = SensorKind::ALL.iter().flat_map(|sensor| within(&place.join(sensor.name())));
    let mut files: Vec<PathBuf> =
        within(place).into_iter().chain(sensors).filter(|path| path.is_file()).collect();
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    files
}

fn image(path: &Path) -> Result<FrameSet, Unreadable> {
    let name = path.display().to_string();
    let bytes = fs::read(path).map_err(|error| {
        let reason = format!("{name}: cannot be read ({error}); check the path");
        Unreadable::new(name.clone(), reason)
    })?;
    let frames = vec![frame_from_file(SensorKind::Color, bytes)];
    Ok(FrameSet {
        sequence: 0,
        host_time: HostTime { utc_ns: 0 },
        device_time: None,
        name: Some(name),
        frames,
    })
}

fn files_of_glob(pattern: &str) -> Result<Vec<PathBuf>, Unreadable> {
    let unreadable = |reason| Unreadable::new(pattern.to_owned(), reason);
    let found = glob::glob(pattern)
        .map_err(|error| unreadable(format!("{pattern}: not a glob pattern ({error})")))?;
    let mut files: Vec<PathBuf> =
        found.filter_map(Result::ok).filter(|path| path.is_file()).collect();
    if files.is_empty() {
        return Err(unreadable(format!(
            "{pattern}: no file has such a name; check the pattern and the folder"
        )));
    }
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE: &[u8] = b"P5 1 1 255\n7";

    #[test]
    fn files_folders_and_globs_in_the_order_given() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).display().to_string();
        fs::create_dir(folder.path().join("more")).unwrap();
        for name in ["a10.pgm", "a9.pgm", "b.pgm", "more/c.pgm"] {
            fs::write(at(name), IMAGE).unwrap();
        }
        let paths = [at("b.pgm"), at("a*.pgm"), at("nothing*.pgm"), at("more"), at("gone.pgm")];
        let seen: Vec<_> = FrameSets::new(paths.into_iter())
            .map(|frames| frames.map(|frames| frames.path()).map_err(|unreadable| unreadable.path))
            .collect();
        let expected = [
            Ok(at("b.pgm")),
            Ok(at("a9.pgm")),
            Ok(at("a10.pgm")),
            Err(at("nothing*.pgm")),
            Ok(at("more/c.pgm")),
            Err(at("gone.pgm")),
        ];
        assert_eq!(seen, expected);
    }
}
