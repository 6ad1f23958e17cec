//! Recording in the background: the capture thread passes frame sets through a bounded queue to a
//! thread that writes them.

use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::FrameSet;
use crate::locks::lock;
use crate::pipeline::assembly::SharedFactory;
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::recording::recording_notes;
pub use crate::pipeline::recording::recording_status::{RecordingState, RecordingStatus};
use crate::recording::{McapWriter, RecordingError};
use crate::store::error::StoreError;

/// The most frame sets that wait for the disk; further ones are dropped.
const QUEUED_FRAME_SETS: usize = 64;

/// What a recording may still write after it has been asked to end: the chunk in memory, of about a
/// megabyte, and the index.
pub(in crate::pipeline) const UNWRITTEN_BYTES: u64 = 2_000_000;

/// How often a recording's note on disk is updated, in frame time.
const NOTE_EVERY_NS: i64 = 1_000_000_000;

/// The limits at which a recording ends by itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RecordingLimits {
    /// After this many seconds of frame time. Default: never.
    pub seconds: Option<f64>,
    /// Once the file has this size, in bytes. Default: never.
    pub bytes: Option<u64>,
}

/// Why a recording was not started or stopped.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecordError {
    /// No such camera is configured.
    #[error("there is no camera `{camera}`; see GET /v1/cameras for those there are")]
    UnknownCamera {
        /// The name that was asked for.
        camera: String,
    },
    /// A camera has one recording at a time.
    #[error(
        "camera `{camera}` is being recorded already, as {recording}; stop that recording first"
    )]
    Busy {
        /// The camera's name.
        camera: String,
        /// The recording that goes on.
        recording: String,
    },
    /// The file could not be begun or deleted.
    #[error("the recording could not be begun or deleted: {detail}")]
    File {
        /// What the system said.
        detail: String,
    },
    /// Less of the disk is free than has to stay free.
    #[error("{detail}")]
    NoRoom {
        /// What is free and what is to stay free.
        detail: String,
    },
    /// No such recording.
    #[error("there is no recording `{id}`; see GET /v1/recordings for those there are")]
    UnknownRecording {
        /// The id that was asked for.
        id: String,
    },
    /// It has not ended.
    #[error("recording {id} goes on; stop it first")]
    GoesOn {
        /// Its id.
        id: String,
    },
    /// It has ended.
    #[error("recording {id} has ended already")]
    Over {
        /// Its id.
        id: String,
    },
}

/// The link from a camera's frames to its newest recording since the daemon started.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct RecorderLink(Mutex<Option<Recorder>>);

/// The camera that is recorded.
pub(in crate::pipeline) struct RecordedCamera<'a> {
    pub(in crate::pipeline) name: &'a str,
    /// What its device states about its sensors, known from its first frame on.
    pub(in crate::pipeline) factory: &'a SharedFactory,
}

#[derive(Debug)]
struct Recorder {
    /// None once it has ended.
    frames: Option<SyncSender<Arc<FrameSet>>>,
    status: Arc<Mutex<RecordingStatus>>,
    thread: Option<JoinHandle<()>>,
}

