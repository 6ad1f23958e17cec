//! Folders of images as recordings: names in time order, one folder a sensor.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::imaging::image_file::{frame_from_file, is_image};
use crate::imaging::timestamp::HostTime;
use crate::recording::{RecordingError, natural_order};

/// Images in the natural order of their names; with the subfolders `color/`, `infrared/`,
/// `depth/`, those of equal names (endings aside) are taken together, and a name may be missing in
/// any of them.
#[derive(Debug)]
pub struct Folder {
    frame_sets: Vec<FolderFrameSet>,
    next: usize,
    interval_ns: f64,
}

/// The files of one frame set.
#[derive(Debug)]
struct FolderFrameSet {
    name: String,
    files: Vec<(SensorKind, PathBuf)>,
}

impl Folder {
    /// Lists the images in `path`, `fps` frame sets a second.
    ///
    /// # Errors
    /// [`RecordingError::NoImages`], or what the system refused.
    pub fn open(path: &Path, fps: f64) -> Result<Self, RecordingError> {
        let sensors: Vec<_> =
            SensorKind::ALL.into_iter().filter(|s| path.join(s.name()).is_dir()).collect();
        let frame_sets = if sensors.is_empty() {
            let files = images_in(path)?;
            files.into_iter().map(|file| FolderFrameSet::of_image(path.join(file))).collect()
        } else {
            frame_sets_of_sensors(path, &sensors)?
        };
        if frame_sets.is_empty() {
            return Err(RecordingError::NoImages { path: path.to_owned() });
        }
        Ok(Self::new(frame_sets, fps))
    }

    /// The images `files`, in the order given, as the frames of one color sensor, `fps` a
    /// second.
    pub fn from_files(files: Vec<PathBuf>, fps: f64) -> Self {
        Self::new(files.into_iter().map(FolderFrameSet::of_image).collect(), fps)
    }

    fn new(frame_sets: Vec<FolderFrameSet>, fps: f64) -> Self {
        Self { frame_sets, next: 0, interval_ns: 1e9 / fps }
    }

    /// Reads the next files; `None` after the last.
    ///
    /// # Errors
    /// [`RecordingError::Io`] for a file that cannot be read; the next call goes on with the one
    /// after it.
    pub fn next_frame_set(&mut self) -> Result<Option<FrameSet>, RecordingError> {
        let Some(frame_set) = self.frame_sets.get(self.next) else { return Ok(None) };
        let sequence = self.next;
        self.next += 1;
        let mut frames = Vec::with_capacity(frame_set.files.len());
        for (sensor, path) in &frame_set.files {
            let bytes = fs::read(path)
                .map_err(|source| RecordingError::Io { path: path.clone(), source })?;
            frames.push(frame_from_file(*sensor, bytes));
        }
        let utc_ns = (sequence as f64 * self.interval_ns).round() as i64;
        Ok(Some(FrameSet {
            sequence: sequence as u64,
            host_time: HostTime { utc_ns },
            device_time: None,
            name: Some(frame_set.name.clone()),
            frames,
        }))
    }

    /// Starts again at the first.
    pub fn rewind(&mut self) {
        self.next = 0;
    }

    /// The size of a sensor's first image; `None` without one that can be read.
    pub fn image_size(&self, sensor: SensorKind) -> Option<ImageSize> {
        let mut files = self.frame_sets.iter().flat_map(|frame_set| &frame_set.files);
        let (_, path) = files.find(|(kind, _)| *kind == sensor)?;
        Some(frame_from_file(sensor, fs::read(path).ok()?).size)
    }

    /// How many frame sets there are.
    pub fn frame_set_count(&self) -> usize {
        self.frame_sets.len()
    }
}

impl FolderFrameSet {
    fn of_image(path: PathBuf) -> Self {
        Self { name: path.display().to_string(), files: vec![(SensorKind::Color, path)] }
    }
}

/// Whether the folder at `path` has images, or folders of a sensor.
pub(super) fn holds_images(path: &Path) -> bool {
    SensorKind::ALL.into_iter().any(|sensor| path.join(sensor.name()).is_dir())
        || images_in(path).is_ok_and(|names| !names.is_empty())
}

