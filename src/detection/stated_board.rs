//! Whether images show a ChArUco board as it is stated.
//!
//! A board of another number of rows, or with markers of another size, is found as the stated one:
//! its corners that are on both have the same ids and positions. But corners of rows that are not
//! stated are not used, and a wrong size of markers may be a wrong size of squares.

use std::fmt;

use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::recognition::{RecognizedBoard, recognize};
use crate::geometry::target::{CharucoBoard, Target};
use crate::imaging::gray::GrayView;

/// Largest difference of the size of markers, in parts of a square's side: of 85 photographs of two
/// boards, 11 differ by 0.02 from what is stated, and none by more.
const MOST_DIFFERENCE: f64 = 0.045;

/// A ChArUco board as one image shows it, where that is the stated one but for its rows and the
/// size of its markers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenBoard {
    /// Rows of squares; `None` if there may be more, and no more than stated are seen.
    rows: Option<u32>,
    /// The side of its markers, in parts of a square's.
    marker_ratio: f64,
}

impl SeenBoard {
    /// What `image` shows of the `stated` board; `None` if that is not found. It takes several
    /// times as long as a search, and far longer where another number of rows is seen.
    pub fn of(image: GrayView<'_>, stated: &CharucoBoard) -> Option<Self> {
        let mut detector = TargetDetector::new(Target::Charuco(*stated))?;
        let detection = detector.find(image).ok()?;
        let Target::Charuco(measured) = detector.measured(image, &detection) else { return None };
        let unseen = detector.unseen_rows(image, &detection);
        let rows = match (unseen.may_go_on, unseen.missing_in_view) {
            (false, false) => Some(stated.rows),
            // An occluder or the image's border may be why.
            (true, false) if detection.partial => None,
            _ => recognized_rows(image, stated),
        };
        Some(Self { rows, marker_ratio: ratio(&measured) })
    }
}

/// The rows of the board like `stated` that `image` shows; `None` if it may have more.
fn recognized_rows(image: GrayView<'_>, stated: &CharucoBoard) -> Option<u32> {
    let RecognizedBoard { target: Target::Charuco(seen), may_go_on, .. } = recognize(image)? else {
        return None;
    };
    let is_of_one_kind = seen.dictionary.is_part_of(&stated.dictionary)
        || stated.dictionary.is_part_of(&seen.dictionary);
    let is_alike = is_of_one_kind && (seen.cols, seen.first_id) == (stated.cols, stated.first_id);
    (is_alike && (seen.rows > stated.rows || !may_go_on)).then_some(seen.rows)
}

/// How a stated ChArUco board differs from what images show.
#[derive(Debug, Clone, PartialEq)]
pub struct WronglyStated {
    stated: CharucoBoard,
    rows: Option<u32>,
    marker_ratio: Option<f64>,
}

impl WronglyStated {
    /// What most of the `seen` boards show; `None` where they are as stated.
    pub fn by(stated: &CharucoBoard, seen: &[SeenBoard]) -> Option<Self> {
        let rows: Vec<u32> = seen.iter().filter_map(|board| board.rows).collect();
        let count = |other: u32| rows.iter().filter(|&&rows| rows == other).count();
        let most = rows.iter().copied().find(|&other| 2 * count(other) > rows.len());
        let other = most.filter(|&most| most != stated.rows);
        let mut ratios: Vec<f64> = seen.iter().map(|board| board.marker_ratio).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        let median = ratios.get(ratios.len() / 2).copied();
        let differs = |seen: &f64| (seen - ratio(stated)).abs() > MOST_DIFFERENCE;
        let marker_ratio = median.filter(differs);
        let is_wrong = other.is_some() || marker_ratio.is_some();
        is_wrong.then_some(Self { stated: *stated, rows: other, marker_ratio })
    }
}

/// The side of a marker, in parts of a square's.
fn ratio(board: &CharucoBoard) -> f64 {
    board.marker_m / board.square_m
}

impl fmt::Display for WronglyStated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let stated = &self.stated;
        write!(f, "the {} is not as stated: ", Target::Charuco(*stated))?;
        if let Some(rows) = self.rows {
            write!(
                f,
                "{rows} rows of squares are seen, not {}; state \"rows\": {rows}",
                stated.rows
            )?;
        }
        let Some(seen) = self.marker_ratio else { return Ok(()) };
        if self.rows.is_some() {
            f.write_str("; ")?;
        }
        write!(
            f,
            "its markers are {seen:.2} of a square, not {:.2}; measure square_m and marker_m (all lengths follow from square_m)",
            ratio(stated)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::dictionary::Dictionary;

    #[test]
    fn what_most_images_show_is_named() {
        let stated = CharucoBoard {
            cols: 8,
            rows: 7,
            square_m: 0.02,
            marker_m: 0.015,
            dictionary: Dictionary::named("DICT_4X4_50").unwrap(),
            first_id: 0,
            legacy: None,
        };
        let wrongly = |seen: &[(Option<u32>, f64)]| {
            let board =
                |&(rows, marker_ratio): &(Option<u32>, f64)| SeenBoard { rows, marker_ratio };
            let seen: Vec<SeenBoard> = seen.iter().map(board).collect();
            WronglyStated::by(&stated, &seen).map(|wrongly| wrongly.to_string())
        };
        assert_eq!(wrongly(&[]), None);
        assert_eq!(wrongly(&[(None, 0.73), (Some(7), 0.77), (Some(8), 0.9)]), None);
        let rows = wrongly(&[(Some(8), 0.75), (Some(8), 0.75), (Some(7), 0.75)]).unwrap();
        assert!(rows.contains("8 rows of squares are seen, not 7; state \"rows\": 8"), "{rows}");
        let ratio = wrongly(&[(None, 0.61), (None, 0.6), (None, 0.75)]).unwrap();
        assert!(ratio.contains("0.61 of a square, not 0.75") && !ratio.contains("rows"), "{ratio}");
    }
}
