//! TLS: the certificate, its key, and the detection of clients that do not use it.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, RwLock};

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

use crate::locks::{read, write};

/// The first byte of a TLS connection: a record of the handshake (RFC 8446, 5.1).
pub(super) const HANDSHAKE: u8 = 0x16;

/// Why a certificate and its key cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// The file is no PEM file, or does not contain what it must.
    #[error("`{}` holds no {what} in PEM: {source}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What it must hold.
        what: &'static str,
        /// What is wrong with it.
        source: pem::Error,
    },
    /// The key does not belong to the certificate, or is of an unsupported kind.
    #[error("`{}` and its key cannot be used: {source}", certificate.display())]
    Pair {
        /// The certificate's file.
        certificate: PathBuf,
        /// What is wrong with them.
        source: rustls::Error,
    },
}

/// A certificate and its key.
#[derive(Clone)]
pub struct Certificate(Arc<rustls::ServerConfig>);

impl fmt::Debug for Certificate {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Certificate(…)")
    }
}

impl Certificate {
    /// Reads a chain of certificates, the server's first, and the server's key, both PEM.
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn read(certificate: &Path, key: &Path) -> Result<Self, TlsError> {
        let unusable = |file: &Path, what| {
            let file = file.to_owned();
            move |source| TlsError::File { file, what, source }
        };
        let chain: Result<Vec<CertificateDer<'static>>, pem::Error> =
            CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect);
        let chain = chain
            .and_then(
                |chain| if chain.is_empty() { Err(pem::Error::NoItemsFound) } else { Ok(chain) },
            )
            .map_err(unusable(certificate, "certificate"))?;
        let key = PrivateKeyDer::from_pem_file(key).map_err(unusable(key, "private key"))?;
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config = rustls::ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
            .map_err(|source| TlsError::Pair { certificate: certificate.to_owned(), source })?;
        Ok(Self(Arc::new(config)))
    }
}

/// The certificate of a running daemon; it can be replaced.
#[derive(Debug)]
pub struct Tls(RwLock<Certificate>);

impl Tls {
    /// Starts with `certificate`.
    pub fn new(certificate: Certificate) -> Self {
        Self(RwLock::new(certificate))
    }

    /// Uses `certificate` for new connections.
    pub fn replace(&self, certificate: Certificate) {
        *write(&self.0) = certificate;
    }

    pub(super) fn acceptor(&self) -> TlsAcceptor {
        TlsAcceptor::from(Arc::clone(&read(&self.0).0))
    }
}
