//! The search at scales that the pyramid does not have, if its levels show no target.

use crate::detection::coded::detector::{FoundTarget, LatticeSearch, TargetDetector, Unlabeled};
use crate::detection::search::between::BetweenLevel;
use crate::imaging::gray::GrayView;

impl TargetDetector {
    /// The target at scales that the pyramid does not have; they are tried in the order of their
    /// cost.
    pub(super) fn find_between(
        &mut self,
        image: GrayView<'_>,
        coarsest: usize,
        seen: &mut Unlabeled,
    ) -> Option<FoundTarget> {
        let mut between = std::mem::take(&mut self.between);
        let mut found = None;
        for level in between.two_thirds(image, coarsest) {
            found = found.or_else(|| self.find_on_copy(image, level, LatticeSearch::Boards, seen));
        }
        for level in between.two_thirds(image, coarsest).filter(|it| it.finer + 1 >= coarsest) {
            let search = LatticeSearch::FewSquares;
            found = found.or_else(|| self.find_on_copy(image, level, search, seen));
        }
        let is_large = image.width().max(image.height()) > self.thresholds.lattice.large_side_px;
        if found.is_none() && !is_large {
            let level = between.doubled(image);
            found = self.find_on_copy(image, level, LatticeSearch::SmallSquares, seen);
        }
        self.between = between;
        found
    }

    fn find_on_copy(
        &mut self,
        image: GrayView<'_>,
        level: BetweenLevel<'_>,
        search: LatticeSearch,
        seen: &mut Unlabeled,
    ) -> Option<FoundTarget> {
        let BetweenLevel { view, finer, scale } = level;
        if view.width().min(view.height()) < self.thresholds.lattice.least_side_px {
            return None;
        }
        self.prepare(view, seen);
        let label = self.search(view, search, seen)?;
        self.scale_grid(scale);
        if scale > 1.0 {
            let pyramid = std::mem::take(&mut self.pyramid);
            self.sharpen_on(pyramid.level(image, finer), label);
            self.pyramid = pyramid;
        }
        let detection = self.finish(image, finer, label)?;
        Some(FoundTarget { detection, label, level: finer, between: true })
    }
}
