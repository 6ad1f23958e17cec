//! What the operator should do next, in words and as an outline in the image.
//!
//! A fixed list of placements that together determine a lens well: five tilts in the middle, every
//! corner and edge of the image, near and far. The advice is the first of them that no accepted
//! view is close to. If something is wrong with the newest image, the message says that instead.

use nalgebra::{Vector2, Vector3};

use crate::calibration::admission::Rejection;
use crate::calibration::placement::{NOMINAL_FOCAL, Placement};
use crate::detection::board_detection::NoBoard;
use crate::geometry::board::Chessboard;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

/// One piece of advice: what to do, and where to hold the board.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Guidance {
    /// A sentence for the operator.
    pub message: String,
    /// The board's four outer corners as they should be seen next, in pixels, clockwise from the
    /// board's first corner; empty when no place is better than another.
    pub outline_px: Vec<Pixel>,
    /// The board's suggested pose.
    pub camera_from_board: Option<Pose>,
    /// The uncertainty after that view, in pixels; `None` while the pose of a depth camera beside
    /// color is unknown.
    pub expected_uncertainty_px: Option<f64>,
    /// How many more views reach the goal, at least and at most; `None` without a goal.
    pub views_to_go: Option<[u32; 2]>,
}

/// A placement to suggest, and its words.
struct SuggestedPlacement {
    words: &'static str,
    center: [f64; 2],
    size: f64,
    /// Which side is nearer: +x the right, +y the lower.
    tilt: [f64; 2],
}

const fn suggest(
    words: &'static str,
    center: [f64; 2],
    size: f64,
    tilt: [f64; 2],
) -> SuggestedPlacement {
    SuggestedPlacement { words, center, size, tilt }
}

/// The suggested angle of a tilted board, in radians: 34 degrees, of the 20 to 45 that the verdict
/// asks for where the focal length is weak.
const TILT_RAD: f64 = 0.6;
/// The size ([`Placement::size`]) of a board that is neither near nor far: it spans 18 % of the
/// image, and centered at a quarter of the image's width and height it nearly reaches the edges.
const MEDIUM_SIZE: f64 = 0.42;
/// Half as large: 5 % of the image.
const HALF_SIZE: f64 = 0.22;
/// Nearly all of it: 64 %.
const FULL_SIZE: f64 = 0.8;

const SUGGESTIONS: [SuggestedPlacement; 15] = [
    suggest("in the middle of the image, facing the camera", [0.5, 0.5], MEDIUM_SIZE, [0.0, 0.0]),
    suggest(
        "in the middle, its right side nearer to the camera",
        [0.5, 0.5],
        MEDIUM_SIZE,
        [TILT_RAD, 0.0],
    ),
    suggest(
        "in the middle, its left side nearer to the camera",
        [0.5, 0.5],
        MEDIUM_SIZE,
        [-TILT_RAD, 0.0],
    ),
    suggest(
        "in the middle, its upper side nearer to the camera",
        [0.5, 0.5],
        MEDIUM_SIZE,
        [0.0, -TILT_RAD],
    ),
    suggest(
        "in the middle, its lower side nearer to the camera",
        [0.5, 0.5],
        MEDIUM_SIZE,
        [0.0, TILT_RAD],
    ),
    suggest("into the upper left corner of the image", [0.25, 0.25], MEDIUM_SIZE, [0.0, 0.0]),
    suggest("into the upper right corner of the image", [0.75, 0.25], MEDIUM_SIZE, [0.0, 0.0]),
    suggest("into the lower right corner of the image", [0.75, 0.75], MEDIUM_SIZE, [0.0, 0.0]),
    suggest("into the lower left corner of the image", [0.25, 0.75], MEDIUM_SIZE, [0.0, 0.0]),
    suggest(
        "nearer to the camera, so that it nearly fills the image",
        [0.5, 0.5],
        FULL_SIZE,
        [0.0, 0.0],
    ),
    suggest(
        "to the left edge, its left side nearer to the camera",
        [0.25, 0.5],
        MEDIUM_SIZE,
        [-TILT_RAD, 0.0],
    ),
    suggest(
        "to the right edge, its right side nearer to the camera",
        [0.75, 0.5],
        MEDIUM_SIZE,
        [TILT_RAD, 0.0],
    ),
    suggest(
        "to the upper edge, its upper side nearer to the camera",
        [0.5, 0.25],
        MEDIUM_SIZE,
        [0.0, -TILT_RAD],
    ),
    suggest(
        "to the lower edge, its lower side nearer to the camera",
        [0.5, 0.75],
        MEDIUM_SIZE,
        [0.0, TILT_RAD],
    ),
    suggest("farther away, at half its size", [0.5, 0.5], HALF_SIZE, [0.35, 0.35]),
];

