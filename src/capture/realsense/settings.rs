//! Settings of a RealSense device besides its streams.

/// How the device weighs depth's completeness against its accuracy: Intel's visual presets of the
/// D400 line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// As the device comes.
    Default,
    /// For hands near the camera.
    Hand,
    /// Only depth that is sure.
    HighAccuracy,
    /// As much depth as can be.
    HighDensity,
    /// Between the two.
    MediumDensity,
}

impl Preset {
    /// Every preset.
    pub const ALL: [Self; 5] =
        [Self::Default, Self::Hand, Self::HighAccuracy, Self::HighDensity, Self::MediumDensity];

    /// Its name in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Hand => "hand",
            Self::HighAccuracy => "high_accuracy",
            Self::HighDensity => "high_density",
            Self::MediumDensity => "medium_density",
        }
    }

    /// The preset of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.name() == name)
    }

    /// The library's number of it (`rs2_rs400_visual_preset`).
    pub fn number(self) -> u8 {
        match self {
            Self::Default => 1,
            Self::Hand => 2,
            Self::HighAccuracy => 3,
            Self::HighDensity => 4,
            Self::MediumDensity => 5,
        }
    }
}

/// Settings that are made when the device is opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Settings {
    /// Default: as the device stands.
    pub preset: Option<Preset>,
    /// Whether it projects its dots while no session collects; default: as the device stands.
    /// During a session they are on in every other frame where the device can do that, and else
    /// off.
    pub emitter: Option<bool>,
}
