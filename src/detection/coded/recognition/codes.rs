//! Which marker of any dictionary a pattern is, at once.

use std::sync::OnceLock;

use crate::geometry::dictionary::Dictionary;

/// All markers of one dictionary as they appear in each rotation, sorted by their pattern.
#[derive(Debug)]
pub(super) struct CodeTable {
    pub dictionary: Dictionary,
    /// Pattern, marker, and quarters by which it appears rotated.
    patterns: Vec<(u64, u32, u8)>,
}

impl CodeTable {
    fn new(dictionary: Dictionary) -> Self {
        let n = dictionary.bits();
        let mut patterns = Vec::with_capacity(4 * dictionary.count());
        for marker in 0..dictionary.count() {
            for quarter in 0..4_u8 {
                let pattern = (0..n * n).fold(0, |pattern, k| {
                    let at = (k / n, k % n);
                    let is_white = dictionary.is_white_rotated(marker, at, usize::from(quarter));
                    pattern << 1 | u64::from(is_white.unwrap_or(false))
                });
                patterns.push((pattern, marker as u32, quarter));
            }
        }
        patterns.sort_unstable();
        Self { dictionary, patterns }
    }

    /// The marker with this pattern, row by row from its upper left cell, and how it is rotated.
    pub(super) fn marker(&self, pattern: u64) -> Option<(u32, u8)> {
        let at = self.patterns.binary_search_by_key(&pattern, |entry| entry.0).ok()?;
        let (_, marker, quarter) = self.patterns[at];
        Some((marker, quarter))
    }
}

/// A table for each dictionary that is no part of a larger one.
pub(super) fn all() -> &'static [CodeTable] {
    static TABLES: OnceLock<Vec<CodeTable>> = OnceLock::new();
    TABLES.get_or_init(|| {
        let is_largest = |one: &Dictionary| {
            !Dictionary::all().any(|other| one.is_part_of(&other) && other.count() > one.count())
        };
        Dictionary::all().filter(is_largest).map(CodeTable::new).collect()
    })
}

/// The smallest dictionary with these markers that has more than `last`.
pub(super) fn smallest(table: Dictionary, last: u32) -> Dictionary {
    Dictionary::all()
        .filter(|one| one.is_part_of(&table) && one.count() > last as usize)
        .min_by_key(Dictionary::count)
        .unwrap_or(table)
}
