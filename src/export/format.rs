//! The formats.

use crate::geometry::lens::LensModel;

/// A format that a calibration can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// Plumb's own calibration document.
    Json,
    /// ROS `camera_info` YAML, as `camera_info_manager` and `image_geometry` read it.
    Ros,
    /// The same of two cameras, rectified: one file each.
    RosStereo,
    /// OpenCV `FileStorage` YAML, with the field names of its calibration sample.
    Opencv,
    /// The same of two cameras, rectified, with the names of its stereo calibration sample.
    OpencvStereo,
    /// Kalibr's camera chain YAML.
    Kalibr,
    /// mrcal's `.cameramodel`.
    Mrcal,
    /// COLMAP's `cameras.txt`.
    Colmap,
    /// Where the sensors are, as a URDF of fixed joints between optical frames.
    Urdf,
    /// Where the sensors are, as a YAML list of ROS `geometry_msgs/TransformStamped`.
    Tf,
    /// The meaning and the correction of a depth sensor's readings; docs/depth-correction has
    /// readers of it.
    Depth,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 11] = [
        Self::Json,
        Self::Ros,
        Self::RosStereo,
        Self::Opencv,
        Self::OpencvStereo,
        Self::Kalibr,
        Self::Mrcal,
        Self::Colmap,
        Self::Urdf,
        Self::Tf,
        Self::Depth,
    ];
}

/// The models that a format `holds`, most coefficients first, as a choice in words.
pub(super) fn models(holds: impl Fn(LensModel) -> bool) -> String {
    let mut held: Vec<LensModel> =
        LensModel::ALL.into_iter().filter(|model| holds(*model)).collect();
    held.sort_by_key(|model| std::cmp::Reverse(model.coefficient_names().len()));
    let names: Vec<&str> = held.into_iter().map(LensModel::name).collect();
    match names.as_slice() {
        [several @ .., last] if !several.is_empty() => format!("{} or {last}", several.join(", ")),
        one => one.concat(),
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
