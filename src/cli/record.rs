//! `plumb record`: writes the frames of a configured camera to a recording.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::capture::{CaptureError, FrameSource};
use crate::cli::{Failure, output, progress};
use crate::config::{CameraConfig, Config, Overrides};
use crate::daemon::sources::opener_of;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::FrameSet;
use crate::recording::{McapWriter, RecordingError, RepairedRecording, Ros2Writer, repair};

/// The longest wait for a frame: between two waits, a request to stop is noticed.
const WAIT: Duration = Duration::from_millis(200);

/// Record a configured camera until its source ends, N seconds have passed, or Ctrl-C
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The camera's name in the configuration
    #[arg(long, value_name = "NAME", required_unless_present = "repair")]
    camera: Option<String>,
    /// The recording to write; with --ros2 a folder
    #[arg(long, value_name = "FILE.mcap", required_unless_present = "repair")]
    out: Option<PathBuf>,
    /// Record nothing; rebuild, in place, the index of a recording that was cut off
    #[arg(long, value_name = "FILE.mcap", conflicts_with_all = ["camera", "out", "ros2", "seconds"])]
    repair: Option<PathBuf>,
    /// Write a ROS 2 bag: a folder with an MCAP file and its metadata.yaml
    #[arg(long)]
    ros2: bool,
    /// How long to record, from the first frame on
    #[arg(long, value_name = "N", value_parser = positive_seconds)]
    seconds: Option<Duration>,
    /// The configuration, TOML
    #[arg(long, value_name = "FILE", default_value = "plumb.toml")]
    config: PathBuf,
    /// Print what was recorded as one JSON document
    #[arg(long)]
    json: bool,
}

impl Args {
    /// The camera's name; clap ensures that there is one unless a recording is repaired.
    fn camera(&self) -> &str {
        self.camera.as_deref().unwrap_or_default()
    }

    fn out(&self) -> &Path {
        self.out.as_deref().unwrap_or(Path::new(""))
    }
}

/// The recording being written.
enum Writer {
    Foxglove(McapWriter),
    Ros2(Ros2Writer),
}

impl Writer {
    fn create(args: &Args) -> Result<Self, RecordingError> {
        if args.ros2 {
            return Ros2Writer::create(args.out(), args.camera()).map(Self::Ros2);
        }
        McapWriter::create(args.out(), args.camera()).map(Self::Foxglove)
    }

    fn write(&mut self, set: &FrameSet) -> Result<(), RecordingError> {
        match self {
            Self::Foxglove(writer) => writer.write(set),
            Self::Ros2(writer) => writer.write(set),
        }
    }

    fn write_factory(
        &mut self,
        factory: &FactoryCalibration,
        utc_ns: i64,
    ) -> Result<(), RecordingError> {
        match self {
            Self::Foxglove(writer) => writer.write_factory(factory, utc_ns),
            Self::Ros2(writer) => writer.write_factory(factory, utc_ns),
        }
    }

    fn finish(self) -> Result<(), RecordingError> {
        match self {
            Self::Foxglove(writer) => writer.finish(),
            Self::Ros2(writer) => writer.finish(),
        }
    }
}

/// What was recorded.
#[derive(Debug, Serialize)]
struct Recorded<'a> {
    path: &'a Path,
    camera: &'a str,
    frame_sets: u64,
    /// Gaps in the source's count.
    lost: u64,
}

