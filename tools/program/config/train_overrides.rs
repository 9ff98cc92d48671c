//! Training settings on the command line.

use ashsplat::train::TrainSettings;
use ashsplat::train::settings::{OptionKind, OptionValue, TrainOption};
use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Arg, ArgMatches, Args, Command, FromArgMatches, value_parser};
use toml::{Table, Value};

/// Training settings that are given on the command line, by name. The options follow from
/// [`TrainSettings::OPTIONS`].
#[derive(Debug, Default)]
pub(super) struct TrainOverrides(pub(super) Table);

/// Earlier names of values: option, earlier name, current name.
const EARLIER_NAMES: [(&str, &str, &str); 1] = [("strategy", "default", "reference")];

/// Options with a letter, as in the reference.
const LETTERS: [(&str, char); 1] = [("white_background", 'w')];

/// Headings in `--help`, by options. Others are rates and schedules.
const HEADINGS: [(&str, &[&str]); 4] = [
    (
        "Density control",
        &[
            "strategy",
            "cap_",
            "noise_lr",
            "initial_",
            "percent_dense",
            "densif",
            "opacity_reset",
            "absgrad",
            "split",
            "importance",
            "growth_curve",
            "recovery",
            "min_opacity",
            "late_min_opacity",
        ],
    ),
    ("Exposures, lenses and poses", &["exposure", "lens_", "pose_"]),
    ("Loss", &["lambda_dssim", "opacity_reg", "scale_reg", "surface", "depth_", "dropout"]),
    (
        "Picture",
        &["white_background", "random_background", "antialiasing", "kernel_size", "filter_3d", "sh_degree"],
    ),
];

fn heading(name: &str) -> &'static str {
    let is_of = |(_, starts): &&(&str, &[&str])| starts.iter().any(|start| name.starts_with(start));
    HEADINGS.iter().find(is_of).map_or("Rates and schedules", |(heading, _)| heading)
}

/// The names of an option's values, including earlier ones.
fn choices(option: &str, names: &'static [&'static str]) -> PossibleValuesParser {
    let earlier = |name: &str| {
        let of = EARLIER_NAMES.iter().filter(|of| (of.0, of.2) == (option, name));
        of.map(|of| of.1).collect::<Vec<_>>()
    };
    PossibleValuesParser::new(names.iter().map(|name| PossibleValue::new(name).aliases(earlier(name))))
}

impl TrainOverrides {
    fn argument(option: &TrainOption) -> Arg {
        let about = option.about.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ");
        let default = match option.defaults()[..] {
            [(_, OptionValue::Switch(false))] => String::new(),
            ref all => {
                let all: Vec<String> = all.iter().map(|(name, value)| format!("{name}: {value}")).collect();
                format!(" [{}]", all.join(", "))
            }
        };
        let argument = Arg::new(option.name).long(option.name.replace('_', "-")).help(about + &default);
        let argument = argument.help_heading(heading(option.name));
        let argument = match LETTERS.iter().find(|(name, _)| *name == option.name) {
            Some((_, letter)) => argument.short(*letter),
            None => argument,
        };
        match option.kind {
            // A negative number gets an error about its range instead of being taken for an option.
            OptionKind::Integer => {
                argument.value_name("N").allow_negative_numbers(true).value_parser(value_parser!(u32))
            }
            OptionKind::Number => {
                argument.value_name("X").allow_negative_numbers(true).value_parser(value_parser!(f64))
            }
            OptionKind::Choice(names) => {
                argument.value_name("NAME").value_parser(choices(option.name, names))
            }
            OptionKind::Switch => argument
                .value_name("BOOL")
                .num_args(0..=1)
                .require_equals(true)
                .default_missing_value("true")
                .value_parser(value_parser!(bool)),
        }
    }
}

impl Args for TrainOverrides {
    fn augment_args(command: Command) -> Command {
        command.args(TrainSettings::OPTIONS.iter().map(Self::argument))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for TrainOverrides {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut overrides = Self::default();
        overrides.update_from_arg_matches(matches)?;
        Ok(overrides)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        for option in TrainSettings::OPTIONS {
            let name = option.name;
            let given: Option<Value> = match option.kind {
                OptionKind::Integer => matches.get_one::<u32>(name).map(|&value| i64::from(value).into()),
                OptionKind::Number => matches.get_one::<f64>(name).map(|&value| value.into()),
                OptionKind::Choice(_) => matches.get_one::<String>(name).map(|value| value.clone().into()),
                OptionKind::Switch => matches.get_one::<bool>(name).map(|&value| value.into()),
            };
            if let Some(value) = given {
                self.0.insert(name.into(), value);
            }
        }
        Ok(())
    }
}
