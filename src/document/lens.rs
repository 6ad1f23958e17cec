//! A lens as `model` and its named parameters.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::LazyLock;

use serde::de::{Error, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::{Ref, RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use crate::document::error::{DocumentError, physical};
use crate::document::lens_model::LensModelName;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::physical::{FOCAL_LENGTH_PX, PRINCIPAL_POINT_PX};

/// A lens: its model, fx, fy, cx, cy, skew, and exactly the coefficients that the model has.
#[derive(Debug, Clone, PartialEq)]
pub struct LensDocument {
    /// Which coefficients there are and what they mean.
    model: LensModel,
    parameters: NamedParameters,
}

/// Standard deviations of a lens's parameters, by the same names; 0 for one that was fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct LensStdDocument(NamedParameters);

/// Values by their parameter's place in [`NAMES`].
#[derive(Debug, Clone, PartialEq, Default)]
struct NamedParameters(BTreeMap<usize, f64>);

const MODEL: &str = "model";
const SKEW: &str = "skew";

/// The names of every model's parameters, each once: first those of the model with the most.
static NAMES: LazyLock<Vec<&'static str>> = LazyLock::new(|| {
    let mut models = LensModel::ALL;
    models.sort_by_key(|model| std::cmp::Reverse(model.coefficient_names().len()));
    let mut names = Vec::new();
    for name in models.into_iter().flat_map(Lens::parameter_names) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
});

/// The keys of a lens in a document.
static KEYS: LazyLock<Vec<&'static str>> =
    LazyLock::new(|| std::iter::once(MODEL).chain(NAMES.iter().copied()).collect());

fn place_of(name: &str) -> Option<usize> {
    NAMES.iter().position(|known| *known == name)
}

impl NamedParameters {
    /// From values in the order of [`Lens::parameter_names`].
    fn new(model: LensModel, values: &[f64]) -> Self {
        let named = Lens::parameter_names(model).into_iter().zip(values);
        Self(named.filter_map(|(name, value)| Some((place_of(name)?, *value))).collect())
    }

    fn value(&self, name: &str) -> Option<f64> {
        self.0.get(&place_of(name)?).copied()
    }

    /// The values in the order of [`Lens::parameter_names`], all of them and no others.
    fn to_values(&self, model: LensModel) -> Result<Vec<f64>, DocumentError> {
        let names = Lens::parameter_names(model);
        let mut given = self.0.keys().filter_map(|place| NAMES.get(*place));
        if let Some(extra) = given.find(|name| !names.contains(name)) {
            let problem = format!("a `{model}` lens has no such coefficient");
            return Err(DocumentError::field(*extra, problem));
        }
        let value = |name: &str| {
            let missing =
                || DocumentError::field(name, format!("is missing; a `{model}` lens has it"));
            self.value(name).ok_or_else(missing)
        };
        names.into_iter().map(value).collect()
    }

    fn entries(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        self.0.iter().filter_map(|(place, value)| Some((*NAMES.get(*place)?, *value)))
    }
}

impl From<&Lens> for LensDocument {
    fn from(lens: &Lens) -> Self {
        let model = lens.model();
        Self { model, parameters: NamedParameters::new(model, &lens.parameters()) }
    }
}

impl TryFrom<&LensDocument> for Lens {
    type Error = DocumentError;
    fn try_from(document: &LensDocument) -> Result<Self, DocumentError> {
        let LensDocument { model, parameters } = document;
        for (name, range) in [
            ("fx", &FOCAL_LENGTH_PX),
            ("fy", &FOCAL_LENGTH_PX),
            ("cx", &PRINCIPAL_POINT_PX),
            ("cy", &PRINCIPAL_POINT_PX),
        ] {
            physical(name, parameters.value(name).unwrap_or_default(), range)?;
        }
        let wrong = || DocumentError::field(MODEL, "has other coefficients than are given");
        Self::from_parameters(*model, &parameters.to_values(*model)?).ok_or_else(wrong)
    }
}

