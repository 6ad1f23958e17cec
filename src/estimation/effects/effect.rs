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
    PointOffset,
    /// The board's rotation during the readout of an image.
    Rotation,
    /// The board's translation during the readout of an image.
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
            Self::PointOffset => smooth..basis.len(),
            Self::Rotation => 0..3,
            Self::Translation => 3..6,
        }
    }
}

impl BoardBasis {
    /// The basis with only the functions that belong to `effects`, and the indices of their
    /// coefficients in this basis.
    pub(super) fn only(&self, effects: &[Effect]) -> (Self, Vec<usize>) {
        let contains = |effect: Effect| effects.contains(&effect);
        let kept: Vec<usize> = effects
            .iter()
            .filter(|effect| !effect.is_motion())
            .flat_map(|effect| effect.range(self))
            .collect();
        let heights = self.heights.iter().filter(|(group, _)| contains(Effect::Height(*group)));
        let narrow = Self {
            heights: heights.cloned().collect(),
            stretches: if contains(Effect::Stretch) { self.stretches.clone() } else { Vec::new() },
            has_point_offsets: self.has_point_offsets && contains(Effect::PointOffset),
            ..self.clone()
        };
        (narrow, kept)
    }
}

/// Which effects are tested, and which are in the model regardless of the evidence.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CandidateEffects {
    pub(crate) shape: bool,
    pub(crate) motion: bool,
    pub(crate) is_shape_required: bool,
    pub(crate) is_motion_required: bool,
}
