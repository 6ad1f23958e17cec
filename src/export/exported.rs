//! What is to be written of a calibration, and what was.

/// A calibration, written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exported {
    /// The file's content; of a format of several files, all of them one after the other.
    pub bytes: Vec<u8>,
    /// Its files, where the format has several.
    pub files: Vec<ExportedFile>,
    /// Its media type.
    pub media_type: &'static str,
    /// What to call it.
    pub file_name: String,
    /// What the reader must know: that the lens was refitted, and how well.
    pub note: Option<String>,
}

/// A file of several.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportedFile {
    /// What to call it.
    pub file_name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// What of a calibration is written.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExportOptions {
    /// The sensor, for formats that hold one, by its name in documents (`color`, `left.infrared`).
    /// Of a stereo format two of them, as `left,right`; of `kalibr` several, in the chain's order.
    /// Default: the only one, or color's; the cameras of a rig.
    pub sensor: Option<String>,
    /// Of ROS's formats and the stereo ones: 0 for rectified images that have only valid pixels, 1
    /// for those with all source pixels. Default: 0.
    pub alpha: f64,
}
