//! What values a query's parameters may have, for the API's document.

use utoipa::openapi::schema::{Object, ObjectBuilder, SchemaType, Type};

use crate::export::Format;
use crate::imaging::frame::SensorKind;

/// The name of a format.
pub(super) fn format() -> Object {
    one_of(Format::ALL.map(Format::name))
}

/// The kind of a sensor.
pub(super) fn sensor_kind() -> Object {
    one_of(SensorKind::ALL.map(SensorKind::name))
}

/// A positive number.
pub(super) fn positive() -> Object {
    let number = ObjectBuilder::new().schema_type(SchemaType::Type(Type::Number));
    number.exclusive_minimum(Some(0.0)).build()
}

/// A whole number of at least 1.
pub(super) fn count() -> Object {
    let number = ObjectBuilder::new().schema_type(SchemaType::Type(Type::Integer));
    number.minimum(Some(1)).maximum(Some(u32::MAX)).build()
}

/// A part of an image: `left,top,width,height` in pixels.
pub(super) fn region() -> Object {
    let text = ObjectBuilder::new().schema_type(SchemaType::Type(Type::String));
    text.pattern(Some("^[0-9]{1,5},[0-9]{1,5},[1-9][0-9]{0,4},[1-9][0-9]{0,4}$")).build()
}

fn one_of<const N: usize>(names: [&'static str; N]) -> Object {
    let text = ObjectBuilder::new().schema_type(SchemaType::Type(Type::String));
    text.enum_values(Some(names)).build()
}
