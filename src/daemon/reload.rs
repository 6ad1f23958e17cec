//! SIGHUP: the configuration is read again, and the cameras that changed are exchanged; the others go on undisturbed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::config::{CameraConfig, Config, Overrides};
use crate::daemon::DaemonError;
use crate::daemon::sources::plan_of;
use crate::pipeline::fleet::Fleet;

/// What is running, and from where it was read.
pub(super) struct Reload {
    pub(super) fleet: Arc<Fleet>,
    pub(super) file: Option<PathBuf>,
    pub(super) config: Config,
}

impl Reload {
    /// Reads the configuration again with each SIGHUP from now on.
    #[cfg(unix)]
    pub(super) fn with_each_hangup(mut self) -> Result<(), DaemonError> {
        use tokio::signal::unix::{SignalKind, signal};
        let mut hangups = signal(SignalKind::hangup())
            .map_err(|source| DaemonError::System { what: "signals could not be listened to", source })?;
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
        // The command line went into what is running; the address does not change any more.
        let overrides = Overrides { listen: Some(self.config.listen.to_string()) };
        let config = match Config::load(Some(file), &overrides) {
            Ok(config) => config,
            Err(error) => {
                tracing::error!("the configuration is not taken, everything goes on as it was: {error}");
                return;
            }
        };
        let Changes { stopped, started } = changes(&self.config.cameras, &config.cameras);
        let plans = started.iter().map(plan_of).collect();
        if let Err(error) = self.fleet.replace_cameras(&stopped, plans) {
            tracing::error!("not every camera could be exchanged: {error}");
        }
        let kept = Config { cameras: config.cameras.clone(), ..self.config.clone() };
        if kept != config {
            tracing::warn!("only cameras change while plumb runs; what else changed holds from the next start");
        }
        tracing::info!(stopped = stopped.len(), started = started.len(), "configuration read again");
        self.config = kept;
    }
}

/// Which cameras go, and which come.
#[derive(Debug, PartialEq)]
struct Changes {
    stopped: Vec<String>,
    started: Vec<CameraConfig>,
}

fn changes(before: &[CameraConfig], after: &[CameraConfig]) -> Changes {
    let stopped = before.iter().filter(|camera| !after.contains(camera)).map(|camera| camera.name.clone());
    let started = after.iter().filter(|camera| !before.contains(camera)).cloned();
    Changes { stopped: stopped.collect(), started: started.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Written;

    fn cameras(text: &str) -> Vec<CameraConfig> {
        Written::parse(text, Path::new("plumb.toml")).unwrap().check(&Overrides::default()).unwrap().cameras
    }

    #[test]
    fn only_what_changed_is_exchanged() {
        let camera =
            |name: &str, seed: u32| format!("[[camera]]\nname=\"{name}\"\nsource={{kind=\"simulator\",seed={seed}}}\n");
        let before = cameras(&[camera("a", 1), camera("b", 1), camera("c", 1)].concat());
        let after = cameras(&[camera("a", 1), camera("b", 2), camera("d", 1)].concat());
        let Changes { stopped, started } = changes(&before, &after);
        assert_eq!(stopped, ["b", "c"]);
        assert_eq!(started.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>(), ["b", "d"]);
        assert_eq!(changes(&after, &after), Changes { stopped: Vec::new(), started: Vec::new() });
    }
}
