//! The markers of coded boards: the pattern of black and white cells for each number.
//!
//! The tables are in `dictionaries.txt` beside this file, which states their origin.

use std::sync::OnceLock;

/// A dictionary of square markers, all of one size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dictionary {
    name: &'static str,
    table: &'static MarkerTable,
    count: usize,
}

#[derive(Debug, PartialEq, Eq)]
struct MarkerTable {
    name: &'static str,
    bits: usize,
    codes: Vec<u64>,
}

/// OpenCV's name, the table that starts with its markers, and the number of them (0: all).
const NAMES: [(&str, &str, usize); 22] = [
    ("DICT_4X4_50", "DICT_4X4_1000", 50),
    ("DICT_4X4_100", "DICT_4X4_1000", 100),
    ("DICT_4X4_250", "DICT_4X4_1000", 250),
    ("DICT_4X4_1000", "DICT_4X4_1000", 0),
    ("DICT_5X5_50", "DICT_5X5_1000", 50),
    ("DICT_5X5_100", "DICT_5X5_1000", 100),
    ("DICT_5X5_250", "DICT_5X5_1000", 250),
    ("DICT_5X5_1000", "DICT_5X5_1000", 0),
    ("DICT_6X6_50", "DICT_6X6_1000", 50),
    ("DICT_6X6_100", "DICT_6X6_1000", 100),
    ("DICT_6X6_250", "DICT_6X6_1000", 250),
    ("DICT_6X6_1000", "DICT_6X6_1000", 0),
    ("DICT_7X7_50", "DICT_7X7_1000", 50),
    ("DICT_7X7_100", "DICT_7X7_1000", 100),
    ("DICT_7X7_250", "DICT_7X7_1000", 250),
    ("DICT_7X7_1000", "DICT_7X7_1000", 0),
    ("DICT_ARUCO_ORIGINAL", "DICT_ARUCO_ORIGINAL", 0),
    ("DICT_APRILTAG_16h5", "DICT_APRILTAG_16h5", 0),
    ("DICT_APRILTAG_25h9", "DICT_APRILTAG_25h9", 0),
    ("DICT_APRILTAG_36h10", "DICT_APRILTAG_36h10", 0),
    ("DICT_APRILTAG_36h11", "DICT_APRILTAG_36h11", 0),
    ("DICT_ARUCO_MIP_36h12", "DICT_ARUCO_MIP_36h12", 0),
];

/// The family names of AprilTag's own library.
const FAMILIES: [(&str, &str); 4] = [
    ("tag16h5", "DICT_APRILTAG_16h5"),
    ("tag25h9", "DICT_APRILTAG_25h9"),
    ("tag36h10", "DICT_APRILTAG_36h10"),
    ("tag36h11", "DICT_APRILTAG_36h11"),
];

/// A name that no dictionary has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "there is no dictionary `{name}`: give one of OpenCV's, as in DICT_4X4_50, or a family of AprilTags, as in tag36h11"
)]
pub struct UnknownDictionary {
    /// The requested name.
    pub name: String,
}

impl Dictionary {
    /// The dictionary of this name: OpenCV's (`DICT_4X4_50`) or AprilTag's (`tag36h11`).
    ///
    /// # Errors
    /// [`UnknownDictionary`] if there is none.
    pub fn named(name: &str) -> Result<Self, UnknownDictionary> {
        let opencv = FAMILIES.iter().find(|family| family.0 == name).map_or(name, |found| found.1);
        let unknown = || UnknownDictionary { name: name.to_owned() };
        let &(known, table, count) =
            NAMES.iter().find(|known| known.0 == opencv).ok_or_else(unknown)?;
        let table = tables().iter().find(|other| other.name == table).ok_or_else(unknown)?;
        let count = if count == 0 { table.codes.len() } else { count };
        Ok(Self { name: known, table, count })
    }

    /// All dictionaries.
    pub fn all() -> impl Iterator<Item = Self> {
        NAMES.iter().filter_map(|name| Self::named(name.0).ok())
    }

