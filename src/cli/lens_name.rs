//! The lens models by their names on the command line.

use std::sync::LazyLock;

use clap::ValueEnum;
use clap::builder::PossibleValue;

use crate::estimation::problem::LensChoice;
use crate::geometry::lens::LensModel;

/// Which lens model to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LensName(LensChoice);

impl ValueEnum for LensName {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<LensName>> = LazyLock::new(|| {
            let models = LensModel::ALL.into_iter().map(LensChoice::Model);
            std::iter::once(LensChoice::Auto).chain(models).map(LensName).collect()
        });
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self.0 {
            LensChoice::Auto => {
                let help = "the simplest model that no larger one beats on held-out views";
                PossibleValue::new("auto").help(help)
            }
            LensChoice::Model(model) => {
                PossibleValue::new(model.name()).help(model.facts().summary)
            }
        })
    }
}

impl From<LensName> for LensChoice {
    fn from(name: LensName) -> Self {
        name.0
    }
}

/// Which lens model to fit to a scene, where `auto` has no held-out views to compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneLensName(LensName);

impl ValueEnum for SceneLensName {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<SceneLensName>> = LazyLock::new(|| {
            LensName::value_variants().iter().copied().map(SceneLensName).collect()
        });
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let value = self.0.to_possible_value()?;
        Some(match self.0.0 {
            LensChoice::Auto => {
                value.help("the simplest model that no larger one fits significantly better")
            }
            LensChoice::Model(_) => value,
        })
    }
}

impl From<SceneLensName> for LensChoice {
    fn from(name: SceneLensName) -> Self {
        name.0.into()
    }
}
