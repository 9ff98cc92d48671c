//! `--spec [KERNEL.]NAME=VALUE`: other values for specialization constants.

use crate::kernels;
use ashsplat::vk::{ConstantInfo, ConstantKind, ContextOptions, SpecOverride, is_kernel_of, is_yardstick};
use ashsplat::{Error, Result};

pub fn kernel_names() -> Vec<&'static str> {
    kernels::all().iter().map(|kernel| kernel.name).collect()
}

/// Parses a comma-separated list of settings; "-" is an empty list.
pub fn parse_list(text: &str) -> Result<Vec<SpecOverride>> {
    match text.trim() {
        "-" => Ok(Vec::new()),
        "" => Err(Error::argument("--ab", "a setting is empty; write - for none")),
        text => parse_all("--ab", text.split(',')),
    }
}

/// Parses the settings of an option, in which each constant may appear once.
pub fn parse_all<'a>(option: &str, settings: impl Iterator<Item = &'a str>) -> Result<Vec<SpecOverride>> {
    let mut all: Vec<SpecOverride> = Vec::new();
    for setting in settings {
        let one = parse(option, setting.trim())?;
        if all.iter().any(|o| (&o.kernel, &o.constant) == (&one.kernel, &one.constant)) {
            return Err(Error::argument(
                format!("{option} {setting}"),
                "the constant is set twice; set it once",
            ));
        }
        all.push(one);
    }
    Ok(all)
}

/// Parses one setting, "backward/project_backward.LANE_INSTANCES=32", "sort.ITEMS=8" or "WORKGROUP_SIZE=128".
fn parse(option: &str, text: &str) -> Result<SpecOverride> {
    if text.is_empty() {
        return Err(Error::argument(option, "a setting is empty; write [KERNEL.]NAME=VALUE"));
    }
    let argument = |problem: String| Error::argument(format!("{option} {text}"), problem);
    let Some((place, value)) = text.split_once('=') else {
        return Err(argument("expected [KERNEL.]NAME=VALUE".into()));
    };
    let (kernel, name) = place.rsplit_once('.').unwrap_or(("", place));
    if is_yardstick(kernel) {
        let problem = "is the yardstick of the other kernels and keeps its constants; name another kernel";
        return Err(argument(format!("{kernel} {problem}")));
    }
    if !kernel.is_empty() && !kernel_names().iter().any(|k| is_kernel_of(k, kernel)) {
        let known = kernel_names().join(", ");
        return Err(argument(format!("there is no kernel or folder '{kernel}'; there are: {known}")));
    }
    let chosen = kernels::all().into_iter().filter(|k| kernel.is_empty() || is_kernel_of(k.name, kernel));
    let constants: Vec<&ConstantInfo> =
        chosen.filter(|k| !is_yardstick(k.name)).flat_map(|k| k.constants).collect();
    let Some(constant) = constants.iter().find(|c| c.name == name) else {
        let mut names: Vec<&str> = constants.iter().map(|c| c.name).collect();
        names.sort_unstable();
        names.dedup();
        let whose = if kernel.is_empty() { "any kernel".to_owned() } else { kernel.to_owned() };
        return Err(argument(format!("no constant '{name}' in {whose}; there are: {}", names.join(", "))));
    };
    let bits =
        bits(constant.kind, value).ok_or_else(|| argument(format!("'{value}' is no {:?}", constant.kind)))?;
    check_place(kernel, name).map_err(argument)?;
    if ["WORKGROUP_SIZE", "SUBGROUP_SIZE"].contains(&name) && !bits.is_power_of_two() {
        return Err(argument(format!("{value} is no power of two")));
    }
    let (min, max) = match name {
        "WORKGROUP_SIZE" => (1, 1024),
        "SUBGROUP_SIZE" => (4, 128),
        // Loops of these lengths are unrolled.
        "STRIP" | "REGIONS_PER_SUBGROUP" => (1, 64),
        "ITEMS" => (1, 1 << 14),
        _ => (0, u32::MAX),
    };
    if constant.kind == ConstantKind::Uint && !(min..=max).contains(&bits) {
        return Err(argument(format!("{value} is not within {min} to {max}")));
    }
    Ok(SpecOverride { kernel: kernel.to_owned(), constant: name.to_owned(), bits })
}

fn bits(kind: ConstantKind, value: &str) -> Option<u32> {
    match kind {
        ConstantKind::Uint => value.parse().ok(),
        ConstantKind::Int => value.parse::<i32>().ok().map(|v| v as u32),
        ConstantKind::Float => value.parse::<f32>().ok().map(f32::to_bits),
        ConstantKind::Bool => match value {
            "true" | "1" => Some(1),
            "false" | "0" => Some(0),
            _ => None,
        },
    }
}

/// Refuses to change, for single kernels, sizes with which the host counts workgroups of several kernels.
fn check_place(kernel: &str, name: &str) -> Result<(), String> {
    let shared: &[&str] = match name {
        "WORKGROUP_SIZE" => &["", "sort", "loss"],
        "SUBGROUP_SIZE" => &[""],
        "ITEMS" => &["sort", "scan"],
        "STRIP" => &["loss"],
        "REGION_HEIGHT" => return Err("how high regions are follows from the device".into()),
        "WHOLE_ROWS" => return Err("who scans a row follows from the device".into()),
        "STRIPS" => return Err("how kernels hand pictures on follows from the device".into()),
        _ => return Ok(()),
    };
    if shared.contains(&kernel) {
        return Ok(());
    }
    let forms: Vec<String> = shared
        .iter()
        .map(|folder| if folder.is_empty() { name.to_owned() } else { format!("{folder}.{name}") })
        .collect();
    Err(format!("kernels share this size with the host; it can be set as {}", forms.join(", ")))
}

pub fn apply(options: &mut ContextOptions, overrides: &[SpecOverride]) {
    for o in overrides {
        if o.constant == "SUBGROUP_SIZE" {
            options.subgroup_size = Some(o.bits);
        }
    }
    options.overrides = overrides.to_vec();
}
