//! How a grid of tags is printed, black and white inverted or not and with which border: it is
//! found, and a wrong statement of it is named.

use plumb::detection::coded::answer::TargetDetection;
use plumb::detection::coded::detector::TargetDetector;
use plumb::detection::coded::no_target::NoTarget;
use plumb::detection::coded::recognition::recognize;
use plumb::geometry::target::{AprilGrid, Target};
use plumb::imaging::gray::GrayImage;

use crate::coded_targets::{april_grid, image, paint};

/// Largest distance of a corner from the same one in the inverted image, in standard deviations: as
/// far as other roundings move it. A missing or wrong model of the print moves it by one and more.
const MOST_MOVED_STDS: f64 = 0.25;

fn inverted(image: &GrayImage) -> GrayImage {
    let view = image.view();
    let pixels = image.pixels().iter().map(|gray| 255 - gray).collect();
    GrayImage::from_pixels(view.width(), view.height(), pixels).expect("so many pixels")
}

fn find(grid: AprilGrid, image: &GrayImage) -> Result<TargetDetection, NoTarget> {
    TargetDetector::new(Target::AprilGrid(grid)).expect("tags").find(image.view())
}

#[test]
fn inverted_grids_are_found_as_exactly() {
    let grids = [
        april_grid("tag36h11", 2, 0),
        april_grid("tag36h11", 1, 3),
        AprilGrid { spacing: 0.2, ..april_grid("tag25h9", 2, 0) },
        AprilGrid { spacing: 1.0, ..april_grid("tag16h5", 2, 0) },
    ];
    let (mut corners, mut squares, mut stated) = (0, 0.0, [0.0; 2]);
    for (seed, grid) in grids.into_iter().enumerate() {
        let asked = AprilGrid { border_bits: None, ..grid };
        let target = Target::AprilGrid(grid);
        for seed in [810 + seed as u64, 820 + seed as u64] {
            let (image, _) = image(&target, seed);
            let own = find(asked, &image).unwrap_or_else(|none| panic!("{target}: {none}"));
            let other = find(asked, &inverted(&image)).unwrap_or_else(|none| panic!("{none}"));
            assert!(!own.markers.inverted && other.markers.inverted, "{target}");
            assert_eq!(own.markers.border_bits, other.markers.border_bits, "{target}");
            let ids = |found: &TargetDetection| -> Vec<u32> {
                found.corners.iter().map(|corner| corner.id).collect()
            };
            assert_eq!(ids(&own), ids(&other), "{target}, seed {seed}");
            for (own, other) in own.corners.iter().zip(&other.corners) {
                let stds = own.pixel.distance_px(other.pixel) / own.std_px;
                squares += stds.powi(2) / 2.0;
                corners += 1;
                stated[0] += own.std_px;
                stated[1] += other.std_px;
            }
        }
    }
    let moved = (squares / f64::from(corners)).sqrt();
    assert!(moved < MOST_MOVED_STDS, "moved by {moved} std, {corners} corners");
    let ratio = stated[1] / stated[0];
    assert!((0.8..1.25).contains(&ratio), "{ratio} of the std");
}

#[test]
fn an_inverted_grid_is_followed_and_named() {
    let grid = april_grid("tag36h11", 2, 0);
    let (image, _) = image(&Target::AprilGrid(grid), 830);
    let image = inverted(&image);
    let mut detector = TargetDetector::new(Target::AprilGrid(grid)).expect("tags");
    for frame in 0..3 {
        let tracked = detector.track(image.view()).unwrap_or_else(|none| panic!("{none}"));
        assert!(tracked.detection.markers.inverted);
        assert_eq!(tracked.followed, frame > 0, "frame {frame}");
    }
    let named = recognize(image.view()).expect("a grid").to_string();
    assert!(named.contains("4x3 AprilGrid") && named.ends_with("inverted"), "{named}");
}

/// Other tags, and fewer of them than prove a place.
#[test]
fn other_inverted_boards_are_not_answered() {
    let asked = april_grid("tag36h11", 2, 0);
    let others = [
        AprilGrid { first_id: 50, ..asked },
        AprilGrid { cols: 3, rows: 4, ..asked },
        april_grid("tag36h10", 2, 0),
    ];
    for (seed, shown) in others.into_iter().enumerate() {
        let (image, _) = image(&Target::AprilGrid(shown), 840 + seed as u64);
        let answer = find(asked, &inverted(&image));
        assert!(answer.is_err(), "{}: {answer:?}", Target::AprilGrid(shown));
    }
    let (image, _) = image(&Target::AprilGrid(asked), 850);
    let without = paint(&image, |x, _| (if x > 40.0 { 1.0 } else { 0.0 }, 128.0));
    assert!(find(asked, &inverted(&without)).is_err());
}

#[test]
fn a_border_that_is_stated_wrongly_is_named() {
    let families = ["tag36h11", "tag25h9", "tag16h5", "tag36h10"];
    for (seed, family) in families.into_iter().enumerate() {
        for (printed, stated) in [(1, 2), (2, 1), (1, 1), (2, 2)] {
            let shown = april_grid(family, printed, 0);
            let asked = AprilGrid { border_bits: Some(stated), ..shown };
            let (image, _) = image(&Target::AprilGrid(shown), 860 + seed as u64);
            for image in [inverted(&image), image] {
                let answer = find(asked, &image);
                if printed == stated {
                    let found = answer.unwrap_or_else(|none| panic!("{family} {printed}: {none}"));
                    assert_eq!(found.markers.border_bits, Some(printed));
                    continue;
                }
                let none = answer.expect_err(&format!("{family}, {stated} for {printed}"));
                let NoTarget::OtherBorder { seen, .. } = none else { panic!("{family}: {none}") };
                assert_eq!(seen, printed, "{family}");
                let words = format!("a border of {printed} cell");
                assert!(none.to_string().contains(&words), "{none}");
                assert!(none.to_string().contains(&format!("state {printed}")), "{none}");
            }
        }
    }
}

#[test]
fn the_border_is_found_where_it_is_left_out() {
    for (seed, family) in ["tag36h11", "tag25h9", "tag16h5", "tag36h10"].into_iter().enumerate() {
        for printed in [1, 2] {
            let shown = april_grid(family, printed, 0);
            let (image, _) = image(&Target::AprilGrid(shown), 870 + seed as u64);
            let found = find(AprilGrid { border_bits: None, ..shown }, &image);
            let found = found.unwrap_or_else(|none| panic!("{family} {printed}: {none}"));
            assert_eq!(found.markers.border_bits, Some(printed), "{family}");
        }
    }
}
