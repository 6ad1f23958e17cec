//! SIGHUP: the configuration is read again, the cameras and rigs that changed are exchanged, and
//! tokens and certificate are those of the files; the others go on undisturbed. A session of a
//! camera that is exchanged goes on if the new one has the same source, and ends otherwise.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::sync::watch;

use crate::config::{CameraConfig, Config, Overrides, RigConfig};
use crate::daemon::error::DaemonError;
use crate::daemon::sources::{plan_of, rig_of};
use crate::http::Access;
use crate::http::tls::{Certificate, Tls};
use crate::pipeline::Exchange;
use crate::pipeline::fleet::Fleet;

/// What is running, and from where it was read.
pub(super) struct Reload {
    pub(super) fleet: Arc<Fleet>,
    pub(super) access: Arc<Access>,
    pub(super) tls: Option<Arc<Tls>>,
    pub(super) file: Option<PathBuf>,
    /// What the command line said.
    pub(super) overrides: Overrides,
    pub(super) config: Config,
    /// What runs, for who follows it.
    pub(super) running: watch::Sender<Config>,
}

impl Reload {
    /// Reads the configuration again with each SIGHUP from now on.
    #[cfg(unix)]
    pub(super) fn with_each_hangup(mut self) -> Result<(), DaemonError> {
        use tokio::signal::unix::{SignalKind, signal};
        let mut hangups = signal(SignalKind::hangup()).map_err(|source| DaemonError::System {
            what: "signals could not be listened to",
            source,
        })?;
        tokio::spawn(async move {
            while hangups.recv().await.is_some() {
                let Some(file) = self.file.clone() else { continue };
                // Stopping a camera waits for its threads.
                let reloaded = tokio::task::spawn_blocking(move || {
                    self.reload(&file);
                    self
                });
                match reloaded.await {
                    Ok(reload) => self = reload,
                    Err(_) => return,
                }
            }
        });
        Ok(())
    }

    /// Where there are no such signals, the configuration is read once.
    #[cfg(not(unix))]
    pub(super) fn with_each_hangup(self) -> Result<(), DaemonError> {
        Ok(())
    }

    fn reload(&mut self, file: &Path) {
        let config = match Config::load(Some(file), &self.overrides) {
            Ok(config) => config,
            Err(error) => {
                tracing::error!(
                    "the new configuration is rejected, and the old one stays in use: {error}"
                );
                return;
            }
        };
        let changes = Changes::between(&self.config, &config);
        let exchange = Exchange {
            stopped_rigs: changes.stopped_rigs.clone(),
            stopped_cameras: changes.stopped.clone(),
            cameras: changes.started.iter().map(plan_of).collect(),
            rigs: changes.started_rigs.iter().map(rig_of).collect(),
        };
        if let Err(error) = self.fleet.exchange(exchange) {
            tracing::error!("not all changes could be applied: {error}");
        }
        let cameras: Vec<&str> = config.cameras.iter().map(|camera| camera.name.as_str()).collect();
        let rigs: Vec<&str> = config.rigs.iter().map(|rig| rig.name.as_str()).collect();
        self.fleet.arrange(&cameras, &rigs);
        if config.tokens != self.config.tokens {
            self.access.replace(config.tokens.clone());
            tracing::info!("tokens read again");
        }
        self.read_certificate(&config);
        let kept = Config {
            tokens: config.tokens.clone(),
            cameras: config.cameras.clone(),
            rigs: config.rigs.clone(),
            ..self.config.clone()
        };
        if kept != config {
            tracing::warn!(
                "only cameras, rigs, tokens and the certificate are reloaded; other changes take effect at the next start"
            );
        }
        let count = |cameras: usize, rigs: usize| format!("{cameras} cameras, {rigs} rigs");
        let stopped = count(changes.stopped.len(), changes.stopped_rigs.len());
        let started = count(changes.started.len(), changes.started_rigs.len());
        tracing::info!(stopped, started, "configuration read again");
        self.running.send_replace(kept.clone());
        self.config = kept;
    }
}

