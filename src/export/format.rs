//! The formats by their names.

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

    /// Its name on the command line and in `?format=`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Ros => "ros",
            Self::RosStereo => "ros_stereo",
            Self::Opencv => "opencv",
            Self::OpencvStereo => "opencv_stereo",
            Self::Kalibr => "kalibr",
            Self::Mrcal => "mrcal",
            Self::Colmap => "colmap",
            Self::Urdf => "urdf",
            Self::Tf => "tf",
            Self::Depth => "depth",
        }
    }

    /// The format with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// Whether it holds every sensor of a calibration, in the calibration's order.
    pub(super) fn holds_all(self) -> bool {
        matches!(self, Self::Json | Self::Colmap | Self::Urdf | Self::Tf)
    }

    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Ros
            | Self::RosStereo
            | Self::Opencv
            | Self::OpencvStereo
            | Self::Kalibr
            | Self::Tf => "application/yaml",
            Self::Urdf => "application/xml",
            Self::Mrcal | Self::Colmap | Self::Depth => "text/plain; charset=utf-8",
        }
    }

    pub(super) fn file_name(self, camera: &str) -> String {
        match self {
            Self::Json => format!("{camera}.json"),
            Self::Ros => format!("{camera}.yaml"),
            Self::RosStereo => format!("{camera}-stereo.yaml"),
            Self::Opencv => format!("{camera}-opencv.yaml"),
            Self::OpencvStereo => format!("{camera}-opencv-stereo.yaml"),
            Self::Kalibr => format!("{camera}-camchain.yaml"),
            Self::Mrcal => format!("{camera}.cameramodel"),
            Self::Colmap => "cameras.txt".to_owned(),
            Self::Urdf => format!("{camera}.urdf"),
            Self::Tf => format!("{camera}-tf.yaml"),
            Self::Depth => format!("{camera}-depth.txt"),
        }
    }
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
