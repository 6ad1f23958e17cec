//! Which process has a device open, as far as this user may see.

use std::fs;
use std::path::Path;

/// The processes that have `node` open, in words (`cheese (process 1234)`); `None` when none can be
/// seen. This process counts if it has the node open more than `own` times.
pub(super) fn holders_of(node: &Path, own: usize) -> Option<String> {
    let processes = fs::read_dir("/proc").ok()?;
    let ids =
        processes.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let mut ids: Vec<u32> = ids.collect();
    ids.sort_unstable();
    let holds = |id: &u32| open_count(*id, node) > if *id == std::process::id() { own } else { 0 };
    let words: Vec<String> = ids.into_iter().filter(holds).map(words).collect();
    (!words.is_empty()).then(|| words.join(" and "))
}

fn open_count(process: u32, node: &Path) -> usize {
    let Ok(descriptors) = fs::read_dir(format!("/proc/{process}/fd")) else { return 0 };
    descriptors
        .flatten()
        .filter(|link| fs::read_link(link.path()).is_ok_and(|target| target == node))
        .count()
}

fn words(process: u32) -> String {
    if process == std::process::id() {
        return "this process itself, for another camera".to_owned();
    }
    let name = fs::read_to_string(format!("/proc/{process}/comm")).unwrap_or_default();
    format!("{} (process {process})", name.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_file_is_seen_and_a_closed_one_is_not() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = fs::canonicalize(file.path()).unwrap();
        assert_eq!(
            holders_of(&path, 0).as_deref(),
            Some("this process itself, for another camera")
        );
        assert_eq!(holders_of(&path, 1), None);
        let path = file.into_temp_path();
        assert_eq!(holders_of(&fs::canonicalize(&path).unwrap(), 0), None);
    }
}
