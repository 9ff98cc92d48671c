//! Options of training, declared once: see [`super::TrainSettings`].

use super::choices::{ImportanceType, OptimizerType, SplitType, StrategyType};
use super::settings::TrainSettings;
use crate::error::{Error, Result};

/// Bounds of an option's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounds {
    /// Any value of the type.
    None,
    /// A whole number of at least this.
    AtLeast(u32),
    /// A whole number of at most this.
    AtMost(u32),
    /// A number above 0, up to a million.
    Positive,
    /// A number from 0 to a million.
    NotNegative,
    /// A number from 0 to 1.
    Share,
}

/// Type of an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionKind {
    /// A whole number, 0 or more.
    Integer,
    /// A number.
    Number,
    /// True or false.
    Switch,
    /// One of these names.
    Choice(&'static [&'static str]),
}

/// Value of an option.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OptionValue {
    /// Value of an [`OptionKind::Integer`].
    Integer(u32),
    /// Value of an [`OptionKind::Number`].
    Number(f64),
    /// Value of an [`OptionKind::Switch`].
    Switch(bool),
    /// Value of an [`OptionKind::Choice`].
    Choice(&'static str),
}

impl std::fmt::Display for OptionValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Integer(value) => write!(f, "{value}"),
            Self::Number(value) => write!(f, "{value}"),
            Self::Switch(value) => write!(f, "{value}"),
            Self::Choice(value) => write!(f, "{value}"),
        }
    }
}

/// Declaration of an option of training.
#[derive(Clone, Copy, Debug)]
pub struct TrainOption {
    /// Name of the option and of its field.
    pub name: &'static str,
    /// Lines of the description.
    pub about: &'static [&'static str],
    /// Type of the value.
    pub kind: OptionKind,
    /// Bounds of the value.
    pub bounds: Bounds,
    /// Returns the value in the given settings.
    pub value: fn(&TrainSettings) -> OptionValue,
}

impl TrainOption {
    /// Checks the value in the given settings.
    ///
    /// # Errors
    /// [`Error::Argument`] with the name, the value and the allowed range.
    pub fn check(&self, settings: &TrainSettings) -> Result<()> {
        /// Upper limit of all numbers; larger ones are mistakes.
        const LARGEST: f64 = 1e6;
        let value = (self.value)(settings);
        let (fits, wanted) = match (self.bounds, value) {
            (Bounds::AtLeast(low), OptionValue::Integer(x)) => (x >= low, format!("at least {low}")),
            (Bounds::AtMost(high), OptionValue::Integer(x)) => (x <= high, format!("0 to {high}")),
            (Bounds::Positive, OptionValue::Number(x)) => {
                ((f64::MIN_POSITIVE..=LARGEST).contains(&x), format!("above 0, at most {LARGEST}"))
            }
            (Bounds::NotNegative, OptionValue::Number(x)) => {
                ((0.0..=LARGEST).contains(&x), format!("0 to {LARGEST}"))
            }
            (Bounds::Share, OptionValue::Number(x)) => ((0.0..=1.0).contains(&x), "between 0 and 1".into()),
            (Bounds::None, _) => (true, String::new()),
            // The declared bounds do not match the type.
            _ => (false, "of the type of its bounds".into()),
        };
        match fits {
            true => Ok(()),
            false => Err(Error::argument(self.name, format!("is {value}, must be {wanted}"))),
        }
    }

    /// Returns the default value.
    pub fn default_value(&self) -> OptionValue {
        (self.value)(&TrainSettings::default())
    }
}

/// A type that an option can have.
pub(super) trait IsOption: Copy {
    const KIND: OptionKind;
    fn value(self) -> OptionValue;
}

impl IsOption for u32 {
    const KIND: OptionKind = OptionKind::Integer;
    fn value(self) -> OptionValue {
        OptionValue::Integer(self)
    }
}

impl IsOption for f64 {
    const KIND: OptionKind = OptionKind::Number;
    fn value(self) -> OptionValue {
        OptionValue::Number(self)
    }
}

impl IsOption for bool {
    const KIND: OptionKind = OptionKind::Switch;
    fn value(self) -> OptionValue {
        OptionValue::Switch(self)
    }
}

/// Declares the names of an enumeration's values, in the order of the values.
macro_rules! choice {
    ($kind:ty, $($name:literal = $value:path),*) => {
        impl IsOption for $kind {
            const KIND: OptionKind = OptionKind::Choice(&[$($name),*]);
            fn value(self) -> OptionValue {
                OptionValue::Choice(match self { $($value => $name),* })
            }
        }
    };
}

choice!(OptimizerType, "default" = OptimizerType::Default, "sparse_adam" = OptimizerType::SparseAdam);
choice!(
    StrategyType,
    "reference" = StrategyType::Reference,
    "fixed" = StrategyType::Fixed,
    "mcmc" = StrategyType::Mcmc,
    "budget" = StrategyType::Budget
);
choice!(SplitType, "sample" = SplitType::Sample, "long-axis" = SplitType::LongAxis);
choice!(
    ImportanceType,
    "edges" = ImportanceType::Edges,
    "statistic" = ImportanceType::Statistic,
    "none" = ImportanceType::None
);

/// Declares the settings: a struct with documented fields, and a table of their types, defaults, bounds and descriptions.
macro_rules! options {
    ($(#[$about:meta])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $kind:ty = $default:expr, $bounds:expr;)*
    }) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
        pub struct $name { $($(#[doc = $doc])+ pub $field: $kind,)* }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $name {
            /// All settings in the order of declaration.
            pub const OPTIONS: &[$crate::trainer::options::TrainOption] = &[$(
                $crate::trainer::options::TrainOption {
                    name: stringify!($field),
                    about: &[$($doc),+],
                    kind: <$kind as $crate::trainer::options::IsOption>::KIND,
                    bounds: $bounds,
                    value: |settings| $crate::trainer::options::IsOption::value(settings.$field),
                },
            )*];

            /// Names and values of all settings, in the order of declaration.
            pub fn values(&self) -> Vec<(&'static str, OptionValue)> {
                Self::OPTIONS.iter().map(|option| (option.name, (option.value)(self))).collect()
            }
        }
    };
}
pub(super) use options;