impl RecorderLink {
    /// Begins a recording of `camera` in `folder`. `room` fails once no more of the disk is free
    /// than has to stay free.
    pub(in crate::pipeline) fn start(
        &self,
        camera: &RecordedCamera<'_>,
        folder: &Path,
        limits: RecordingLimits,
        room: impl Fn() -> Result<(), StoreError> + Send + 'static,
    ) -> Result<RecordingStatus, RecordError> {
        let RecordedCamera { name: camera, factory } = *camera;
        let mut link = lock(&self.0);
        if let Some(running) = link.as_ref().map(|recorder| lock(&recorder.status).clone())
            && running.state == RecordingState::Recording
        {
            return Err(RecordError::Busy { camera: camera.to_owned(), recording: running.id });
        }
        let failed = |detail: String| RecordError::File { detail };
        room().map_err(|full| RecordError::NoRoom { detail: full.to_string() })?;
        std::fs::create_dir_all(folder)
            .map_err(|e| failed(format!("{}: {e}", folder.display())))?;
        let id = ulid::Ulid::generate().to_string();
        let path = folder.join(format!("{id}.mcap"));
        let writer = McapWriter::create(&path, camera).map_err(|e| failed(e.to_string()))?;
        let status = RecordingStatus {
            id,
            camera: camera.to_owned(),
            path,
            state: RecordingState::Recording,
            reason: None,
            started_at_ns: utc_now_ns(),
            finished_at_ns: None,
            frame_sets: 0,
            dropped: 0,
            bytes: 0,
        };
        recording_notes::write(&status).map_err(|e| failed(e.to_string()))?;
        let shown = Arc::new(Mutex::new(status.clone()));
        let (frames, waiting) = sync_channel(QUEUED_FRAME_SETS);
        let (written, factory) = (Arc::clone(&shown), Arc::clone(factory));
        let thread = std::thread::Builder::new()
            .name(format!("record-{camera}"))
            .spawn(move || {
                let bounds = RecordingBounds { limits, room: &room };
                write_all(&waiting, writer, &factory, &bounds, &written);
            })
            .map_err(|e| failed(format!("no thread for it: {e}")))?;
        *link = Some(Recorder { frames: Some(frames), status: shown, thread: Some(thread) });
        Ok(status)
    }

    /// Offers a frame set to the recording, if there is one; waits for the disk if no frame may be
    /// dropped.
    pub(in crate::pipeline) fn offer(&self, frame_set: &Arc<FrameSet>, waits: bool) {
        let recording =
            |recorder: &Recorder| Some((recorder.frames.clone()?, Arc::clone(&recorder.status)));
        let Some((frames, status)) = lock(&self.0).as_ref().and_then(recording) else { return };
        // Sent after the lock was released, so that waiting for the disk blocks no other thread.
        let sent = match waits {
            true => frames.send(Arc::clone(frame_set)).map_err(|_| false),
            false => frames
                .try_send(Arc::clone(frame_set))
                .map_err(|error| matches!(error, TrySendError::Full(_))),
        };
        match sent {
            Ok(()) => {}
            Err(true) => lock(&status).dropped += 1,
            Err(false) => {
                let mut link = lock(&self.0);
                let same = link.as_mut().filter(|recorder| Arc::ptr_eq(&recorder.status, &status));
                same.into_iter().for_each(|recorder| recorder.frames = None);
            }
        }
    }

    /// Ends the recording and waits until its file is complete. Returns its last status, if there
    /// is one.
    pub(in crate::pipeline) fn finish(&self) -> Option<RecordingStatus> {
        let (thread, status) = {
            let mut link = lock(&self.0);
            let recorder = link.as_mut()?;
            recorder.frames = None;
            (recorder.thread.take(), Arc::clone(&recorder.status))
        };
        if let Some(thread) = thread {
            // If the thread panicked, the status is as the thread left it.
            let _ = thread.join();
        }
        let status = lock(&status).clone();
        Some(status)
    }

    /// The newest recording.
    pub(in crate::pipeline) fn status(&self) -> Option<RecordingStatus> {
        lock(&self.0).as_ref().map(|recorder| lock(&recorder.status).clone())
    }
}

/// What ends a recording by itself.
struct RecordingBounds<'a> {
    limits: RecordingLimits,
    /// Whether the disk has room for more.
    room: &'a dyn Fn() -> Result<(), StoreError>,
}

