//! `plumb store`: checks, copies, repairs and prunes the daemon's store.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::{Failure, output};
use crate::config::{Config, Overrides};
use crate::document::time;
use crate::pipeline::recording::recording_retention::{
    RecordingRetention, prune_folder, recordings_folder,
};
use crate::store::{Retention, Store, StoreReader};

/// Check, back up, repair or prune the store of sessions and calibrations.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, clap::Subcommand)]
enum Task {
    /// Verify the checksum of every row and report damage; the daemon may be running.
    Check(Check),
    /// Copy the store as it is now to a new file; the daemon may be running.
    Backup(Backup),
    /// Move a damaged database aside and replace it with its readable rows.
    Repair(Repair),
    /// Delete old sessions with their images, and old recordings; calibrations are kept.
    Prune(Prune),
}

/// Which store.
#[derive(Debug, clap::Args)]
struct StorePlace {
    /// The store's folder [default: `path` in [store] of plumb.toml, else plumb-data].
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
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct Backup {
    #[command(flatten)]
    place: StorePlace,
    /// The file to write. If it is named plumb.sqlite in its own folder, that folder can be used as
    /// a store.
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
    /// Delete sessions that started more than this many days ago.
    #[arg(long, value_name = "N")]
    keep_days: Option<u32>,
    /// Keep only the newest N sessions.
    #[arg(long, value_name = "N")]
    keep_sessions: Option<u32>,
    /// Delete the oldest sessions until the database is at most this many megabytes.
    #[arg(long, value_name = "N")]
    keep_mb: Option<u32>,
    /// Delete recordings that started more than this many days ago.
    #[arg(long, value_name = "N")]
    keep_recording_days: Option<u32>,
    /// Keep only the newest N recordings.
    #[arg(long, value_name = "N")]
    keep_recordings: Option<u32>,
    /// Delete the oldest recordings until all together are at most this many megabytes.
    #[arg(long, value_name = "N")]
    keep_recordings_mb: Option<u32>,
    /// Only list what would be deleted.
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
        output::print_line(&format!("readable rows: {}, findings: {count}", found.rows))?;
    }
    match count {
        0 => Ok(()),
        _ => Err(Failure::failed(format!(
            "store {}: damaged places: {count}; `plumb store repair` rebuilds a damaged database from its readable rows; a row with a wrong checksum can only be restored from a backup",
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
        || "SQLite finds no damage, nothing was changed; `plumb store check` also verifies the checksum of every row".to_owned(),
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
            "no limit is given; give --keep-days, --keep-sessions or --keep-mb, or for recordings --keep-recording-days, --keep-recordings or --keep-recordings-mb",
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
