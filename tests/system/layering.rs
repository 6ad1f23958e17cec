//! The architecture, as a test: which layer may name which.

use std::fs;
use std::path::{Path, PathBuf};

/// Each layer and the layers it may use, bottom to top.
const LAYERS: &[(&str, &[&str])] = &[
    ("locks", &[]),
    ("geometry", &[]),
    ("dds", &["locks"]),
    ("imaging", &["geometry"]),
    ("detection", &["geometry", "imaging"]),
    ("features", &["geometry", "imaging"]),
    ("estimation", &["geometry"]),
    ("calibration", &["geometry", "imaging", "estimation", "detection", "features"]),
    ("simulation", &["geometry", "imaging"]),
    ("recording", &["geometry", "imaging"]),
    ("capture", &["locks", "dds", "geometry", "imaging", "recording", "simulation"]),
    ("document", &["geometry", "imaging", "detection", "estimation", "calibration"]),
    ("export", &["geometry", "imaging", "calibration", "document"]),
    ("store", &["locks", "geometry", "imaging", "detection", "calibration", "document"]),
    (
        "pipeline",
        &[
            "locks",
            "geometry",
            "imaging",
            "detection",
            "estimation",
            "calibration",
            "recording",
            "capture",
            "document",
            "store",
        ],
    ),
    (
        "http",
        &[
            "locks",
            "geometry",
            "imaging",
            "estimation",
            "calibration",
            "document",
            "export",
            "store",
            "pipeline",
        ],
    ),
    ("graph", &["dds", "geometry", "calibration", "recording", "store", "pipeline"]),
];

/// What the files of a layer that are for its tests alone may use besides.
const IN_TESTS: &[(&str, &[&str])] = &[("pipeline", &["simulation"])];

/// The layers above all others, which no layer may name.
const TOP: &[&str] = &["config", "daemon", "cli"];
const ASYNC_ALLOWED: &[&str] = &["pipeline", "http", "graph"];
const SERDE_ALLOWED: &[&str] = &["document", "export", "store", "http"];
/// The only files that may contain `unsafe`: device bindings.
const UNSAFE_ALLOWED: &[&str] = &["src/capture/realsense/pixels.rs", "src/capture/v4l2/kernel.rs"];

#[test]
fn layers_only_use_layers_below() {
    for (layer, allowed) in LAYERS {
        for (file, line, text) in lines_of(layer) {
            let others = LAYERS.iter().map(|(other, _)| other).chain(TOP);
            for other in others.filter(|other| *other != layer && !allowed.contains(other)) {
                let in_tests = IN_TESTS.iter().any(|(of, may)| of == layer && may.contains(other));
                let named =
                    text.contains(&format!("crate::{other}")) && !(in_tests && is_for_tests(&file));
                assert!(!named, "{}:{line}: {layer} may not use {other}", file.display());
            }
        }
    }
}

#[test]
fn every_permission_is_used() {
    for (layer, allowed) in LAYERS {
        let code = code_of(layer, |file| !is_for_tests(file));
        for other in *allowed {
            let used = code.contains(&format!("crate::{other}"));
            assert!(used, "{layer} does not use {other}: take it off LAYERS and src/lib.rs");
        }
    }
    for (layer, allowed) in IN_TESTS {
        let code = code_of(layer, is_for_tests);
        for other in *allowed {
            let used = code.contains(&format!("crate::{other}"));
            assert!(used, "the tests of {layer} do not use {other}: take it off IN_TESTS");
        }
    }
    let all = |_: &Path| true;
    for layer in ASYNC_ALLOWED {
        let code = code_of(layer, all);
        let used = code.contains("async ") || code.contains("tokio::");
        assert!(used, "{layer} is not async: take it off ASYNC_ALLOWED");
    }
    for layer in SERDE_ALLOWED {
        let used = code_of(layer, all).contains("serde");
        assert!(used, "{layer} does not use serde: take it off SERDE_ALLOWED");
    }
    for file in UNSAFE_ALLOWED {
        let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
        assert!(text.contains("unsafe {"), "{file} has no unsafe: take it off UNSAFE_ALLOWED");
    }
}

#[test]
fn every_folder_is_a_layer_or_the_top() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for entry in fs::read_dir(src).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        let name = name.trim_end_matches(".rs");
        let known = LAYERS.iter().any(|(layer, _)| *layer == name) || TOP.contains(&name);
        assert!(known || ["lib", "main"].contains(&name), "src/{name}: in no layer");
    }
}