fn frame_sets_of_sensors(
    path: &Path,
    sensors: &[SensorKind],
) -> Result<Vec<FolderFrameSet>, RecordingError> {
    let mut by_stem: BTreeMap<String, Vec<(SensorKind, PathBuf)>> = BTreeMap::new();
    for sensor in sensors {
        let folder = path.join(sensor.name());
        for file in images_in(&folder)? {
            let stem =
                Path::new(&file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
            by_stem.entry(stem).or_default().push((*sensor, folder.join(file)));
        }
    }
    let mut frame_sets: Vec<_> =
        by_stem.into_iter().map(|(name, files)| FolderFrameSet { name, files }).collect();
    frame_sets.sort_by(|a, b| natural_order(&a.name, &b.name));
    Ok(frame_sets)
}

/// The names of the images in `folder`, in natural order.
fn images_in(folder: &Path) -> Result<Vec<OsString>, RecordingError> {
    let refused = |source| RecordingError::Io { path: folder.to_owned(), source };
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(refused)? {
        let path = entry.map_err(refused)?.path();
        if let (true, Some(name)) = (is_image(&path), path.file_name()) {
            names.push(name.to_owned());
        }
    }
    names.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE: &[u8] = b"P5 1 1 255\n7";

    fn write(folder: &Path, name: &str) {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, IMAGE).unwrap();
    }

    #[test]
    fn equal_names_of_the_sensors_are_taken_together() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "color/2.ppm",
            "color/10.pgm",
            "depth/2.pgm",
            "depth/3.pgm",
            "infrared/10.pgm",
            "depth/notes.txt",
        ] {
            write(folder.path(), name);
        }
        let mut recording = Folder::open(folder.path(), 20.0).unwrap();
        let mut seen = Vec::new();
        while let Some(set) = recording.next_frame_set().unwrap() {
            let sensors: Vec<_> = set.frames.iter().map(|frame| frame.sensor.name()).collect();
            seen.push((set.name.unwrap(), set.host_time.utc_ns, sensors.join(" ")));
        }
        let expected = [
            ("2", 0, "color depth"),
            ("3", 50_000_000, "depth"),
            ("10", 100_000_000, "color infrared"),
        ];
        assert_eq!(
            seen,
            expected.map(|(name, ns, sensors)| (name.to_owned(), ns, sensors.to_owned()))
        );
    }

    /// As files from cameras and archives of another encoding have.
    #[cfg(unix)]
    #[test]
    fn a_name_that_is_no_text_is_an_image_as_any() {
        use std::os::unix::ffi::OsStrExt;
        let folder = tempfile::tempdir().unwrap();
        for name in [&b"a.pgm"[..], b"b\xff.pgm", b"c.pgm"] {
            fs::write(folder.path().join(std::ffi::OsStr::from_bytes(name)), IMAGE).unwrap();
        }
        let mut opened = Folder::open(folder.path(), 30.0).unwrap();
        let names: Vec<String> = std::iter::from_fn(|| opened.next_frame_set().unwrap())
            .map(|set| set.name.unwrap().rsplit_once('/').unwrap().1.to_owned())
            .collect();
        assert_eq!(names, ["a.pgm", "b\u{fffd}.pgm", "c.pgm"]);
    }

    #[test]
    fn a_folder_without_images_is_refused_with_what_it_needs() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "notes.txt");
        let line = Folder::open(folder.path(), 10.0).unwrap_err().to_string();
        assert!(line.contains("no images in this folder") && !line.contains('\n'), "{line}");
    }

    #[test]
    fn a_file_that_vanishes_is_one_error_and_the_rest_is_read() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "1.pgm");
        write(folder.path(), "2.pgm");
        let mut recording = Folder::open(folder.path(), 10.0).unwrap();
        fs::remove_file(folder.path().join("1.pgm")).unwrap();
        assert!(matches!(recording.next_frame_set(), Err(RecordingError::Io { .. })));
        assert_eq!(recording.next_frame_set().unwrap().unwrap().sequence, 1);
        assert!(recording.next_frame_set().unwrap().is_none());
    }
}