impl Reload {
    /// Takes the certificate that is in the files now: it is renewed every few months.
    fn read_certificate(&self, config: &Config) {
        let (Some(tls), Some(files)) = (&self.tls, &config.tls) else { return };
        match Certificate::read(&files.cert, &files.key) {
            Ok(certificate) => tls.replace(certificate),
            Err(error) => tracing::error!("the certificate stays as it was: {error}"),
        }
    }
}

/// What goes, and what comes.
#[derive(Debug, PartialEq, Default)]
struct Changes {
    stopped: Vec<String>,
    started: Vec<CameraConfig>,
    stopped_rigs: Vec<String>,
    started_rigs: Vec<RigConfig>,
}

impl Changes {
    /// A rig of which a camera is exchanged is exchanged too: it borrows the new one then.
    fn between(before: &Config, after: &Config) -> Self {
        let goes = |camera: &&CameraConfig| !after.cameras.contains(camera);
        let stopped: Vec<String> =
            before.cameras.iter().filter(goes).map(|camera| camera.name.clone()).collect();
        let stays = |rig: &&RigConfig| {
            before.rigs.contains(rig)
                && after.rigs.contains(rig)
                && !rig.cameras.iter().any(|c| stopped.contains(c))
        };
        let stopped_rigs =
            before.rigs.iter().filter(|rig| !stays(rig)).map(|rig| rig.name.clone()).collect();
        let started_rigs = after.rigs.iter().filter(|rig| !stays(rig)).cloned().collect();
        let started = after
            .cameras
            .iter()
            .filter(|camera| !before.cameras.contains(camera))
            .cloned()
            .collect();
        Self { stopped, started, stopped_rigs, started_rigs }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Written;

    fn config(text: &[String]) -> Config {
        Written::parse(&text.concat(), Path::new("plumb.toml"))
            .unwrap()
            .check(&Overrides::default())
            .unwrap()
    }

    fn camera(name: &str, seed: u32) -> String {
        format!("[[camera]]\nname=\"{name}\"\nsource={{kind=\"simulator\",seed={seed}}}\n")
    }

    fn rig(name: &str, cameras: &[&str]) -> String {
        format!("[[rig]]\nname=\"{name}\"\ncameras={cameras:?}\n")
    }

    #[test]
    fn only_what_changed_is_exchanged() {
        let before = config(&[camera("a", 1), camera("b", 1), camera("c", 1)]);
        let after = config(&[camera("a", 1), camera("b", 2), camera("d", 1)]);
        let Changes { stopped, started, .. } = Changes::between(&before, &after);
        assert_eq!(stopped, ["b", "c"]);
        assert_eq!(
            started.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>(),
            ["b", "d"]
        );
        assert_eq!(Changes::between(&after, &after), Changes::default());
    }

    #[test]
    fn a_rig_is_exchanged_with_its_cameras() {
        let cameras = |of_c: u32| [camera("a", 1), camera("b", 1), camera("c", of_c)].concat();
        let before = config(&[
            cameras(1),
            rig("ab", &["a", "b"]),
            rig("bc", &["b", "c"]),
            rig("ca", &["c", "a"]),
        ]);
        let after = config(&[
            cameras(2),
            rig("ab", &["a", "b"]),
            rig("bc", &["b", "c"]),
            rig("ac", &["a", "c"]),
        ]);
        let Changes { stopped_rigs, started_rigs, .. } = Changes::between(&before, &after);
        assert_eq!(stopped_rigs, ["bc", "ca"]);
        assert_eq!(
            started_rigs.iter().map(|rig| rig.name.as_str()).collect::<Vec<_>>(),
            ["bc", "ac"]
        );
        let changed = config(&[
            cameras(1),
            rig("ab", &["b", "a"]),
            rig("bc", &["b", "c"]),
            rig("ca", &["c", "a"]),
        ]);
        let Changes { stopped, stopped_rigs, started_rigs, .. } =
            Changes::between(&before, &changed);
        assert_eq!((stopped.len(), stopped_rigs), (0, vec!["ab".to_owned()]));
        assert_eq!(started_rigs[0].cameras, ["b", "a"]);
    }
}