fn write_all(
    frames: &Receiver<Arc<FrameSet>>,
    mut writer: McapWriter,
    factory: &Mutex<FactoryCalibration>,
    bounds: &RecordingBounds<'_>,
    status: &Mutex<RecordingStatus>,
) {
    let path = lock(status).path.clone();
    let size = || std::fs::metadata(&path).map_or(0, |file| file.len());
    let mut began_ns = None;
    let mut noted_ns = None;
    let mut outcome: Result<Option<String>, RecordingError> = Ok(None);
    for frame_set in frames {
        let now_ns = frame_set.host_time.utc_ns;
        let stated = match noted_ns {
            Some(_) => Ok(()),
            None => writer.write_factory(&lock(factory).clone(), now_ns),
        };
        if let Err(error) = stated.and_then(|()| writer.write(&frame_set)) {
            outcome = Err(error);
            break;
        }
        let bytes = size();
        {
            let mut status = lock(status);
            status.frame_sets += 1;
            status.bytes = bytes;
        }
        if now_ns.saturating_sub(*noted_ns.get_or_insert(now_ns)) >= NOTE_EVERY_NS {
            noted_ns = Some(now_ns);
            // A note that cannot be written is no reason to end the recording.
            let _ = recording_notes::write(&lock(status).clone());
        }
        // Sessions need the space that stays free in order to end.
        if let Err(full) = (bounds.room)() {
            outcome = Ok(Some(full.to_string()));
            break;
        }
        let elapsed_s = now_ns.saturating_sub(*began_ns.get_or_insert(now_ns)) as f64 * 1e-9;
        if let Some(reached) = reached(bounds.limits, elapsed_s, bytes) {
            outcome = Ok(Some(reached));
            break;
        }
    }
    let finished = writer.finish();
    let mut status = lock(status);
    status.bytes = size();
    status.finished_at_ns = Some(utc_now_ns());
    (status.state, status.reason) = match outcome.and_then(|reason| finished.map(|()| reason)) {
        Ok(reason) => (RecordingState::Finished, reason),
        Err(error) => {
            (RecordingState::Failed, Some(format!("{error}; what was written until then stays")))
        }
    };
    let _ = recording_notes::write(&status);
}