impl LensStdDocument {
    /// From values in the order of [`Lens::parameter_names`].
    pub fn new(model: LensModel, std: &[f64]) -> Self {
        Self(NamedParameters::new(model, std))
    }

    /// The values in the order of [`Lens::parameter_names`].
    ///
    /// # Errors
    /// [`DocumentError::Field`] naming a coefficient that is missing or that the model does not
    /// have.
    pub fn to_values(&self, model: LensModel) -> Result<Vec<f64>, DocumentError> {
        self.0.to_values(model)
    }
}

impl Serialize for LensDocument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry(MODEL, &LensModelName(self.model))?;
        for (name, value) in self.parameters.entries() {
            map.serialize_entry(name, &value)?;
        }
        map.end()
    }
}

impl Serialize for LensStdDocument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.entries())
    }
}

impl<'de> Deserialize<'de> for LensDocument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (model, parameters) =
            deserializer.deserialize_map(ParametersVisitor { keys: &KEYS })?;
        let LensModelName(model) = model.ok_or_else(|| Error::missing_field(MODEL))?;
        Ok(Self { model, parameters })
    }
}

impl<'de> Deserialize<'de> for LensStdDocument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (_, parameters) = deserializer.deserialize_map(ParametersVisitor { keys: &NAMES })?;
        Ok(Self(parameters))
    }
}

/// Reads parameters by name; the model too where it is among the keys.
struct ParametersVisitor {
    keys: &'static [&'static str],
}

impl<'de> Visitor<'de> for ParametersVisitor {
    type Value = (Option<LensModelName>, NamedParameters);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut model, mut parameters) = (None, NamedParameters::default());
        while let Some(key) = map.next_key::<String>()? {
            let Some(name) = self.keys.iter().find(|known| **known == key) else {
                return Err(Error::unknown_field(&key, self.keys));
            };
            let before = match place_of(name) {
                None => model.replace(map.next_value()?).is_some(),
                // Null is as good as left out.
                Some(place) => map
                    .next_value::<Option<f64>>()?
                    .is_some_and(|value| parameters.0.insert(place, value).is_some()),
            };
            if before {
                return Err(Error::duplicate_field(name));
            }
        }
        for name in ["fx", "fy", "cx", "cy"] {
            if parameters.value(name).is_none() {
                return Err(Error::missing_field(name));
            }
        }
        if let Some(skew) = place_of(SKEW) {
            parameters.0.entry(skew).or_insert(0.0);
        }
        Ok((model, parameters))
    }
}

/// An object of numbers, of which the coefficients depend on the model.
fn schema(with_model: bool, description: &str) -> RefOr<Schema> {
    let number = || ObjectBuilder::new().schema_type(Type::Number);
    let mut schema = ObjectBuilder::new().description(Some(description));
    if with_model {
        schema = schema.property(MODEL, Ref::from_schema_name(LensModelName::name()));
        schema = schema.required(MODEL);
    }
    for name in NAMES.iter() {
        let has = |model: &LensModel| model.coefficient_names().contains(name);
        let models: Vec<&str> =
            LensModel::ALL.into_iter().filter(has).map(LensModel::name).collect();
        let of = match *name {
            "fx" | "fy" => "Focal length, in pixels.".to_owned(),
            "cx" | "cy" => "Principal point, in pixels.".to_owned(),
            SKEW => "Skew, K[0][1] of the camera matrix, in pixels: 0 unless estimated.".to_owned(),
            _ => format!("Coefficient of {}.", models.join(", ")),
        };
        schema = schema.property(*name, number().description(Some(of)));
        if models.is_empty() && *name != SKEW {
            schema = schema.required(*name);
        }
    }
    schema.into()
}

