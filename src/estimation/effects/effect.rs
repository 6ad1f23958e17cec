//! The kinds of effect beyond lens and poses, and which of them to search for.

use crate::estimation::effects::board_basis::BoardBasis;

/// A kind of effect. All its coefficients have one prior variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Effect {
    /// The board's height out of its plane, by this group of polynomials.
    Height(usize),
    /// The board's aspect and shear.
    Stretch,
    /// Each corner's own offset in the plane.
    Own,
    /// The board's rotation during the read-out of an image.
    Rotation,
    /// The board's translation during the read-out of an image.
    Translation,
}

impl Effect {
    pub(crate) fn is_motion(self) -> bool {
        matches!(self, Self::Rotation | Self::Translation)
    }

    /// The indices of its coefficients: among those of a shape, or among the six numbers of a
    /// view's motion.
    pub(super) fn range(self, basis: &BoardBasis) -> std::ops::Range<usize> {
        let (heights, smooth) = (basis.heights.len(), basis.smooth_len());
        match self {
            Self::Height(group) => {
                let start = basis.heights.partition_point(|(other, _)| *other < group);
                start..basis.heights.partition_point(|(other, _)| *other <= group)
            }
            Self::Stretch => heights..smooth,
            Self::Own => smooth..basis.len(),
            Self::Rotation => 0..3,
            Self::Translation => 3..6,
        }
    }
}

impl BoardBasis {
    /// The basis with only the functions that belong to `effects`, and the indices of their
    /// coefficients in this basis.
    pub(super) fn only(&self, effects: &[Effect]) -> (Self, Vec<usize>) {
        let wanted = |effect: Effect| effects.contains(&effect);
        let kept: Vec<usize> = effects
            .iter()
            .filter(|effect| !effect.is_motion())
            .flat_map(|effect| effect.range(self))
            .collect();
        let heights = self.heights.iter().filter(|(group, _)| wanted(Effect::Height(*group)));
        let narrow = Self {
            heights: heights.cloned().collect(),
            stretches: if wanted(Effect::Stretch) { self.stretches.clone() } else { Vec::new() },
            has_own: self.has_own && wanted(Effect::Own),
            ..self.clone()
        };
        (narrow, kept)
    }
}

/// Which effects are tested, and which are in the model regardless of the evidence.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub(crate) shape: bool,
    pub(crate) motion: bool,
    pub(crate) shape_for_certain: bool,
    pub(crate) motion_for_certain: bool,
}
