//! Finds corners that are farther away than their neighbors predict, as where a lens compresses the
//! board; they must be at a candidate.

use crate::detection::grid::{Grid, Node, in_steps};
use crate::detection::measure::Probe;
use crate::detection::measure::edges::is_edge;
use crate::detection::measure::prediction::Prediction;
use crate::detection::search::candidates::{Candidate, edges_along};
use crate::detection::search::seeds::Neighborhood;
use crate::detection::vec2::Vec2;

/// A free position next to a corner where nothing was found, to be searched for farther away.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct Stretch {
    place: Prediction,
    /// The corner next to it, and the direction: along which of the steps, forward or back.
    from: Node,
    axis: usize,
    forward: f32,
}

impl Stretch {
    /// The position from the corner (i, j) of `grid` towards (di, dj), if it is free.
    pub(in crate::detection) fn from(
        probe: Probe<'_>,
        grid: &Grid,
        (i, j): (i32, i32),
        (di, dj): (i32, i32),
    ) -> Option<Self> {
        let (from, next) = (grid.get(i, j)?, (i + di, j + dj));
        if grid.get(next.0, next.1).is_some() || !grid.holds(next.0, next.1) {
            return None;
        }
        Some(Self {
            place: Prediction::by_neighbors(grid, next, &probe.thresholds.measure)?,
            from,
            axis: usize::from(dj != 0),
            forward: (di + dj) as f32,
        })
    }

    /// The corner there: at a candidate of the right polarity, with an edge along the whole way.
    pub(in crate::detection) fn measure(
        &self,
        probe: Probe<'_>,
        candidates: &[Candidate],
        neighborhood: &Neighborhood,
    ) -> Option<Node> {
        let at = self.candidate(probe, candidates, neighborhood)?;
        let Prediction { mut steps, polarity, .. } = self.place;
        steps[self.axis] = (at - self.from.pixel) * self.forward;
        let node = Prediction { expected: at, steps, ..self.place }
            .measure(probe, probe.thresholds.windows.wide())?;
        // The quadrant between +i and +v has the corner's own polarity, and the next quadrant the
        // opposite one: seen from the farther corner, this edge goes back.
        let (aside, sign) =
            if self.axis == 0 { (steps[1], self.forward) } else { (steps[0], self.forward) };
        let contrast = -0.5 * (node.contrast.abs() + self.from.contrast.abs()) * polarity * sign;
        is_edge(probe, [self.from.pixel, node.pixel], aside, contrast)
            .filter(|&holds| holds)
            .map(|_| node)
    }

    /// The position of the nearest candidate whose edges and position fit.
    fn candidate(
        &self,
        probe: Probe<'_>,
        candidates: &[Candidate],
        neighborhood: &Neighborhood,
    ) -> Option<Vec2> {
        let thresholds = &probe.thresholds.stretch;
        let Prediction { expected, steps, polarity, .. } = self.place;
        let edges = edges_along(steps, polarity);
        let fits = |candidate: &Candidate| {
            candidate.has_edges(edges, thresholds.most_rotation)
                && in_steps(candidate.pixel - expected, steps).is_some_and(|off| {
                    let (along, aside) =
                        if self.axis == 0 { (off.x, off.y) } else { (off.y, off.x) };
                    aside.abs() < thresholds.most_aside
                        && (-thresholds.most_nearer..thresholds.most_farther)
                            .contains(&(along * self.forward))
                })
        };
        let reach = thresholds.most_farther * steps[self.axis].norm()
            + thresholds.most_aside * steps[1 - self.axis].norm();
        Some(candidates[neighborhood.nearest(candidates, expected, reach, fits)?].pixel)
    }
}