impl PartialSchema for LensDocument {
    fn schema() -> RefOr<Schema> {
        schema(
            true,
            "A lens: its model, fx, fy, cx, cy, skew, and exactly the coefficients that the model has.",
        )
    }
}

impl ToSchema for LensDocument {
    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        schemas.push((LensModelName::name().into_owned(), LensModelName::schema()));
    }
}

impl PartialSchema for LensStdDocument {
    fn schema() -> RefOr<Schema> {
        schema(
            false,
            "Standard deviations of a lens's parameters, by the same names; 0 for one that was fixed.",
        )
    }
}

impl ToSchema for LensStdDocument {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::reading::{from_json, to_json};

    #[test]
    fn every_model_survives_to_the_bit_in_the_contract_s_order() {
        for model in LensModel::ALL {
            let names = Lens::parameter_names(model);
            let values: Vec<f64> = (0..names.len()).map(|i| 500.0 / 3.0 + i as f64 / 7.0).collect();
            let lens = Lens::from_parameters(model, &values).unwrap();
            let json = to_json(&LensDocument::from(&lens)).unwrap();
            let expected: Vec<String> =
                names.iter().zip(&values).map(|(n, v)| format!("\"{n}\":{v}")).collect();
            assert_eq!(json, format!("{{\"model\":\"{model}\",{}}}", expected.join(",")));
            assert_eq!(
                Lens::try_from(&from_json::<LensDocument>(json.as_bytes()).unwrap()),
                Ok(lens)
            );
            assert_eq!(LensStdDocument::new(model, &values).to_values(model), Ok(values));
        }
    }

    #[test]
    fn wrong_lenses_are_refused_by_field() {
        let base = r#""fx":500,"fy":500,"cx":320,"cy":240"#;
        let table = [
            (format!(r#"{{"model":"radial",{base}}}"#), "k1: is missing; a `radial` lens has it"),
            (
                format!(r#"{{"model":"pinhole",{base},"k1":0}}"#),
                "k1: a `pinhole` lens has no such coefficient",
            ),
            (
                r#"{"model":"pinhole","fx":-1,"fy":500,"cx":320,"cy":240}"#.into(),
                "fx: -1 px is not a focal length: it is 0.1 to 10000000 px",
            ),
        ];
        for (json, expected) in table {
            let document: LensDocument = from_json(json.as_bytes()).unwrap();
            assert_eq!(Lens::try_from(&document).unwrap_err().to_string(), expected);
        }
        let unknown = from_json::<LensDocument>(format!(r#"{{"model":"fov",{base}}}"#).as_bytes())
            .unwrap_err();
        assert_eq!(unknown.path(), Some("model"));
    }

    #[test]
    fn parameters_are_those_of_some_model_and_each_is_given_once() {
        let base = r#""fx":500,"fy":500,"cx":320,"cy":240"#;
        let read = |rest: &str| {
            from_json::<LensDocument>(format!("{{{base},{rest}}}").as_bytes())
                .map_err(|error| error.to_string())
        };
        for (rest, named) in [
            (r#""model":"pinhole","k9":0"#, "k9"),
            (r#""model":"radial","k1":0,"k1":0"#, "k1"),
            (r#""model":"radial","k1":"0""#, "k1"),
            (r#""k1":0"#, "model"),
        ] {
            let error = read(rest).unwrap_err();
            assert!(error.contains(named), "{rest}: {error}");
        }
        let without = read(r#""model":"pinhole","k1":null"#).unwrap();
        assert_eq!(
            Lens::try_from(&without).unwrap().parameters(),
            [500.0, 500.0, 320.0, 240.0, 0.0]
        );
        assert_eq!(read(r#""model":"pinhole","skew":0"#), Ok(without));
        let schema = serde_json::to_value(LensDocument::schema()).unwrap();
        for model in LensModel::ALL {
            for name in Lens::parameter_names(model) {
                assert!(schema["properties"][name].is_object(), "{name}");
            }
        }
    }
}
