//! The sensors of a camera as documents hold them: an object with a key for each kind.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{IgnoredAny, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::openapi::{ObjectBuilder, Ref, RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use crate::calibration::depth_calibration::DepthCalibration;
use crate::calibration::result::{CalibratedSensor, ImageCalibration, SensorResult};
use crate::calibration::sensor::SensorId;
use crate::document::depth::DepthDocument;
use crate::document::error::DocumentError;
use crate::document::image_sensor::SensorDocument;
use crate::imaging::frame::SensorKind;

/// The calibrated sensors of a camera, by kind.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SensorsDocument {
    /// In the order of documents.
    pub by_kind: BTreeMap<SensorKind, AnySensorDocument>,
}

/// One of them, by what it measures.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a handful of them exist at a time")]
pub enum AnySensorDocument {
    /// Light.
    Image(SensorDocument),
    /// Distance.
    Depth(DepthDocument),
}

impl SensorsDocument {
    /// The sensors of `camera` among `sensors`.
    pub fn of(sensors: &[CalibratedSensor], camera: Option<&str>) -> Self {
        let own = sensors.iter().filter(|sensor| sensor.id.camera.as_deref() == camera);
        Self { by_kind: own.map(|sensor| (sensor.id.kind, (&sensor.result).into())).collect() }
    }

    /// The calibrated sensors of `camera`.
    ///
    /// # Errors
    /// [`DocumentError::Field`] that names the sensor.
    pub fn to_sensors(&self, camera: Option<&str>) -> Result<Vec<CalibratedSensor>, DocumentError> {
        let sensor = |(kind, document): (&SensorKind, &AnySensorDocument)| {
            let id = SensorId { camera: camera.map(str::to_owned), kind: *kind };
            let result = match document {
                AnySensorDocument::Image(image) => {
                    ImageCalibration::try_from(image).map(SensorResult::Image)
                }
                AnySensorDocument::Depth(depth) => {
                    DepthCalibration::try_from(depth).map(SensorResult::Depth)
                }
            };
            let result = result.map_err(|e| e.inside(&format!("sensors.{}", kind.name())))?;
            Ok(CalibratedSensor { id, result })
        };
        self.by_kind.iter().map(sensor).collect()
    }
}

impl From<&SensorResult> for AnySensorDocument {
    fn from(result: &SensorResult) -> Self {
        match result {
            SensorResult::Image(image) => Self::Image(image.into()),
            SensorResult::Depth(depth) => Self::Depth(depth.into()),
        }
    }
}

impl Serialize for SensorsDocument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.by_kind.len()))?;
        for (kind, sensor) in &self.by_kind {
            match sensor {
                AnySensorDocument::Image(image) => map.serialize_entry(kind.name(), image)?,
                AnySensorDocument::Depth(depth) => map.serialize_entry(kind.name(), depth)?,
            }
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for SensorsDocument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(SensorsVisitor)
    }
}

struct SensorsVisitor;

impl<'de> Visitor<'de> for SensorsVisitor {
    type Value = SensorsDocument;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<SensorsDocument, A::Error> {
        let mut sensors = SensorsDocument::default();
        while let Some(key) = map.next_key::<String>()? {
            let Some(kind) = SensorKind::from_name(&key) else {
                map.next_value::<IgnoredAny>()?;
                continue;
            };
            let sensor = if kind.is_image() {
                map.next_value::<Option<SensorDocument>>()?.map(AnySensorDocument::Image)
            } else {
                map.next_value::<Option<DepthDocument>>()?.map(AnySensorDocument::Depth)
            };
            sensors.by_kind.extend(sensor.map(|sensor| (kind, sensor)));
        }
        Ok(sensors)
    }
}

impl PartialSchema for SensorsDocument {
    fn schema() -> RefOr<Schema> {
        let property = |schema: ObjectBuilder, kind: SensorKind| {
            let of = if kind.is_image() { SensorDocument::name() } else { DepthDocument::name() };
            schema.property(kind.name(), Ref::from_schema_name(of))
        };
        let description = "The calibrated sensors of a camera, by kind.";
        let schema = ObjectBuilder::new().description(Some(description));
        SensorKind::ALL.into_iter().fold(schema, property).into()
    }
}

impl ToSchema for SensorsDocument {
    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        schemas.push((SensorDocument::name().into_owned(), SensorDocument::schema()));
        schemas.push((DepthDocument::name().into_owned(), DepthDocument::schema()));
        SensorDocument::schemas(schemas);
        DepthDocument::schemas(schemas);
    }
}
