//! Lens models by their names: one in a result, one or `auto` in a request.

use std::fmt;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use crate::estimation::problem::LensChoice;
use crate::geometry::lens::LensModel;

/// The name of a lens model in a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LensModelName(pub LensModel);

/// The requested lens model: one by name, or `auto`, for the simplest model that no larger one
/// beats on held-out views.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LensRequest(pub LensChoice);

/// What leaves the choice open.
const AUTO: &str = "auto";

/// Every name, without [`AUTO`].
const MODELS: &[&str] = &LensModel::NAMES;

impl Default for LensRequest {
    fn default() -> Self {
        Self(LensChoice::Auto)
    }
}

impl From<LensChoice> for LensRequest {
    fn from(choice: LensChoice) -> Self {
        Self(choice)
    }
}

impl From<LensRequest> for LensChoice {
    fn from(request: LensRequest) -> Self {
        request.0
    }
}

impl Serialize for LensModelName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0.name())
    }
}

impl Serialize for LensRequest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(match self.0 {
            LensChoice::Auto => AUTO,
            LensChoice::Model(model) => model.name(),
        })
    }
}

impl<'de> Deserialize<'de> for LensModelName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let found = deserializer.deserialize_str(NameVisitor)?;
        LensModel::from_name(&found).map(Self).ok_or_else(|| Error::unknown_variant(&found, MODELS))
    }
}

impl<'de> Deserialize<'de> for LensRequest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let found = deserializer.deserialize_str(NameVisitor)?;
        if found == AUTO {
            return Ok(Self::default());
        }
        let model = LensModel::from_name(&found);
        let unknown = || {
            let known = MODELS.join("`, `");
            Error::custom(format!("unknown variant `{found}`, expected one of `{AUTO}`, `{known}`"))
        };
        model.map(|model| Self(LensChoice::Model(model))).ok_or_else(unknown)
    }
}

struct NameVisitor;

impl Visitor<'_> for NameVisitor {
    type Value = String;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a lens model")
    }

    fn visit_str<E>(self, name: &str) -> Result<String, E> {
        Ok(name.to_owned())
    }
}

fn one_of(names: impl IntoIterator<Item = &'static str>, description: &str) -> RefOr<Schema> {
    let schema = ObjectBuilder::new().schema_type(Type::String).enum_values(Some(names));
    schema.description(Some(description)).into()
}

impl PartialSchema for LensModelName {
    fn schema() -> RefOr<Schema> {
        one_of(LensModel::NAMES, "The name of a lens model in a result.")
    }
}

impl PartialSchema for LensRequest {
    fn schema() -> RefOr<Schema> {
        one_of(
            std::iter::once(AUTO).chain(LensModel::NAMES),
            "The requested lens model: one by name, or `auto`, for the simplest model that no larger one beats on held-out views.",
        )
    }
}

impl ToSchema for LensModelName {}

impl ToSchema for LensRequest {}
