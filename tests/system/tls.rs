//! HTTP by TLS: a client that knows the certificate is answered, one in plain is answered what to
//! do, and a renewed certificate is taken without a restart.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::sync::Arc;

use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned, crypto};

use crate::served::Served;

/// Writes a new certificate for localhost and its key into `folder`.
fn renew(folder: &Path) -> CertificateDer<'static> {
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    std::fs::write(folder.join("cert.pem"), made.cert.pem()).unwrap();
    std::fs::write(folder.join("key.pem"), made.signing_key.serialize_pem()).unwrap();
    made.cert.der().clone()
}

fn config(folder: &Path) -> String {
    let file = |name: &str| folder.join(name).display().to_string();
    format!("[server]\ntls = {{ cert = {:?}, key = {:?} }}\n", file("cert.pem"), file("key.pem"))
}

fn connect(served: &Served) -> TcpStream {
    TcpStream::connect(served.address.rsplit_once('/').unwrap().1).unwrap()
}

fn request(path: &str) -> String {
    format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
}

/// What is answered to a client that trusts `certificate` alone; `None` where it is another's.
fn ask(served: &Served, certificate: &CertificateDer<'static>, path: &str) -> Option<String> {
    let mut roots = RootCertStore::empty();
    roots.add(certificate.clone()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("localhost").unwrap();
    let client = ClientConnection::new(Arc::new(config), name).unwrap();
    let mut stream = StreamOwned::new(client, connect(served));
    stream.write_all(request(path).as_bytes()).ok()?;
    let mut answer = Vec::new();
    // A server may end the connection without a farewell.
    let _ = stream.read_to_end(&mut answer);
    Some(String::from_utf8(answer).unwrap())
}

fn ask_in_plain(served: &Served, path: &str) -> String {
    let mut stream = connect(served);
    stream.write_all(request(path).as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn connections_are_secured_and_a_plain_one_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let certificate = renew(folder.path());
    let served = Served::start(folder.path(), &config(folder.path()));
    assert!(served.address.starts_with("https://"), "{}", served.address);
    let cameras = ask(&served, &certificate, "/v1/cameras").unwrap();
    assert!(cameras.starts_with("HTTP/1.1 200"), "{cameras}");
    let plain = ask_in_plain(&served, "/v1/cameras");
    assert!(plain.starts_with("HTTP/1.1 400") && plain.contains("write https://"), "{plain}");
    // The watchdog's question.
    assert!(ask_in_plain(&served, "/healthz").starts_with("HTTP/1.1 200"));
    let other = renew(tempfile::tempdir().unwrap().path());
    assert!(ask(&served, &other, "/v1/cameras").is_none(), "the client trusts anyone");
}

#[test]
fn a_renewed_certificate_is_taken_at_a_hangup_and_a_damaged_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let before = renew(folder.path());
    let served = Served::start(folder.path(), &config(folder.path()));
    assert!(ask(&served, &before, "/healthz").is_some());
    let after = renew(folder.path());
    assert!(ask(&served, &before, "/healthz").is_some(), "nobody has asked for it yet");
    served.signal("HUP");
    let taken = (0..10_000).find(|_| ask(&served, &after, "/healthz").is_some());
    assert!(taken.is_some(), "the certificate stays as it was");
    std::fs::write(folder.path().join("cert.pem"), "no certificate").unwrap();
    served.signal("HUP");
    assert!(ask(&served, &after, "/healthz").is_some());
}

#[test]
fn files_that_hold_no_certificate_are_refused_with_their_names() {
    let folder = tempfile::tempdir().unwrap();
    renew(folder.path());
    let file = folder.path().join("plumb.toml");
    std::fs::write(&file, config(folder.path())).unwrap();
    let refusal = || {
        let ended = crate::program::plumb(["serve", "--config", &file.display().to_string()]);
        assert_eq!(ended.code, Some(2), "{}", ended.stderr);
        ended.stderr
    };
    let key = std::fs::read(folder.path().join("key.pem")).unwrap();
    for (damaged, expected) in
        [("key.pem", "private key in PEM"), ("cert.pem", "certificate in PEM")]
    {
        std::fs::write(folder.path().join(damaged), "nothing of the kind").unwrap();
        let message = refusal();
        assert!(message.contains(damaged) && message.contains(expected), "{message}");
        assert!(message.contains("server.tls"), "{message}");
    }
    renew(folder.path());
    std::fs::write(folder.path().join("key.pem"), key).unwrap();
    assert!(refusal().contains("and its key cannot be used"));
}