/// A view within this many steps ([`Placement::steps_to`]) of a suggested placement fulfills it: in
/// tilt 0.34 rad, little more than half of what is asked for, so that the untilted board fulfills
/// none of the tilted suggestions. Chosen for operators, not swept.
const FULFILLED_STEPS: f64 = 1.7;

/// What to do next with the board `target` in images of `size`, given the placements kept so far
/// and why the newest frame was rejected, if it was.
pub fn advise(
    target: &Chessboard,
    size: ImageSize,
    kept: &[Placement],
    newest: Option<&Rejection>,
) -> Guidance {
    let mut guidance = next_suggestion(target, size, kept);
    if let Some(obstacle) = newest.and_then(obstacle) {
        guidance.message = obstacle;
    }
    guidance
}

fn next_suggestion(target: &Chessboard, size: ImageSize, kept: &[Placement]) -> Guidance {
    for suggested in &SUGGESTIONS {
        let Some((placement, outline_px)) = place(suggested, target, size) else { continue };
        // The operator is free to choose the board's roll.
        let fulfilled = |view: &Placement| {
            placement.steps_to(&Placement { roll: placement.roll, ..*view }) < FULFILLED_STEPS
        };
        if !kept.iter().any(fulfilled) {
            let message = format!("hold the board {}", suggested.words);
            return Guidance { message, outline_px, ..Guidance::default() };
        }
    }
    let message = "every part of the image is covered; stop the session, or continue to lower the uncertainty";
    Guidance { message: message.to_owned(), ..Guidance::default() }
}

/// What to do about the rejection of the newest frame; `None` if nothing has to be done.
pub(crate) fn obstacle(rejection: &Rejection) -> Option<String> {
    match rejection {
        Rejection::NoBoard(reason @ NoBoard::LowContrast { .. }) => Some(reason.to_string()),
        Rejection::NoBoard(NoBoard::Blurred { .. }) | Rejection::Blurred { .. } => Some(
            "the image is blurred: hold the board still, add light, or focus the lens".to_owned(),
        ),
        Rejection::NoBoard(NoBoard::Incomplete { .. } | NoBoard::CutOff { .. })
        | Rejection::Partial { .. } => Some("bring the whole board into the image".to_owned()),
        Rejection::NoBoard(reason) if reason.names_another() => Some(reason.to_string()),
        Rejection::NoBoard(_) => Some("show the board to the camera".to_owned()),
        Rejection::Moving { .. } => Some("hold the board still".to_owned()),
        Rejection::NoTexture { .. } => {
            Some("point the camera at something with texture, in focus and lit".to_owned())
        }
        Rejection::UnknownScene { .. } => {
            Some("go back to where the scene is in view, and take smaller steps".to_owned())
        }
        Rejection::Unreadable { .. }
        | Rejection::NoImage { .. }
        | Rejection::OtherImageSize { .. }
        | Rejection::Full { .. } => Some(rejection.to_string()),
        Rejection::TooSimilar { .. }
        | Rejection::SmallStep { .. }
        | Rejection::LittleInformation { .. } => None,
    }
}

