//! `plumb store`: checks, copies, repairs and prunes the daemon's store.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::{Failure, output};
use crate::config::{Config, Overrides};
use crate::document::time;
use crate::pipeline::recording_retention::{RecordingRetention, prune_folder, recordings_folder};
use crate::store::{Retention, Store, StoreReader};

/// Checks, copies, repairs or prunes the store of sessions and calibrations.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, clap::Subcommand)]
enum Task {
    /// Reads every row against its checksum and says what is damaged; the daemon may be running.
    Check(Check),
    /// Copies the store as it is now to a new file; the daemon may be running.
    Backup(Backup),
    /// Moves a damaged database aside and puts what can be read of it in its place.
    Repair(Repair),
    /// Deletes old sessions with their images, and old recordings; calibrations stay.
    Prune(Prune),
}

/// Which store.
#[derive(Debug, clap::Args)]
struct StorePlace {
    /// The store's folder: `path` in [store] of plumb.toml, else plumb-data, unless given.
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    /// The daemon's configuration, which names the store.
    #[arg(long, value_name = "FILE", conflicts_with = "store")]
    config: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct Check {
    #[command(flatten)]
    place: StorePlace,
    /// Prints JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct Backup {
    #[command(flatten)]
    place: StorePlace,
    /// The file to write; named plumb.sqlite in a folder of its own it is a store by itself.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Repair {
    #[command(flatten)]
    place: StorePlace,
}

#[derive(Debug, clap::Args)]
struct Prune {
    #[command(flatten)]
    place: StorePlace,
    /// Deletes sessions that began longer ago, in days.
    #[arg(long, value_name = "N")]
    keep_days: Option<u32>,
    /// Keeps the newest so many sessions.
    #[arg(long, value_name = "N")]
    keep_sessions: Option<u32>,
    /// Deletes the oldest until the database holds no more, in millions of bytes.
    #[arg(long, value_name = "N")]
    keep_mb: Option<u32>,
    /// Deletes recordings that began longer ago, in days.
    #[arg(long, value_name = "N")]
    keep_recording_days: Option<u32>,
    /// Keeps the newest so many recordings.
    #[arg(long, value_name = "N")]
    keep_recordings: Option<u32>,
    /// Deletes the oldest recordings until all together hold no more, in millions of bytes.
    #[arg(long, value_name = "N")]
    keep_recordings_mb: Option<u32>,
    /// Only says what would be deleted.
    #[arg(long)]
    dry_run: bool,
}

/// Runs the command.
///
/// # Errors
/// When there is no store, when another process has it open and the task would change it, or when
/// it is damaged.
pub fn run(args: &Args) -> Result<(), Failure> {
    match &args.task {
        Task::Check(args) => check(args),
        Task::Backup(args) => backup(args),
        Task::Repair(args) => repair(args),
        Task::Prune(args) => prune(args),
    }
}

#[derive(Debug, Serialize)]
struct CheckDocument {
    readable_rows: u64,
    damage: Vec<String>,
}

fn check(args: &Check) -> Result<(), Failure> {
    let folder = folder_of(&args.place)?;
    let found = StoreReader::open(&folder).and_then(StoreReader::check).map_err(Failure::failed)?;
    let count = found.damage.len();
    if args.json {
        output::print_json(&CheckDocument {
            readable_rows: found.rows,
            damage: found.damage.clone(),
        })?;
    } else {
        found.damage.iter().try_for_each(|line| output::print_line(line))?;
        output::print_line(&format!("{} rows can be read, {count} findings", found.rows))?;
    }
    match count {
        0 => Ok(()),
        _ => Err(Failure::failed(format!(
            "store {}: damaged in {count} places; `plumb store repair` keeps what can be read",
            folder.display()
        ))),
    }
}

fn backup(args: &Backup) -> Result<(), Failure> {
    let folder = folder_of(&args.place)?;
    let reader = StoreReader::open(&folder).map_err(Failure::failed)?;
    reader.backup(&args.out).map_err(Failure::failed)?;
    output::print_line(&format!("{} is a copy of the store", args.out.display()))
}

fn repair(args: &Repair) -> Result<(), Failure> {
    let folder = folder_of(&args.place)?;
    // Fails if there is no store, so that none is created.
    drop(StoreReader::open(&folder).map_err(Failure::failed)?);
    let (_, report) = Store::open_or_repair(&folder, 0).map_err(Failure::failed)?;
    output::print_line(&report.map_or_else(
        || "the database is whole; nothing was changed".to_owned(),
        |report| report.to_string(),
    ))
}

fn prune(args: &Prune) -> Result<(), Failure> {
    let Prune { keep_days: days, keep_sessions: sessions, keep_mb: megabytes, dry_run, .. } = *args;
    let retention = Retention { days, sessions, megabytes };
    let of_recordings = RecordingRetention {
        days: args.keep_recording_days,
        recordings: args.keep_recordings,
        megabytes: args.keep_recordings_mb,
    };
    if retention == Retention::default() && of_recordings == RecordingRetention::default() {
        return Err(Failure::usage(
            "nothing says what to keep; give --keep-days, --keep-sessions or --keep-mb, or for recordings --keep-recording-days, --keep-recordings or --keep-recordings-mb",
        ));
    }
    let folder = folder_of(&args.place)?;
    drop(StoreReader::open(&folder).map_err(Failure::failed)?);
    let store = Store::open(&folder).map_err(Failure::failed)?;
    let now_ns = time::utc_ns(jiff::Timestamp::now());
    let pruned = store.prune(&retention, now_ns, dry_run).map_err(Failure::failed)?;
    if !dry_run {
        store.compact().map_err(Failure::failed)?;
    }
    let recordings = prune_folder(&recordings_folder(&folder), &of_recordings, now_ns, dry_run);
    let recordings = recordings.map_err(Failure::failed)?;
    let recorded_bytes: u64 = recordings.iter().map(|recording| recording.bytes).sum();
    let recordings: Vec<String> = recordings.into_iter().map(|recording| recording.id).collect();
    let what = if dry_run { "would be deleted" } else { "deleted" };
    for (noun, ids, bytes) in
        [("sessions", pruned.sessions, pruned.bytes), ("recordings", recordings, recorded_bytes)]
    {
        ids.iter().try_for_each(|id| output::print_line(id))?;
        output::print_line(&format!("{} {noun} of {} kB {what}", ids.len(), bytes / 1000))?;
    }
    Ok(())
}

fn folder_of(place: &StorePlace) -> Result<PathBuf, Failure> {
    if let Some(folder) = &place.store {
        return Ok(folder.clone());
    }
    let default = Path::new("plumb.toml");
    let file = place.config.as_deref().or_else(|| default.exists().then_some(default));
    let config = Config::load(file, &Overrides::default()).map_err(Failure::usage)?;
    Ok(config.store_path)
}