/// Runs the command.
///
/// # Errors
/// When there is no such camera, it cannot be opened or is lost, or the file cannot be written.
/// What was recorded until then is kept.
pub fn run(args: &Args) -> Result<(), Failure> {
    if let Some(path) = &args.repair {
        return repaired(path, args.json);
    }
    let config = Config::load(Some(&args.config), &Overrides::default()).map_err(Failure::usage)?;
    let camera = find_camera(&config, args)?;
    let of_camera =
        |error: &CaptureError| Failure::failed(format!("camera `{}`: {error}", args.camera()));
    let mut source = opener_of(&camera.source).open().map_err(|error| of_camera(&error))?;
    let mut writer = Writer::create(args).map_err(Failure::failed)?;
    let stop = stopped_by_signal()?;
    let mut recorded = Recorded { path: args.out(), camera: args.camera(), frame_sets: 0, lost: 0 };
    let outcome = record(source.as_mut(), &mut writer, &mut recorded, &stop, args.seconds);
    writer.finish().map_err(Failure::failed)?;
    outcome.map_err(|failure| {
        let line = failure.line().unwrap_or_default();
        Failure::failed(format!(
            "camera `{}`: {line}; {} frame sets are in {}",
            args.camera(),
            recorded.frame_sets,
            args.out().display()
        ))
    })?;
    if args.json {
        return output::print_json(&recorded);
    }
    let Recorded { frame_sets, lost, .. } = recorded;
    output::print_line(&format!(
        "{}: {frame_sets} frame sets of {}, {lost} lost",
        args.out().display(),
        args.camera()
    ))
}

fn repaired(path: &Path, json: bool) -> Result<(), Failure> {
    let repaired = repair(path).map_err(Failure::failed)?;
    let RepairedRecording { frame_sets, fault, original } = repaired;
    let fault = fault.map(|fault| fault.to_string());
    if json {
        return output::print_json(&serde_json::json!({
            "path": path, "frame_sets": frame_sets, "fault": fault, "original": original
        }));
    }
    let file = path.display();
    output::print_line(&match fault {
        None => format!("{file}: {frame_sets} frame sets, with its index"),
        Some(fault) => {
            let kept = original.map(|kept| format!("; it is kept as {}", kept.display()));
            let kept = kept.unwrap_or_default();
            format!("{file}: {frame_sets} frame sets kept, with an index; it was: {fault}{kept}")
        }
    })
}

fn record(
    source: &mut dyn FrameSource,
    writer: &mut Writer,
    recorded: &mut Recorded<'_>,
    stop: &AtomicBool,
    limit: Option<Duration>,
) -> Result<(), Failure> {
    let mut started: Option<Instant> = None;
    let mut next_sequence = None;
    let spinner = progress::spinner("recording");
    while !stop.load(Ordering::Relaxed) {
        if started.zip(limit).is_some_and(|(started, limit)| started.elapsed() >= limit) {
            break;
        }
        let set = match source.next_frame(WAIT) {
            Ok(set) => set,
            Err(CaptureError::TimedOut { .. }) => continue,
            Err(CaptureError::Ended) => break,
            Err(error) => return Err(Failure::failed(error)),
        };
        if started.is_none() {
            started = Some(Instant::now());
            let factory = source.description().factory;
            writer.write_factory(&factory, set.host_time.utc_ns).map_err(Failure::failed)?;
        }
        recorded.lost += next_sequence.map_or(0, |next| set.sequence.saturating_sub(next));
        next_sequence = Some(set.sequence + 1);
        writer.write(&set).map_err(Failure::failed)?;
        recorded.frame_sets += 1;
        spinner.inc(1);
    }
    spinner.finish_and_clear();
    Ok(())
}

fn find_camera<'a>(config: &'a Config, args: &Args) -> Result<&'a CameraConfig, Failure> {
    let known: Vec<&str> = config.cameras.iter().map(|camera| camera.name.as_str()).collect();
    config.cameras.iter().find(|camera| camera.name == args.camera()).ok_or_else(|| {
        let file = args.config.display();
        Failure::usage(format!(
            "{file} has no camera `{}`; it has {}",
            args.camera(),
            known.join(", ")
        ))
    })
}

/// Set by the first Ctrl-C, so that the file is completed.
fn stopped_by_signal() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&stop);
    let refused = |error| Failure::failed(format!("signals could not be listened to: {error}"));
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(refused)?;
    let wait = move || {
        if runtime.block_on(tokio::signal::ctrl_c()).is_ok() {
            seen.store(true, Ordering::Relaxed);
        }
    };
    std::thread::Builder::new().name("ctrl-c".to_owned()).spawn(wait).map_err(refused)?;
    Ok(stop)
}

fn positive_seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| *seconds > 0.0);
    let duration = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    duration.ok_or_else(|| format!("`{text}` is not a number of seconds above 0"))
}