/// A suggested placement with its outline, shrunk until it lies in the image; `None` for an image
/// of no size.
fn place(
    suggested: &SuggestedPlacement,
    target: &Chessboard,
    size: ImageSize,
) -> Option<(Placement, Vec<Pixel>)> {
    (0..12).find_map(|shrinks| {
        let outline = outline(suggested, suggested.size * 0.9_f64.powi(shrinks), target, size)?;
        outline.iter().all(|corner| size.contains(*corner)).then_some(())?;
        let placement = Placement::of_outline(outline, target.size, size)?;
        Some((placement, outline.to_vec()))
    })
}

/// The board's outermost inner corners, for a board held as suggested but with the size `scale`.
fn outline(
    suggested: &SuggestedPlacement,
    scale: f64,
    target: &Chessboard,
    size: ImageSize,
) -> Option<[Pixel; 4]> {
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let focal_px = NOMINAL_FOCAL * width.max(height);
    let half =
        Vector2::new(f64::from(target.size.cols) - 1.0, f64::from(target.size.rows) - 1.0) / 2.0;
    let square_px = scale * (width * height / (4.0 * half.x * half.y)).sqrt();
    let distance = focal_px / square_px;
    let middle =
        Vector2::new((suggested.center[0] - 0.5) * width, (suggested.center[1] - 0.5) * height)
            / square_px;
    let rotation = Vector3::new(-suggested.tilt[1], suggested.tilt[0], 0.0);
    let camera_from_middle =
        Pose::from_axis_angle(rotation, Vector3::new(middle.x, middle.y, distance));
    let corner = |x: f64, y: f64| {
        let point = camera_from_middle * nalgebra::Point3::new(x * half.x, y * half.y, 0.0);
        let center = size.center();
        (point.z > 0.0).then(|| {
            Pixel::new(
                center.x + focal_px * point.x / point.z,
                center.y + focal_px * point.y / point.z,
            )
        })
    };
    Some([corner(-1.0, -1.0)?, corner(1.0, -1.0)?, corner(1.0, 1.0)?, corner(-1.0, 1.0)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::board::BoardSize;

    const SIZE: ImageSize = ImageSize::new(640, 480);

    fn target(cols: u32, rows: u32) -> Chessboard {
        Chessboard::new(BoardSize::new(cols, rows).unwrap(), 0.025).unwrap()
    }

    #[test]
    fn whoever_follows_the_advice_covers_everything_in_a_few_views() {
        for (target, size) in [
            (target(9, 6), SIZE),
            (target(4, 11), SIZE),
            (target(7, 7), ImageSize::new(1080, 1920)),
            (target(3, 3), ImageSize::new(80, 60)),
        ] {
            let mut kept = Vec::new();
            loop {
                let guidance = advise(&target, size, &kept, None);
                let Ok(outline) = <[Pixel; 4]>::try_from(guidance.outline_px) else { break };
                assert!(outline.iter().all(|corner| size.contains(*corner)), "{outline:?}");
                kept.push(Placement::of_outline(outline, target.size, size).unwrap());
                assert!(
                    kept.len() <= SUGGESTIONS.len(),
                    "asked twice for the same: {}",
                    guidance.message
                );
            }
            assert!(kept.len() >= 8, "only {} views for {} in {size}", kept.len(), target.size);
        }
    }

    #[test]
    fn what_is_wrong_now_is_said_first_and_the_outline_stays() {
        let moving = Rejection::Moving { speed_px_per_s: 900.0, limit_px_per_s: 300.0 };
        let guidance = advise(&target(9, 6), SIZE, &[], Some(&moving));
        assert_eq!(guidance.message, "hold the board still");
        assert_eq!(guidance.outline_px.len(), 4);
        let similar = advise(&target(9, 6), SIZE, &[], Some(&Rejection::TooSimilar { view: 0 }));
        assert_eq!(similar.message, "hold the board in the middle of the image, facing the camera");
    }

    #[test]
    fn an_image_of_no_size_has_no_place() {
        assert!(advise(&target(9, 6), ImageSize::new(0, 0), &[], None).outline_px.is_empty());
    }
}
