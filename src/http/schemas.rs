//! The allowed values of query parameters, for the API's document.

use utoipa::openapi::schema::{Object, ObjectBuilder, SchemaType, Type};

use crate::export::Format;
use crate::imaging::frame::SensorKind;

/// The name of a format, and what each is.
pub(super) fn format() -> Object {
    let each = Format::ALL.map(|format| format!("{}: {}", format.name(), format.description()));
    let description = format!("Default: json. {}.", each.join("; "));
    one_of(Format::ALL.map(Format::name)).description(Some(description)).build()
}

/// The kind of a sensor.
pub(super) fn sensor_kind() -> Object {
    one_of(SensorKind::ALL.map(SensorKind::name)).build()
}

/// Limits of a lens's parameters, as smallest and largest: wider than any real lens needs, and
/// narrow enough that every figure derived from them is finite.
pub(super) const F_NUMBER: [f64; 2] = [0.1, 1e3];
pub(super) const PIXEL_UM: [f64; 2] = [0.01, 1e3];
pub(super) const FOCAL_MM: [f64; 2] = [0.01, 1e5];
pub(super) const FOCUS_M: [f64; 2] = [1e-3, 1e6];
pub(super) const BLUR_PX: [f64; 2] = [0.01, 1e3];

/// A number within `range`.
fn within([least, most]: [f64; 2]) -> Object {
    let number = ObjectBuilder::new().schema_type(SchemaType::Type(Type::Number));
    number.minimum(Some(least)).maximum(Some(most)).build()
}

/// See [`FOCAL_MM`].
pub(super) fn focal_mm() -> Object {
    within(FOCAL_MM)
}

/// See [`FOCUS_M`].
pub(super) fn focus_m() -> Object {
    within(FOCUS_M)
}

/// See [`BLUR_PX`].
pub(super) fn blur_px() -> Object {
    within(BLUR_PX)
}

/// The free scaling parameter of rectified images, from 0 to 1.
pub(super) fn alpha() -> Object {
    within([0.0, 1.0])
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

fn one_of<const N: usize>(names: [&'static str; N]) -> ObjectBuilder {
    let text = ObjectBuilder::new().schema_type(SchemaType::Type(Type::String));
    text.enum_values(Some(names))
}
