//! The daemon's configuration: TOML text → [`Written`] (what it says) → [`Config`] (what it means).
//!
//! Reading is separate from checking: [`Written::parse`] needs no file system, [`Written::check`]
//! checks that what is named exists. Every refusal names the key, the file and the line.
//! Relative paths are taken from the directory that the daemon runs in.
//!
//! ```toml
//! [server]
//! listen = "127.0.0.1:8600"      # default; an address that others can reach needs a token
//! token_file = "tokens"          # default: none; `plumb token add` writes it
//! solve_seconds = 60             # default; how long POST /v1/solve may compute
//! tls = { cert = "cert.pem", key = "key.pem" } # default: none, plain HTTP
//!
//! [store]
//! path = "plumb-data"            # default; made if it is not there
//! min_free_mb = 100              # default; with less of the disk free, sessions pause
//! keep_days = 90                 # default: all; sessions that began longer ago are deleted
//! keep_sessions = 500            # default: all; only this many, the newest, are kept
//! keep_mb = 20000                # default: all; the oldest are deleted when the store holds more
//! keep_recording_days = 30       # default: all; recordings that began longer ago are deleted
//! keep_recordings = 20           # default: all; only this many, the newest, are kept
//! keep_recordings_mb = 50000     # default: all; the oldest are deleted when all hold more
//!
//! [calibration]
//! auto_approve = true            # default; a `good` calibration becomes current by itself
//!
//! [ros2]                         # needs the cargo feature `ros2`
//! publish = true                 # default: false; results on the graph of ROS 2
//! domain_id = 0                  # default: ROS_DOMAIN_ID, or 0
//! session = { target = { kind = "chessboard", cols = 9, rows = 6, square_m = 0.025 } } # what the
//!                                # service `start` begins: the body of POST …/sessions; default: refused
//! camera_info_with_images = true # default: false; with each image, too, and with its stamp
//! alpha = 0.0                    # default: rectified, only valid pixels; 1: all source pixels
//!
//! [[camera]]
//! name = "front"                 # letters, digits, `-`, `_`; once each
//! source = { kind = "simulator" }
//!
//! [[rig]]                        # cameras that are fixed to each other; none unless given
//! name = "pair"                  # as for a camera, and no camera's
//! cameras = ["front", "side"]    # two or more
//! ```

mod error;
mod not_as_expected;
mod place;
mod settings;
pub mod source;
mod source_values;
pub mod token_file;
mod written;
mod written_source;

use std::path::Path;

pub use crate::config::error::ConfigError;
pub use crate::config::settings::{
    CameraConfig, Config, Overrides, RigConfig, Ros2Config, TlsFiles,
};
pub use crate::config::source::SourceConfig;
pub use crate::config::written::Written;

