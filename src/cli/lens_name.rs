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
                PossibleValue::new("auto").help("the model with the smallest held-out error")
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
