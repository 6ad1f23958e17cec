//! A lens as `model` and its named parameters.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::error::{DocumentError, physical};
use crate::estimation::problem::LensChoice;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::physical::{FOCAL_LENGTH_PX, PRINCIPAL_POINT_PX};

/// The name of a lens model in a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LensModelName {
    /// No distortion.
    Pinhole,
    /// One radial coefficient.
    Radial,
    /// OpenCV's five coefficients, ROS `plumb_bob`.
    Brown,
    /// OpenCV's eight coefficients, ROS `rational_polynomial`.
    Rational,
    /// OpenCV's `fisheye`, ROS `equidistant`.
    KannalaBrandt,
}

impl From<LensModel> for LensModelName {
    fn from(model: LensModel) -> Self {
        match model {
            LensModel::Pinhole => Self::Pinhole,
            LensModel::Radial => Self::Radial,
            LensModel::Brown => Self::Brown,
            LensModel::Rational => Self::Rational,
            LensModel::KannalaBrandt => Self::KannalaBrandt,
        }
    }
}

impl From<LensModelName> for LensModel {
    fn from(name: LensModelName) -> Self {
        match name {
            LensModelName::Pinhole => Self::Pinhole,
            LensModelName::Radial => Self::Radial,
            LensModelName::Brown => Self::Brown,
            LensModelName::Rational => Self::Rational,
            LensModelName::KannalaBrandt => Self::KannalaBrandt,
        }
    }
}

/// The lens model that is asked for: one by name, or `auto`, chosen by the error on views that were
/// not fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LensRequest {
    /// Chosen by held-out error.
    #[default]
    Auto,
    /// No distortion.
    Pinhole,
    /// One radial coefficient.
    Radial,
    /// OpenCV's five coefficients.
    Brown,
    /// OpenCV's eight coefficients.
    Rational,
    /// OpenCV's `fisheye`.
    KannalaBrandt,
}

impl From<LensChoice> for LensRequest {
    fn from(choice: LensChoice) -> Self {
        match choice {
            LensChoice::Auto => Self::Auto,
            LensChoice::Model(LensModel::Pinhole) => Self::Pinhole,
            LensChoice::Model(LensModel::Radial) => Self::Radial,
            LensChoice::Model(LensModel::Brown) => Self::Brown,
            LensChoice::Model(LensModel::Rational) => Self::Rational,
            LensChoice::Model(LensModel::KannalaBrandt) => Self::KannalaBrandt,
        }
    }
}

impl From<LensRequest> for LensChoice {
    fn from(request: LensRequest) -> Self {
        match request {
            LensRequest::Auto => Self::Auto,
            LensRequest::Pinhole => Self::Model(LensModel::Pinhole),
            LensRequest::Radial => Self::Model(LensModel::Radial),
            LensRequest::Brown => Self::Model(LensModel::Brown),
            LensRequest::Rational => Self::Model(LensModel::Rational),
            LensRequest::KannalaBrandt => Self::Model(LensModel::KannalaBrandt),
        }
    }
}

/// A lens: its model, fx, fy, cx, cy, skew, and exactly the coefficients that the model has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LensDocument {
    /// Which coefficients there are and what they mean.
    pub model: LensModelName,
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels.
    pub fy: f64,
    /// Principal point, x, in pixels.
    pub cx: f64,
    /// Principal point, y, in pixels.
    pub cy: f64,
    /// How much x moves with normalized y, in pixels: 0 unless asked for.
    #[serde(default)]
    pub skew: f64,
    /// The model's coefficients.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
    /// Radial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k2: Option<f64>,
    /// Tangential.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p1: Option<f64>,
    /// Tangential.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p2: Option<f64>,
    /// Radial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k3: Option<f64>,
    /// Radial; `rational`: in the denominator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k4: Option<f64>,
    /// `rational`: in the denominator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k5: Option<f64>,
    /// `rational`: in the denominator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k6: Option<f64>,
}