#[test]
fn below_the_pipeline_nothing_is_async_or_reads_a_clock() {
    for (layer, _) in LAYERS.iter().filter(|(layer, _)| !ASYNC_ALLOWED.contains(layer)) {
        for (file, line, text) in lines_of(layer) {
            let forbidden =
                ["async fn", "tokio::", "Instant::now", "SystemTime::now", "Timestamp::now"];
            // A source waits for its device, and paces a replay: it is the one place below that
            // meets a clock.
            let clock_allowed = *layer == "capture";
            for word in forbidden.iter().filter(|word| !(clock_allowed && word.contains("::now"))) {
                assert!(
                    !text.contains(word),
                    "{}:{line}: {layer} may not use {word}",
                    file.display()
                );
            }
        }
    }
}

#[test]
fn serde_stays_at_the_edges() {
    for (layer, _) in LAYERS.iter().filter(|(layer, _)| !SERDE_ALLOWED.contains(layer)) {
        for (file, line, text) in lines_of(layer) {
            assert!(
                !text.contains("serde"),
                "{}:{line}: {layer} may not use serde",
                file.display()
            );
        }
    }
}

#[test]
fn unsafe_only_in_device_files() {
    for (layer, _) in LAYERS {
        for (file, line, text) in lines_of(layer) {
            let code = text.split("//").next().unwrap();
            let named = UNSAFE_ALLOWED.iter().any(|allowed| file.ends_with(allowed));
            let uses = code.contains("unsafe ") || code.contains("allow(unsafe_code)");
            assert!(!uses || named, "{}:{line}: no unsafe here", file.display());
        }
    }
}

#[test]
fn imports_name_their_layer_plainly() {
    for (layer, _) in LAYERS {
        for (file, line, text) in lines_of(layer) {
            let hidden = text.contains("crate::{") || text.contains("super::super");
            assert!(
                !hidden,
                "{}:{line}: write one `use crate::layer::...` per layer",
                file.display()
            );
        }
    }
}

#[test]
fn every_pose_is_named_target_from_source() {
    for (layer, _) in LAYERS {
        for (file, line, text) in lines_of(layer) {
            let code = text.split("//").next().unwrap();
            for typed in [": Pose", ": &Pose", ": Option<Pose", ": Vec<Pose", ": &[Pose"] {
                let Some((name, rest)) = code.split_once(typed) else { continue };
                if rest.starts_with(|c: char| c.is_alphanumeric() || c == '_') {
                    continue; // another type, whose name only begins so
                }
                let name = name.rsplit(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap();
                let named = name.contains("_from_") || name == "other";
                assert!(named, "{}:{line}: name `{name}` as target_from_source", file.display());
            }
        }
    }
}

/// The code of the files of a layer that `takes`, without comments and without the tests at the end
/// of a file.
fn code_of(layer: &str, takes: impl Fn(&Path) -> bool) -> String {
    let mut code = String::new();
    for of_file in lines_of(layer).chunk_by(|(file, ..), (next, ..)| file == next) {
        if takes(&of_file[0].0) {
            let own = of_file.iter().take_while(|(.., text)| !text.ends_with("mod tests {"));
            code.extend(own.map(|(.., text)| format!("{}\n", text.split("//").next().unwrap())));
        }
    }
    code
}

/// Whether a file is compiled for tests alone: by its name, or as its folder declares it.
fn is_for_tests(file: &Path) -> bool {
    let name = file.file_stem().unwrap().to_str().unwrap();
    let declared = fs::read_to_string(file.with_file_name("mod.rs"))
        .is_ok_and(|folder| folder.contains(&format!("#[cfg(test)]\nmod {name};")));
    name.ends_with("tests") || declared
}

fn lines_of(layer: &str) -> Vec<(PathBuf, usize, String)> {
    let mut lines = Vec::new();
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    visit(&src.join(layer), &mut lines);
    assert!(!lines.is_empty(), "src/{layer} has no code");
    lines
}

fn visit(dir: &Path, lines: &mut Vec<(PathBuf, usize, String)>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            visit(&path, lines);
        } else if path.extension().is_some_and(|e| e == "rs") {
            let text = fs::read_to_string(&path).unwrap();
            lines
                .extend(text.lines().enumerate().map(|(i, l)| (path.clone(), i + 1, l.to_owned())));
        }
    }
}
