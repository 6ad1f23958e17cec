//! Who may ask the daemon: bearers of tokens, each as far as its role goes, until it is revoked.

use std::path::Path;

use crate::program::plumb;
use crate::served::Served;

const PLAIN: &str = "s3cret-token-of-the-test";

/// What `plumb token` prints; it must succeed.
fn token(arguments: &[&str], file: &Path) -> String {
    let file = file.display().to_string();
    let done = plumb([&["token"], arguments, &["--file", &file]].concat());
    assert_eq!(done.code, Some(0), "{}", done.stderr);
    done.stdout.trim().to_owned()
}

fn serving(folder: &Path, file: &Path) -> Served {
    Served::start(folder, &format!("[server]\ntoken_file = {:?}\n", file.display().to_string()))
}

fn bearer(token: &str) -> String {
    format!("Bearer {token}")
}

#[test]
fn without_a_token_only_health_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let of_wall = token(&["add", "wall", "--role", "view"], &file);
    let served = serving(folder.path(), &file);
    assert_eq!(served.get("/healthz").status, 200);
    for path in ["/", "/v1/cameras", "/metrics", "/docs/", "/openapi.json", "/v1/events"] {
        let refused = served.get(path);
        assert_eq!(
            (refused.status, refused.media_type.as_str()),
            (401, "application/problem+json")
        );
    }
    let with = |header: (&str, &str)| served.get_with("/v1/cameras", &[header]).status;
    assert_eq!(with(("Authorization", &bearer(&of_wall))), 200);
    assert_eq!(with(("Authorization", "Bearer wrong")), 401);
    assert_eq!(served.get("/?token=wrong").status, 401);
}

#[test]
fn a_browser_carries_a_session_and_not_the_token() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("token");
    std::fs::write(&file, format!("{PLAIN}\n")).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    let served = serving(folder.path(), &file);
    let opened = served.get(&format!("/?token={PLAIN}"));
    assert_eq!((opened.status, opened.location.as_deref()), (303, Some("/")));
    let cookie = opened.cookie.unwrap();
    let port = served.address.rsplit_once(':').unwrap().1;
    assert!(cookie.starts_with(&format!("plumb_session_{port}=")), "{cookie}");
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    assert!(!cookie.contains(PLAIN), "{cookie}");
    let session = cookie.split(';').next().unwrap();
    let with = |cookie: &str| served.get_with("/v1/cameras", &[("Cookie", cookie)]).status;
    assert_eq!(with(&format!("a=b; {session}")), 200);
    assert_eq!(with(&session[..session.len() - 1]), 401);
    assert_eq!(with(&format!("plumb_session_{port}={PLAIN}")), 401);
}

#[test]
fn a_role_goes_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let roles = ["view", "operate", "approve"];
    let tokens = roles.map(|role| token(&["add", role, "--role", role], &file));
    assert_eq!(token(&["list"], &file), "view view\noperate operate\napprove approve");
    let served = serving(folder.path(), &file);
    let headers = tokens.each_ref().map(|token| bearer(token));
    let with = headers.each_ref().map(|header| [("Authorization", header.as_str())]);
    let seen = with.map(|with| served.get_with("/v1/sessions", &with).status);
    assert_eq!(seen, [200; 3]);
    let stopped = with.map(|with| served.post_with("/v1/sessions/none/stop", &with).status);
    assert_eq!(stopped, [403, 404, 404]);
    let approved = with.map(|with| served.post_with("/v1/calibrations/none/approve", &with).status);
    assert_eq!(approved, [403, 403, 404]);
}

#[test]
fn a_revoked_token_ends_with_the_next_hangup_and_its_browsers_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let [of_tablet, of_wall] = ["tablet", "wall"].map(|name| token(&["add", name], &file));
    let served = serving(folder.path(), &file);
    let cookie = served.get(&format!("/?token={of_tablet}")).cookie.unwrap();
    let session = cookie.split(';').next().unwrap();
    let by_session = || served.get_with("/v1/cameras", &[("Cookie", session)]).status;
    let by =
        |token: &str| served.get_with("/v1/cameras", &[("Authorization", &bearer(token))]).status;
    assert_eq!([by_session(), by(&of_tablet), by(&of_wall)], [200; 3]);
    token(&["revoke", "tablet"], &file);
    served.signal("HUP");
    // Each request is a wait of its own, until the file was read.
    let ended = (0..10_000).find(|_| by_session() == 401);
    assert!(ended.is_some(), "the session goes on");
    assert_eq!([by(&of_tablet), by(&of_wall)], [401, 200]);
}

#[test]
fn files_and_names_that_cannot_be_are_refused() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let path = file.display().to_string();
    token(&["add", "wall"], &file);
    let cases: [(&[&str], i32, &str); 4] = [
        (&["add", "wall"], 1, "`wall` has a token already"),
        (&["revoke", "hall"], 1, "`hall` has no token"),
        (&["add", "the wall"], 2, "`the wall` is no name"),
        (&["add", "hall", "--role", "root"], 2, "invalid value 'root'"),
    ];
    for (arguments, code, expected) in cases {
        let refused = plumb([&["token"], arguments, &["--file", &path]].concat());
        assert_eq!(refused.code, Some(code), "{}", refused.stderr);
        assert!(refused.stderr.contains(expected), "{}", refused.stderr);
        assert_eq!(refused.stderr.trim().lines().count(), 1, "{}", refused.stderr);
    }
    let config = folder.path().join("plumb.toml");
    let of = |content: &str, mode: u32| {
        std::fs::write(&file, content).unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).unwrap();
        std::fs::write(&config, format!("[server]\ntoken_file = {path:?}\n")).unwrap();
        let served = plumb(["serve", "--config", &config.display().to_string()]);
        assert_eq!(served.code, Some(2), "{}", served.stderr);
        served.stderr
    };
    assert!(of(PLAIN, 0o644).contains("can be read or changed by others (mode 644); chmod 600"));
    assert!(
        of("hunter2", 0o600).contains("can be guessed: at least 128 bits of entropy are needed")
    );
    assert!(of("", 0o600).contains("it is empty; `plumb token add` makes a token"));
    assert!(
        of("t\u{f6}ken-that-is-long-enough-to-be-one", 0o600)
            .contains("is not allowed in an HTTP header")
    );
}
