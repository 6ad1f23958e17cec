//! Takes a grid found on a coarse level down to the image itself, and across occluders.

use crate::detection::grid::extent::{exceeds, is_whole, most_corners};
use crate::detection::grid::{Bounds, Grid};
use crate::detection::measure::prediction::sharpen_all;
use crate::detection::search::growth::Growth;
use crate::detection::search::level::SearchScene;

/// The most lines beyond the grid's own that an occluder may hide, on each side. Chosen, not swept.
const MOST_HIDDEN_LINES: i32 = 3;
/// The most bridges, one after the other: corners beyond one occluder may help to cross the next.
/// Chosen, not swept.
const BRIDGES: usize = 2;

impl Growth {
    /// Takes `grid` from `level` to the image itself, and searches for missing corners on each
    /// level.
    pub(in crate::detection) fn descend(
        &mut self,
        scene: &SearchScene<'_>,
        grid: &mut Grid,
        level: usize,
    ) {
        let (board, thresholds) = (scene.board, scene.probe.thresholds);
        let windows = &thresholds.windows;
        let reaches = [thresholds.search.first_reach, thresholds.search.second_reach];
        let small = grid.members.len() < thresholds.search.least_part;
        let most = if small { most_corners(board) } else { usize::MAX };
        for finer in (0..level).rev() {
            grid.descend();
            let probe = scene.level(finer);
            let reaches = if finer == 0 { &reaches[..] } else { &reaches[..1] };
            sharpen_all(probe, grid, windows.wide(), reaches);
            if is_whole(grid, board) {
                continue;
            }
            grid.forget_attempts();
            let sizes = if finer == 0 { &windows.0[..] } else { windows.wide() };
            self.grow_to(probe, grid, sizes, most);
            if grid.members.len() >= most {
                return;
            }
        }
        if level == 0 && !is_whole(grid, board) {
            grid.forget_attempts();
            self.grow_to(scene.probe, grid, &windows.0, most);
        }
        if level == 0 || !is_whole(grid, board) {
            sharpen_all(scene.probe, grid, &windows.0, &reaches);
        }
    }

    /// Searches across occluders for the rest of a board of which a good part is found. Returns
    /// true if more of it is found.
    pub(in crate::detection) fn bridge_occluders(
        &mut self,
        scene: &SearchScene<'_>,
        grid: &mut Grid,
    ) -> bool {
        let (board, before) = (scene.board, grid.members.len());
        let longer = board.cols.max(board.rows) as i32;
        let shorter = board.cols.min(board.rows) as i32;
        let room = |length: i32, has: i32| (length - has).clamp(0, MOST_HIDDEN_LINES);
        for _ in 0..BRIDGES {
            let Some(bounds) = grid.bounds() else { break };
            let count = grid.members.len();
            let too_few = count < scene.probe.thresholds.search.least_part;
            if too_few || is_whole(grid, board) || exceeds(bounds, board) {
                break;
            }
            let lies_along_i = bounds.width() > shorter
                || (bounds.width() >= bounds.height() && bounds.height() <= shorter);
            let (along_i, along_j) =
                if lies_along_i { (longer, shorter) } else { (shorter, longer) };
            let (room_i, room_j) = (room(along_i, bounds.width()), room(along_j, bounds.height()));
            let wider = Bounds {
                i: (bounds.i.0 - room_i, bounds.i.1 + room_i),
                j: (bounds.j.0 - room_j, bounds.j.1 + room_j),
            };
            self.bridge(scene.probe, grid, wider);
            if grid.members.len() == count {
                break;
            }
        }
        grid.members.len() > before
    }
}