impl Config {
    /// Reads and checks the file at `path`; without one, every default and no camera.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn load(path: Option<&Path>, overrides: &Overrides) -> Result<Self, ConfigError> {
        let Some(path) = path else {
            return Written::parse("", Path::new("(no file)"))?.check(overrides);
        };
        let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable {
            file: path.to_owned(),
            detail: error.to_string(),
        })?;
        Written::parse(&text, path)?.check(overrides)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::pipeline::recording::recording_retention::RecordingRetention;
    use crate::store::Retention;

    fn refusal(text: &str) -> String {
        let file = Path::new("plumb.toml");
        let config =
            Written::parse(text, file).and_then(|written| written.check(&Overrides::default()));
        config.unwrap_err().to_string()
    }

    #[test]
    fn an_empty_file_means_every_default() {
        let config = Written::parse("", Path::new("plumb.toml"))
            .unwrap()
            .check(&Overrides::default())
            .unwrap();
        let expected = Config {
            listen: "127.0.0.1:8600".parse().unwrap(),
            tokens: None,
            solve_time: Duration::from_secs(60),
            tls: None,
            store_path: "plumb-data".into(),
            least_free_bytes: 100_000_000,
            retention: Retention::default(),
            recording_retention: RecordingRetention::default(),
            auto_approve: true,
            ros2: Ros2Config::default(),
            cameras: Vec::new(),
            rigs: Vec::new(),
        };
        assert_eq!(config, expected);
    }

    #[test]
    fn a_refusal_names_file_line_and_key() {
        let cases = [
            (
                "[server]\nlisten = \"127.0.0.1:1\"\nportt = 3\n",
                "plumb.toml:3: portt: unknown field `portt`",
            ),
            (
                "[ros2]\ndomain_id = 300\n",
                "plumb.toml:2: ros2.domain_id: 300 is not a valid domain; write 0 to 232",
            ),
            (
                "[ros2]\nalpha = 2\n",
                "plumb.toml:2: ros2.alpha: 2 is out of range; give a number from 0 to 1",
            ),
            (
                "[ros2]\nsession = { target = { kind = \"chessboard\", cols = 1, rows = 6, square_m = 0.025 } }\n",
                "plumb.toml:2: ros2.session: ",
            ),
            ("[servers]\n", "plumb.toml:1: servers: unknown field `servers`"),
            ("\n[server]\nlisten = 8600\n", "plumb.toml:3: listen: invalid type: integer `8600`"),
            (
                "[server]\nsolve_seconds = 0\n",
                "plumb.toml:2: server.solve_seconds: 0 is out of range; give 1 to 3600",
            ),
            (
                "[server]\nlisten = \"here\"\n",
                "plumb.toml:2: server.listen: `here` is not an address",
            ),
            (
                "[server]\nlisten = \"0.0.0.0:1\"\n",
                "plumb.toml:2: server.listen: `0.0.0.0:1` can be reached by others",
            ),
            (
                "[server]\ntoken_file = \"/not/there\"\n",
                "plumb.toml:2: server.token_file: `/not/there` cannot be read",
            ),
            (
                "[[camera]]\nsource = { kind = \"simulator\" }\n",
                "plumb.toml:1: name: missing field `name`",
            ),
            ("[[camera]]\nname = \"front\"\n", "plumb.toml:1: source: missing field `source`"),
            (
                "[[camera]]\nname = \"a/b\"\nsource = { kind = \"simulator\" }\n",
                "plumb.toml:2: camera.name: `a/b` is no",
            ),
            ("[store]\npath = \n", "plumb.toml:2: "),
        ];
        for (text, expected) in cases {
            let message = refusal(text);
            assert!(message.starts_with(expected), "{message}\nis not\n{expected}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
    }

    #[test]
    fn a_name_is_used_once() {
        let camera = "[[camera]]\nname = \"front\"\nsource = { kind = \"simulator\" }\n";
        let message = refusal(&camera.repeat(2));
        assert!(
            message.starts_with("plumb.toml:5: camera.name: `front` is used twice"),
            "{message}"
        );
    }

    #[cfg(feature = "ros2")]
    #[test]
    fn names_that_are_one_in_ros_are_refused_where_results_are_published() {
        let table =
            |kind: &str, name: &str, rest: &str| format!("[[{kind}]]\nname = \"{name}\"\n{rest}\n");
        let camera = |name: &str| table("camera", name, "source = { kind = \"simulator\" }");
        let cameras = camera("a-b") + &camera("a_b");
        let check = |text: &str| {
            Written::parse(text, Path::new("plumb.toml")).unwrap().check(&Overrides::default())
        };
        assert_eq!(check(&cameras).unwrap().cameras.len(), 2);
        let same = "are both `a_b` in ROS 2, whose names have no `-`; rename one";
        let publish = "[ros2]\npublish = true\n";
        let message = refusal(&(cameras + publish));
        assert_eq!(message, format!("plumb.toml:5: camera.name: `a_b` and `a-b` {same}"));
        let rig = table("rig", "a_b", "cameras = [\"a-b\", \"c\"]");
        let message = refusal(&(camera("a-b") + &camera("c") + &rig + publish));
        assert_eq!(message, format!("plumb.toml:8: rig.name: `a_b` and `a-b` {same}"));
    }

    #[test]
    fn the_command_line_is_louder_than_the_file_and_held_to_the_same_rule() {
        let listen = |address: &str| {
            let overrides = Overrides { listen: Some(address.to_owned()) };
            Written::parse("", Path::new("plumb.toml")).unwrap().check(&overrides)
        };
        assert_eq!(listen("127.0.0.1:0").unwrap().listen, "127.0.0.1:0".parse().unwrap());
        let message = listen("0.0.0.0:80").unwrap_err().to_string();
        assert!(message.starts_with("--listen 0.0.0.0:80: can be reached by others"), "{message}");
    }
}