impl LensDocument {
    fn new(model: LensModel, parameters: &[f64]) -> Self {
        let names = Lens::parameter_names(model);
        let value = |name: &str| {
            names.iter().position(|n| *n == name).and_then(|i| parameters.get(i)).copied()
        };
        let number = |name: &str| value(name).unwrap_or(0.0);
        Self {
            model: model.into(),
            fx: number("fx"),
            fy: number("fy"),
            cx: number("cx"),
            cy: number("cy"),
            skew: number("skew"),
            k1: value("k1"),
            k2: value("k2"),
            p1: value("p1"),
            p2: value("p2"),
            k3: value("k3"),
            k4: value("k4"),
            k5: value("k5"),
            k6: value("k6"),
        }
    }

    /// The parameters in the order of [`Lens::parameter_names`], all of them and no others.
    fn parameters(&self) -> Result<Vec<f64>, DocumentError> {
        let model = LensModel::from(self.model);
        let given = [
            ("k1", self.k1),
            ("k2", self.k2),
            ("p1", self.p1),
            ("p2", self.p2),
            ("k3", self.k3),
            ("k4", self.k4),
            ("k5", self.k5),
            ("k6", self.k6),
        ];
        let names = model.coefficient_names();
        if let Some((extra, _)) =
            given.iter().find(|(name, value)| value.is_some() && !names.contains(name))
        {
            return Err(DocumentError::field(
                *extra,
                format!("a `{model}` lens has no such coefficient"),
            ));
        }
        let mut parameters = vec![self.fx, self.fy, self.cx, self.cy, self.skew];
        for name in names {
            let value = given.iter().find(|(given, _)| given == name).and_then(|(_, value)| *value);
            let missing =
                || DocumentError::field(*name, format!("is missing; a `{model}` lens has it"));
            parameters.push(value.ok_or_else(missing)?);
        }
        Ok(parameters)
    }
}

impl From<&Lens> for LensDocument {
    fn from(lens: &Lens) -> Self {
        Self::new(lens.model(), &lens.parameters())
    }
}

impl TryFrom<&LensDocument> for Lens {
    type Error = DocumentError;
    fn try_from(document: &LensDocument) -> Result<Self, DocumentError> {
        for (name, value, range) in [
            ("fx", document.fx, &FOCAL_LENGTH_PX),
            ("fy", document.fy, &FOCAL_LENGTH_PX),
            ("cx", document.cx, &PRINCIPAL_POINT_PX),
            ("cy", document.cy, &PRINCIPAL_POINT_PX),
        ] {
            physical(name, value, range)?;
        }
        let wrong = || DocumentError::field("model", "has other coefficients than are given");
        Self::from_parameters(document.model.into(), &document.parameters()?).ok_or_else(wrong)
    }
}

/// Standard deviations of a lens's parameters, by the same names; 0 for one that was fixed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LensStdDocument {
    /// Of fx, in pixels.
    pub fx: f64,
    /// Of fy, in pixels.
    pub fy: f64,
    /// Of cx, in pixels.
    pub cx: f64,
    /// Of cy, in pixels.
    pub cy: f64,
    /// Of skew, in pixels.
    #[serde(default)]
    pub skew: f64,
    /// Of k1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
    /// Of k2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k2: Option<f64>,
    /// Of p1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p1: Option<f64>,
    /// Of p2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p2: Option<f64>,
    /// Of k3.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k3: Option<f64>,
    /// Of k4.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k4: Option<f64>,
    /// Of k5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k5: Option<f64>,
    /// Of k6.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k6: Option<f64>,
}

impl LensStdDocument {
    /// From values in the order of [`Lens::parameter_names`].
    pub fn new(model: LensModel, std: &[f64]) -> Self {
        let LensDocument { fx, fy, cx, cy, skew, k1, k2, p1, p2, k3, k4, k5, k6, .. } =
            LensDocument::new(model, std);
        Self { fx, fy, cx, cy, skew, k1, k2, p1, p2, k3, k4, k5, k6 }
    }

    /// The values in the order of [`Lens::parameter_names`].
    ///
    /// # Errors
    /// [`DocumentError::Field`] naming a coefficient that is missing or that the model does not
    /// have.
    pub fn to_values(&self, model: LensModel) -> Result<Vec<f64>, DocumentError> {
        let &Self { fx, fy, cx, cy, skew, k1, k2, p1, p2, k3, k4, k5, k6 } = self;
        LensDocument { model: model.into(), fx, fy, cx, cy, skew, k1, k2, p1, p2, k3, k4, k5, k6 }
            .parameters()
    }
}

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
}