fn reached(limits: RecordingLimits, elapsed_s: f64, bytes: u64) -> Option<String> {
    if let Some(seconds) = limits.seconds.filter(|seconds| elapsed_s >= *seconds) {
        return Some(format!("the limit of {seconds} s is reached"));
    }
    let limit = limits.bytes.filter(|limit| bytes >= *limit)?;
    Some(format!("the limit of {limit} bytes is reached"))
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use std::path::PathBuf;

    use super::*;
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::depth_encoding::DepthEncoding;
    use crate::imaging::frame::{Frame, PixelFormat, SensorKind};
    use crate::imaging::timestamp::HostTime;
    use crate::recording::{ReadOptions, Recording};

    fn frame_set(sequence: u64) -> Arc<FrameSet> {
        // Noise, which no compression makes smaller.
        let mut noise = rand_chacha::ChaCha8Rng::seed_from_u64(sequence);
        let mut bytes = vec![0; 640 * 480];
        noise.fill_bytes(&mut bytes);
        let bytes: Arc<[u8]> = bytes.into();
        let size = ImageSize::new(640, 480);
        let frame = Frame {
            sensor: SensorKind::Color,
            size,
            format: PixelFormat::Mono8,
            stride: 640,
            bytes,
        };
        let host_time =
            HostTime { utc_ns: 1_770_000_000_000_000_000 + sequence as i64 * 100_000_000 };
        Arc::new(FrameSet {
            sequence,
            host_time,
            device_time: None,
            name: None,
            frames: vec![frame],
        })
    }

    fn started(
        link: &RecorderLink,
        folder: &Path,
        limits: RecordingLimits,
    ) -> Result<RecordingStatus, RecordError> {
        let camera = RecordedCamera { name: "front", factory: &Arc::default() };
        link.start(&camera, folder, limits, || Ok(()))
    }

    fn read_back(path: &Path) -> Vec<u64> {
        let mut recording = Recording::open(path, &ReadOptions::default()).unwrap();
        std::iter::from_fn(|| recording.next_frame_set().unwrap()).map(|set| set.sequence).collect()
    }

    #[test]
    fn what_was_offered_is_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let link = RecorderLink::default();
        link.offer(&frame_set(0), true);
        let recording = started(&link, folder.path(), RecordingLimits::default()).unwrap();
        (1..100).for_each(|sequence| link.offer(&frame_set(sequence), true));
        let busy = started(&link, folder.path(), RecordingLimits::default()).unwrap_err();
        assert_eq!(busy, RecordError::Busy { camera: "front".into(), recording: recording.id });
        let finished = link.finish().unwrap();
        assert_eq!(
            (finished.state, finished.frame_sets, finished.dropped),
            (RecordingState::Finished, 99, 0)
        );
        assert_eq!(read_back(&finished.path), (1..100).collect::<Vec<_>>());
        link.offer(&frame_set(100), true);
        assert_eq!(link.status(), Some(finished));
    }

    #[test]
    fn a_limit_ends_it_with_a_whole_file() {
        for limits in [
            RecordingLimits { seconds: Some(0.95), bytes: None },
            RecordingLimits { seconds: None, bytes: Some(3_000_000) },
        ] {
            let folder = tempfile::tempdir().unwrap();
            let link = RecorderLink::default();
            started(&link, folder.path(), limits).unwrap();
            (0..60).for_each(|sequence| link.offer(&frame_set(sequence), true));
            let finished = link.finish().unwrap();
            assert_eq!(finished.state, RecordingState::Finished);
            assert!(finished.reason.unwrap().contains("is reached"));
            let read = read_back(&finished.path);
            assert!(read.len() >= 9 && read.len() < 20, "{}", read.len());
            assert_eq!(read.len() as u64, finished.frame_sets);
        }
    }

    /// As what the device states of itself while it is replayed live.
    #[test]
    fn what_the_device_states_is_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let link = RecorderLink::default();
        let factory = SharedFactory::default();
        let camera = RecordedCamera { name: "front", factory: &factory };
        link.start(&camera, folder.path(), RecordingLimits::default(), || Ok(())).unwrap();
        // A device that is opened only now.
        lock(&factory).depth_encoding = Some(DepthEncoding::metric(1e-4));
        link.offer(&frame_set(0), true);
        let finished = link.finish().unwrap();
        let recording = Recording::open(&finished.path, &ReadOptions::default()).unwrap();
        assert_eq!(recording.factory(), *lock(&factory));
    }

    /// `/dev/full` answers as a full disk does.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_ends_it_and_is_reported() {
        let path = PathBuf::from("/dev/full");
        let writer = McapWriter::create(&path, "front").unwrap();
        let status = Mutex::new(RecordingStatus {
            id: "1".to_owned(),
            camera: "front".to_owned(),
            path,
            state: RecordingState::Recording,
            reason: None,
            started_at_ns: 0,
            finished_at_ns: None,
            frame_sets: 0,
            dropped: 0,
            bytes: 0,
        });
        let (frames, waiting) = sync_channel(10);
        (0..10).for_each(|sequence| frames.send(frame_set(sequence)).unwrap());
        drop(frames);
        let limits = RecordingLimits::default();
        let bounds = RecordingBounds { limits, room: &|| Ok(()) };
        write_all(&waiting, writer, &Mutex::default(), &bounds, &status);
        let ended = lock(&status).clone();
        assert_eq!(ended.state, RecordingState::Failed);
        let reason = ended.reason.unwrap();
        assert!(reason.contains("No space left on device") && !reason.contains('\n'), "{reason}");
    }

    #[test]
    fn a_folder_that_cannot_be_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let refused =
            started(&RecorderLink::default(), &file.join("x"), RecordingLimits::default());
        assert!(matches!(refused, Err(RecordError::File { .. })));
    }
}
