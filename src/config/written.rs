//! The file as written: its tables, and what they mean once they are checked.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;

use crate::calibration::session_record::SessionRequest;
use crate::config::error::ConfigError;
use crate::config::not_as_expected::{not_as_expected, one_line};
use crate::config::place::Place;
use crate::config::settings::{CameraConfig, Config, Overrides, RigConfig, Ros2Config, TlsFiles};
use crate::config::token_file::read_tokens;
use crate::config::written_source::{WrittenSource, check_domain};
use crate::document::session::StartDocument;
use crate::http::tls::{Certificate, TlsError};
use crate::http::tokens::AccessTokens;
use crate::pipeline::recording::recording_retention::RecordingRetention;
use crate::recording::ros2_results::ros_name;
use crate::store::Retention;

/// Where the daemon listens by default.
const DEFAULT_LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8600);

/// How long a stateless solve may take by default: ordinary ones take less than a second.
const DEFAULT_SOLVE_TIME: Duration = Duration::from_secs(60);

/// What stays free of the disk by default, in millions of bytes: room to end what runs.
const DEFAULT_MIN_FREE_MB: u32 = 100;

/// What a file says, with where it says so.
#[derive(Debug)]
pub struct Written {
    tables: Tables,
    place: Place,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Tables {
    #[serde(default)]
    server: ServerTable,
    #[serde(default)]
    store: StoreTable,
    #[serde(default)]
    calibration: CalibrationTable,
    #[serde(default)]
    ros2: Ros2Table,
    #[serde(default)]
    camera: Vec<CameraTable>,
    #[serde(default)]
    rig: Vec<RigTable>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
struct ServerTable {
    listen: Option<Spanned<String>>,
    token_file: Option<Spanned<PathBuf>>,
    solve_seconds: Option<Spanned<u64>>,
    tls: Option<Spanned<TlsFiles>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
struct StoreTable {
    path: Option<PathBuf>,
    min_free_mb: Option<u32>,
    keep_days: Option<u32>,
    keep_sessions: Option<u32>,
    keep_mb: Option<u32>,
    keep_recording_days: Option<u32>,
    keep_recordings: Option<u32>,
    keep_recordings_mb: Option<u32>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
struct CalibrationTable {
    auto_approve: Option<bool>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
struct Ros2Table {
    publish: Option<Spanned<bool>>,
    domain_id: Option<Spanned<u16>>,
    session: Option<Spanned<StartDocument>>,
    camera_info_with_images: Option<bool>,
    alpha: Option<Spanned<f64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
struct CameraTable {
    name: Spanned<String>,
    source: Spanned<WrittenSource>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
struct RigTable {
    name: Spanned<String>,
    cameras: Spanned<Vec<String>>,
}

impl Written {
    /// Reads `text`; `file` is what refusals call it. Reads nothing else.
    ///
    /// # Errors
    /// [`ConfigError::Refused`] for text that is not TOML, an unknown or missing key, a value of
    /// the wrong type.
    pub fn parse(text: &str, file: &Path) -> Result<Self, ConfigError> {
        let place = Place { file: file.to_owned(), text: text.to_owned() };
        match toml::from_str(text) {
            Ok(tables) => Ok(Self { tables, place }),
            Err(error) => Err(not_as_expected(&error, &place)),
        }
    }

    /// Whether it can be run as it stands, and what it then means.
    ///
    /// # Errors
    /// [`ConfigError`] for the first thing that cannot be: a name used twice, a file that is not
    /// there, an impossible size, an address that others can reach without a token.
    pub fn check(self, overrides: &Overrides) -> Result<Config, ConfigError> {
        let Self { tables, place } = self;
        let tokens = check_tokens(tables.server.token_file.as_ref(), &place)?;
        let listen =
            check_listen(tables.server.listen.as_ref(), tokens.is_some(), overrides, &place)?;
        let solve_time = check_solve_time(tables.server.solve_seconds.as_ref(), &place)?;
        let tls = check_tls(tables.server.tls, &place)?;
        let mut cameras: Vec<CameraConfig> = Vec::new();
        for table in &tables.camera {
            let taken: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
            let name = check_name("camera.name", &table.name, &taken, &place)?;
            let source = table.source.get_ref().check(&table.source.span(), &place)?;
            cameras.push(CameraConfig { name, source });
        }
        let rigs = check_rigs(&tables.rig, &cameras, &place)?;
        let store_path = tables.store.path.unwrap_or_else(|| PathBuf::from("plumb-data"));
        let least_free_bytes =
            1_000_000 * u64::from(tables.store.min_free_mb.unwrap_or(DEFAULT_MIN_FREE_MB));
        let auto_approve = tables.calibration.auto_approve.unwrap_or(true);
        let ros2 = check_ros2(&tables.ros2, &place)?;
        if ros2.publish {
            check_ros_names(&tables.camera, &tables.rig, &place)?;
        }
        let retention = Retention {
            days: tables.store.keep_days,
            sessions: tables.store.keep_sessions,
            megabytes: tables.store.keep_mb,
        };
        let recording_retention = RecordingRetention {
            days: tables.store.keep_recording_days,
            recordings: tables.store.keep_recordings,
            megabytes: tables.store.keep_recordings_mb,
        };
        Ok(Config {
            listen,
            tokens,
            solve_time,
            tls,
            store_path,
            least_free_bytes,
            retention,
            recording_retention,
            auto_approve,
            ros2,
            cameras,
            rigs,
        })
    }
}

fn check_solve_time(
    seconds: Option<&Spanned<u64>>,
    place: &Place,
) -> Result<Duration, ConfigError> {
    let Some(seconds) = seconds else { return Ok(DEFAULT_SOLVE_TIME) };
    if !(1..=3600).contains(seconds.get_ref()) {
        let problem = format!("{} is out of range; give 1 to 3600", seconds.get_ref());
        return Err(place.refuse(&seconds.span(), "server.solve_seconds", problem));
    }
    Ok(Duration::from_secs(*seconds.get_ref()))
}

fn check_tokens(
    file: Option<&Spanned<PathBuf>>,
    place: &Place,
) -> Result<Option<AccessTokens>, ConfigError> {
    let Some(file) = file else { return Ok(None) };
    let refuse = |problem: String| place.refuse(&file.span(), "server.token_file", problem);
    read_tokens(file.get_ref()).map(Some).map_err(|error| refuse(error.to_string()))
}

/// The files, if they hold a certificate and its key.
fn check_tls(
    files: Option<Spanned<TlsFiles>>,
    place: &Place,
) -> Result<Option<TlsFiles>, ConfigError> {
    let Some(files) = files else { return Ok(None) };
    let TlsFiles { cert, key } = files.get_ref();
    let refuse = |error: TlsError| place.refuse(&files.span(), "server.tls", error.to_string());
    Certificate::read(cert, key).map_err(refuse)?;
    Ok(Some(files.into_inner()))
}

fn check_listen(
    listen: Option<&Spanned<String>>,
    has_token: bool,
    overrides: &Overrides,
    place: &Place,
) -> Result<SocketAddr, ConfigError> {
    if let Some(text) = &overrides.listen {
        let refuse = |problem| ConfigError::Listen { listen: text.clone(), problem };
        return parse_listen(text, has_token).map_err(refuse);
    }
    let Some(listen) = listen else { return Ok(DEFAULT_LISTEN) };
    parse_listen(listen.get_ref(), has_token).map_err(|problem| {
        place.refuse(&listen.span(), "server.listen", format!("`{}` {problem}", listen.get_ref()))
    })
}

fn parse_listen(text: &str, has_token: bool) -> Result<SocketAddr, String> {
    let resolved = text.to_socket_addrs().ok().and_then(|mut addresses| addresses.next());
    let address = resolved.ok_or("is not an address; write HOST:PORT, as in 127.0.0.1:8600")?;
    if address.ip().is_loopback() || has_token {
        Ok(address)
    } else {
        Err("can be reached by others and needs a token; give server.token_file, or listen on 127.0.0.1".to_owned())
    }
}

fn check_ros2(table: &Ros2Table, place: &Place) -> Result<Ros2Config, ConfigError> {
    if let Some(publish) = table.publish.as_ref().filter(|publish| *publish.get_ref())
        && !cfg!(feature = "ros2")
    {
        let problem = "this plumb was built without ROS 2; build it with --features ros2";
        return Err(place.refuse(&publish.span(), "ros2.publish", problem));
    }
    check_domain("ros2.domain_id", table.domain_id.as_ref(), place)?;
    let request = |written: &Spanned<StartDocument>| {
        SessionRequest::try_from(written.get_ref()).map_err(|error| {
            place.refuse(&written.span(), "ros2.session", one_line(&error.to_string()))
        })
    };
    Ok(Ros2Config {
        publish: table.publish.as_ref().is_some_and(|publish| *publish.get_ref()),
        domain_id: table.domain_id.as_ref().map(|id| *id.get_ref()),
        session: table.session.as_ref().map(request).transpose()?,
        camera_info_with_images: table.camera_info_with_images.unwrap_or(false),
        alpha: check_alpha(table.alpha.as_ref(), place)?,
    })
}

/// Names that differ must do so on the graph too: two cameras would offer the same services.
fn check_ros_names(
    cameras: &[CameraTable],
    rigs: &[RigTable],
    place: &Place,
) -> Result<(), ConfigError> {
    let mut taken: BTreeMap<String, &str> = BTreeMap::new();
    let cameras = cameras.iter().map(|table| ("camera.name", &table.name));
    for (key, name) in cameras.chain(rigs.iter().map(|table| ("rig.name", &table.name))) {
        let (text, on_graph) = (name.get_ref(), ros_name(name.get_ref()));
        if let Some(other) = taken.get(&on_graph) {
            let problem = format!(
                "`{text}` and `{other}` are both `{on_graph}` in ROS 2, whose names have no `-`; rename one"
            );
            return Err(place.refuse(&name.span(), key, problem));
        }
        taken.insert(on_graph, text);
    }
    Ok(())
}

fn check_alpha(alpha: Option<&Spanned<f64>>, place: &Place) -> Result<f64, ConfigError> {
    let Some(alpha) = alpha else { return Ok(0.0) };
    if !(0.0..=1.0).contains(alpha.get_ref()) {
        let problem = format!("{} is out of range; give a number from 0 to 1", alpha.get_ref());
        return Err(place.refuse(&alpha.span(), "ros2.alpha", problem));
    }
    Ok(*alpha.get_ref())
}

fn check_rigs(
    tables: &[RigTable],
    cameras: &[CameraConfig],
    place: &Place,
) -> Result<Vec<RigConfig>, ConfigError> {
    let known: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    let mut rigs: Vec<RigConfig> = Vec::new();
    for table in tables {
        let taken: Vec<&str> =
            known.iter().copied().chain(rigs.iter().map(|rig| rig.name.as_str())).collect();
        let name = check_name("rig.name", &table.name, &taken, place)?;
        let members = table.cameras.get_ref();
        let refuse =
            |problem: String| Err(place.refuse(&table.cameras.span(), "rig.cameras", problem));
        if members.len() < 2 {
            return refuse("a rig has two cameras or more; name them".to_owned());
        }
        for (k, member) in members.iter().enumerate() {
            if !known.contains(&member.as_str()) {
                return refuse(format!(
                    "there is no camera `{member}`; name those of the [[camera]] tables"
                ));
            }
            if members[..k].contains(member) {
                return refuse(format!("`{member}` is named twice; name each camera once"));
            }
        }
        rigs.push(RigConfig { name, cameras: members.clone() });
    }
    Ok(rigs)
}

fn check_name(
    key: &str,
    name: &Spanned<String>,
    taken: &[&str],
    place: &Place,
) -> Result<String, ConfigError> {
    let text = name.get_ref();
    let refuse =
        |problem: &str| Err(place.refuse(&name.span(), key, format!("`{text}` {problem}")));
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if text.is_empty() || text.len() > 64 || !text.chars().all(allowed) {
        return refuse("is not a valid name; use 1 to 64 letters, digits, `-` and `_`");
    }
    if taken.contains(&text.as_str()) {
        return refuse("is used twice; each camera and each rig needs its own name");
    }
    Ok(text.clone())
}
