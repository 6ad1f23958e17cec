//! A threshold's value, unit and origin, and how the sensitivity bench visits and scales it.

/// Where a threshold's value comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ThresholdOrigin {
    /// Follows from what is said.
    Derived(&'static str),
    /// Chosen where the figures are flat: the bench's table says how flat.
    Swept,
}

/// A threshold as the sensitivity bench sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct ThresholdEntry {
    /// Stage and field: `candidates.least_score`.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Where the value comes from.
    pub origin: ThresholdOrigin,
}

/// A number that the bench may scale.
pub(super) trait Scale {
    fn value(&self) -> f64;
    /// Multiplies; whole numbers change by one at least.
    fn scale(&mut self, factor: f64);
}

macro_rules! scale_floats {
    ($($type:ty),*) => {$(
        impl Scale for $type {
            fn value(&self) -> f64 {
                // As it is written: 0.35, not the nearest float's 0.3499999940395355.
                self.to_string().parse().unwrap_or(f64::NAN)
            }
            fn scale(&mut self, factor: f64) {
                *self = (f64::from(*self) * factor) as $type;
            }
        }
    )*};
}
scale_floats!(f32, f64);

macro_rules! scale_counts {
    ($($type:ty),*) => {$(
        impl Scale for $type {
            fn value(&self) -> f64 {
                *self as f64
            }
            fn scale(&mut self, factor: f64) {
                let scaled = (*self as f64 * factor).round() as $type;
                *self = if scaled != *self {
                    scaled
                } else if factor > 1.0 {
                    *self + 1
                } else {
                    self.saturating_sub(1).max(0)
                };
            }
        }
    )*};
}
scale_counts!(u8, u32, i32, usize);

/// Numbers that are scaled together; the first stands for them.
impl<const N: usize> Scale for [f64; N] {
    fn value(&self) -> f64 {
        self.first().map_or(f64::NAN, Scale::value)
    }
    fn scale(&mut self, factor: f64) {
        self.iter_mut().for_each(|number| number.scale(factor));
    }
}

/// What is visited of each threshold: name, unit, origin, the number.
pub(super) type Visitor<'a> =
    dyn FnMut(&'static str, &'static str, ThresholdOrigin, &mut dyn Scale) + 'a;

/// A struct of thresholds, its default values, and a visit of each.
macro_rules! thresholds {
    ($(#[$doc:meta])* $name:ident {
        $($(#[$field_doc:meta])* $field:ident: $type:ty = $value:expr, $unit:literal, $origin:expr;)*
    }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl $name {
            /// The values in use.
            pub const DEFAULT: Self = Self { $($field: $value,)* };

            pub(super) fn visit(&mut self, visit: &mut $crate::detection::thresholds::entry::Visitor<'_>) {
                $(visit(stringify!($field), $unit, $origin, &mut self.$field);)*
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::DEFAULT
            }
        }
    };
}

pub(super) use thresholds;
