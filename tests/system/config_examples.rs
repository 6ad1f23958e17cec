//! The shipped configurations are read as they stand.

use std::path::Path;

use plumb::config::Written;

#[test]
fn every_shipped_configuration_reads() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut count = 0;
    let folders = ["config", "packaging/ros2"].map(|folder| root.join(folder));
    for entry in folders.iter().flat_map(|folder| std::fs::read_dir(folder).unwrap()) {
        let file = entry.unwrap().path();
        if file.extension().is_some_and(|extension| extension == "toml") {
            let text = std::fs::read_to_string(&file).unwrap();
            Written::parse(&text, &file).unwrap_or_else(|error| panic!("{error}"));
            count += 1;
        }
    }
    assert!(count >= 2, "no configurations in config/");
}