    /// OpenCV's name.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// AprilTag's name of the family, for a dictionary of its tags.
    pub fn family(&self) -> Option<&'static str> {
        FAMILIES.iter().find(|family| family.1 == self.name).map(|family| family.0)
    }

    /// Cells along a marker's side, without the border.
    pub fn bits(&self) -> usize {
        self.table.bits
    }

    /// Number of markers, numbered from 0.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether `other` contains all its markers, with the same numbers.
    pub fn is_part_of(&self, other: &Self) -> bool {
        self.table.name == other.table.name && self.count <= other.count
    }

    /// Whether the cell in `row` and `col` of the marker `id` is white, as OpenCV draws it upright.
    /// `None` outside of the marker or of the dictionary.
    pub fn is_white(&self, id: usize, row: usize, col: usize) -> Option<bool> {
        let bits = self.table.bits;
        let code = self.table.codes[..self.count].get(id)?;
        (row < bits && col < bits).then(|| code >> (bits * bits - 1 - (row * bits + col)) & 1 == 1)
    }

    /// The same for the marker as it appears rotated by this number of `quarters` from +x to +y,
    /// with cells counted from the upper left one again.
    pub fn is_white_rotated(
        &self,
        id: usize,
        (row, col): (usize, usize),
        quarters: usize,
    ) -> Option<bool> {
        let last = self.table.bits - 1;
        if row > last || col > last {
            return None;
        }
        let (row, col) = match quarters % 4 {
            0 => (row, col),
            1 => (last - col, row),
            2 => (last - row, last - col),
            _ => (col, last - row),
        };
        self.is_white(id, row, col)
    }
}

fn tables() -> &'static [MarkerTable] {
    static TABLES: OnceLock<Vec<MarkerTable>> = OnceLock::new();
    TABLES.get_or_init(|| {
        let lines = include_str!("dictionaries.txt").lines();
        lines.filter(|line| !line.starts_with('#')).filter_map(table).collect()
    })
}

/// A line of the file; the tests check that all are well formed.
fn table(line: &'static str) -> Option<MarkerTable> {
    let mut words = line.split(' ');
    let (name, bits, count) = (words.next()?, words.next()?, words.next()?);
    let codes: Vec<u64> =
        words.map(|code| u64::from_str_radix(code, 16)).collect::<Result<_, _>>().ok()?;
    let (bits, count): (usize, usize) = (bits.parse().ok()?, count.parse().ok()?);
    (codes.len() == count).then_some(MarkerTable { name, bits, codes })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_has_its_markers() {
        assert_eq!(Dictionary::all().count(), NAMES.len());
        for dictionary in Dictionary::all() {
            let bits = dictionary.bits();
            assert!((4..=7).contains(&bits));
            let cells = |id: usize| -> Vec<Option<bool>> {
                (0..bits * bits).map(|k| dictionary.is_white(id, k / bits, k % bits)).collect()
            };
            let codes: std::collections::BTreeSet<_> = (0..dictionary.count()).map(cells).collect();
            assert_eq!(codes.len(), dictionary.count(), "{}", dictionary.name());
            assert_eq!(dictionary.is_white(dictionary.count(), 0, 0), None);
            assert_eq!(dictionary.is_white(0, bits, 0), None);
        }
        assert_eq!(Dictionary::named("tag36h11").map(|d| d.count()), Ok(587));
        assert!(Dictionary::named("DICT_8X8_50").is_err());
    }

    #[test]
    fn a_quarter_brings_the_left_column_to_the_top() {
        let family = Dictionary::named("tag36h11").expect("a family");
        for quarters in 0..5 {
            for (row, col) in (0..6).flat_map(|row| (0..6).map(move |col| (row, col))) {
                assert_eq!(
                    family.is_white_rotated(7, (row, col), quarters + 1),
                    family.is_white_rotated(7, (5 - col, row), quarters),
                );
                assert_eq!(family.is_white_rotated(7, (row, col), 4), family.is_white(7, row, col));
            }
        }
        assert_eq!(family.is_white_rotated(7, (0, 6), 1), None);
        assert_eq!(family.is_white_rotated(587, (0, 0), 1), None);
    }

    #[test]
    fn the_published_distance_holds_between_all_markers_and_their_rotations() {
        // Olson, "AprilTag: A robust and flexible visual fiducial system" (ICRA 2011): 36h11 is
        // named for its least Hamming distance.
        let family = Dictionary::named("tag36h11").expect("a family");
        let code = |id: usize, quarters: usize| {
            (0..36).fold(0_u64, |code, k| {
                let (r, c) = (k / 6, k % 6);
                let (r, c) = match quarters {
                    0 => (r, c),
                    1 => (c, 5 - r),
                    2 => (5 - r, 5 - c),
                    _ => (5 - c, r),
                };
                code << 1 | u64::from(family.is_white(id, r, c).expect("a cell"))
            })
        };
        for a in 0..40 {
            for b in (a..60).flat_map(|b| (0..4).map(move |quarters| (b, quarters))) {
                let distance = (code(a, 0) ^ code(b.0, b.1)).count_ones();
                assert!(distance >= 11 || b == (a, 0), "{a} {b:?} {distance}");
            }
        }
    }
}
