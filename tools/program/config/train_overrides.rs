//! Training settings on the command line.

use ashsplat::train::TrainSettings;
use ashsplat::train::settings::{OptionKind, OptionValue, TrainOption};
use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Arg, ArgMatches, value_parser};
use toml::{Table, Value};

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
        &[
            "white_background",
            "random_background",
            "antialiasing",
            "kernel_size",
            "filter_3d",
            "distance_order",
            "sh_degree",
        ],
    ),
];

fn heading(name: &str) -> &'static str {
    let is_of = |(_, starts): &&(&str, &[&str])| starts.iter().any(|start| name.starts_with(start));
    HEADINGS.iter().find(is_of).map_or("Rates and schedules", |(heading, _)| heading)
}

/// The values of an option, and the former name of one.
fn choices(option: &str, names: &'static [&'static str]) -> PossibleValuesParser {
    let earlier = |name: &str| ((option, name) == ("strategy", "reference")).then_some("default");
    PossibleValuesParser::new(names.iter().map(|name| PossibleValue::new(name).aliases(earlier(name))))
}

pub(super) fn arguments() -> impl Iterator<Item = Arg> {
    TrainSettings::OPTIONS.iter().map(argument)
}

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
    // The reference has this letter too.
    let argument = argument.short((option.name == "white_background").then_some('w'));
    let argument = argument.help_heading(heading(option.name));
    match option.kind {
        // A negative number gets an error about its range instead of being taken for an option.
        OptionKind::Integer => {
            argument.value_name("N").allow_negative_numbers(true).value_parser(value_parser!(u32))
        }
        OptionKind::Number => {
            argument.value_name("X").allow_negative_numbers(true).value_parser(value_parser!(f64))
        }
        OptionKind::Choice(names) => argument.value_name("NAME").value_parser(choices(option.name, names)),
        OptionKind::Switch => argument
            .value_name("BOOL")
            .num_args(0..=1)
            .require_equals(true)
            .default_missing_value("true")
            .value_parser(value_parser!(bool)),
    }
}

/// The training settings that are given on the command line, by name.
pub(super) fn given(matches: &ArgMatches) -> Table {
    let value = |option: &TrainOption| -> Option<Value> {
        let name = option.name;
        match option.kind {
            OptionKind::Integer => matches.get_one::<u32>(name).map(|&value| i64::from(value).into()),
            OptionKind::Number => matches.get_one::<f64>(name).map(|&value| value.into()),
            OptionKind::Choice(_) => matches.get_one::<String>(name).map(|value| value.clone().into()),
            OptionKind::Switch => matches.get_one::<bool>(name).map(|&value| value.into()),
        }
    };
    TrainSettings::OPTIONS
        .iter()
        .filter_map(|option| Some((option.name.to_owned(), value(option)?)))
        .collect()
}
