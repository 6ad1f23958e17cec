//! A configuration that holds, for those who run by it.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use crate::calibration::session_record::SessionRequest;
use crate::config::source::SourceConfig;
use crate::http::tokens::AccessTokens;
use crate::pipeline::recording::recording_retention::RecordingRetention;
use crate::store::Retention;

/// A configuration that holds: what it names was there when it was checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Where to listen. Default: 127.0.0.1:8600.
    pub listen: SocketAddr,
    /// One of them is what every request must carry. Default: none, which only a loopback address
    /// allows.
    pub tokens: Option<AccessTokens>,
    /// How long a stateless solve may take. Default: a minute.
    pub solve_time: Duration,
    /// What connections are secured with. Default: nothing.
    pub tls: Option<TlsFiles>,
    /// The folder of the database and the kept images. Default: `plumb-data`.
    pub store_path: PathBuf,
    /// What stays free of the disk that it is on, in bytes. Default: 100 million.
    pub least_free_bytes: u64,
    /// Which sessions are kept. Default: all of them. Approved calibrations and their sessions are
    /// kept in any case.
    pub retention: Retention,
    /// Which recordings are kept. Default: all of them.
    pub recording_retention: RecordingRetention,
    /// Whether a `good` calibration becomes the camera's current one by itself. Default: true.
    pub auto_approve: bool,
    /// What ROS 2 sees of it. Default: nothing.
    pub ros2: Ros2Config,
    /// The cameras, in the order of the file.
    pub cameras: Vec<CameraConfig>,
    /// The rigs, in the order of the file.
    pub rigs: Vec<RigConfig>,
}

/// What the graph of ROS 2 sees.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ros2Config {
    /// Whether results are published. Default: not.
    pub publish: bool,
    /// The DDS domain; `None` takes the environment's.
    pub domain_id: Option<u16>,
    /// What the service `start` begins. Default: it is refused.
    pub session: Option<SessionRequest>,
    /// Whether camera_info comes with each image too, with the image's stamp. Default: not.
    pub camera_info_with_images: bool,
    /// What rectified images show, by the P of camera_info: from 0, only valid pixels, to 1, all
    /// source pixels. Default: 0.
    pub alpha: f64,
}

/// Where the certificate is, and its key; both PEM.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsFiles {
    /// The server's certificate, and those that it is signed with.
    pub cert: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

/// Cameras that are fixed to each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigConfig {
    /// Its name, in addresses.
    pub name: String,
    /// The names of its cameras, two or more; the first is the rig's own frame.
    pub cameras: Vec<String>,
}

/// One camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraConfig {
    /// Its name, in addresses and topics.
    pub name: String,
    /// Where its frames come from.
    pub source: SourceConfig,
}

/// What the command line says louder than the file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Overrides {
    /// Where to listen. Default: as the file says.
    pub listen: Option<String>,
}
