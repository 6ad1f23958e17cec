//! Topics by their names or the beginnings of them.

/// Whether the topic `name` is one of those `asked` for; with none, each is.
pub(super) fn names_topic(asked: &[String], name: &str) -> bool {
    asked.is_empty() || asked.iter().any(|asked| topic_begins(asked, name))
}

/// Whether `asked` is the topic `name` or begins it up to a slash.
pub(super) fn topic_begins(asked: &str, name: &str) -> bool {
    let (asked, name) = (asked.trim_matches('/'), name.trim_matches('/'));
    name.strip_prefix(asked).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}
