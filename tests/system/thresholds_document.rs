//! The document of detection's thresholds names every one of them, and its table no other.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use plumb::detection::thresholds::Thresholds;

const DOCUMENT: &str = "docs/detection/thresholds.md";
const REMEDY: &str = "run `cargo bench --bench thresholds`, or say that its table is older";

#[test]
fn every_threshold_is_in_its_document() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(DOCUMENT);
    let text = fs::read_to_string(path).unwrap();
    let known: BTreeSet<String> =
        Thresholds::entries().into_iter().map(|entry| entry.name).collect();
    let named: BTreeSet<&str> = text.split('`').skip(1).step_by(2).collect();
    let missing: Vec<&String> =
        known.iter().filter(|name| !named.contains(name.as_str())).collect();
    assert!(missing.is_empty(), "{DOCUMENT} does not name {missing:?}: {REMEDY}");
    let rows = text.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    let gone: Vec<&str> = rows.filter(|name| !known.contains(*name)).collect();
    assert!(gone.is_empty(), "{DOCUMENT} has rows of {gone:?}, which do not exist: {REMEDY}");
}
