//! The positions of a board's corners in the last image, and their motion since the image before.

use crate::detection::grid::Node;
use crate::detection::vec2::Vec2;

/// The corners of the last two images, in the board's order; `None` for those that were not seen.
#[derive(Debug, Default)]
pub(in crate::detection) struct LastCorners {
    nodes: Vec<Option<Node>>,
    before: Vec<Option<Node>>,
}

impl LastCorners {
    /// Forgets the board: the last image showed none.
    pub(in crate::detection) fn forget(&mut self) {
        self.nodes.clear();
        self.before.clear();
    }

    /// Takes the corners of one more image.
    pub(in crate::detection) fn remember(&mut self, nodes: impl Iterator<Item = Option<Node>>) {
        std::mem::swap(&mut self.nodes, &mut self.before);
        self.nodes.clear();
        self.nodes.extend(nodes);
    }

    /// Corner `index` as it was measured.
    pub(in crate::detection) fn get(&self, index: usize) -> Option<Node> {
        *self.nodes.get(index)?
    }

    /// How far corner `index` moved between the last two images.
    pub(in crate::detection) fn motion(&self, index: usize) -> Option<Vec2> {
        Some(self.get(index)?.pixel - (*self.before.get(index)?)?.pixel)
    }

    /// Whether the motion of any corner is known.
    pub(in crate::detection) fn moved(&self) -> bool {
        (0..self.nodes.len()).any(|index| self.motion(index).is_some())
    }

    /// Whether all `count` corners of the board were seen.
    pub(in crate::detection) fn is_whole(&self, count: usize) -> bool {
        self.nodes.len() == count && self.nodes.iter().all(Option::is_some)
    }

    /// Those that were seen, with their index.
    pub(in crate::detection) fn seen(&self) -> impl Iterator<Item = (usize, Node)> {
        self.nodes.iter().enumerate().filter_map(|(index, node)| Some((index, (*node)?)))
    }
}
