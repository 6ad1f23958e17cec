//! What the readings of depth images mean, as a device or a folder states it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::depth::{DepthKind, DisparityDocument};
use crate::document::error::DocumentError;
use crate::geometry::depth_camera::DepthReading;
use crate::imaging::depth_encoding::DepthEncoding;

/// How the readings of depth images encode depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DepthEncodingDocument {
    /// Distances or disparities.
    pub kind: DepthKind,
    /// Meters per unit of `depth`; null for disparity.
    pub unit_m: Option<f64>,
    /// For disparity d: 1/z = offset + slope · d, in 1/m; null where that is to be estimated.
    pub disparity: Option<DisparityDocument>,
    /// The reading that means none, besides 0 for depth.
    pub invalid: Option<u16>,
}

impl From<&DepthEncoding> for DepthEncodingDocument {
    fn from(encoding: &DepthEncoding) -> Self {
        let (kind, unit_m, disparity) = match encoding.reading {
            Some(DepthReading::Metric { unit_m }) => (DepthKind::Depth, Some(unit_m), None),
            Some(DepthReading::Disparity { offset, slope }) => {
                (DepthKind::Disparity, None, Some(DisparityDocument { offset, slope }))
            }
            None => (DepthKind::Disparity, None, None),
        };
        Self { kind, unit_m, disparity, invalid: encoding.invalid }
    }
}

impl TryFrom<&DepthEncodingDocument> for DepthEncoding {
    type Error = DocumentError;
    fn try_from(document: &DepthEncodingDocument) -> Result<Self, DocumentError> {
        let reading = match (document.kind, document.unit_m, document.disparity) {
            (DepthKind::Depth, Some(unit_m), _) if unit_m > 0.0 && unit_m < 1.0 => {
                Some(DepthReading::Metric { unit_m })
            }
            (DepthKind::Depth, None, _) => {
                return Err(DocumentError::field(
                    "unit_m",
                    "is missing: give the unit in meters, as in unit_m = 0.001",
                ));
            }
            (DepthKind::Depth, ..) => {
                return Err(DocumentError::field("unit_m", "must be above 0 and below 1 m"));
            }
            (DepthKind::Disparity, _, Some(DisparityDocument { offset, slope })) => {
                Some(DepthReading::Disparity { offset, slope })
            }
            (DepthKind::Disparity, _, None) => None,
        };
        Ok(Self { reading, invalid: document.invalid })
    }
}
