//! Options of training, declared once: see [`super::TrainSettings`].

use super::choices::{ImportanceType, OptimizerType, SplitType, StrategyType};
use super::settings::TrainSettings;
use crate::error::{Error, Result};

/// Values that an option may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounds {
    /// Any of its type.
    None,
    /// A whole number from this one on.
    AtLeast(u32),
    /// A whole number up to this one.
    AtMost(u32),
    /// A number above 0, up to a million.
    Positive,
    /// A number from 0 to a million.
    NotNegative,
    /// A number from 0 to 1.
    Share,
}

/// The type of an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionKind {
    /// A whole number, 0 or more.
    Integer,
    /// A number.
    Number,
    /// Yes or no.
    Switch,
    /// One of these names.
    Choice(&'static [&'static str]),
}

/// The value of an option.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OptionValue {
    /// Of [`OptionKind::Integer`].
    Integer(u32),
    /// Of [`OptionKind::Number`].
    Number(f64),
    /// Of [`OptionKind::Switch`].
    Switch(bool),
    /// Of [`OptionKind::Choice`].
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

/// An option of training, as it is declared.
#[derive(Clone, Copy, Debug)]
pub struct TrainOption {
    /// Its name: that of the field.
    pub name: &'static str,
    /// What it does: lines of text.
    pub about: &'static [&'static str],
    /// Its type.
    pub kind: OptionKind,
    /// Its bounds.
    pub bounds: Bounds,
    /// Its value in some settings.
    pub value: fn(&TrainSettings) -> OptionValue,
}

impl TrainOption {
    /// Checks the value in some settings.
    ///
    /// # Errors
    /// [`Error::Argument`] with the name, the value and what would be right.
    pub fn check(&self, settings: &TrainSettings) -> Result<()> {
        /// Larger numbers are mistakes.
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
            // A declaration whose bounds are of another type than its values.
            _ => (false, "of the type of its bounds".into()),
        };
        match fits {
            true => Ok(()),
            false => Err(Error::argument(self.name, format!("is {value}, must be {wanted}"))),
        }
    }

    /// The default.
    pub fn default_value(&self) -> OptionValue {
        (self.value)(&TrainSettings::default())
    }
}

/// A type of options.
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

/// Declares the settings: the fields with types, defaults, bounds and descriptions, and a table of them.
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
            /// Every setting, in the order of declaration.
            pub const OPTIONS: &[$crate::trainer::options::TrainOption] = &[$(
                $crate::trainer::options::TrainOption {
                    name: stringify!($field),
                    about: &[$($doc),+],
                    kind: <$kind as $crate::trainer::options::IsOption>::KIND,
                    bounds: $bounds,
                    value: |settings| $crate::trainer::options::IsOption::value(settings.$field),
                },
            )*];

            /// Every setting's name and value, in the order of declaration.
            pub fn values(&self) -> Vec<(&'static str, OptionValue)> {
                Self::OPTIONS.iter().map(|option| (option.name, (option.value)(self))).collect()
            }
        }
    };
}
pub(super) use options;
