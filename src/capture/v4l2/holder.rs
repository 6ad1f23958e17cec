//! Which process has a device open, as far as this user may see.

use std::fs;
use std::path::Path;

/// The processes that have `node` open, in words (`cheese (process 1234)`); `None` when none can be seen.
pub(super) fn holders_of(node: &Path) -> Option<String> {
    let processes = fs::read_dir("/proc").ok()?;
    let mut found: Vec<(u32, String)> = Vec::new();
    for entry in processes.flatten() {
        let Some(id) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else { continue };
        let Ok(descriptors) = fs::read_dir(entry.path().join("fd")) else { continue };
        let holds = |link: fs::DirEntry| fs::read_link(link.path()).is_ok_and(|target| target == node);
        if descriptors.flatten().any(holds) {
            let name = fs::read_to_string(entry.path().join("comm")).unwrap_or_default();
            found.push((id, name.trim().to_owned()));
        }
    }
    found.sort();
    let words = found.iter().map(|(id, name)| match *id == std::process::id() {
        true => "this daemon itself, for another camera".to_owned(),
        false => format!("{name} (process {id})"),
    });
    let words: Vec<String> = words.collect();
    (!words.is_empty()).then(|| words.join(" and "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_file_is_seen_and_a_closed_one_is_not() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = fs::canonicalize(file.path()).unwrap();
        assert_eq!(holders_of(&path).as_deref(), Some("this daemon itself, for another camera"));
        let path = file.into_temp_path();
        assert_eq!(holders_of(&fs::canonicalize(&path).unwrap()), None);
    }
}
