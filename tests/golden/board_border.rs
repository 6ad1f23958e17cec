//! Corners at the border of a small board err no more together than each by itself: an error that
//! a whole row has in common rotates or shears the board, and no corner's residual shows it.

use plumb::geometry::board::Chessboard;
use plumb::geometry::pixel::ImageSize;
use plumb::simulation::{World, WorldOptions};

/// The board stands still at every third frame.
const PLACES: u64 = 20;
/// Corners of small cells share pixels with the next, which is 1.1 by itself.
const MOST: f64 = 1.35;

/// A board of some ten pixels a square before a wide lens.
fn world(seed: u64) -> (World, Chessboard) {
    let mut options = WorldOptions::on_rig(seed, ImageSize::new(640, 480), 0);
    options.fps = 5.0;
    options.board.square_m = 0.04;
    (options.walk.still_s, options.walk.travel_s) = (0.3, 0.3);
    options.walk.width = [0.3, 0.6];
    let board = options.board;
    (World::new(&options), board)
}

/// Amplitude of errors that grow from row to row, in units of what the corners' standard deviations
/// give it: in the image's x, and in its y.
fn slopes_over_rows(world: &mut World, board: &Chessboard, place: u64) -> Option<[f64; 2]> {
    let frame = world.frame(3 * place + 1);
    let truth = world.corners(&frame.truth);
    let detection = plumb::detect(frame.image.view(), board.size).ok()?;
    let middle = (f64::from(board.size.rows) - 1.0) / 2.0;
    let (mut sums, mut norm) = ([0.0; 2], 0.0);
    for (corner, truth) in detection.corners.iter().zip(truth) {
        let truth = truth?;
        let row = f64::from(corner.index.row) - middle;
        norm += row * row;
        sums[0] += row * (corner.pixel.x - truth.x) / corner.std_px;
        sums[1] += row * (corner.pixel.y - truth.y) / corner.std_px;
    }
    Some(sums.map(|sum| sum / norm.sqrt()))
}

#[test]
fn rows_at_the_border_have_no_error_in_common() {
    let (mut squares, mut views) = ([0.0; 2], 0.0);
    for seed in [11, 48, 85, 122, 159, 196, 233, 270] {
        let (mut world, board) = world(seed);
        let seen = (0..PLACES).filter_map(|place| slopes_over_rows(&mut world, &board, place));
        for slopes in seen {
            (0..2).for_each(|axis| squares[axis] += slopes[axis] * slopes[axis]);
            views += 1.0;
        }
    }
    let rms = squares.map(|sum: f64| (sum / views).sqrt());
    println!("slope over rows: {:.2} in x, {:.2} in y, {views} views", rms[0], rms[1]);
    assert!(views > 120.0 && rms.iter().all(|rms| *rms < MOST), "{rms:?} of {views} views");
}
