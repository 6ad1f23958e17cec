//! Errors of the store.

use std::path::PathBuf;

/// A store that cannot be opened, read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The folder cannot be made or used.
    #[error("store {}: {detail}; give a folder that can be written, with `path` in [store]", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system said.
        detail: String,
    },
    /// Another process has it open.
    #[error("store {}: in use by another plumb; stop that one, or give another `path` in [store]", path.display())]
    InUse {
        /// The database.
        path: PathBuf,
    },
    /// Written by a newer program.
    #[error(
        "store {}: has schema {found}, this program knows up to {known}; use the newer plumb, or give another `path` in [store]",
        path.display()
    )]
    Newer {
        /// The database.
        path: PathBuf,
        /// Its schema's version.
        found: i64,
        /// The newest version that is known here.
        known: i64,
    },
    /// Written by an older program, and only to be read.
    #[error(
        "store {}: has schema {found} and this program's is {known}; `plumb serve` brings it up to date",
        path.display()
    )]
    Older {
        /// The database.
        path: PathBuf,
        /// Its schema's version.
        found: i64,
        /// This program's.
        known: i64,
    },
    /// Not a database, that of another program, or a broken one; SQLite reports the same for a disk
    /// that cannot be read. No repair was tried yet.
    #[error(
        "store {}: damaged, or not a Plumb store: {detail}; check `dmesg` for disk errors, then run `plumb store repair`, or restore a backup",
        path.display()
    )]
    Damaged {
        /// The database.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// As [`StoreError::Damaged`], and a repair finds nothing in it that could be read.
    #[error(
        "store {}: not a Plumb store, or damaged beyond repair: {detail}; check `dmesg` for disk errors, then move the file away, or restore a backup",
        path.display()
    )]
    Irreparable {
        /// The database.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// A row that cannot be read as the type that it should contain.
    #[error("store: {row} cannot be read: {detail}; restore the store from an earlier backup")]
    Unreadable {
        /// Which row.
        row: String,
        /// What is wrong with it.
        detail: String,
    },
    /// Something that would not read back as it was given.
    #[error("store: {row} cannot be stored: {detail}")]
    Unstorable {
        /// What it is.
        row: String,
        /// What is wrong with it.
        detail: String,
    },
    /// There is no such row.
    #[error(
        "store: there is no {row}; see GET /v1/sessions and GET /v1/cameras/CAMERA/calibrations for those there are"
    )]
    Missing {
        /// What was asked for.
        row: String,
    },
    /// A row that may not be deleted.
    #[error("store: {row} cannot be deleted: {reason}")]
    Held {
        /// The row.
        row: String,
        /// Why it stays, and what can be done about it, if anything.
        reason: String,
    },
    /// Less of the disk would stay free than has to.
    #[error(
        "store {}: only {free_mb} MB are free, and {least_mb} MB must stay free; free some space, or lower `min_free_mb` in [store]",
        path.display()
    )]
    NoRoom {
        /// The folder.
        path: PathBuf,
        /// What is free, in millions of bytes.
        free_mb: u64,
        /// What is to stay free.
        least_mb: u64,
    },
    /// The database failed.
    #[error("store {}: {detail}; is the disk full, read-only or failing?", path.display())]
    Failed {
        /// The database.
        path: PathBuf,
        /// SQLite's message.
        detail: String,
    },
}
