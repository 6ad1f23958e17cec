//! Why the daemon did not run.

use std::net::SocketAddr;

use crate::http::tls::TlsError;
use crate::pipeline::fleet_error::FleetError;
use crate::store::StoreError;

/// Why the daemon did not run.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// The address is not to be had.
    #[error(
        "cannot listen on {address}: {source}; stop whoever has it (another plumb?), or give another --listen"
    )]
    Listen {
        /// What was asked for.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The certificate cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The cameras cannot be set going.
    #[error(transparent)]
    Fleet(#[from] FleetError),
    /// The system refused what every program needs.
    #[error("{what}: {source}")]
    System {
        /// What was attempted.
        what: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
}
